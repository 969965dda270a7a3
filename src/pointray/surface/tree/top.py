"""Top of the kd-tree: space is cut into roots, which threads then cut further independently.

A root is the space around a range of the kd order, so that all roots hold similar numbers of splats. Blocks are joined
into groups of 64, so that the top is quick to build. It does not depend on the number of threads.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles, Floats
from ...cloud.neighbors.order import first_part
from ...engine.jit import Array, borrow, f32, kernel, next_tile, run, uncompiled
from ...engine.kernels.tree import BLOCK, FAR, INV_R2, PX
from .blocks import PER_BLOCK

PER_GROUP = 64  # blocks
ROOTS = 128  # minimum number of roots of large models
CROWDED = 8  # a single root is made if all roots together list more than this many times the groups
LEAST, MOST = 64, 1024  # limits of the groups per root; powers of two


class Groups(NamedTuple):
    """Bounds of g groups of 64 consecutive blocks of splats, from which the top of a kd-tree is cut.

    supports : (g, 6) float32, boxes around the supports of their splats
    places : (g, 6) float32, boxes around the positions of their splats
    longest : (g,) float32, largest radius of their splats
    """

    supports: Floats
    places: Floats
    longest: Floats


class Top(NamedTuple):
    """Uppermost nodes of a kd-tree. Below them are roots: boxes that threads cut into voxels independently.

    children : two per node, a node or ~root
    boxes : (6,) per root, lo x y z, hi x y z
    groups : for each root the numbers of the groups of 64 blocks that may overlap it
    around : for each root the margin around its box within which supports matter
    """

    children: list[list[int]]
    boxes: list[Doubles]
    groups: list[NDArray[np.int64]]
    around: list[float]


@kernel
def _bound_groups(work: Array, blocks: Array, bounds: Array, out: Groups) -> None:
    """Compute the bounds of each group of 64 consecutive blocks, and write them to `out`.

    blocks : (blocks * 28,), the splats
    bounds : (blocks * 4,), centre and radius of each block's bounding sphere
    """
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


class _Node(NamedTuple):
    """Node at the top of a kd-tree, before it is cut.

    roots : range of the roots below the node; a root is a box that one thread cuts into voxels
    groups : (m,) numbers of the groups (64 consecutive blocks each) that may overlap the node
    cell : (6,) the node's box, not yet shrunk to the supports of these groups
    parent : number of the parent node, -1 for none; side : 0 or 1, which of the parent's children this is
    """

    roots: range
    groups: NDArray[np.int64]
    cell: Doubles
    parent: int
    side: int


def groups_of(blocks: Array, bounds: Array, threads: int | None = None) -> Groups:
    """Return the bounds of each group of 64 consecutive blocks of splats.

    blocks : (blocks * 28,), the splats; bounds : (blocks * 4,), centre and radius of each block's bounding sphere
    """
    count = -(-len(bounds) // (4 * PER_GROUP))
    groups = Groups(np.empty((count, 6), np.float32), np.empty((count, 6), np.float32), np.empty(count, np.float32))
    run(_bound_groups, count, blocks, bounds, groups, threads=threads)
    return groups


def groups_per_root(groups: int) -> int:
    """Return how many consecutive groups of 64 blocks each root gets. A root is a box that one thread cuts into voxels.

    groups : number of groups of the model
    """
    per_root = LEAST
    while per_root < MOST and 2 * per_root * ROOTS <= groups:
        per_root *= 2
    return per_root


def cut_top(groups: Groups, step: float, part: range | None = None, within: Doubles | None = None) -> Top:
    """Cut space along the kd order into roots: boxes with similar numbers of splats that threads cut independently.

    Parameters
    ----------
    groups : Groups
        All groups of 64 blocks of a model.
    step : float
        Maximum sample distance along rays, in support radii.
    part : range, optional
        Numbers of the groups of one part of the model, from a multiple of the parts' size (a power of two). Only the
        roots of these groups are returned, with the nodes above them that have no other roots.
    within : (6,) float64, optional
        Box to which space is restricted.
    """
    supports, _, longest = groups
    root_boxes, per_root = _root_boxes(groups)
    wanted = range(len(root_boxes))
    if part is not None:
        wanted = range(part.start // per_root, -(-part.stop // per_root))
    top = Top([], [], [], [])
    space = _everything() if within is None else within
    pending = [_Node(range(len(root_boxes)), np.arange(len(supports)), space, -1, 0)]
    while pending:
        node = pending.pop()
        if node.roots.start >= wanted.stop or node.roots.stop <= wanted.start:
            continue
        rows = node.groups
        low, high = supports[rows, :3].min(axis=0, initial=FAR), supports[rows, 3:].max(axis=0, initial=-FAR)
        cell = np.concatenate([np.maximum(node.cell[:3], low), np.minimum(node.cell[3:], high)])
        edge = float((cell[3:] - cell[:3]).max())
        around = step * max(min(float(longest[rows].max(initial=0.0)), edge), 0.0)
        whole = len(node.roots) == 1
        inside = wanted.start <= node.roots.start and node.roots.stop <= wanted.stop
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
        half = uncompiled(first_part)(len(node.roots))
        sides = node.roots[:half], node.roots[half:]
        axis, place = _plane_between(*(root_boxes[side.start : side.stop] for side in sides))
        for side, face in enumerate((3 + axis, axis)):
            box = cell.copy()
            box[face] = min(max(place, cell[axis]), cell[3 + axis])
            meets = (supports[rows, :3] <= box[3:] + around) & (supports[rows, 3:] >= box[:3] - around)
            pending.append(_Node(sides[side], rows[meets.all(axis=1)], box, number, side))
    if sum(len(rows) for rows in top.groups) > CROWDED * per_root * len(wanted):
        return _one_root(top)
    return top


def cells_of_parts(groups: Groups, size: int) -> Doubles:
    """Return the boxes into which the kd-tree of a model divides space among its parts, (parts, 6): lo x y z, hi x y z.

    size : number of groups (64 consecutive blocks each) of each part, a power of two
    """
    root_boxes, per_root = _root_boxes(groups)
    most, cells = size // per_root, np.empty((-(-len(groups.longest) // size), 6))
    pending = [(range(len(root_boxes)), _everything())]
    while pending:
        node, cell = pending.pop()
        if len(node) <= most:
            cells[node.start // most] = cell
            continue
        half = uncompiled(first_part)(len(node))
        sides = node[:half], node[half:]
        axis, place = _plane_between(*(root_boxes[side.start : side.stop] for side in sides))
        for side, face in zip(sides, (3 + axis, axis), strict=True):
            box = cell.copy()
            box[face] = place
            pending.append((side, box))
    return cells


def _everything() -> Doubles:
    return np.array([-FAR] * 3 + [FAR] * 3, np.float64)


def _one_root(top: Top) -> Top:
    """Join the roots of a kd-tree to one, which a single thread cuts into voxels.

    Where splats extend over nearly all of space, cuts make no root smaller.
    """
    boxes = np.array(top.boxes)
    cell = np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])
    return Top([], [cell], [np.unique(np.concatenate(top.groups))], [max(top.around)])


def _root_boxes(groups: Groups) -> tuple[Doubles, int]:
    """Return a box around the positions of each root's splats, (m, 6), and the number of groups of 64 blocks per root.

    A root is a box that one thread cuts into voxels.

    groups : all groups of 64 blocks of the model
    """
    per_root = groups_per_root(len(groups.longest))
    starts = np.arange(0, len(groups.longest), per_root)
    low, high = groups.places[:, :3], groups.places[:, 3:]
    boxes = np.hstack([np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)])
    return boxes.astype(np.float64), per_root


def _plane_between(first: Doubles, second: Doubles) -> tuple[int, float]:
    """Return the axis and the coordinate of a plane between two ranges of the kd order, where they are farthest apart.

    first, second : boxes around splats, (m, 6), that together enclose each range
    """
    ends, begins = first[:, 3:].max(axis=0), second[:, :3].min(axis=0)
    axis = int(np.argmax(begins - ends))
    return axis, float((ends[axis] + begins[axis]) / 2)


def top_of_part(groups: Groups, step: float, part: range) -> tuple[Top, NDArray[np.int64]]:
    """Return the top of a part's kd-tree, and the numbers in the model of all groups that overlap its roots, ascending.

    Group numbers in the returned top are indices into the second result.

    groups : all groups of 64 blocks of the model; step : maximum sample distance, in support radii
    part : numbers of the part's groups, from a multiple of the parts' size (a power of two)
    """
    top = cut_top(groups, step, part)
    needed = np.unique(np.concatenate(top.groups))
    return top._replace(groups=[np.searchsorted(needed, rows) for rows in top.groups]), needed
