"""Import of optional packages, with installation instructions if one is missing."""

from __future__ import annotations

import importlib
from typing import Any

from .manual import with_note


class MissingPackageError(ImportError, ValueError):
    """Error for a missing optional package. Also a ValueError, which earlier releases raised."""


def require(module: str, extra: str, what: str) -> Any:
    """Import and return a module of an optional package; if missing, raise an error with the `pip install` command.

    Parameters
    ----------
    extra : str
        Optional dependency group of pointray that contains it.
    what : str
        What needs it, such as "a.exr"; the message begins with it.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        message = f"{what} needs {module.replace('_', '-')}: pip install 'pointray[{extra}]'"
        raise with_note(MissingPackageError(message)) from None
