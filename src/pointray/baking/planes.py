"""Patches of a plane: the cells of its grid, see `shade/grid.py`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles
from ..engine.kernels.records import PLANE_CHECKER, PLANE_COLOR, PLANE_NORMAL, PLANE_POINT, PLANE_U, PLANE_V

FINE = 4  # colour samples along each side of a cell


class Grid(NamedTuple):
    """Grid on a plane whose cells hold its baked light: fine around the scene, coarser far away, unbounded.

    edge : number of cells along each side, even; middle : coordinates (u, v) of the centre along the plane's axes
    half : half the width of the scene on the plane; half of the cells along each axis lie within that width
    """

    edge: int
    middle: tuple[float, float]
    half: float


def from_grid(u: Doubles) -> Doubles:
    """Map grid positions, -1 to 1, to plane coordinates in units of half the scene's width: u / (1 - |u|)."""
    return np.asarray(u / (1.0 - np.abs(u)))


def fit_grid(record: Doubles, bounds: Doubles, edge: int) -> Grid:
    """Return a grid for the light on a plane, centred on the scene.

    record : the plane, as in `World.planes`; bounds : (2, 3), box around the scene; edge : number of cells along each
        side
    """
    corners = np.stack(np.meshgrid(*bounds.T), axis=-1).reshape(-1, 3) - record[PLANE_POINT : PLANE_POINT + 3]
    axes = np.stack([record[PLANE_U : PLANE_U + 3], record[PLANE_V : PLANE_V + 3]])
    places = corners @ axes.T
    low, high = places.min(axis=0), places.max(axis=0)
    u, v = ((low + high) / 2.0).tolist()
    return Grid(edge, (u, v), float(max((high - low).max() / 2.0, 1e-9)))


def grid_positions(record: Doubles, grid: Grid, fine: int = 1) -> Doubles:
    """Return world positions of the cell centres of a plane's grid, (edge * edge, 3), row by row.

    record : the plane, as in `World.planes`; fine : n for a raster with n x n points per cell, (edge^2 * n^2, 3)
    """
    steps = from_grid((np.arange(grid.edge * fine) + 0.5) / (grid.edge * fine) * 2.0 - 1.0) * grid.half
    u, v = record[PLANE_U : PLANE_U + 3], record[PLANE_V : PLANE_V + 3]
    along = (steps + grid.middle[0])[None, :, None] * u + (steps + grid.middle[1])[:, None, None] * v
    return np.asarray((along + record[PLANE_POINT : PLANE_POINT + 3]).reshape(-1, 3))


def grid_colors(record: Doubles, grid: Grid) -> Doubles:
    """Return the mean colour of a plane, or of its checker pattern, in each cell of its grid, (edge * edge, 3).

    record : the plane, as in `World.planes`
    """
    color = record[PLANE_COLOR : PLANE_COLOR + 3]
    if record[PLANE_CHECKER] <= 0.0:
        return np.broadcast_to(color, (grid.edge**2, 3)).copy()
    v = grid_positions(record, grid, FINE) - record[PLANE_POINT : PLANE_POINT + 3]
    a, b = (np.floor(v @ record[k : k + 3] / record[PLANE_CHECKER]) for k in (PLANE_U, PLANE_V))
    shade = np.where((a + b) % 2 != 0, 0.5, 1.0)
    cells = shade.reshape(grid.edge, FINE, grid.edge, FINE).mean(axis=(1, 3))
    return np.asarray(cells.reshape(-1, 1) * color)


def grid_neighbors(grid: Grid, count: int, middles: Doubles, walls: list[Doubles]) -> NDArray[np.int32]:
    """Return the nearest cells around each cell of a plane's grid, (edge * edge, count) int32, padded with -1.

    Of cells at the same distance either all are included or none.

    middles : (edge * edge, 3), cell centres; walls : records of other planes, across which cells are not neighbours
    """
    edge = grid.edge
    reach = range(-3, 4)
    offsets = sorted(((a, b) for a in reach for b in reach if (a, b) != (0, 0)), key=lambda p: p[0] ** 2 + p[1] ** 2)
    rings = [o for o in offsets if sum(p[0] ** 2 + p[1] ** 2 <= o[0] ** 2 + o[1] ** 2 for p in offsets) <= count]
    row, column = np.divmod(np.arange(edge * edge), edge)
    out = np.full((edge * edge, count), -1, np.int32)
    for k, (a, b) in enumerate(rings):
        inside = (row + a >= 0) & (row + a < edge) & (column + b >= 0) & (column + b < edge)
        out[inside, k] = ((row + a) * edge + column + b)[inside]
    for wall in walls:
        before = (middles - wall[PLANE_POINT : PLANE_POINT + 3]) @ grid_normal(wall) > 0.0
        out[before[out] != before[:, None]] = -1
    return out


def grid_normal(record: Doubles) -> Doubles:
    """Return the unit normal of a plane, (3,). record : the plane, as in `World.planes`"""
    return record[PLANE_NORMAL : PLANE_NORMAL + 3]
