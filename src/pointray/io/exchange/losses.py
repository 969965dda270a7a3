"""What a conversion to an object of another library cannot store, for one warning; free names of columns."""

from __future__ import annotations

import importlib
from collections.abc import Container, Sequence
from typing import Any

from ...base.extras import MissingPackageError
from ...base.warning_log import warn
from ...cloud.georeference import Georeference
from ..formats._named_columns import SPECIAL

STACK = 4  # frames from the caller of a public method to `warn_lost`


def package(name: str, what: str) -> Any:
    """Import and return a package that a conversion needs; MissingPackageError with the pip command if it is missing.

    what : the method that needs it, such as "to_open3d"
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        advice = f"pip install {name}" if isinstance(error, ModuleNotFoundError) and error.name == name else str(error)
        raise MissingPackageError(f"{what} needs {name}: {advice}") from None


def warn_lost(what: str, lost: Sequence[str]) -> None:
    """Issue one warning about all that a conversion cannot store. what : the method; lost : texts for the user"""
    if lost:
        warn(f"{what}: {'; '.join(lost)}", stacklevel=STACK)


def lost_georeference(georeference: Georeference, *kept: str) -> list[str]:
    """Describe the parts of a georeference that an object cannot store. kept : names of fields that it does store"""
    names = {"crs": "coordinate system", "unit": "unit", "stations": "scanner positions"}
    there = [text for name, text in names.items() if name not in kept and getattr(georeference, name)]
    return [f"cannot store the {' and the '.join(there)}"] if there else []


def free_name(name: str, taken: Container[str], lost: list[str]) -> str:
    """Return a name for an attribute that is not taken and has no special meaning: its own, or one with a number.

    taken : names in use; lost : receives a description of a change
    """
    new, k = name, 2
    while new in taken or new.lower() in SPECIAL:
        new, k = f"{name}_{k}", k + 1
    if new != name:
        lost.append(f"attribute {name!r} is called {new!r}")
    return new
