"""An order of points that keeps neighbours together: the leaves of a kd-tree, one after the other.

A span of points is cut across its longest side, again and again. The first part holds the largest power of two that
leaves something over, so that all aligned stretches of 4, 16, 64 ... points are boxes of the kd-tree: four points are a
splats' block of the ray tracing tree, 16 a block of the neighbour search, and no box has to be stored for the cuts.

Points on a cut, and those of a leaf, follow their numbers. So a stretch that is sorted by itself has the order that it
has in the whole, see `cuts`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...engine.jit import Array, borrow, cancelled, f32, inline, kernel, next_tile, run
from ...engine.simd import INF, broadcast16, lane, load4, load16, store, vmax, vmin

ROW = 4  # float32 of a row: x, y, z, and the point's number as bits
LEAF = 4  # points in the order of their numbers
COARSE = 32  # spans from which threads sort a span each; before that a span is cut by one thread
FEW = 1 << 14  # points that one thread sorts sooner than others begin
SAMPLE = 32  # rows that tell where to cut a span
MANY = 4 * SAMPLE  # rows of a span from which a sample is asked
DEPTH = 64  # of the stack of spans
NUMBER = 3  # the column of a point's number; as float32 numbers below 2^31 - 2^23 are in their order

Floats = NDArray[np.float32]


@inline
def first_part(count: int) -> int:
    """How many of so many points, at least 2, are the first part: the largest power of two below."""
    half = 1
    while 2 * half < count:
        half *= 2
    return half


@inline
def _longest_side(rows: Array, low: int, high: int) -> int:
    """The axis in which rows[low:high] extend farthest."""
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
    """A value near that of the nth row of rows[left : right + 1], were they sorted."""
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
    """Move rows below the pivot, or with `equal` up to it, to the front of rows[left : right + 1]; returns their end.

    Without a branch that depends on the rows: with Hoare's partition the sort takes twice as long.
    """
    end = left
    for i in range(left, right + 1):
        value = rows[ROW * i + axis]
        _swap(rows, i, end)
        end += value <= pivot if equal else value < pivot
    return end


@inline
def _select(rows: Array, axis: int, low: int, high: int, nth: int, sample: Array) -> None:
    """Partition rows[low:high] so that row `nth` is where sorting along an axis would put it (quickselect)."""
    left, right = low, high - 1
    while right > left:
        pivot = _pivot(rows, axis, left, right, nth, sample)
        end = _partition(rows, axis, left, right, pivot, False)
        if end == left:  # the pivot is the least value
            end = _partition(rows, axis, left, right, pivot, True)
            if nth < end:
                return
        if nth < end:
            right = end - 1
        else:
            left = end


@inline
def _order_ties(rows: Array, axis: int, low: int, high: int, nth: int, sample: Array) -> None:
    """Of the rows at the coordinate of the cut before row `nth` put those of the lowest numbers before it."""
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
    """Sort a few rows by their numbers."""
    for i in range(low + 1, high):
        j = i
        while j > low and rows[ROW * (j - 1) + NUMBER] > rows[ROW * j + NUMBER]:
            _swap(rows, j - 1, j)
            j -= 1


@kernel
def _cut(work: Array, rows: Array, spans: Array, least: int) -> int:
    """Sort each span of rows, flat, down to spans of `least` rows."""
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
    return 0


def sort_rows(rows: Floats, threads: int | None = None) -> None:
    """Put rows (x, y, z and a number each, (n, 4)) into the order of `kd_order`, in place."""
    n = len(rows)
    flat, half = rows.reshape(-1), 1 << max(n - 1, 1).bit_length() - 1
    stretch = n
    while n > FEW and n // stretch < COARSE:
        # One cut of each span: its first part is as long as the first part of the first span.
        run(_cut, -(-n // stretch), flat, _stretches(n, stretch), half, threads=threads)
        stretch, half = half, half // 2
    run(_cut, -(-n // stretch), flat, _stretches(n, stretch), LEAF, threads=threads)


def _stretches(n: int, length: int) -> NDArray[np.int64]:
    starts = np.arange(0, n, length)
    return np.stack([starts, np.minimum(starts + length, n)], axis=1)


def kd_order(positions: Floats, threads: int | None = None) -> NDArray[np.int32]:
    """An order of the points in which each aligned stretch of 4, 16, 64 ... is a leaf or a subtree of a kd-tree.

    Parameters
    ----------
    positions : (n, 3) float32

    Returns
    -------
    (n,) int32
    """
    rows = np.empty((len(positions), ROW), np.float32)
    rows[:, :3] = positions
    rows.view(np.int32)[:, 3] = np.arange(len(positions), dtype=np.int32)
    sort_rows(rows, threads)
    return rows.view(np.int32)[:, 3].copy()
