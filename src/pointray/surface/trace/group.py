"""Groups of a tile's rays that traverse a model together: rays with close origins and similar directions.

If not all rays are similar, as at a silhouette, each group of similar rays is packed into the tile's first slots and
traced by itself; a ray with too few similar neighbours is traced singly.
"""

from __future__ import annotations

import math

from ...engine.jit import Array, f32, i64, inline
from ...engine.kernels import scratch as sc
from ...engine.kernels.scratch import Scratch
from ...engine.kernels.tree import SCATTER_LEAVES, Tree
from ...engine.simd import (
    ONE,
    ZERO,
    Bits,
    bits,
    broadcast16,
    count_bits,
    count_trailing_zeros,
    load16,
    mask16,
    select,
    store,
    store_packed,
    vabs,
)
from .tile import range_of

WIDEST = f32(0.2)  # largest difference of the directions' components
# Largest difference of the origins' components in leaf edges: rays farther apart share no leaves. With 0.1 of the
# bounds instead, 24 statues of a million points were 5% slower (8% with levels of detail); with 2 and 16 edges 4 and
# 35%.
SCATTERED = f32(4.0)
FEWEST = 4  # rays in the smallest group
RAY_ROWS = (
    *range(sc.OX, sc.LENGTH, sc.TILE),
    sc.END,
    sc.SIDE,
    sc.BEGIN,
)  # the rows that are packed with a ray, besides LENGTH
FOUND_ROWS = (sc.HIT_T, sc.NX, sc.NY, sc.NZ)
FAILURES = 4  # after this many rays with too few similar neighbours the others are traced singly too


@inline
def leaf_edge(tree: Tree) -> float:
    """Return the approximate width of a leaf of a model, as if the leaves covered the bounds."""
    x, y, z = tree.head[3] - tree.head[0], tree.head[4] - tree.head[1], tree.head[5] - tree.head[2]
    numbers = f32(tree.spans.size) + f32(2.0) * tree.head[SCATTER_LEAVES]
    return f32(math.sqrt(f32(4.0) * (x * y + y * z + z * x) / numbers))


@inline
def coherent(edge: float, rows: Array) -> bool:
    """Return whether all rays of a tile are worth a common traversal: close origins, similar directions of equal signs.

    edge : width of a leaf, in which distances of origins are measured; rows : `Scratch.model`, the rays
    """
    for c in range(3):
        low, high = range_of(rows, sc.DX + c * sc.TILE, (0, sc.TILE))
        if (low < ZERO and high > ZERO) or high - low > WIDEST:
            return False
        low, high = range_of(rows, sc.OX + c * sc.TILE, (0, sc.TILE))
        if high - low > SCATTERED * edge:
            return False
    return True


@inline
def similar_rays(edge: float, rows: Array, left: Bits) -> Bits:
    """Return which rays of a tile may be traced together with one of them, as bits of the tile.

    left : bits of the rays to choose from, the first of which is that one
    edge : width of a leaf, in which distances of origins are measured
    rows : `Scratch.model`, with the copies of the rays that `save_rays` has made
    """
    i, rays = sc.SAVED_ROWS + count_trailing_zeros(left), i64(0)
    far, wide = f32(0.5) * SCATTERED * edge, f32(0.5) * WIDEST
    for v in range(0, sc.TILE, sc.LANES):
        word, offset = (left >> v) & 0xFFFF, sc.SAVED_ROWS + v
        if word == 0:
            continue
        for c in range(0, 3 * sc.TILE, sc.TILE):
            o, d = load16(rows, sc.OX + c + offset), load16(rows, sc.DX + c + offset)
            word &= bits((vabs(o - rows[sc.OX + c + i]) <= far) & (vabs(d - rows[sc.DX + c + i]) <= wide))
            word &= bits(load16(rows, sc.IX + c + offset) * rows[sc.IX + c + i] > ZERO)
        rays |= word << v
    return rays


@inline
def _copy(rows: Array, source: int, target: int, row: int) -> None:
    """Copy one row of all rays of the tile within `rows`. source, target : offsets that are added to `row`"""
    for v in range(0, sc.TILE, sc.LANES):
        store(rows, target + row + v, load16(rows, source + row + v))


@inline
def save_rays(scratch: Scratch) -> None:
    """Copy all rays of the tile, without hits, elsewhere in `scratch`, before groups are packed in their place."""
    for row in RAY_ROWS:
        _copy(scratch.model, 0, sc.SAVED_ROWS, row)
    _copy(scratch.model, 0, sc.SAVED_ROWS, sc.LENGTH)
    for i in range(sc.TILE):
        scratch.numbers[sc.FOUND_SAVED + i] = -1


@inline
def _pack_row(rows: Array, row: int, rays: Bits, last: float) -> None:
    """Pack one row of the given saved rays (bits) into the tile's first slots, one number for each ray.

    row : offset of the row in `rows`; rows : `Scratch.model`
    last : number for the slots behind the last ray, up to a multiple of 16
    """
    n = i64(0)
    for v in range(0, sc.TILE, sc.LANES):
        word = (rays >> v) & 0xFFFF
        store_packed(rows, row + n, mask16(word), load16(rows, sc.SAVED_ROWS + row + v))
        n += count_bits(word)
    offset = (n - 1) // sc.LANES * sc.LANES
    store(rows, row + offset, select(mask16((1 << (n - offset)) - 1), load16(rows, row + offset), broadcast16(last)))


@inline
def pack_rays(rays: Bits, scratch: Scratch) -> int:
    """Pack the given saved rays (bits) into the tile's first slots; return the end of these, a multiple of 16.

    Unused slots hold copies of the first ray that have already ended, so that they do not widen the group.
    """
    rows, first = scratch.model, sc.SAVED_ROWS + count_trailing_zeros(rays)
    for row in RAY_ROWS:
        _pack_row(rows, row, rays, rows[row + first])
    _pack_row(rows, sc.LENGTH, rays, -ONE)
    end = (count_bits(rays) + sc.LANES - 1) // sc.LANES * sc.LANES
    for k in range(end):
        scratch.numbers[sc.FOUND + k] = -1
    return end


@inline
def save_hits(rays: Bits, lifted: Bits, scratch: Scratch) -> Bits:
    """Copy the hits of a group of rays that were packed into the tile's first slots to the saved rays.

    rays : the group, as bits of the tile; lifted : rays to which the start rule applies, as bits of the first slots

    Returns `lifted` as bits of the tile.
    """
    rows, numbers, k, back = scratch.model, scratch.numbers, 0, i64(0)
    while rays != 0:
        i = count_trailing_zeros(rays)
        rays &= rays - 1
        if numbers[sc.FOUND + k] >= 0:
            numbers[sc.FOUND_SAVED + i] = numbers[sc.FOUND + k]
            for row in FOUND_ROWS:
                rows[sc.SAVED_ROWS + row + i] = rows[row + k]
        back |= ((lifted >> k) & 1) << i
        k += 1
    return back


@inline
def restore_rays(scratch: Scratch) -> None:
    """Restore all saved rays to their slots in the tile, with the hits of their groups."""
    for row in RAY_ROWS:
        _copy(scratch.model, sc.SAVED_ROWS, 0, row)
    for row in FOUND_ROWS:
        _copy(scratch.model, sc.SAVED_ROWS, 0, row)
    for i in range(sc.TILE):
        scratch.numbers[sc.FOUND + i] = scratch.numbers[sc.FOUND_SAVED + i]
