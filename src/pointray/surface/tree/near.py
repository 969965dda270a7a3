"""Search for splats near a box: the splats of four blocks are tested at once, in 16 lanes."""

from __future__ import annotations

from typing import TypeAlias

from ...engine.jit import Array, f64, i64, inline, routine
from ...engine.kernels.tree import BLOCK, INV_R2
from ...engine.simd import (
    F16,
    INF,
    ONE,
    ZERO,
    Bits,
    bits,
    broadcast16,
    count_bits,
    join4,
    lane,
    mask16,
    move4,
    reduce_max,
    reduce_min,
    select,
    sum_over_quarters,
    vmax,
    vmin,
    vsqrt,
)
from .blocks import PER_BLOCK

NEAR = 16  # float32 numbers per block in the copy that is searched

Box: TypeAlias = tuple[float, float, float, float, float, float]
Span: TypeAlias = tuple[int, int]  # begin and end in refs


@inline
def distances(cell: Box, x: F16, y: F16, z: F16) -> F16:
    """Return the squared distances of 16 points x, y, z from a box; 0 for points inside of it."""
    zero = broadcast16(ZERO)
    dx = vmax(vmax(cell[0] - x, x - cell[3]), zero)
    dy = vmax(vmax(cell[1] - y, y - cell[4]), zero)
    dz = vmax(vmax(cell[2] - z, z - cell[5]), zero)
    return dx * dx + dy * dy + dz * dz


@inline
def four_from(refs: Array, s: int, end: int) -> tuple[tuple[int, int, int, int], Bits]:
    """Return the block numbers refs[s : s + 4], and 16 bits that are set for the splats of these blocks.

    Numbers from `end` on repeat the last one; the bits of their splats are not set.
    """
    last = end - 1
    found = i64(refs[s]), i64(refs[min(s + 1, last)]), i64(refs[min(s + 2, last)]), i64(refs[min(s + 3, last)])
    return found, (1 << PER_BLOCK * min(end - s, 4)) - 1


@inline
def sum_of(vector: F16) -> float:
    """Return the sum of all 16 lanes as float64."""
    four = sum_over_quarters(vector)
    return f64(lane(four, 0)) + f64(lane(four, 1)) + f64(lane(four, 2)) + f64(lane(four, 3))


@inline
def room_for(blocks: int) -> int:
    """Return the length of the array for positions and squared radii of `blocks` blocks, which `copy_near` fills."""
    return NEAR * blocks


@inline
def copy_near(blocks: Array, numbers: Array, near: Array) -> None:
    """Copy positions and squared radii of blocks to consecutive memory, where a search reads them fast.

    blocks : all blocks, 28 numbers each; numbers : numbers of the blocks to copy
    near : output, 16 numbers for each copied block: 4 each of x, y, z and r^2
    """
    for k in range(len(numbers)):
        offset = i64(numbers[k]) * BLOCK
        for row in range(3):
            move4(blocks, offset + PER_BLOCK * row, near, NEAR * k + PER_BLOCK * row)
        for j in range(PER_BLOCK):
            near[NEAR * k + 3 * PER_BLOCK + j] = ONE / blocks[offset + INV_R2 + j]


@routine
def gather(
    near: Array, sources: Span, cell: Array, around: float, refs: Array, start: int
) -> tuple[int, float, float, float, Box]:
    """List in refs, from `start` on, the blocks with a splat whose support overlaps a box that is grown by a margin.

    near : positions and squared radii of blocks, 4 each of x, y, z and r^2
    sources : range in refs of the blocks to test
    cell : the box; around : the margin
    refs : indices of blocks in `near`

    Returns five values: the end of the list in refs; the mean, the least and the largest radius of the splats that
    overlap; the bounding box of their supports, inverted if no splat overlaps.
    """
    grown = (cell[0] - around, cell[1] - around, cell[2] - around, cell[3] + around, cell[4] + around, cell[5] + around)
    zero, inf = broadcast16(ZERO), broadcast16(INF)
    total, count, shortest, longest = zero, 0, inf, zero
    lx, ly, lz, hx, hy, hz = inf, inf, inf, -ONE * inf, -ONE * inf, -ONE * inf
    end = start
    for s in range(sources[0], sources[1], 4):
        (a, b, c, d), valid = four_from(refs, s, sources[1])
        i, j, k, m = NEAR * a, NEAR * b, NEAR * c, NEAR * d
        x, y = join4(near, i, j, k, m), join4(near, i + 4, j + 4, k + 4, m + 4)
        z, r2 = join4(near, i + 8, j + 8, k + 8, m + 8), join4(near, i + 12, j + 12, k + 12, m + 12)
        inside = (distances(grown, x, y, z) <= r2) & mask16(valid)
        word = bits(inside)
        if word == 0:
            continue
        r = vsqrt(r2)
        total = total + select(inside, r, zero)
        count += count_bits(word)
        shortest, longest = select(inside, vmin(r, shortest), shortest), select(inside, vmax(r, longest), longest)
        lx, hx = select(inside, vmin(x - r, lx), lx), select(inside, vmax(x + r, hx), hx)
        ly, hy = select(inside, vmin(y - r, ly), ly), select(inside, vmax(y + r, hy), hy)
        lz, hz = select(inside, vmin(z - r, lz), lz), select(inside, vmax(z + r, hz), hz)
        for block in (a, b, c, d):
            if word & 15 != 0:
                refs[end] = block
                end += 1
            word >>= PER_BLOCK
    low, high = (reduce_min(lx), reduce_min(ly), reduce_min(lz)), (reduce_max(hx), reduce_max(hy), reduce_max(hz))
    mean = sum_of(total) / max(count, 1)
    return (
        end,
        mean,
        reduce_min(shortest),
        f64(reduce_max(longest)),
        (low[0], low[1], low[2], high[0], high[1], high[2]),
    )
