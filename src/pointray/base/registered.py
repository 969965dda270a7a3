"""Modules of higher rooms that lower ones use, imported when they are needed: `__init__.py` of the package lists them.

"exchange": conversions between `Points` and objects of other libraries, for `cloud/`
"default_scene": the scene that the command line makes of a scan, for `rendering/` and `baking/`
"meshing": triangle meshes by ray queries, for `model/`
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_LOADERS: dict[str, Callable[[], Any]] = {}


def register(name: str, load: Callable[[], Any]) -> None:
    """Set the function that imports and returns a module. name : by which lower rooms know it"""
    _LOADERS[name] = load


def registered(name: str) -> Any:
    """Import and return a module that is registered by this name."""
    return _LOADERS[name]()
