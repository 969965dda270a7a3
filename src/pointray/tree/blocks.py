"""Splats in an order that keeps neighbours together, four to a block."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..jit import Array, cancelled, f32, inline, kernel, next_tile, run, uncompiled
from ..kernels.tree import BLOCK, EMPTY, INV_R2, NX, PX

PER_BLOCK = 4
CHUNK = 4096  # blocks that a thread fills at a time


@inline
def _select(rows: Array, axis: int, low: int, high: int, nth: int) -> None:
    """Partition rows[low:high] so that row `nth` is where sorting along an axis would put it (Hoare's quickselect)."""
    left, right = low, high - 1
    while right > left:
        pivot = rows[(left + right) >> 1, axis]
        i, j = left, right
        while i <= j:
            while rows[i, axis] < pivot:
                i += 1
            while rows[j, axis] > pivot:
                j -= 1
            if i <= j:
                for c in range(4):
                    rows[i, c], rows[j, c] = rows[j, c], rows[i, c]
                i += 1
                j -= 1
        if nth <= j:
            right = j
        elif nth >= i:
            left = i
        else:
            return


@inline
def _widest_axis(rows: Array, low: int, high: int) -> int:
    best, axis = f32(-1.0), 0
    for c in range(3):
        least = greatest = rows[low, c]
        for i in range(low + 1, high):
            value = rows[i, c]
            least = min(least, value)
            greatest = max(greatest, value)
        if greatest - least > best:
            best, axis = greatest - least, c
    return axis


@inline
def _middle(low: int, high: int) -> int:
    """Where a span is cut in halves, rounded to whole blocks."""
    return low + ((high - low + 2 * PER_BLOCK - 1) // (2 * PER_BLOCK)) * PER_BLOCK


@kernel
def _sort_rows(work: Array, rows: Array, spans: Array, limit: int) -> int:
    """Cut each span of rows (x, y, z, number) at the median of its widest axis, down to spans of `limit` rows."""
    stack = np.empty((64, 2), np.int64)
    span = next_tile(work)
    while span >= 0:
        stack[0, 0], stack[0, 1] = spans[span, 0], spans[span, 1]
        depth = 1
        while depth > 0:
            depth -= 1
            low, high = stack[depth, 0], stack[depth, 1]
            if high - low <= limit or cancelled(work):
                continue
            middle = _middle(low, high)
            _select(rows, _widest_axis(rows, low, high), low, high, middle)
            stack[depth, 0], stack[depth, 1] = low, middle
            stack[depth + 1, 0], stack[depth + 1, 1] = middle, high
            depth += 2
        span = next_tile(work)
    return 0


def _spans(low: int, high: int, limit: int) -> list[tuple[int, int]]:
    """The spans that `_sort_rows` leaves behind."""
    if high - low <= limit:
        return [(low, high)]
    middle = int(uncompiled(_middle)(low, high))
    return _spans(low, middle, limit) + _spans(middle, high, limit)


def sort_splats(positions: NDArray[np.float32], threads: int | None = None) -> NDArray[np.int32]:
    """An order of the points in which each block of four holds neighbours: the leaves of a balanced kd-tree.

    Parameters
    ----------
    positions : (n, 3) float32

    Returns
    -------
    (n,) int32
    """
    n = len(positions)
    rows = np.empty((n, 4), np.float32)
    rows[:, :3] = positions
    rows.view(np.int32)[:, 3] = np.arange(n, dtype=np.int32)
    coarse = max(n // 16, 4 * PER_BLOCK)
    run(_sort_rows, 1, rows, np.array([[0, n]]), coarse, threads=1)
    spans = np.array(_spans(0, n, coarse))
    run(_sort_rows, len(spans), rows, spans, PER_BLOCK, threads=threads)
    return rows.view(np.int32)[:, 3].copy()


@kernel
def _fill_blocks(
    work: Array, order: Array, positions: Array, normals: Array, radii: Array, out: tuple[Array, Array]
) -> int:
    """Copy splats into blocks and bound each block: out is (blocks, bounds (blocks * 4: centre, radius))."""
    blocks, bounds = out
    tile = next_tile(work)
    while tile >= 0:
        for b in range(tile * CHUNK, min((tile + 1) * CHUNK, bounds.size // 4)):
            count = min(PER_BLOCK, order.size - b * PER_BLOCK)
            for k in range(PER_BLOCK):
                i = order[b * PER_BLOCK + k] if k < count else -1
                for c in range(3):
                    blocks[b * BLOCK + PX + 4 * c + k] = positions[i, c] if i >= 0 else EMPTY
                    blocks[b * BLOCK + NX + 4 * c + k] = normals[i, c] if i >= 0 else f32(0.0)
                blocks[b * BLOCK + INV_R2 + k] = f32(1.0) / (radii[i] * radii[i]) if i >= 0 else f32(1.0)
            for c in range(3):
                least, greatest = np.inf, -np.inf
                for k in range(count):
                    i = order[b * PER_BLOCK + k]
                    least = min(least, positions[i, c] - radii[i])
                    greatest = max(greatest, positions[i, c] + radii[i])
                bounds[b * 4 + c] = 0.5 * (least + greatest)
            radius = 0.0
            for k in range(count):
                i = order[b * PER_BLOCK + k]
                square = 0.0
                for c in range(3):
                    d = positions[i, c] - bounds[b * 4 + c]
                    square += d * d
                radius = max(radius, math.sqrt(square) + radii[i])
            bounds[b * 4 + 3] = radius * (1.0 + 1e-6)
        tile = next_tile(work)
    return 0


def make_blocks(
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
    radii: NDArray[np.float32],
    order: NDArray[np.int32],
    threads: int | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Blocks (see `kernels.tree.BLOCK`) of the splats in the given order, and each block's bounding sphere.

    Returns
    -------
    blocks : (b * 28,) float32
    bounds : (b * 4,) float32, centre and radius; encloses the supports of the block's splats
    """
    count = -(-len(order) // PER_BLOCK)
    blocks = np.empty(count * BLOCK, np.float32)
    bounds = np.empty(count * 4, np.float32)
    run(_fill_blocks, -(-count // CHUNK), order, positions, normals, radii, (blocks, bounds), threads=threads)
    return blocks, bounds
