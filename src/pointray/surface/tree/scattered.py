"""Tree over scattered points, under one root with that of the surface; its leaves hold spheres or single flat discs.

A leaf holds eight points that are neighbours in the kd order. The boxes of the leaves are halved by the surface area
heuristic (binned: I. Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", 2007), then collapsed into
nodes of eight.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles, Floats
from ...cloud.neighbors import kd_order
from ...engine.jit import Array, inline, kernel, next_tile, run
from ...engine.kernels import tree as tr
from ...engine.kernels.tree import Tree, first_scattered
from .blocks import PER_BLOCK, make_blocks
from .build import Splats, bounds_of, packed_colors, rows_of_slots, unpacked_colors
from .wide import collapse, enclose

PER_LEAF = tr.LEAF_BLOCKS * PER_BLOCK
CHUNK = 4096  # leaves per tile
BINS = 16  # candidate cuts of a node along each axis
DEEP = 32  # nodes below this level are halved by number: files with more than 64 levels are rejected
ROOM = 1.01  # radii: margin of the bounds, so that rays that start on a sphere start inside of them
PAD = 5e-7  # of the largest coordinate: margin for rounding of boxes and of rays against them

Boxes = Doubles


@kernel
def _bound(work: Array, blocks: Array, pad: float, boxes: Array) -> None:
    """Compute the boxes of leaves, each around eight spheres, and write them to `boxes`, (n, 6): lo x y z, hi x y z.

    blocks : (2 n * 28,), two blocks of splats for each leaf
    pad : length by which each sphere is enlarged, against rounding
    """
    tile = next_tile(work)
    while tile >= 0:
        for b in range(tile * CHUNK, min((tile + 1) * CHUNK, len(boxes))):
            for c in range(3):
                boxes[b, c], boxes[b, 3 + c] = np.inf, -np.inf
            for k in range(PER_LEAF):
                at = (tr.LEAF_BLOCKS * b + k // PER_BLOCK) * tr.BLOCK + k % PER_BLOCK
                if blocks[at + tr.PX] > tr.FAR:
                    continue
                radius = 1.00001 / np.sqrt(blocks[at + tr.INV_R2]) + pad
                for c in range(3):
                    x = blocks[at + tr.PX + PER_BLOCK * c]
                    boxes[b, c], boxes[b, 3 + c] = min(boxes[b, c], x - radius), max(boxes[b, 3 + c], x + radius)
        tile = next_tile(work)


@inline
def _half_area(bins: Array, k: int) -> float:
    """Return half the surface area of box k of `bins`, rows of lo x y z, hi x y z; 0 if it is empty."""
    x, y, z = bins[k, 3] - bins[k, 0], bins[k, 4] - bins[k, 1], bins[k, 5] - bins[k, 2]
    return x * y + y * z + z * x if x >= 0.0 else 0.0


@inline
def _grow(bins: Array, k: int, boxes: Array, b: int) -> None:
    """Extend the box of bin k by box b. bins, boxes : rows of lo x y z, hi x y z"""
    for c in range(3):
        bins[k, c], bins[k, 3 + c] = min(bins[k, c], boxes[b, c]), max(bins[k, 3 + c], boxes[b, 3 + c])


@inline
def _bin_of(boxes: Array, b: int, axis: int, low: float, scale: float) -> int:
    """Return the bin, 0 to 15, of the centre of boxes[b] along an axis.

    Twice the centre (the sum of the box's two faces) is divided into bins.

    low : the least of these sums among all boxes; scale : number of bins per unit of the sum
    """
    return min(max(int((boxes[b, axis] + boxes[b, 3 + axis] - low) * scale), 0), BINS - 1)


@inline
def _best_cut(boxes: Array, order: Array, span: tuple[int, int], bins: Array, memory: tuple[Array, Array]):  # type: ignore[no-untyped-def]
    """Return the cheapest cut of a node by the surface area heuristic, with 16 bins along each axis.

    boxes : (n, 6); order : indices of boxes; span : the node's range in `order`
    bins, memory : work space

    Returns (axis, first, low, scale), where
        `axis` is -1 if no cut is possible
        `first` is the first bin of the second half
        `low` is twice the least centre along the axis
        `scale` is the number of bins per unit of twice a centre
    """
    counts, costs = memory
    best, found = np.inf, (-1, 0, 0.0, 0.0)
    for axis in range(3):
        low, high = np.inf, -np.inf
        for i in range(span[0], span[1]):
            middle = boxes[order[i], axis] + boxes[order[i], 3 + axis]
            low, high = min(low, middle), max(high, middle)
        if not high > low:
            continue
        scale = BINS / (high - low)
        if not scale < np.inf:
            continue
        bins[:, :3], bins[:, 3:] = np.inf, -np.inf
        counts[:] = 0
        for i in range(span[0], span[1]):
            k = _bin_of(boxes, order[i], axis, low, scale)
            counts[k] += 1
            _grow(bins, k, boxes, order[i])
        total = 0
        bins[BINS, :3], bins[BINS, 3:] = np.inf, -np.inf
        for k in range(BINS - 1):
            _grow(bins, BINS, bins, k)
            total += counts[k]
            costs[k + 1] = total * _half_area(bins, BINS)
        total = 0
        bins[BINS, :3], bins[BINS, 3:] = np.inf, -np.inf
        for k in range(BINS - 1, 0, -1):
            _grow(bins, BINS, bins, k)
            total += counts[k]
            cost = costs[k] + total * _half_area(bins, BINS)
            if 0 < total < span[1] - span[0] and cost < best:
                best, found = cost, (axis, k, low, scale)
    return found


@inline
def _cut(
    boxes: Array, order: Array, span: tuple[int, int], bins: Array, memory: tuple[Array, Array], depth: int
) -> int:
    """Partition a node's boxes into two halves, by reordering `order`; return where in `order` the second half starts.

    boxes : (n, 6); order : indices of boxes; span : the node's range in `order`
    bins, memory : work space
    depth : level of the node; very deep ones are split into halves of equal number
    """
    middle = (span[0] + span[1]) // 2
    if depth > DEEP:
        return middle
    axis, first, low, scale = _best_cut(boxes, order, span, bins, memory)
    if axis < 0:
        return middle
    i, j = span[0], span[1]
    while i < j:
        if _bin_of(boxes, order[i], axis, low, scale) < first:
            i += 1
        else:
            j -= 1
            order[i], order[j] = order[j], order[i]
    return i


@kernel
def _halve(boxes: Array, order: Array, children: Array, leaf_of: Array) -> int:
    """Build a binary tree over n boxes whose leaves hold one box each; return the number of nodes.

    boxes : (n, 6); order : indices of the boxes, reordered here
    children : output, (2 n - 1, 2), the two children of each node, -1 for a leaf
    leaf_of : output, (2 n - 1,), the index of a leaf's box, -1 for other nodes
    """
    bins, memory = np.empty((BINS + 1, 6)), (np.empty(BINS, np.int64), np.empty(BINS + 1))
    stack = np.empty((len(boxes) + 1, 4), np.int64)  # node, first, end, depth
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, 0, len(boxes), 0
    top, total = 1, 1
    while top > 0:
        top -= 1
        node, first, end, depth = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        if end - first == 1:
            children[node, 0], children[node, 1], leaf_of[node] = -1, -1, order[first]
            continue
        middle = _cut(boxes, order, (first, end), bins, memory, depth)
        children[node, 0], children[node, 1], leaf_of[node] = total, total + 1, -1
        stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = total, first, middle, depth + 1
        top += 1
        stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = total + 1, middle, end, depth + 1
        top += 1
        total += 2
    return total


def _nodes(blocks: Floats, first: int, threads: int | None) -> tuple[Floats, NDArray[np.int32]]:
    """Build nodes of eight over blocks of scattered points; return their boxes (nodes * 48,) and children (nodes * 8,).

    blocks : (b * 28,), two for each leaf; first : number of the first of these blocks in the whole tree
    """
    count = blocks.size // (tr.LEAF_BLOCKS * tr.BLOCK)
    places = blocks.reshape(-1, 7, PER_BLOCK)[:, :3]
    pad = PAD * float(np.abs(places[places < tr.FAR]).max(initial=0.0))
    boxes, around = np.empty((count, 6)), np.empty((2 * count - 1, 6))
    run(_bound, -(-count // CHUNK), blocks, pad, boxes, threads=threads)
    children, leaf_of = np.empty((2 * count - 1, 2), np.int32), np.empty(2 * count - 1, np.int32)
    _halve(boxes, np.arange(count), children, leaf_of)
    enclose(children, leaf_of, boxes, around)
    numbers = np.where(leaf_of >= 0, tr.SCATTERED + first + tr.LEAF_BLOCKS * leaf_of.astype(np.int64), -1).astype(
        np.int32
    )
    wide_boxes = np.empty(len(children) * tr.NODE, np.float32)
    wide_children = np.empty(len(children) * tr.WIDTH, np.int32)
    wide = collapse(children, numbers, around, (wide_boxes, wide_children))
    return wide_boxes[: wide * tr.NODE].copy(), wide_children[: wide * tr.WIDTH].copy()


def _box_around(boxes: Floats) -> Floats:
    """Return the box around the children of a tree's root, (6,). boxes : those of its nodes of eight, the root first"""
    root = boxes[: tr.NODE].reshape(2, 3, tr.WIDTH)
    return np.concatenate([root[0].min(axis=1), root[1].max(axis=1)])


def _under_one_root(
    a: tuple[Floats, NDArray[np.int32]], b: tuple[Floats, NDArray[np.int32]]
) -> tuple[Floats, NDArray[np.int32]]:
    """Join the nodes of two trees under a new root; return boxes and children of the joined tree.

    a, b : boxes (nodes * 48,) and children (nodes * 8,) of each tree's nodes
    """
    boxes = np.repeat(np.array([np.inf] * 3 + [-np.inf] * 3, np.float32), tr.WIDTH).reshape(6, tr.WIDTH)
    boxes[:, 0], boxes[:, 1] = _box_around(a[0]), _box_around(b[0])
    root = np.full(tr.WIDTH, tr.NO_CHILD, np.int32)
    root[0], root[1] = 1, 1 + a[1].size // tr.WIDTH
    moved = [np.where(c >= 0, c + root[k], c).astype(np.int32) for k, c in enumerate((a[1], b[1]))]
    return np.concatenate([boxes.reshape(-1), a[0], b[0]]), np.concatenate([root, *moved])


def _whole_leaves(blocks: Floats) -> Floats:
    """Append an empty block if the number of blocks is odd: a leaf of scattered points holds two blocks."""
    empty = np.zeros((7, PER_BLOCK), np.float32)
    empty[:3], empty[tr.INV_R2 // PER_BLOCK] = tr.EMPTY, 1.0
    missing = -(blocks.size // tr.BLOCK) % tr.LEAF_BLOCKS
    return np.concatenate([blocks, *[empty.reshape(-1)] * missing])


def with_scattered(tree: Tree, scattered: Splats, kind: int, threads: int | None = None) -> Tree:
    """Return a tree with scattered points added, drawn as spheres or discs. The tree may have no surface.

    Parameters
    ----------
    scattered : Splats
        At least one. Their normals are those of discs or, for spheres, mean directions away from nearby points.
    kind : int
        SPHERES or DISCS.
    """
    order = kd_order(scattered.positions, threads)
    added = _whole_leaves(make_blocks(scattered.positions, scattered.normals, scattered.radii, order, threads)[0])
    first, slots = tree.blocks.size // tr.BLOCK, added.size // tr.BLOCK * PER_BLOCK
    boxes, children = _nodes(added, first, threads)
    if tree.blocks.size:
        boxes, children = _under_one_root((tree.boxes, tree.children), (boxes, children))
    head, bounds = tree.head.copy(), bounds_of(scattered._replace(radii=scattered.radii * np.float32(ROOM)))
    if tree.blocks.size:
        head[tr.BOUNDS : tr.BOUNDS + 3] = np.minimum(head[tr.BOUNDS : tr.BOUNDS + 3], bounds[:3])
        head[tr.BOUNDS + 3 : tr.BOUNDS + 6] = np.maximum(head[tr.BOUNDS + 3 : tr.BOUNDS + 6], bounds[3:])
    else:
        head[tr.BOUNDS : tr.BOUNDS + 6] = bounds
    head[tr.SCATTER], head[tr.SCATTER_LEAVES] = kind, added.size // (tr.LEAF_BLOCKS * tr.BLOCK)
    return tree._replace(
        head=head,
        boxes=boxes,
        children=children,
        blocks=np.concatenate([tree.blocks, added]),
        order=np.concatenate([tree.order, rows_of_slots(order, scattered.rows, slots)]),
        borders=np.concatenate([tree.borders, np.zeros(3 * slots if tree.borders.size else 0, np.int8)]),
        facing=np.concatenate([tree.facing, np.zeros(3 * slots if tree.facing.size else 0, np.int8)]),
        colors=np.concatenate([tree.colors, packed_colors(order, scattered.colors, slots)]),
        noise=np.concatenate([tree.noise, np.zeros(slots // PER_BLOCK if tree.noise.size else 0, np.float32)]),
    )


def scattered_rows(tree: Tree) -> NDArray[np.int32]:
    """Return the caller's rows of the scattered points of a tree, (m,), in the tree's order."""
    rows = tree.order[PER_BLOCK * first_scattered(tree) :]
    return rows[rows >= 0]


def scattered_of(tree: Tree, radii: Floats) -> Splats | None:
    """Return the scattered points of a tree as splats, in the tree's order, or None if it has none.

    radii : (n,), support radii of all the caller's rows; these are returned, because those in the tree are rounded
    """
    first = first_scattered(tree)
    if first * tr.BLOCK == tree.blocks.size:
        return None
    there = np.flatnonzero(tree.order[PER_BLOCK * first :] >= 0)
    rows = tree.order[PER_BLOCK * first :][there]
    blocks = tree.blocks[first * tr.BLOCK :].reshape(-1, 7, PER_BLOCK)
    columns = np.ascontiguousarray(blocks.transpose(0, 2, 1)).reshape(-1, 7)[there]
    colors = unpacked_colors(tree.colors[PER_BLOCK * first :][there]) if tree.colors.size else None
    return Splats(columns[:, :3].copy(), columns[:, 3:6].copy(), radii[rows], rows, colors)
