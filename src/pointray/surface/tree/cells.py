"""The kd-tree: space is cut into voxels, and each voxel lists every splat whose support overlaps it (part III).

The surface area heuristic decides whether a voxel is cut: the cost of its two halves and of a node above them, each in
proportion to the surface of its box, is compared with the cost of the whole voxel.

A voxel also lists the splats within one sample step around it. So a ray's samples do not depend on the voxels: samples
next to a voxel's face are evaluated in full from both sides of it.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from ...engine.jit import Array, cancelled, f32, inline, kernel, next_tile
from ...engine.kernels.tree import BLOCK
from .near import Box, Span, copy_near, gather, room_for

FEW = 3  # a voxel with no more blocks than this is not cut further
DEEPEST = 60  # cuts below a root
STEP_WIDTH = 8.0  # mean radii: the first ancestor that is no wider than this decides the sample step in a voxel
# A voxel is cut while it is wider than this many of its least radii: 128 samples. Otherwise the narrowest splat decides
# the step over a whole voxel of splats ten thousand times as wide. Voxels of even scans are narrower by themselves.
MOST_LEAST = 64.0
FREEDOM = 2.0  # voxels may be this many times narrower than asked for, where the costs favour it
# The time that a ray spends, in nanoseconds, on a node, a leaf, a block of the leaf, and samples a least radius apart.
# These are rounded between profiles of rays in tiles (3, 10, 0.5, 40) and single rays (35, 20, 3, 50). Render times
# depend on them little (10, 30, 1, 50: within 2%); with 5, 10, 1, 20, 1 million points from afar take 4% longer.
NODE_COST, LEAF_COST, BLOCK_COST, LOOK_COST = 10.0, 10.0, 1.0, 50.0
FULL = -1  # stands for the number of nodes of a root whose arrays were too small

Parts: TypeAlias = tuple[Array, Array, Array, Array, Array]  # one root's parts of the arrays of `Cells`


class Cells(NamedTuple):
    """The binary kd-tree as it is built; children come after their parent.

    children : (nodes, 2) int32, -1 for a leaf
    boxes : (nodes, 6) float32; a leaf's box is its voxel, shrunk to the supports in it
    spans : (nodes, 2) int64, a leaf's part of refs
    refs : (references,) int32, numbers of blocks
    least : (nodes,) float32, least support radius over the ancestor voxel of STEP_WIDTH, so it does not depend on
        the size of the voxels
    """

    children: Array
    boxes: Array
    spans: Array
    refs: Array
    least: Array


@inline
def _shrink(cell: Array, box: Box) -> None:
    """Cut a cell to a box."""
    for c in range(3):
        cell[c] = max(cell[c], box[c])
        cell[3 + c] = min(cell[3 + c], box[3 + c])


@inline
def _area(box: Array) -> float:
    """Half the surface of a box, in proportion to which rays meet it; 0 for an empty one."""
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x if x >= 0 and y >= 0 and z >= 0 else f32(0.0)


@inline
def _cost(box: Array, count: int, mean: float, least: float) -> float:
    """The cost of a leaf with `count` blocks; a smaller least radius brings samples closer together."""
    return _area(box) * (LEAF_COST + BLOCK_COST * count + LOOK_COST * mean / max(abs(least), 1e-30))


@inline
def _longest_edge(box: Array) -> tuple[int, float]:
    """The axis and the length of a box's longest edge."""
    axis = 0
    for c in range(1, 3):
        if box[3 + c] - box[c] > box[3 + axis] - box[axis]:
            axis = c
    return axis, box[3 + axis] - box[axis]


@inline
def _decide(near: Array, sources: Span, box: Array, mean: float, step: float, refs: Array) -> tuple[int, float]:
    """The end of the blocks that stay, and the least radius around a voxel, which decides the step of its samples.

    The voxel's blocks were found with the step of a greater radius; those within a step of the mean radius stay.
    """
    end, _, shortest, _, _ = gather(near, sources, box, f32(step * mean), refs, sources[0])
    return end, min(shortest, f32(mean))


@inline
def _halve(
    near: Array, span: Span, cut: tuple[int, int, int], around: tuple[float, float], radii: Array, out: Parts
) -> tuple[int, int, int]:
    """Make the two halves of a voxel whose blocks are `span` of refs; the halves' blocks follow it. Returns three ends.

    cut : the voxel's node, the first half's node, the axis
    around : a half is grown by this step, in radii, times this radius to find its blocks
    radii : the mean and greatest radius of each half are written here; the mean, which may yet decide the step, is at
        most `around[1]` until then
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
    """Cut the voxel boxes[0], whose blocks are among `numbers`; returns the number of nodes or FULL.

    In refs blocks go by their place in `numbers`, until they are a leaf's.
    limits : width and step, see `cut_roots`, and by how much the voxel is grown to find its blocks
    """
    children, boxes, spans, refs, least = out
    width, step, around = limits
    near = np.empty(room_for(len(numbers)), np.float32)
    copy_near(blocks, numbers, near)
    for k in range(len(numbers)):
        refs[k] = k
    count, mean, shortest, longest, supports = gather(near, (0, len(numbers)), boxes[0], f32(around), refs, 0)
    _shrink(boxes[0], supports)
    least[0] = -shortest  # negative until it is decided
    top = 1
    pending = np.empty((2 * DEEPEST + 2, 4), np.int64)  # node, span of its refs in the work area, depth
    radii = np.empty((2 * DEEPEST + 2, 2), np.float64)  # mean and greatest
    pending[0], radii[0] = (0, 0, count, 0), (min(mean, around / step), longest)
    waiting = 1
    # Finished leaves grow from the end of refs downwards; the work area is a stack from its start upwards.
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
            # Before the step is decided, the greatest radius bounds it; and the edge, else a wide splat among narrow
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
) -> int:
    """Cut voxels in the middle of their longest edges, each root in its own part of the arrays.

    roots : as in `tree/subtrees.py`: first node, first reference and first group of each; groups; growth of each root
    limits : greatest width of the voxels in mean radii; longest step of the samples in radii; blocks in a group
    out : a `Cells` that holds the roots' boxes, and the number of nodes of each root, or FULL

    Voxels are first shrunk to the supports they contain, so space without supports is never examined again.
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
    return 0
