"""Packages that not every installation has: which `pip install` brings one is said before any work is done."""

from __future__ import annotations

import importlib
from typing import Any


def require(module: str, extra: str, what: str) -> Any:
    """The module of an optional package; ValueError, which says how to install it, if it is absent.

    Parameters
    ----------
    extra : str
        The extra of pointray that brings it.
    what : str
        What needs it, as the message begins: "a.exr".
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ValueError(f"{what} needs {module.replace('_', '-')}: pip install 'pointray[{extra}]'") from None
