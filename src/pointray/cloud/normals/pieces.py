"""Pieces: points whose signs agree reliably, joined within each tile of the kd order.

A tile is an aligned range of the kd order. Its edges are sorted and joined, most reliable first. The work is local, so
a cloud in parts has the same pieces as the whole.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
from ...engine.jit import Array, borrow, i64, inline, kernel, next_tile, run
from ...engine.simd import gather_rows8, load_apart16, store
from .agreement import agreement_of

Signs = NDArray[np.int8]

TILE = 2048  # points: with 4,096, 5.3% of a layered wall face away, not 4.2%
LEVELS = 256  # quantization levels of confidence
SURE = 0.95  # confidence at which points of a tile join without a vote: 0.5% of Lucy are flipped; 1.8 to 22% with 0.5


class Pieces(NamedTuple):
    """Division of consecutive points in kd order into pieces: sets of points whose normals reliably face the same side.

    piece : (m,) int32, number of each point's piece, from 0
    sign : (m,) int8, 1 or -1: the sign that makes its normal consistent with its piece
    sizes : (p,) int64, number of points of each piece
    """

    piece: NDArray[np.int32]
    sign: Signs
    sizes: Rows


@inline
def _agreements(table: Array, near: Array, core: int, first: int, q: int, k: int, out: Array) -> None:
    """Write the confidence, -1 to 1, that 16 consecutive points and the q-th neighbour of each face the same side.

    table : flat, eight floats per point, beginning with position and normal
    near : flat, k rows of neighbours for each point from row `core` of the table on
    first : index of the first of the 16 points, counted from `core`
    out : (16,)
    """
    at = 8 * (core + first)
    n = load_apart16(table, at + 3, 8), load_apart16(table, at + 4, 8), load_apart16(table, at + 5, 8)
    x, y, z, u, v, w, _, _ = gather_rows8(table, near, first * k + q, k)
    x = x - load_apart16(table, at, 8)
    y = y - load_apart16(table, at + 1, 8)
    z = z - load_apart16(table, at + 2, 8)
    store(out, 0, agreement_of((x, y, z), n, (u, v, w)))


@inline
def climb(parent: Array, sign: Array, i: int) -> tuple[int, int]:
    """Return the root above element i of a forest (union-find), and 1 or -1: the product of the signs on the way.

    parent, sign : (n,) parent of each element, itself at a root, and 1 or -1, the sign relative to it
    """
    s = 1
    while parent[i] != i:
        s *= sign[i]
        i = parent[i]
    return i, s


@inline
def _climb_halving(parent: Array, sign: Array, i: int) -> tuple[int, int]:
    """Return the root above element i of a forest, and the sign relative to it, like `climb`; shorten the path.

    Each element on the way gets its grandparent as parent, which halves later paths.

    parent, sign : (n,) parent of each element, and 1 or -1, the sign relative to it
    """
    s = 1
    while parent[i] != i:
        above = parent[i]
        sign[i] *= sign[above]
        parent[i] = parent[above]
        s *= sign[i]
        i = parent[i]
    return i, s


@kernel
def _join_tiles(work: Array, table: Array, near: Array, k: int, core: int, parent: Array, sign: Array) -> None:
    """Join the points of each tile whose normals reliably face the same side, along edges to neighbours, best first.

    work : gives each thread its next tile, 2048 points
    table : flat, eight floats per point, beginning with position and normal; padded to a multiple of 16 points
    near : flat, k rows of neighbours per point from row `core` of the table on, itself first
    parent, sign : (m,) receive the root of each point's piece, and 1 or -1, its sign relative to the root
    """
    table, near, parent, sign = borrow(table), borrow(near), borrow(parent), borrow(sign)
    n, lanes = len(parent), np.empty(16, np.float32)
    size = np.empty(TILE, np.int32)
    vote = np.empty(TILE * (k - 1), np.int16)
    order = np.empty(TILE * (k - 1), np.int32)
    start = np.empty(LEVELS + 2, np.int64)
    tile = next_tile(work)
    while tile >= 0:
        first = tile * TILE
        last = min(first + TILE, n)
        start[:] = 0
        for i in range(first, last):
            parent[i], sign[i], size[i - first] = i, 1, 1
        for i in range(first, last, 16):
            for q in range(1, k):
                _agreements(table, near, core, i, q, k, lanes)
                for lane in range(min(16, last - i)):
                    j, v = near[(i + lane) * k + q] - core, lanes[lane]
                    level = int(min(abs(v), 1.0) * LEVELS) if first <= j < last and abs(v) > SURE else 0
                    vote[(i + lane - first) * (k - 1) + q - 1] = level if v >= 0.0 else -level
                    start[LEVELS - level + 1] += 1
        for level in range(LEVELS):
            start[level + 1] += start[level]
        for t in range((last - first) * (k - 1)):
            level = LEVELS - abs(vote[t])
            if level < LEVELS:
                order[start[level]] = t
                start[level] += 1
        for u in range(start[LEVELS - 1]):
            t = order[u]
            i, q = first + t // (k - 1), t % (k - 1) + 1
            j = i64(near[i * k + q]) - core
            if parent[i] == parent[j]:  # true of most edges: saves half the time
                continue
            a, s = _climb_halving(parent, sign, i)
            b, r = _climb_halving(parent, sign, j)
            if a != b:
                if size[a - first] < size[b - first]:
                    a, b = b, a
                parent[b] = a
                sign[b] = s * r * (1 if vote[t] > 0 else -1)
                size[a - first] += size[b - first]
        for i in range(first, last):
            a, s = climb(parent, sign, i)
            order[i - first] = a
            vote[i - first] = s
        for i in range(first, last):
            parent[i], sign[i] = order[i - first], vote[i - first]
        tile = next_tile(work)


def find_pieces(positions: Floats, normals: Floats, near: NDArray[np.int32], core: slice) -> Pieces:
    """Divide consecutive points in kd order into pieces: sets of points whose normals reliably face the same side.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32, unit
    near : (m, k) int32
        Rows of the neighbours of each point of the core, itself first.
    core : slice
        The m points; tiles, of 2,048 points each, begin at the first one. A piece lies within a tile.
    """
    m = len(near)
    parent, sign = np.empty(m, np.int32), np.empty(m, np.int8)
    table, flat = _for_lanes(positions, normals, near, core.start)
    run(_join_tiles, -(-m // TILE), table, flat, near.shape[1], core.start, parent, sign)
    is_root = parent == np.arange(m, dtype=np.int32)
    piece = (np.cumsum(is_root, dtype=np.int32) - np.int32(1))[parent]
    return Pieces(piece, sign, np.bincount(piece))


def _for_lanes(
    positions: Floats, normals: Floats, near: NDArray[np.int32], core: int
) -> tuple[Floats, NDArray[np.int32]]:
    """Return flat arrays for vectors of 16 lanes, padded with zeros to a multiple of 16 points.

    The first holds eight floats per point, beginning with position and normal, the second the k neighbours per point.

    positions, normals : (n, 3)
    near : (m, k) rows of the neighbours of each point from row `core` on
    """
    n, m = len(positions), len(near)
    rows = -(-m // 16) * 16
    table = np.zeros((max(n, core + rows), 8), np.float32)
    table[:n, :3], table[:n, 3:6] = positions, normals
    if rows > m:
        near = np.concatenate([near, np.zeros((rows - m, near.shape[1]), np.int32)])
    return table.reshape(-1), np.ascontiguousarray(near).reshape(-1)
