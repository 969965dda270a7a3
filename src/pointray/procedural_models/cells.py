"""Lists of the strokes that can change the surface in each cell of space."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles
from ..engine.jit import Array, borrow, kernel, next_tile, run
from . import clay
from .clay import Solid
from .smooth import blend
from .solids import CLAY

_CHUNK = 64


@kernel
def _select(work: Array, solid: Solid, centers: Array, parents: Array, half: float, out: Array, near: Array) -> None:
    """Select the strokes (shapes that add or remove clay) that can change the surface of a sculpture in each grid cell.

    It is done by interval arithmetic over a ball around the cell.

    centers : (cells, 3); half : radius of the ball
    parents : (cells,) number of the list of strokes in `solid` that each cell selects from
    out : out[i, 0] is set to the number of strokes of cell i, out[i, 1:] to their indices
    near : near[i] is set to 1 if the surface may pass through the cell
    """
    solid = borrow(solid)
    table = solid.table
    t = next_tile(work)
    while t >= 0:
        for cell in range(t * _CHUNK, min((t + 1) * _CHUNK, parents.size)):
            x, y, z = centers[cell, 0], centers[cell, 1], centers[cell, 2]
            f, slack, count = clay.FAR, 0.0, 0
            for j in range(solid.starts[parents[cell]], solid.starts[parents[cell] + 1]):
                i = solid.items[j]
                op, width = int(table[i, clay.OP]), table[i, clay.WIDTH]
                if op == clay.RELIEF:
                    u, v, w = clay.local(table, i, x, y, z)
                    region = clay.ellipsoid(
                        u, v, w, table[i, clay.SIZE], table[i, clay.SIZE + 1], table[i, clay.SIZE + 2]
                    )
                    if region - 1.5 * half >= width:
                        continue
                    f -= clay.height(table, i, x, y, z)
                    slack += min(2.0 * half, 2.5 * abs(table[i, clay.ROUND]))
                else:
                    d = clay.shape(table, i, x, y, z)
                    spread = half * (1.5 if int(table[i, clay.KIND]) <= clay.TUBE else 1.0)
                    if op == clay.PAINT:
                        if d - spread >= width:
                            continue
                    elif op == clay.ADD:
                        if d - spread > f + slack + width:
                            continue
                        if d + spread < f - slack - width:
                            count, f, slack = 0, d, spread
                        else:
                            f, slack = blend(f, d, width), max(slack, spread)
                    else:
                        d = -d if op == clay.CARVE else d
                        if d + spread < f - slack - width:
                            continue
                        f, slack = -blend(-f, -d, width), max(slack, spread)
                count += 1
                out[cell, count] = i
            out[cell, 0] = count
            near[cell] = abs(f) <= slack
        t = next_tile(work)


def _subdivide(centers: Doubles, edge: float) -> Doubles:
    """Return the centres of the eight octants of each cubic cell, (8 n, 3), cell by cell. edge : of the cells"""
    corners = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], np.float64)
    return np.asarray((centers[:, None] + corners * (edge / 4)).reshape(-1, 3))


def clay_solid(table: Doubles, low: Doubles, high: Doubles, cell: float) -> Solid:
    """Return a solid made of strokes (shapes that add or remove clay), with a list of those near each grid cell.

    Cells are halved three times where the surface passes through them.

    Parameters
    ----------
    table : (strokes, clay.COLUMNS) float64
        One row per stroke.
    low, high : (3,) float64
        A box that contains the surface, with a margin.
    cell : float
        Edge of the finest cells.
    """
    assert table.shape[1] == clay.COLUMNS
    levels = 3
    coarse = cell * 2**levels
    dims = np.ceil((high - low) / coarse).astype(np.int64)
    fine = dims * 2**levels
    lists = np.zeros(tuple(fine), np.int32)
    starts: list[NDArray[Any]]
    items: list[NDArray[Any]]
    starts, items = [np.array([0, len(table)])], [np.arange(len(table))]
    solid = Solid(CLAY, table, lists, starts[0].astype(np.int32), items[0].astype(np.int32), low, cell)
    centers = low + (np.indices(tuple(dims)).reshape(3, -1).T + 0.5) * coarse
    parents = np.zeros(len(centers), np.int32)
    total, known, edge = len(table), 1, coarse
    for level in range(levels + 1):
        out = np.empty((len(centers), int(np.diff(solid.starts).max()) + 1), np.int32)
        near = np.empty(len(centers), np.bool_)
        run(
            _select,
            -(-len(centers) // _CHUNK),
            solid,
            np.ascontiguousarray(centers),
            parents,
            edge * 3**0.5 / 2,
            out,
            near,
        )
        counts = out[:, 0]
        starts.append(total + np.cumsum(counts))
        items.append(out[:, 1:][np.arange(out.shape[1] - 1) < counts[:, None]])
        total += int(counts.sum())
        solid = solid._replace(
            starts=np.concatenate(starts).astype(np.int32), items=np.concatenate(items).astype(np.int32)
        )
        numbers = known + np.arange(len(centers), dtype=np.int32)
        known += len(centers)
        span = 2 ** (levels - level)
        corner = np.rint((centers - edge / 2 - low) / cell).astype(np.int64)
        for i, j, k in np.ndindex(span, span, span):
            lists[corner[:, 0] + i, corner[:, 1] + j, corner[:, 2] + k] = numbers
        centers, parents = _subdivide(centers[near], edge), np.repeat(numbers[near], 8)
        edge /= 2
    return solid
