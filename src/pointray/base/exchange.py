"""Place of the conversions between `Points` and objects of other libraries, which `io/exchange/` registers.

`cloud/` offers them as methods of `Points`, and must not import `io/`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_LOADERS: list[Callable[[], Any]] = []


def register_exchange(load: Callable[[], Any]) -> None:
    """Set the function that imports and returns the module with the conversions."""
    _LOADERS[:] = [load]


def exchange() -> Any:
    """Import and return the module with the conversions: `as_points`, `to_open3d`, `to_pyvista`, ..."""
    return _LOADERS[0]()
