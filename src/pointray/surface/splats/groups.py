"""Groups of splats that share a grid cell and a main direction of their normals, and means over groups."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles, Flags, Floats, Rows
from ...cloud.neighbors import distinct
from ...engine.jit import Array, borrow, f32, f64, i64, kernel, next_tile, run

MOST_CELLS = 2**20  # along an axis
SIDES = 6  # main directions; the product with a cell number is exact in float32
CHUNK = 1 << 12  # splats or groups per tile


class Groups(NamedTuple):
    """Rows of n splats in m groups: group g is order[starts[g] : starts[g + 1]], ascending.

    order : (n,) int32; starts : (m + 1,) int64
    """

    order: NDArray[np.int32]
    starts: Rows

    def mean(self, values: Floats) -> Doubles:
        """Return the mean of `values` (n, ...) over each group, (m, ...) float64."""
        out = np.empty((len(self.starts) - 1, *values.shape[1:]))
        width = int(np.prod(values.shape[1:], dtype=int))
        tiles = -(-len(out) // CHUNK)
        run(_means, tiles, np.ascontiguousarray(values).reshape(-1), width, self.order, self.starts, out.reshape(-1))
        return out

    def reach(self, positions: Floats, radii: Floats, middles: Floats) -> Floats:
        """Return how far the supports of each group extend from its middle, (m,).

        positions : (n, 3) and radii : (n,), of all splats; middles : (m, 3), a point for each group
        """
        out = np.empty(len(middles), np.float32)
        run(_reach, -(-len(out) // CHUNK), (positions, radii, middles), self.order, self.starts, out)
        return out

    @property
    def first(self) -> NDArray[np.int32]:
        """First row of each group, (m,)."""
        return self.order[self.starts[:-1]]

    def pick(self, kept: Flags) -> Groups:
        """Return the groups for which the mask `kept` (m,) is true."""
        sizes = np.diff(self.starts)
        return Groups(self.order[np.repeat(kept, sizes)], np.append(0, np.cumsum(sizes[kept])))


@kernel
def _codes(work: Array, positions: Array, normals: Array, low: Array, cell: float, codes: Array) -> None:
    """Write three numbers for each splat, equal for splats in one grid cell that face the same of six directions.

    low : (3,) origin of the grid; cell : edge length; codes : (n, 3) float32, output

    The directions are those of the axes, and their opposites.
    """
    positions, normals, codes = borrow(positions), borrow(normals), borrow(codes)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(codes))):
            axis = 0
            for c in range(3):
                codes[i, c] = math.floor(min((positions[i, c] - low[c]) / cell, f32(MOST_CELLS - 1)))
                if abs(normals[i, c]) > abs(normals[i, axis]):
                    axis = c
            side = 2 * axis + (1 if normals[i, axis] < 0.0 else 0)
            codes[i, 0] = codes[i, 0] * f32(SIDES) + f32(side)
        tile = next_tile(work)


@kernel
def _sort(ids: Array, starts: Array, order: Array) -> None:
    """Sort rows by group (counting sort).

    ids : (n,) group of each row, 0 to g - 1
    starts : (g + 2,) zeros; becomes the start of each group in `order`, and the end
    order : (n,) output, the sorted rows
    """
    ids, starts, order = borrow(ids), borrow(starts), borrow(order)
    for i in range(len(ids)):
        starts[i64(ids[i]) + 2] += 1
    for g in range(2, len(starts)):
        starts[g] += starts[g - 1]
    for i in range(len(ids)):
        g = i64(ids[i]) + 1
        order[starts[g]] = i
        starts[g] += 1


@kernel
def _means(work: Array, values: Array, width: int, order: Array, starts: Array, out: Array) -> None:
    """Write the mean of `values` over each group.

    values : flat, `width` numbers for each row; out : flat output, `width` numbers for each group
    order : rows, group by group; starts : start of each group in `order`, and the end
    """
    values, order, starts, out = borrow(values), borrow(order), borrow(starts), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for g in range(tile * CHUNK, min((tile + 1) * CHUNK, len(starts) - 1)):
            for c in range(width):
                total = 0.0
                for k in range(starts[g], starts[g + 1]):
                    total += f64(values[i64(order[k]) * width + c])
                out[g * width + c] = total / (starts[g + 1] - starts[g])
        tile = next_tile(work)


@kernel
def _reach(work: Array, splats: tuple[Array, Array, Array], order: Array, starts: Array, out: Array) -> None:
    """Write how far the supports of each group extend from a point, the group's middle, (m,).

    splats : positions (n, 3) and radii (n,) of all splats, and the middles of the groups (m, 3)
    order : rows of the splats, group by group; starts : start of each group in `order`, and the end
    """
    positions, radii, middles = borrow(splats[0]), borrow(splats[1]), borrow(splats[2])
    order, starts, out = borrow(order), borrow(starts), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for g in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            most = f32(0.0)
            for k in range(starts[g], starts[g + 1]):
                i, square = i64(order[k]), f32(0.0)
                for c in range(3):
                    away = positions[i, c] - middles[g, c]
                    square += away * away
                most = max(most, f32(math.sqrt(square)) + radii[i])
            out[g] = most
        tile = next_tile(work)


def groups_in_cells(positions: Floats, normals: Floats, cell: float, low: Floats | None = None) -> Groups:
    """Group splats by grid cell and by the axis direction, of six, that they face; in the order of their first rows.

    cell : edge length of the cells; low : (3,) float32, origin of the grid. None: the least coordinates
    """
    rows, ids = distinct(_codes_of(positions, normals, cell, low))
    starts, order = np.zeros(len(rows) + 2, np.int64), np.empty(len(ids), np.int32)
    _sort(ids, starts, order)
    return Groups(order, starts[:-1])


def cell_numbers(positions: Floats, normals: Floats, cell: float, low: Floats) -> Rows:
    """Return a number for each splat, (n,), equal for splats in one grid cell that face the same of six directions.

    cell : edge length of the cells; low : (3,) float32, origin of the grid
    """
    x, y, z = _codes_of(positions, normals, cell, low).astype(np.int64).T
    return np.asarray((x * MOST_CELLS + y) * MOST_CELLS + z)


def _codes_of(positions: Floats, normals: Floats, cell: float, low: Floats | None) -> Floats:
    codes = np.empty((len(positions), 3), np.float32)
    low = np.array([column.min() for column in positions.T]) if low is None else low
    tiles = -(-len(codes) // CHUNK)
    run(_codes, tiles, np.ascontiguousarray(positions), np.ascontiguousarray(normals), low, np.float32(cell), codes)
    return codes
