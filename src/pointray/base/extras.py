"""Optional packages: an error names the `pip install` that brings a missing one, before any work is done."""

from __future__ import annotations

import importlib
from typing import Any


def require(module: str, extra: str, what: str) -> Any:
    """The module of an optional package; ValueError, which says how to install it, if it is absent.

    Parameters
    ----------
    extra : str
        The extra of pointray that installs it.
    what : str
        What needs it; the message begins with it: "a.exr".
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ValueError(f"{what} needs {module.replace('_', '-')}: pip install 'pointray[{extra}]'") from None
