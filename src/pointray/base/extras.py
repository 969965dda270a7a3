"""Import of optional packages, with installation instructions if one is missing."""

from __future__ import annotations

import importlib
from typing import Any


def require(module: str, extra: str, what: str) -> Any:
    """Import a module of an optional package; raise ValueError with the `pip install` command if it is missing.

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
        raise ValueError(f"{what} needs {module.replace('_', '-')}: pip install 'pointray[{extra}]'") from None
