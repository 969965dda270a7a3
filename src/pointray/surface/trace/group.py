"""Groups of a tile's rays that traverse a model together: rays with close origins and similar directions.

If not all rays are similar, as at a silhouette, each group of similar rays is packed into the tile's first slots and
traced by itself; a ray with too few similar neighbours is traced singly.
"""

from __future__ import annotations

import math

from ...engine.jit import Array, f32, i64, inline
from ...engine.kernels.scratch import (
    BEGIN,
    DX,
    END,
    FOUND,
    FOUND_SAVED,
    HIT_T,
    IX,
    LANES,
    LENGTH,
    NX,
    NY,
    NZ,
    OX,
    SAVED_ROWS,
    SIDE,
    TILE,
    Scratch,
)
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
RAY_ROWS = (*range(OX, LENGTH, TILE), END, SIDE, BEGIN)  # the rows that are packed with a ray, besides LENGTH
FOUND_ROWS = (HIT_T, NX, NY, NZ)
FAILURES = 4  # after this many rays with too few similar neighbours the others are traced singly too


@inline
def leaf_edge(tree: Tree) -> float:
    """Return the approximate width of a leaf, as if the leaves covered the bounds."""
    x, y, z = tree.head[3] - tree.head[0], tree.head[4] - tree.head[1], tree.head[5] - tree.head[2]
    numbers = f32(tree.spans.size) + f32(2.0) * tree.head[SCATTER_LEAVES]
    return f32(math.sqrt(f32(4.0) * (x * y + y * z + z * x) / numbers))


@inline
def coherent(edge: float, rows: Array) -> bool:
    """Return whether all rays are worth a common traversal: their directions have equal signs and similar components.

    edge : width of a leaf
    """
    for c in range(3):
        low, high = range_of(rows, DX + c * TILE, (0, TILE))
        if (low < ZERO and high > ZERO) or high - low > WIDEST:
            return False
        low, high = range_of(rows, OX + c * TILE, (0, TILE))
        if high - low > SCATTERED * edge:
            return False
    return True


@inline
def similar_rays(edge: float, rows: Array, left: Bits) -> Bits:
    """Return those of the given saved rays (bits) that may be traced together with the first of them."""
    i, rays = SAVED_ROWS + count_trailing_zeros(left), i64(0)
    far, wide = f32(0.5) * SCATTERED * edge, f32(0.5) * WIDEST
    for v in range(0, TILE, LANES):
        word, offset = (left >> v) & 0xFFFF, SAVED_ROWS + v
        if word == 0:
            continue
        for c in range(0, 3 * TILE, TILE):
            o, d = load16(rows, OX + c + offset), load16(rows, DX + c + offset)
            word &= bits((vabs(o - rows[OX + c + i]) <= far) & (vabs(d - rows[DX + c + i]) <= wide))
            word &= bits(load16(rows, IX + c + offset) * rows[IX + c + i] > ZERO)
        rays |= word << v
    return rays


@inline
def _copy(rows: Array, source: int, target: int, row: int) -> None:
    """Copy one row of all rays."""
    for v in range(0, TILE, LANES):
        store(rows, target + row + v, load16(rows, source + row + v))


@inline
def save_rays(scratch: Scratch) -> None:
    """Save the rows of all rays, without hits."""
    for row in RAY_ROWS:
        _copy(scratch.model, 0, SAVED_ROWS, row)
    _copy(scratch.model, 0, SAVED_ROWS, LENGTH)
    for i in range(TILE):
        scratch.numbers[FOUND_SAVED + i] = -1


@inline
def _pack_row(rows: Array, row: int, rays: Bits, last: float) -> None:
    """Pack one row of the given saved rays; fill the rest of the last 16 slots with `last`."""
    n = i64(0)
    for v in range(0, TILE, LANES):
        word = (rays >> v) & 0xFFFF
        store_packed(rows, row + n, mask16(word), load16(rows, SAVED_ROWS + row + v))
        n += count_bits(word)
    offset = (n - 1) // LANES * LANES
    store(rows, row + offset, select(mask16((1 << (n - offset)) - 1), load16(rows, row + offset), broadcast16(last)))


@inline
def pack_rays(rays: Bits, scratch: Scratch) -> int:
    """Pack the given saved rays (bits) into the first slots; return the end of these, a multiple of 16.

    Unused slots hold copies of the first ray that have already ended, so that they do not widen the group.
    """
    rows, first = scratch.model, SAVED_ROWS + count_trailing_zeros(rays)
    for row in RAY_ROWS:
        _pack_row(rows, row, rays, rows[row + first])
    _pack_row(rows, LENGTH, rays, -ONE)
    end = (count_bits(rays) + LANES - 1) // LANES * LANES
    for k in range(end):
        scratch.numbers[FOUND + k] = -1
    return end


@inline
def save_hits(rays: Bits, lifted: Bits, scratch: Scratch) -> Bits:
    """Save the hits of the given rays (bits); return the lifted ones, by their indices in the tile."""
    rows, numbers, k, back = scratch.model, scratch.numbers, 0, i64(0)
    while rays != 0:
        i = count_trailing_zeros(rays)
        rays &= rays - 1
        if numbers[FOUND + k] >= 0:
            numbers[FOUND_SAVED + i] = numbers[FOUND + k]
            for row in FOUND_ROWS:
                rows[SAVED_ROWS + row + i] = rows[row + k]
        back |= ((lifted >> k) & 1) << i
        k += 1
    return back


@inline
def restore_rays(scratch: Scratch) -> None:
    """Restore all rays to their slots, with their hits."""
    for row in RAY_ROWS:
        _copy(scratch.model, SAVED_ROWS, 0, row)
    for row in FOUND_ROWS:
        _copy(scratch.model, SAVED_ROWS, 0, row)
    for i in range(TILE):
        scratch.numbers[FOUND + i] = scratch.numbers[FOUND_SAVED + i]
