"""The grid of baked light on a plane: fine around the centre of the scene, extending to infinity.

A plane coordinate x, in half widths of the central part, maps to x / (1 + |x|), from -1 to 1. Cells thus grow with the
square of the distance: far from the scene light varies slowly.
"""

from __future__ import annotations

import math

from ..engine.jit import Array, inline
from ..engine.kernels import records as rec
from ..engine.kernels.records import World
from ..engine.kernels.vec import Vec3, add, dot, load3_flat, scale, sub

MOST_WALLS = 64  # with more planes, cells are not tested for planes in between

Frames = tuple[float, float, float, float]


@inline
def to_grid(x: float) -> float:
    """Map a plane coordinate, in units of half the scene's width, to a position in its light's grid, -1 to 1."""
    return x / (1.0 + abs(x))


@inline
def grid_frame(frames: Array, instance: int) -> Frames:
    """Return the grid of baked light on a plane: (u, v of its centre, half the scene's width, cells along each side).

    frames : flat, for each instance five numbers, see `records.BAKED_FRAME`
    """
    k = instance * rec.BAKED_FRAME
    return (
        frames[k + rec.GRID_MIDDLE],
        frames[k + rec.GRID_MIDDLE + 1],
        frames[k + rec.GRID_HALF],
        frames[k + rec.GRID_EDGE],
    )


@inline
def grid_place(world: World, plane: int, frame: Frames, x: Vec3) -> tuple[float, float]:
    """Return (column, row) of a world point on a plane in its grid of baked light; cell edges are at whole numbers.

    plane : offset of its record in `world.planes`; frame : the grid, from `grid_frame`
    """
    v = sub(x, load3_flat(world.planes, plane + rec.PLANE_POINT))
    a = (dot(v, load3_flat(world.planes, plane + rec.PLANE_U)) - frame[0]) / frame[2]
    b = (dot(v, load3_flat(world.planes, plane + rec.PLANE_V)) - frame[1]) / frame[2]
    return (to_grid(a) * 0.5 + 0.5) * frame[3], (to_grid(b) * 0.5 + 0.5) * frame[3]


@inline
def in_grid(row: int, column: int, edge: int) -> int:
    """Return the index of a cell, row * edge + column, with both clamped to 0..edge - 1."""
    return min(max(row, 0), edge - 1) * edge + min(max(column, 0), edge - 1)


@inline
def _from_grid(u: float) -> float:
    return u / (1.0 - abs(u))


@inline
def cell_center(world: World, plane: int, frame: Frames, cell: int) -> Vec3:
    """Return the centre of a cell of the grid of baked light on a plane, in world space.

    plane : offset of its record in `world.planes`; frame : the grid, from `grid_frame`; cell : index of the cell
    """
    edge = int(frame[3])
    a = _from_grid((cell % edge + 0.5) / frame[3] * 2.0 - 1.0) * frame[2] + frame[0]
    b = _from_grid((cell // edge + 0.5) / frame[3] * 2.0 - 1.0) * frame[2] + frame[1]
    u, v = load3_flat(world.planes, plane + rec.PLANE_U), load3_flat(world.planes, plane + rec.PLANE_V)
    return add(load3_flat(world.planes, plane + rec.PLANE_POINT), add(scale(u, a), scale(v, b)))


@inline
def _is_walled_off(world: World, plane: int, x: Vec3, y: Vec3) -> bool:
    """Return whether another plane separates two points of a plane, so that they receive different light.

    It always returns False in scenes with more than MOST_WALLS planes.

    plane : offset of its record in `world.planes`; x, y : the points, world space
    """
    if world.planes.size > MOST_WALLS * rec.PLANE_SIZE:
        return False
    for other in range(0, world.planes.size, rec.PLANE_SIZE):
        if other != plane:
            normal, point = (
                load3_flat(world.planes, other + rec.PLANE_NORMAL),
                load3_flat(world.planes, other + rec.PLANE_POINT),
            )
            if dot(normal, sub(x, point)) * dot(normal, sub(y, point)) < 0.0:
                return True
    return False


@inline
def corner_cell(world: World, plane: int, frame: Frames, x: Vec3, corner: int) -> tuple[int, float]:
    """Return (index, bilinear weight) of one of the four cells of baked light around a world point on a plane.

    A cell behind another plane, such as a wall, has weight 0, so the four weights sum to at most 1.

    plane : offset of its record in `world.planes`; frame : the grid, from `grid_frame`; corner : which cell, 0 to 3
    """
    column, row = grid_place(world, plane, frame, x)
    left, top = math.floor(column - 0.5), math.floor(row - 0.5)
    across, down = column - 0.5 - left, row - 0.5 - top
    right, below = corner % 2, corner // 2
    cell = in_grid(int(top) + below, int(left) + right, int(frame[3]))
    share = (across if right == 1 else 1.0 - across) * (down if below == 1 else 1.0 - down)
    if world.planes.size > rec.PLANE_SIZE and _is_walled_off(world, plane, x, cell_center(world, plane, frame, cell)):
        share = 0.0
    return cell, share


@inline
def grid_cell(world: World, plane: int, frame: Frames, x: Vec3) -> int:
    """Return the index of the cell of baked light that has the largest bilinear weight at a world point on a plane.

    plane : offset of its record in `world.planes`; frame : the grid, from `grid_frame`
    """
    best, most = corner_cell(world, plane, frame, x, 0)
    for corner in range(1, 4):
        cell, share = corner_cell(world, plane, frame, x, corner)
        best, most = (cell, share) if share > most else (best, most)
    return best
