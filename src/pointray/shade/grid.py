"""The grid in which light is baked on a plane: even around the scene's middle, it reaches to infinity beyond it.

A coordinate x of the plane, in half widths of the middle part, becomes x / (1 + |x|), from -1 to 1. So cells grow with
the square of their distance: far from everything light changes slowly.
"""

from __future__ import annotations

import math

from ..jit import Array, inline
from ..kernels.records import BAKED_FRAME, GRID_EDGE, GRID_HALF, GRID_MIDDLE, PLANE_POINT, PLANE_U, PLANE_V, World
from ..kernels.vec import Vec3, dot, load3_flat, sub

Frames = tuple[float, float, float, float]


@inline
def to_grid(x: float) -> float:
    """From half widths, any number, to -1..1."""
    return x / (1.0 + abs(x))


@inline
def grid_frame(frames: Array, instance: int) -> Frames:
    """The grid of a plane: its middle (u, v), half width, and cells a side. frames : see `records.BAKED_FRAME`"""
    k = instance * BAKED_FRAME
    return frames[k + GRID_MIDDLE], frames[k + GRID_MIDDLE + 1], frames[k + GRID_HALF], frames[k + GRID_EDGE]


@inline
def grid_place(world: World, plane: int, frame: Frames, x: Vec3) -> tuple[float, float]:
    """(column, row) of a point of a plane in its grid, in cells; whole numbers are the cells' edges."""
    v = sub(x, load3_flat(world.planes, plane + PLANE_POINT))
    a = (dot(v, load3_flat(world.planes, plane + PLANE_U)) - frame[0]) / frame[2]
    b = (dot(v, load3_flat(world.planes, plane + PLANE_V)) - frame[1]) / frame[2]
    return (to_grid(a) * 0.5 + 0.5) * frame[3], (to_grid(b) * 0.5 + 0.5) * frame[3]


@inline
def in_grid(row: int, column: int, edge: int) -> int:
    """The number of a cell; beyond the grid's edge that of the nearest one."""
    return min(max(row, 0), edge - 1) * edge + min(max(column, 0), edge - 1)


@inline
def grid_cell(world: World, plane: int, frame: Frames, x: Vec3) -> int:
    """The number of the cell in which a point of a plane lies."""
    column, row = grid_place(world, plane, frame, x)
    return in_grid(int(math.floor(row)), int(math.floor(column)), int(frame[3]))
