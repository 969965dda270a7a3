"""Pieces: points whose normals' signs agree surely, joined in each tile of the kd order alone.

A tile is an aligned stretch of the kd order. Its edges are sorted and joined, the surest first. So the work is local,
and a cloud in parts has the pieces of the whole.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...engine.jit import Array, borrow, i64, inline, kernel, next_tile, run
from ...engine.simd import gather_rows8, load_apart16, store
from .agreement import agreement_of

Floats = NDArray[np.float32]
Signs = NDArray[np.int8]

TILE = 2048  # points: with 4,096, 5.3% of a layered wall face away, not 4.2%
LEVELS = 256  # steps of confidence inside a tile
SURE = 0.95  # confidence from which a tile's points join without a vote: 0.5% of Lucy are flipped; 1.8 to 22% at 0.5


class Pieces(NamedTuple):
    """The pieces that some points form.

    piece : (m,) int32, the piece of each point, from 0, in the order of their roots
    sign : (m,) int8, 1 or -1: the sign with which its normal agrees with its piece
    sizes : (p,) int64, how many points each piece has
    """

    piece: NDArray[np.int32]
    sign: Signs
    sizes: NDArray[np.int64]


@inline
def _agreements(table: Array, near: Array, core: int, first: int, q: int, k: int, out: Array) -> None:
    """Write the confidence of 16 points that follow each other in their q-th neighbours, of k.

    table : flat, a row of eight for each point, its position and its normal first
    core : the row of the first point that has neighbours; `first` counts from it
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
    """The root above i, and the sign between them."""
    s = 1
    while parent[i] != i:
        s *= sign[i]
        i = parent[i]
    return i, s


@inline
def _climb_halving(parent: Array, sign: Array, i: int) -> tuple[int, int]:
    """`_climb`, which halves the way for those that follow."""
    s = 1
    while parent[i] != i:
        above = parent[i]
        sign[i] *= sign[above]
        parent[i] = parent[above]
        s *= sign[i]
        i = parent[i]
    return i, s


@kernel
def _join_tiles(work: Array, table: Array, near: Array, k: int, core: int, parent: Array, sign: Array) -> int:
    """Join each tile's sure edges, surest first; parent[i]: the root of i's piece, sign[i]: the sign to it.

    table : flat, see `_agreements`, with rows for whole lanes
    near : flat, k for each point from row `core` of the table on
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
            if parent[i] == parent[j]:  # so it is for most edges: half the time
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
    return 0


def find_pieces(positions: Floats, normals: Floats, near: NDArray[np.int32], core: slice) -> Pieces:
    """The pieces of some points that follow each other.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32, unit
    near : (m, k) int32
        Rows of the neighbours of each point of the core, the point itself first.
    core : slice
        The points, m of the rows; tiles begin at the first one.
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
    """The table and the neighbours that `_join_tiles` reads, with rows for whole lanes; those beyond are empty."""
    n, m = len(positions), len(near)
    rows = -(-m // 16) * 16
    table = np.zeros((max(n, core + rows), 8), np.float32)
    table[:n, :3], table[:n, 3:6] = positions, normals
    if rows > m:
        near = np.concatenate([near, np.zeros((rows - m, near.shape[1]), np.int32)])
    return table.reshape(-1), np.ascontiguousarray(near).reshape(-1)
