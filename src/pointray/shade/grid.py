"""The grid in which light is baked on a plane: even around the scene's middle, it reaches to infinity beyond it.

A coordinate x of the plane, in half widths of the middle part, becomes x / (1 + |x|), from -1 to 1. So cells grow with
the square of their distance: far from everything light changes slowly.
"""

from __future__ import annotations

import math

from ..engine.jit import Array, inline
from ..engine.kernels.records import (
    BAKED_FRAME,
    GRID_EDGE,
    GRID_HALF,
    GRID_MIDDLE,
    PLANE_NORMAL,
    PLANE_POINT,
    PLANE_SIZE,
    PLANE_U,
    PLANE_V,
    World,
)
from ..engine.kernels.vec import Vec3, add, dot, load3_flat, scale, sub

MOST_WALLS = 64  # planes up to which each is asked whether it stands between two points

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
def _from_grid(u: float) -> float:
    return u / (1.0 - abs(u))


@inline
def cell_middle(world: World, plane: int, frame: Frames, cell: int) -> Vec3:
    """The middle of a cell, in the world."""
    edge = int(frame[3])
    a = _from_grid((cell % edge + 0.5) / frame[3] * 2.0 - 1.0) * frame[2] + frame[0]
    b = _from_grid((cell // edge + 0.5) / frame[3] * 2.0 - 1.0) * frame[2] + frame[1]
    u, v = load3_flat(world.planes, plane + PLANE_U), load3_flat(world.planes, plane + PLANE_V)
    return add(load3_flat(world.planes, plane + PLANE_POINT), add(scale(u, a), scale(v, b)))


@inline
def _is_walled_off(world: World, plane: int, x: Vec3, y: Vec3) -> bool:
    """Whether another plane stands between two points of a plane."""
    if world.planes.size > MOST_WALLS * PLANE_SIZE:
        return False
    for other in range(0, world.planes.size, PLANE_SIZE):
        if other != plane:
            normal, point = (
                load3_flat(world.planes, other + PLANE_NORMAL),
                load3_flat(world.planes, other + PLANE_POINT),
            )
            if dot(normal, sub(x, point)) * dot(normal, sub(y, point)) < 0.0:
                return True
    return False


@inline
def corner_cell(world: World, plane: int, frame: Frames, x: Vec3, corner: int) -> tuple[int, float]:
    """(one of the four cells around a point of a plane, its share of the light there); the shares sum to 1 or less.

    A cell behind another plane, which stands on this one as a wall, has no share.
    """
    column, row = grid_place(world, plane, frame, x)
    left, top = math.floor(column - 0.5), math.floor(row - 0.5)
    across, down = column - 0.5 - left, row - 0.5 - top
    right, below = corner % 2, corner // 2
    cell = in_grid(int(top) + below, int(left) + right, int(frame[3]))
    share = (across if right == 1 else 1.0 - across) * (down if below == 1 else 1.0 - down)
    if world.planes.size > PLANE_SIZE and _is_walled_off(world, plane, x, cell_middle(world, plane, frame, cell)):
        share = 0.0
    return cell, share


@inline
def grid_cell(world: World, plane: int, frame: Frames, x: Vec3) -> int:
    """The number of the cell whose light is nearest to that of a point of a plane."""
    best, most = corner_cell(world, plane, frame, x, 0)
    for corner in range(1, 4):
        cell, share = corner_cell(world, plane, frame, x, corner)
        best, most = (cell, share) if share > most else (best, most)
    return best
