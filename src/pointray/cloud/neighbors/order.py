"""Kd order: the points in the order of the leaves of a kd-tree, so that neighbours are close in memory.

A span of points is cut across its longest side, recursively. The first half gets the largest power of two that leaves
at least one point for the second, so all aligned ranges of 4, 16, 64 ... points are nodes of the kd-tree: four points
are a splat block of the ray tracing tree, 16 a block of the neighbour search, and the cuts need not be stored.

Ties on a cut, and points of a leaf, are ordered by their numbers. A range that is sorted alone thus has the same order
as in the whole cloud, see `cuts`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
from ...engine.jit import Array, borrow, cancelled, f32, inline, kernel, next_tile, run
from ...engine.simd import INF, broadcast16, lane, load4, load16, store, vmax, vmin

ROW = 4  # float32 of a row: x, y, z, and the point's number as bits
LEAF = 4  # points of a leaf, ordered by their numbers
COARSE = 32  # number of spans from which threads sort one span each; before, each span is cut by one thread
FEW = 1 << 14  # points that one thread sorts faster than several
SAMPLE = 32  # rows sampled for the pivot of a span
MANY = 4 * SAMPLE  # spans with fewer rows are not sampled
DEPTH = 64  # depth of the stack of spans
NUMBER = 3  # column of a point's number; the bits of numbers below 2^31 - 2^23 compare alike as float32


@inline
def first_part(count: int) -> int:
    """Return the number of points in the first half of a kd-tree node with `count` points, at least 2.

    It is the largest power of two below `count`, so that aligned ranges of 4, 16, 64 ... points are subtrees.
    """
    half = 1
    while 2 * half < count:
        half *= 2
    return half


@inline
def _longest_side(rows: Array, low: int, high: int) -> int:
    """Return the axis along which rows low to high - 1 extend farthest.

    rows : flat, four floats for each point: x, y, z and its number
    """
    least, greatest = broadcast16(INF), broadcast16(-INF)
    i = ROW * low
    while i + 16 <= ROW * high:
        four = load16(rows, i)
        least, greatest = vmin(four, least), vmax(four, greatest)
        i += 16
    best, axis = f32(-1.0), 0
    for c in range(3):
        a, b = lane(least, c), lane(greatest, c)
        for k in range(1, 4):
            a, b = min(a, lane(least, 4 * k + c)), max(b, lane(greatest, 4 * k + c))
        for j in range(i, ROW * high, ROW):
            a, b = min(a, rows[j + c]), max(b, rows[j + c])
        if b - a > best:
            best, axis = b - a, c
    return axis


@inline
def _pivot(rows: Array, axis: int, left: int, right: int, nth: int, sample: Array) -> float:
    """Estimate the value that row `nth` would have along an axis if the rows left to right were sorted.

    rows : flat, four floats for each point: x, y, z and its number
    sample : memory for 32 of the values; if there are many rows, the result is a quantile of these
    """
    count = right - left + 1
    if count < MANY:
        return rows[ROW * ((left + right) >> 1) + axis]
    for k in range(SAMPLE):
        value, i = rows[ROW * (left + (2 * k + 1) * count // (2 * SAMPLE)) + axis], k
        while i > 0 and sample[i - 1] > value:
            sample[i] = sample[i - 1]
            i -= 1
        sample[i] = value
    return sample[min((nth - left) * SAMPLE // count, SAMPLE - 1)]


@inline
def _swap(rows: Array, i: int, j: int) -> None:
    one, other = load4(rows, ROW * i), load4(rows, ROW * j)
    store(rows, ROW * j, one)
    store(rows, ROW * i, other)


@inline
def _partition(rows: Array, axis: int, left: int, right: int, pivot: float, equal: bool) -> int:
    """Move rows below the pivot (with `equal`: up to it) to the front of the rows left to right; return their end.

    No branch depends on the rows: with Hoare's partition sorting takes twice as long.

    rows : flat, four floats for each point: x, y, z and its number
    axis : column that is compared
    """
    end = left
    for i in range(left, right + 1):
        value = rows[ROW * i + axis]
        _swap(rows, i, end)
        end += value <= pivot if equal else value < pivot
    return end


@inline
def _select(rows: Array, axis: int, low: int, high: int, nth: int, sample: Array) -> None:
    """Partition rows low to high - 1 so that row `nth` is where sorting along an axis would put it (quickselect).

    rows : flat, four floats for each point: x, y, z and its number
    sample : memory for 32 values
    """
    left, right = low, high - 1
    while right > left:
        pivot = _pivot(rows, axis, left, right, nth, sample)
        end = _partition(rows, axis, left, right, pivot, False)
        if end == left:  # the pivot is the minimum
            end = _partition(rows, axis, left, right, pivot, True)
            if nth < end:
                return
        if nth < end:
            right = end - 1
        else:
            left = end


@inline
def _order_ties(rows: Array, axis: int, low: int, high: int, nth: int, sample: Array) -> None:
    """Move rows with the lowest numbers before row `nth`, among those exactly at the coordinate where a node is cut.

    rows : flat, four floats for each point: x, y, z and its number
    axis : split axis
    low, high : first row of the node, and the row after its last one
    nth : first row of the second half, already in its place along the axis
    sample : memory for 32 values
    """
    value, begin, end = rows[ROW * nth + axis], nth, nth
    for i in range(nth - 1, low - 1, -1):
        if rows[ROW * i + axis] == value:
            begin -= 1
            _swap(rows, i, begin)
    if begin == nth:
        return
    for i in range(nth, high):
        if rows[ROW * i + axis] == value:
            _swap(rows, i, end)
            end += 1
    _select(rows, NUMBER, begin, end, nth, sample)


@inline
def _sort_leaf(rows: Array, low: int, high: int) -> None:
    """Sort a kd-tree leaf, rows low to high - 1 of a few points, by their numbers.

    rows : flat, four floats for each point: x, y, z and its number
    """
    for i in range(low + 1, high):
        j = i
        while j > low and rows[ROW * (j - 1) + NUMBER] > rows[ROW * j + NUMBER]:
            _swap(rows, j - 1, j)
            j -= 1


@kernel
def _cut(work: Array, rows: Array, spans: Array, least: int) -> None:
    """Sort spans of rows along a kd order: split each recursively across its longest side, down to `least` rows.

    work : gives each thread its next span
    rows : flat, four floats for each point: x, y, z and its number
    spans : (m, 2) first row, and the row after the last one
    """
    rows = borrow(rows)
    stack, sample = np.empty((DEPTH, 2), np.int64), np.empty(SAMPLE, np.float32)
    span = next_tile(work)
    while span >= 0:
        stack[0, 0], stack[0, 1] = spans[span, 0], spans[span, 1]
        depth = 1
        while depth > 0:
            depth -= 1
            low, high = stack[depth, 0], stack[depth, 1]
            if high - low <= least or cancelled(work):
                if least == LEAF:
                    _sort_leaf(rows, low, high)
                continue
            middle, axis = low + first_part(high - low), _longest_side(rows, low, high)
            _select(rows, axis, low, high, middle, sample)
            _order_ties(rows, axis, low, high, middle, sample)
            stack[depth, 0], stack[depth, 1] = low, middle
            stack[depth + 1, 0], stack[depth + 1, 1] = middle, high
            depth += 2
        span = next_tile(work)


def sort_rows(rows: Floats, threads: int | None = None) -> None:
    """Sort points along a kd order, in place.

    rows : (n, 4) x, y, z, and the bits of the point's int32 number
    """
    n = len(rows)
    flat, half = rows.reshape(-1), 1 << max(n - 1, 1).bit_length() - 1
    length = n
    while n > FEW and n // length < COARSE:
        # Cut each span once; its first half is as long as that of the first span.
        run(_cut, -(-n // length), flat, _spans(n, length), half, threads=threads)
        length, half = half, half // 2
    run(_cut, -(-n // length), flat, _spans(n, length), LEAF, threads=threads)


def _spans(n: int, length: int) -> Rows:
    starts = np.arange(0, n, length)
    return np.stack([starts, np.minimum(starts + length, n)], axis=1)


def kd_order(positions: Floats, threads: int | None = None) -> NDArray[np.int32]:
    """Sort points along a kd order: each aligned range of 4, 16, 64 ... points is a leaf or a subtree of a kd-tree.

    Parameters
    ----------
    positions : (n, 3) float32

    Returns
    -------
    (n,) int32
        Point numbers in that order.
    """
    rows = np.empty((len(positions), ROW), np.float32)
    rows[:, :3] = positions
    rows.view(np.int32)[:, 3] = np.arange(len(positions), dtype=np.int32)
    sort_rows(rows, threads)
    return rows.view(np.int32)[:, 3].copy()
