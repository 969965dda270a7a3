"""The top of the kd-tree: space is cut into roots, and threads then cut each root further on its own.

A root is the space around a stretch of the kd order, so that all hold about as many splats. Neighbouring blocks are
joined into groups, so that the top is quick to build. It does not depend on the number of threads.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...cloud.neighbors.order import first_part
from ...engine.jit import Array, borrow, f32, kernel, next_tile, run, uncompiled
from ...engine.kernels.tree import BLOCK, FAR, INV_R2, PX
from .blocks import PER_BLOCK

PER_GROUP = 64  # blocks
ROOTS = 128  # at least so many roots are made of large models
CROWDED = 8  # times the groups: if all roots list more than that, there is one root
LEAST, MOST = 64, 1024  # groups of a root's own, powers of two


class Groups(NamedTuple):
    """What the top needs to know of groups of 64 blocks that follow each other.

    supports : (g, 6) float32, boxes around their splats' supports
    places : (g, 6) float32, boxes around their splats' positions
    longest : (g,) float32, their greatest radii
    """

    supports: NDArray[np.float32]
    places: NDArray[np.float32]
    longest: NDArray[np.float32]


class Top(NamedTuple):
    """The nodes above the roots.

    children : two for each node, a node or ~root
    boxes : (6,) for each root; groups : those that overlap it; around : how far around it splats matter
    """

    children: list[list[int]]
    boxes: list[NDArray[np.float64]]
    groups: list[NDArray[np.int64]]
    around: list[float]


@kernel
def _bound_groups(work: Array, blocks: Array, bounds: Array, out: Groups) -> int:
    """Bound each group: out is filled."""
    blocks, bounds = borrow(blocks), borrow(bounds)
    group = next_tile(work)
    while group >= 0:
        supports, places, inverse = out.supports[group], out.places[group], f32(np.inf)
        supports[:3], supports[3:], places[:3], places[3:] = np.inf, -np.inf, np.inf, -np.inf
        for b in range(group * PER_GROUP, min((group + 1) * PER_GROUP, bounds.size // 4)):
            for c in range(3):
                centre, radius = bounds[b * 4 + c], bounds[b * 4 + 3]
                supports[c], supports[3 + c] = min(supports[c], centre - radius), max(supports[3 + c], centre + radius)
            for k in range(PER_BLOCK):
                if blocks[b * BLOCK + PX + k] < FAR:
                    inverse = min(inverse, blocks[b * BLOCK + INV_R2 + k])
                    for c in range(3):
                        x = blocks[b * BLOCK + PX + 4 * c + k]
                        places[c], places[3 + c] = min(places[c], x), max(places[3 + c], x)
        out.longest[group] = f32(1.0 / math.sqrt(inverse))
        group = next_tile(work)
    return 0


class _Node(NamedTuple):
    """A node of the top that is to be cut.

    stretches : of the roots below it; groups : (m,) that may overlap it; cell : (6,), not yet shrunk to their supports
    parent, side : where its parent names it; -1 for none
    """

    stretches: range
    groups: NDArray[np.int64]
    cell: NDArray[np.float64]
    parent: int
    side: int


def groups_of(blocks: Array, bounds: Array, threads: int | None = None) -> Groups:
    """The groups of blocks, which are given as `blocks.make_blocks` makes them."""
    count = -(-len(bounds) // (4 * PER_GROUP))
    groups = Groups(np.empty((count, 6), np.float32), np.empty((count, 6), np.float32), np.empty(count, np.float32))
    run(_bound_groups, count, blocks, bounds, groups, threads=threads)
    return groups


def groups_per_root(groups: int) -> int:
    """How many groups of a model with so many are of one root's stretch."""
    per_root = LEAST
    while per_root < MOST and 2 * per_root * ROOTS <= groups:
        per_root *= 2
    return per_root


def cut_top(groups: Groups, step: float, part: range | None = None, within: NDArray[np.float64] | None = None) -> Top:
    """Cut space along the kd order, stretch by stretch, down to the roots.

    Parameters
    ----------
    groups : Groups
        All of a model.
    step : float
        Longest step of the samples, in radii.
    part : range, optional
        A stretch of the groups, aligned: only the roots in it are wanted, with what is above them there.
    within : (6,) float64, optional
        A box: only the space in it is cut.
    """
    supports, _, longest = groups
    stretches, per_root = _stretches(groups)
    wanted = range(len(stretches))
    if part is not None:
        wanted = range(part.start // per_root, -(-part.stop // per_root))
    top = Top([], [], [], [])
    space = _everything() if within is None else within
    pending = [_Node(range(len(stretches)), np.arange(len(supports)), space, -1, 0)]
    while pending:
        node = pending.pop()
        if node.stretches.start >= wanted.stop or node.stretches.stop <= wanted.start:
            continue
        rows = node.groups
        low, high = supports[rows, :3].min(axis=0, initial=FAR), supports[rows, 3:].max(axis=0, initial=-FAR)
        cell = np.concatenate([np.maximum(node.cell[:3], low), np.minimum(node.cell[3:], high)])
        edge = float((cell[3:] - cell[:3]).max())
        around = step * max(min(float(longest[rows].max(initial=0.0)), edge), 0.0)
        whole = len(node.stretches) == 1
        inside = wanted.start <= node.stretches.start and node.stretches.stop <= wanted.stop
        number = ~len(top.boxes) if whole else len(top.children) if inside else -1
        if node.parent >= 0:
            top.children[node.parent][node.side] = number
        if whole:
            top.boxes.append(cell)
            top.groups.append(rows)
            top.around.append(around)
            continue
        if inside:
            top.children.append([0, 0])
        half = uncompiled(first_part)(len(node.stretches))
        sides = node.stretches[:half], node.stretches[half:]
        axis, place = _plane_between(*(stretches[side.start : side.stop] for side in sides))
        for side, face in enumerate((3 + axis, axis)):
            box = cell.copy()
            box[face] = min(max(place, cell[axis]), cell[3 + axis])
            meets = (supports[rows, :3] <= box[3:] + around) & (supports[rows, 3:] >= box[:3] - around)
            pending.append(_Node(sides[side], rows[meets.all(axis=1)], box, number, side))
    if sum(len(rows) for rows in top.groups) > CROWDED * per_root * len(wanted):
        return _one_root(top)
    return top


def cells_of_parts(groups: Groups, size: int) -> NDArray[np.float64]:
    """The boxes that the same planes cut all space into, (parts, 6): of parts of so many groups, a power of two."""
    stretches, per_root = _stretches(groups)
    most, cells = size // per_root, np.empty((-(-len(groups.longest) // size), 6))
    pending = [(range(len(stretches)), _everything())]
    while pending:
        node, cell = pending.pop()
        if len(node) <= most:
            cells[node.start // most] = cell
            continue
        half = uncompiled(first_part)(len(node))
        sides = node[:half], node[half:]
        axis, place = _plane_between(*(stretches[side.start : side.stop] for side in sides))
        for side, face in zip(sides, (3 + axis, axis), strict=True):
            box = cell.copy()
            box[face] = place
            pending.append((side, box))
    return cells


def _everything() -> NDArray[np.float64]:
    return np.array([-FAR] * 3 + [FAR] * 3, np.float64)


def _one_root(top: Top) -> Top:
    """The same space as a single root: where splats reach over nearly all of it, cuts make no root smaller."""
    boxes = np.array(top.boxes)
    cell = np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])
    return Top([], [cell], [np.unique(np.concatenate(top.groups))], [max(top.around)])


def _stretches(groups: Groups) -> tuple[NDArray[np.float64], int]:
    """Boxes around the positions of each root's stretch, (m, 6), and how many groups such a stretch has."""
    per_root = groups_per_root(len(groups.longest))
    starts = np.arange(0, len(groups.longest), per_root)
    low, high = groups.places[:, :3], groups.places[:, 3:]
    boxes = np.hstack([np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)])
    return boxes.astype(np.float64), per_root


def _plane_between(first: NDArray[np.float64], second: NDArray[np.float64]) -> tuple[int, float]:
    """The axis across which two parts of the order are farthest apart, and the coordinate in the middle between them.

    They are given as boxes of their stretches, (m, 6).
    """
    ends, begins = first[:, 3:].max(axis=0), second[:, :3].min(axis=0)
    axis = int(np.argmax(begins - ends))
    return axis, float((ends[axis] + begins[axis]) / 2)


def top_of_part(groups: Groups, step: float, part: range) -> tuple[Top, NDArray[np.int64]]:
    """The top of a part, an aligned stretch of the groups, and all groups that overlap its roots, ascending.

    The top's groups are numbered among these.
    """
    top = cut_top(groups, step, part)
    needed = np.unique(np.concatenate(top.groups))
    return top._replace(groups=[np.searchsorted(needed, rows) for rows in top.groups]), needed
