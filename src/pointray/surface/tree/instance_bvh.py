"""BVH over the instances of a scene: a binary tree of their world boxes, split by the surface area heuristic.

It is small and is rebuilt whenever an instance is added, removed or moved.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles
from ...engine.jit import Array, f32, inline, kernel
from ...engine.kernels.records import TOP_BOUNDS, TOP_CENTER, TOP_NODE, TOP_SIZE

FEW = 3  # up to this many models are tested one after the other, without a tree
BINS = 16
DEEP = 48  # nodes at this depth and below are split into halves of equal number, to bound the traversal stack
PAD = 4e-6  # margin of boxes, as a share of the size of all boxes together, because rays are float32 there


@inline
def _half_area(low: Array, high: Array) -> float:
    """Return half the surface area of a box. low, high : its corners, (3,)"""
    x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
    return x * y + y * z + z * x


@inline
def _bin_of(x: float, low: float, width: float) -> int:
    """Return the bin, 0 to 15, of a box's centre x on an axis. low, width : least centre, and extent of all centres"""
    return min(int((x - low) * BINS / width), BINS - 1) if width > 0.0 else 0


@inline
def _costs(bins: tuple[Array, Array], out: Array) -> None:
    """Add to out[k] the cost of a node with the boxes of bins 0 to k: half the area of their bounds times their number.

    bins : counts (16,) and bounds (16, 6) of the boxes in each bin
    """
    counts, boxes = bins
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    number = 0
    for k in range(BINS):
        number += counts[k]
        for c in range(3):
            low[c], high[c] = min(low[c], boxes[k, c]), max(high[c], boxes[k, 3 + c])
        out[k] += _half_area(low, high) * number if number > 0 else 0.0


@inline
def _fill(boxes: Array, rows: Array, axis: int, span: tuple[float, float]) -> tuple[Array, Array]:
    """Sort boxes into 16 bins by their centres on an axis; return each bin's number of boxes (16,) and bounds (16, 6).

    boxes : (n, 6) lo x y z, hi x y z; rows : rows of the boxes to sort
    span : (low, width), the least centre, and the distance from there to the greatest
    """
    counts, held = np.zeros(BINS, np.int64), np.empty((BINS, 6))
    held[:, :3], held[:, 3:] = np.inf, -np.inf
    for i in rows:
        k = _bin_of(0.5 * (boxes[i, axis] + boxes[i, 3 + axis]), span[0], span[1])
        counts[k] += 1
        for c in range(3):
            held[k, c], held[k, 3 + c] = min(held[k, c], boxes[i, c]), max(held[k, 3 + c], boxes[i, 3 + c])
    return counts, held


@inline
def _split(boxes: Array, rows: Array, depth: int) -> int:
    """Split a node by the surface area heuristic: reorder its rows and return how many go to the first half.

    boxes : (n, 6); rows : rows of the node's boxes, at least two; neither half becomes empty
    depth : level of the node; very deep ones are split into halves of equal number
    """
    best, where, along, base, size = np.inf, -1, 0, 0.0, 0.0
    widest = -1.0
    for axis in range(3):
        low, high = np.inf, -np.inf
        for i in rows:
            middle = 0.5 * (boxes[i, axis] + boxes[i, 3 + axis])
            low, high = min(low, middle), max(high, middle)
        if high - low > widest:
            widest = high - low
            if best == np.inf:
                along, base, size = axis, low, high - low
        if not high > low or depth >= DEEP:
            continue
        counts, held = _fill(boxes, rows, axis, (low, high - low))
        before, after = np.zeros(BINS), np.zeros(BINS)
        _costs((counts, held), before)
        _costs((counts[::-1].copy(), held[::-1].copy()), after)
        number = 0  # of the boxes in bins 0 to k; with `sum`, Numba would import SciPy when the kernel is loaded
        for k in range(BINS - 1):
            number += counts[k]
            cost = before[k] + after[BINS - 2 - k]
            if cost < best and 0 < number < len(rows):
                best, where, along, base, size = cost, k, axis, low, high - low
    if where < 0:  # all centres are equal, or the node is too deep: split into halves of equal number
        middles = 0.5 * (boxes[rows, along] + boxes[rows, 3 + along])
        rows[:] = rows[np.argsort(middles)]
        return len(rows) // 2
    first, end = 0, len(rows)
    while first < end:
        i = rows[first]
        if _bin_of(0.5 * (boxes[i, along] + boxes[i, 3 + along]), base, size) <= where:
            first += 1
        else:
            end -= 1
            rows[first], rows[end] = rows[end], i
    return first


@inline
def _enclose(boxes: Array, rows: Array, out: Array) -> None:
    """Compute the box around some boxes and write it to `out`, (6,). boxes : (n, 6); rows : rows of these boxes"""
    for c in range(3):
        out[c], out[3 + c] = f32(np.inf), f32(-np.inf)
    for i in rows:
        for c in range(3):
            out[c] = min(out[c], f32(boxes[i, c]))
            out[3 + c] = max(out[3 + c], f32(boxes[i, 3 + c]))


@kernel
def _build(boxes: Array, numbers: Array, out: tuple[Array, Array]) -> None:
    """Build the nodes of a binary BVH over boxes of instances, or of lights; write them to `out`.

    boxes : (n, 6) float64, n > 1; numbers : (n,) index of each box's instance or light
    out : (boxes, children), where
        `boxes` has 12 numbers for each of the n - 1 nodes, the boxes of its two children
        `children` has 2 numbers for each node, a child >= 0 is a node, a child < 0 is instance ~child
    """
    out_boxes, out_children = out
    rows = np.arange(len(boxes))
    pending = np.empty((len(boxes), 4), np.int64)  # node, first and end of its rows, depth
    pending[0] = (0, 0, len(boxes), 0)
    waiting, nodes = 1, 1
    while waiting > 0:
        waiting -= 1
        node, first, end, depth = pending[waiting]
        middle = first + (1 if end - first == 2 else _split(boxes, rows[first:end], depth))
        for half in range(2):
            low, high = (first, middle) if half == 0 else (middle, end)
            at = node * TOP_NODE + half * (TOP_NODE // 2)
            _enclose(boxes, rows[low:high], out_boxes[at : at + TOP_NODE // 2])
            if high - low == 1:
                out_children[2 * node + half] = ~numbers[rows[low]]
                continue
            out_children[2 * node + half] = nodes
            pending[waiting] = (nodes, low, high, depth + 1)
            waiting, nodes = waiting + 1, nodes + 1


def boxes_around(to_models: Doubles, bounds: Doubles) -> Doubles:
    """Return the boxes of instances in world space, (n, 6): lo x y z, hi x y z.

    Parameters
    ----------
    to_models : (n, 3, 4) float64
        Transforms from the world to each instance's model.
    bounds : (n, 2, 3) float64
        Bounds of each instance's model in its own space, low and high corner.
    """
    back = np.linalg.inv(to_models[:, :, :3])
    middle, half = 0.5 * (bounds[:, 0] + bounds[:, 1]), 0.5 * (bounds[:, 1] - bounds[:, 0])
    center = np.einsum("nij,nj->ni", back, middle - to_models[:, :, 3])
    aside = np.einsum("nij,nj->ni", np.abs(back), half)
    return np.concatenate([center - aside, center + aside], axis=1)


def build_top(boxes: Doubles, numbers: NDArray[np.integer[Any]]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Build a binary BVH over the world boxes of a scene's models, or over the boxes of its lights.

    Parameters
    ----------
    boxes : (n, 6) float64
        lo x y z, hi x y z; n may be 0.
    numbers : (n,) int64
        Index of each box's instance, or light.

    Returns
    -------
    top : (9,) float64
        Centre of all boxes, and the box around all of them relative to this centre.
    top_boxes : (nodes * 12,) float32
        Boxes of both children of each node, relative to the centre; no nodes for up to three boxes.
    top_children : (nodes * 2,) int32
        A child >= 0 is a node, a child < 0 is instance (or light) ~child.
    """
    top = np.zeros(TOP_SIZE)
    nodes = max(len(boxes) - 1, 0) if len(boxes) > FEW else 0
    top_boxes, top_children = np.zeros(nodes * TOP_NODE, np.float32), np.zeros(nodes * 2, np.int32)
    if len(boxes) == 0:
        return top, top_boxes, top_children
    low, high = boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)
    center = 0.5 * (low + high)
    pad = PAD * (np.abs(high - low).max() + np.abs(center).max() * 1e-6)
    top[TOP_CENTER : TOP_CENTER + 3] = center
    top[TOP_BOUNDS : TOP_BOUNDS + 6] = [*(low - center - 2 * pad), *(high - center + 2 * pad)]
    if nodes > 0:
        around = np.concatenate([boxes[:, :3] - center - pad, boxes[:, 3:] - center + pad], axis=1)
        _build(around, numbers, (top_boxes, top_children))
    return top, top_boxes, top_children
