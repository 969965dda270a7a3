"""The kd-tree: space is cut into voxels, each of which knows every splat whose support overlaps it (part III).

A voxel also knows the splats within one step of a ray's samples around it. So a ray's samples are the same whatever
the voxels: those next to a voxel's border are evaluated in full from both sides of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import cancelled, inline, kernel
from ..records import BLOCK, INV_R2, PX, Array
from .blocks import PER_BLOCK

FEW = 3  # a voxel that so few blocks reach is not cut further
DEEPEST = 60
STEP_WIDTH = 8.0  # mean radii: where a voxel's ancestor is no wider, it decides the step of the samples in it
FULL = -2  # what build_cells returns when the arrays are too small
STOPPED = -1


class Cells(NamedTuple):
    """The binary kd-tree as it is built; children come after their parent.

    children : (nodes, 2) int32, -1 for a leaf
    boxes : (nodes, 6) float32, the voxel, shrunk to what the supports in it reach
    spans : (nodes, 2) int64, a leaf's part of refs
    refs : (references,) int32, numbers of blocks
    least : (nodes,) float32, least support radius over the voxel of STEP_WIDTH around: the same for voxels of any size
    """

    children: Array
    boxes: Array
    spans: Array
    refs: Array
    least: Array


@inline
def overlap(blocks, slot, cell):  # type: ignore[no-untyped-def]
    """Squared radius and squared distance to the cell of the splat at blocks[slot]: it overlaps where less or equal."""
    distance = np.float32(0.0)
    for c in range(3):
        p = blocks[slot + PX + 4 * c]
        d = max(cell[c] - p, p - cell[3 + c], np.float32(0.0))
        distance += d * d
    return np.float32(1.0) / blocks[slot + INV_R2], distance


@inline
def _gather(blocks, sources, cell, around, refs, start):  # type: ignore[no-untyped-def]
    """Write the blocks of `sources` that reach the cell, or its surroundings, to refs[start:].

    around : by how much the cell is grown for this test
    Shrinks the cell to their supports; a cell that nothing reaches comes out inverted. Returns the end, and the mean,
    the least and the greatest radius of these splats.
    """
    end = start
    total, count, shortest, longest = 0.0, 0, np.float32(np.inf), np.float32(0.0)
    grown = (cell[0] - around, cell[1] - around, cell[2] - around, cell[3] + around, cell[4] + around, cell[5] + around)
    least = (np.float32(np.inf), np.float32(np.inf), np.float32(np.inf))
    greatest = (np.float32(-np.inf), np.float32(-np.inf), np.float32(-np.inf))
    for s in range(sources[0], sources[1]):
        b = refs[s]
        reached = False
        for k in range(PER_BLOCK):
            slot = b * BLOCK + k
            r2, distance = overlap(blocks, slot, grown)
            if distance <= r2 and blocks[slot] < np.float32(1e14):
                reached = True
                r = np.sqrt(r2)
                total += r
                shortest, longest = min(shortest, r), max(longest, r)
                count += 1
                x, y, z = blocks[slot], blocks[slot + 4], blocks[slot + 8]
                least = (min(least[0], x - r), min(least[1], y - r), min(least[2], z - r))
                greatest = (max(greatest[0], x + r), max(greatest[1], y + r), max(greatest[2], z + r))
        if reached:
            refs[end] = b
            end += 1
    for c in range(3):
        cell[c] = max(cell[c], least[c])
        cell[3 + c] = min(cell[3 + c], greatest[c])
    return end, total / max(count, 1), shortest, np.float64(longest)


@kernel
def build_cells(work, blocks, width, step, out):  # type: ignore[no-untyped-def]
    """Cut the voxels in the middle of their longest edge until none is wider than `width` mean radii.

    step : longest step of the samples, in radii

    Voxels are first shrunk to the supports they contain: what no support reaches is never looked at again.
    Returns the number of nodes, FULL or STOPPED.
    """
    children, boxes, spans, refs, least = out
    count = blocks.size // BLOCK
    if count > refs.size:
        return FULL
    for b in range(count):
        refs[b] = b
    boxes[0, :3], boxes[0, 3:] = np.float32(-1e14), np.float32(1e14)
    _, mean, shortest, longest = _gather(blocks, (0, count), boxes[0], np.float32(0.0), refs, 0)
    least[0] = -shortest  # negative until it is decided
    top = 1
    pending = np.empty((2 * DEEPEST + 2, 4), np.int64)  # node, span of its refs in the work area, depth
    radii = np.empty((2 * DEEPEST + 2, 2), np.float64)  # mean and greatest
    pending[0], radii[0] = (0, 0, count, 0), (mean, longest)
    waiting = 1
    # Finished leaves grow from the end of refs downwards; the work area is a stack from its start upwards.
    floor = refs.size
    while waiting > 0:
        waiting -= 1
        node, begin, end, depth = pending[waiting]
        mean, longest = radii[waiting]
        if cancelled(work):
            return STOPPED
        cell = boxes[node]
        axis = 0
        for c in range(1, 3):
            if cell[3 + c] - cell[c] > cell[3 + axis] - cell[axis]:
                axis = c
        edge = cell[3 + axis] - cell[axis]
        ends = edge <= width * mean or end - begin <= FEW or depth >= DEEPEST
        if least[node] < 0.0 and (ends or edge <= STEP_WIDTH * mean):
            # Found with the step of the greatest radius: of those that a mean step reaches the least decides.
            cell = cell.copy()
            end, _, shortest, _ = _gather(blocks, (begin, end), cell, np.float32(step * mean), refs, begin)
            least[node] = shortest
        decided = least[node] > 0.0
        if ends:
            children[node] = -1
            if floor - (end - begin) < end:
                return FULL
            floor -= end - begin
            refs[floor : floor + end - begin] = refs[begin:end]
            spans[node, 0], spans[node, 1] = floor, floor + end - begin
            continue
        if top + 2 > children.shape[0] or end + 2 * (end - begin) > floor:
            return FULL
        cut = np.float32(0.5) * (cell[axis] + cell[3 + axis])
        start = end
        # Before the step is decided, the greatest radius bounds it.
        around = np.float32(step * (least[node] if decided else longest))
        for side in range(2):
            child = top + side
            children[node, side] = child
            boxes[child] = cell
            boxes[child, axis if side == 1 else 3 + axis] = cut
            stop, mean, shortest, longest = _gather(blocks, (begin, end), boxes[child], around, refs, start)
            least[child] = least[node] if decided else -shortest
            pending[waiting] = (child, start, stop, depth + 1)
            radii[waiting] = mean, longest
            waiting += 1
            start = stop
        top += 2
    return top
