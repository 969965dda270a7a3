"""kd-tree: cuts of space into voxels, each with a list of all splats whose support overlaps it (part III).

The surface area heuristic decides whether to cut a voxel: the cost of its halves and of a node above them, each in
proportion to the surface area of its box, is compared with the cost of the whole voxel.

A voxel also lists the splats within one sample step around it. So a ray's samples do not depend on the voxels: samples
next to a face are evaluated completely from both sides of it.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from ...engine.jit import Array, cancelled, f32, inline, kernel, next_tile
from ...engine.kernels.tree import BLOCK
from .near import Box, Span, copy_near, gather, room_for

FEW = 3  # a voxel with at most this many blocks is not cut
DEEPEST = 60  # maximum number of cuts below a root
STEP_WIDTH = 8.0  # mean radii: the first ancestor at most this wide determines the sample step in a voxel
# A voxel is cut while it is wider than this many of its least radii (128 samples). Otherwise the smallest splat would
# determine the step over a voxel of splats ten thousand times as wide. Voxels of regular scans are smaller anyway.
MOST_LEAST = 64.0
FREEDOM = 2.0  # voxels may be this many times smaller than requested where the costs favour it
# Time that a ray spends, in nanoseconds, on a node, a leaf, a block of the leaf, and samples a least radius apart;
# rounded between profiles of rays in tiles (3, 10, 0.5, 40) and single rays (35, 20, 3, 50). Render times depend little
# on them (10, 30, 1, 50: within 2%); with 5, 10, 1, 20 distant views of 1 million points take 4% longer.
NODE_COST, LEAF_COST, BLOCK_COST, SAMPLE_COST = 10.0, 10.0, 1.0, 50.0
FULL = -1  # in place of the number of nodes of a root whose arrays were too small

Parts: TypeAlias = tuple[Array, Array, Array, Array, Array]  # one root's slices of the arrays of `Cells`


class Cells(NamedTuple):
    """Binary kd-tree under construction, whose leaves are voxels with lists of blocks.

    children : (nodes, 2) int32, numbers of later nodes, -1 for a leaf
    boxes : (nodes, 6) float32, lo x y z, hi x y z; a leaf's box is its voxel, shrunk to the supports in it
    spans : (nodes, 2) int64, begin and end in refs of a leaf's list of blocks
    refs : (references,) int32, block numbers
    least : (nodes,) float32, least support radius over a larger voxel around this one, so that the sample distance does
        not depend on the size of the voxels
    """

    children: Array
    boxes: Array
    spans: Array
    refs: Array
    least: Array


@inline
def _shrink(cell: Array, box: Box) -> None:
    """Clip `cell`, lo x y z, hi x y z, to a box, in place."""
    for c in range(3):
        cell[c] = max(cell[c], box[c])
        cell[3 + c] = min(cell[3 + c], box[3 + c])


@inline
def _area(box: Array) -> float:
    """Return half the surface area of a box, proportional to the probability of a hit; 0 for an empty box."""
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x if x >= 0 and y >= 0 and z >= 0 else f32(0.0)


@inline
def _cost(box: Array, count: int, mean: float, least: float) -> float:
    """Return the estimated time that rays spend in a leaf, in nanoseconds times half its surface area.

    The surface area heuristic compares such costs to decide whether to cut a voxel.

    box : the leaf's box; count : number of blocks that the leaf lists
    mean, least : mean and least support radius in the leaf; samples are closer for a smaller least radius
    """
    return _area(box) * (LEAF_COST + BLOCK_COST * count + SAMPLE_COST * mean / max(abs(least), 1e-30))


@inline
def _longest_edge(box: Array) -> tuple[int, float]:
    """Return the axis (0 to 2) and the length of a box's longest edge."""
    axis = 0
    for c in range(1, 3):
        if box[3 + c] - box[c] > box[3 + axis] - box[axis]:
            axis = c
    return axis, box[3 + axis] - box[axis]


@inline
def _decide(near: Array, sources: Span, box: Array, mean: float, step: float, refs: Array) -> tuple[int, float]:
    """Fix a voxel's sample distance, and drop blocks whose supports are all farther than this distance from its box.

    Samples are `step` times a radius apart: the least support radius around the voxel, which is returned.

    near : positions and squared radii of all blocks of the root
    sources : range in refs of the blocks to test; those that stay are moved to its front
    mean : mean support radius in the voxel; blocks farther than `step * mean` are dropped
    refs : indices of blocks in `near`

    Returns the end in refs of the blocks that stay, and the radius, at most `mean`.
    """
    end, _, shortest, _, _ = gather(near, sources, box, f32(step * mean), refs, sources[0])
    return end, min(shortest, f32(mean))


@inline
def _halve(
    near: Array, span: Span, cut: tuple[int, int, int], around: tuple[float, float], radii: Array, out: Parts
) -> tuple[int, int, int]:
    """Halve a voxel: write the boxes and block lists of two child nodes, from the voxel's blocks refs[span].

    near : positions and squared radii of all blocks of the root
    cut : (node, first, axis), the voxel's node, the node of its first half, and the axis that is cut
    around : (step, radius), whose product is the sample distance, or an upper bound before that is known; a half lists
        the blocks with a support over its box grown by this distance
    radii : output, (2, 2), mean and largest support radius over each half; before the sample distance is known, the
        mean is at most `radius`
    out : children, boxes, ranges in refs, refs, and least radii of the nodes of one root

    Returns three ends in refs: of the voxel's blocks, of the first half's, which follow, and of the second half's.
    """
    boxes, refs, least = out[1], out[3], out[4]
    node, first, axis = cut
    middle = f32(0.5) * (boxes[node, axis] + boxes[node, 3 + axis])
    ends, growth = (span[1], span[1], span[1]), f32(around[0] * around[1])
    for side in range(2):
        child = first + side
        boxes[child] = boxes[node]
        boxes[child, axis if side == 1 else 3 + axis] = middle
        end, mean, shortest, longest, supports = gather(near, span, boxes[child], growth, refs, ends[side])
        _shrink(boxes[child], supports)
        ends = (span[1], end, end) if side == 0 else (span[1], ends[1], end)
        least[child] = least[node] if least[node] > 0.0 else -shortest
        radii[side] = mean if least[node] > 0.0 else min(mean, around[1]), longest
    return ends


@inline
def _cut_root(work: Array, blocks: Array, numbers: Array, limits: tuple[float, float, float], out: Parts) -> int:
    """Cut the box of a root, boxes[0], into voxels, whose nodes and block lists are written to `out`.

    numbers : numbers of the blocks that may overlap the root
    limits : (width, step, around), where
        `width` is the maximum width of voxels, in mean radii
        `step` is the maximum distance of samples along a ray, in radii
        `around` is the margin around the root's box within which supports matter
    out : children, boxes, ranges in refs, refs, and least radii of the nodes; during the work refs holds indices into
        `numbers`, at the end numbers of blocks

    Returns the number of nodes, or FULL if the arrays of `out` are too small.
    """
    children, boxes, spans, refs, least = out
    width, step, around = limits
    near = np.empty(room_for(len(numbers)), np.float32)
    copy_near(blocks, numbers, near)
    for k in range(len(numbers)):
        refs[k] = k
    count, mean, shortest, longest, supports = gather(near, (0, len(numbers)), boxes[0], f32(around), refs, 0)
    _shrink(boxes[0], supports)
    least[0] = -shortest  # negative until it is final
    top = 1
    pending = np.empty((2 * DEEPEST + 2, 4), np.int64)  # node, span of its refs in the work area, depth
    radii = np.empty((2 * DEEPEST + 2, 2), np.float64)  # mean and greatest
    pending[0], radii[0] = (0, 0, count, 0), (min(mean, around / step), longest)
    waiting = 1
    # Finished leaves fill refs from its end downwards; the work area is a stack from its start upwards.
    floor = refs.size
    while waiting > 0 and not cancelled(work):
        waiting -= 1
        node, begin, end, depth = pending[waiting]
        mean, longest = radii[waiting]
        axis, edge = _longest_edge(boxes[node])
        fine = edge <= MOST_LEAST * abs(least[node]) or depth >= DEEPEST
        leaf = fine and (edge * FREEDOM <= width * mean or depth >= DEEPEST)
        if least[node] < 0.0 and fine and (leaf or end - begin <= FEW or edge <= STEP_WIDTH * mean):
            end, least[node] = _decide(near, (begin, end), boxes[node], mean, step, refs)
        leaf |= fine and end - begin <= FEW
        if top + 2 > children.shape[0] or end + 2 * (end - begin) > floor:
            return FULL
        halves = (end, end, end)
        if not leaf:
            # Until the step is final, it is bounded by the largest radius; and by the edge, or a wide splat among small
            # ones makes all halves list most of these (320,000 points with such splats took 22 s, now 0.3).
            most = least[node] if least[node] > 0.0 else min(longest, edge)
            halves = _halve(near, (begin, end), (node, top, axis), (step, most), radii[waiting : waiting + 2], out)
            if fine and edge <= width * mean:
                parts = NODE_COST * _area(boxes[node])
                for side in range(2):
                    child, count = top + side, halves[side + 1] - halves[side]
                    parts += _cost(boxes[child], count, radii[waiting + side, 0], least[child])
                leaf = _cost(boxes[node], end - begin, mean, least[node]) <= parts
        if leaf:
            if least[node] < 0.0:
                end, least[node] = _decide(near, (begin, end), boxes[node], mean, step, refs)
            children[node] = -1
            floor -= end - begin
            for k in range(end - begin):
                refs[floor + k] = numbers[refs[begin + k]]
            spans[node, 0], spans[node, 1] = floor, floor + end - begin
            continue
        for side in range(2):
            children[node, side] = top + side
            pending[waiting + side] = (top + side, halves[side], halves[side + 1], depth + 1)
        waiting += 2
        top += 2
    return top


@kernel
def cut_roots(
    work: Array,
    blocks: Array,
    roots: tuple[Array, Array, Array],
    limits: tuple[float, float, int],
    out: tuple[Cells, Array],
) -> None:
    """Cut roots, boxes at the top of a kd-tree, into voxels, in the middle of their longest edges, each by one thread.

    Voxels are first shrunk to the supports they contain, so that empty space is never examined again.

    roots : (firsts, groups, around), where
        `firsts`, (roots + 1, 3), says where each root's nodes, block references and groups begin
        `groups` holds for one root after the other the numbers of the groups of blocks that may overlap it
        `around`, (roots,), is the margin around each root's box within which supports matter
    limits : (width, step, per_group), where
        `width` is the maximum width of voxels, in mean radii
        `step` is the maximum distance of samples along a ray, in radii
        `per_group` is the number of blocks per group
    out : (cells, used), where
        `cells` receives the nodes; the boxes of the roots are given
        `used`, (roots,), receives the number of nodes of each root, or FULL if the arrays of `cells` are too small
    """
    firsts, groups, around = roots
    width, step, per_group = limits
    cells, used = out
    root = next_tile(work)
    while root >= 0:
        a, b = firsts[root], firsts[root + 1]
        refs = cells.refs[a[1] : b[1]]
        numbers, count = np.empty(per_group * (b[2] - a[2]), np.int32), 0
        for g in groups[a[2] : b[2]]:
            for block in range(g * per_group, min((g + 1) * per_group, blocks.size // BLOCK)):
                numbers[count] = block
                count += 1
        nodes = slice(a[0], b[0])
        used[root] = _cut_root(
            work,
            blocks,
            numbers[:count],
            (width, step, around[root]),
            (cells.children[nodes], cells.boxes[nodes], cells.spans[nodes], refs, cells.least[nodes]),
        )
        root = next_tile(work)
