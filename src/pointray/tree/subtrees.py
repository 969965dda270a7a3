"""The top of the kd-tree: space is cut into roots, and threads then cut each root further on its own.

Neighbouring blocks are joined into groups, so that the top is quick to build. It does not depend on the number of
threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..jit import Array, run
from ..kernels.tree import BLOCK, FAR, INV_R2
from .cells import FULL, Cells, cut_roots

PER_GROUP = 64  # blocks
ROOTS = 128  # about how many roots are made; PER_GROUP groups or fewer make one root


class Top(NamedTuple):
    """The nodes above the roots.

    children : two for each node, a node or ~root
    boxes : (6,) for each root; groups : those that overlap it; around : how far around it splats matter
    """

    children: list[list[int]]
    boxes: list[Array]
    groups: list[Array]
    around: list[float]


def _groups(blocks: Array, bounds: Array) -> tuple[Array, Array]:
    """Boxes (g, 6) around the supports of each group, and the greatest radius in it."""
    spheres = bounds.reshape(-1, 4)
    starts = np.arange(0, len(spheres), PER_GROUP)
    low = np.minimum.reduceat(spheres[:, :3] - spheres[:, 3:], starts)
    high = np.maximum.reduceat(spheres[:, :3] + spheres[:, 3:], starts)
    splats = blocks.reshape(-1, BLOCK)
    inverse = np.where(splats[:, :4] < FAR, splats[:, INV_R2:], np.float32(np.inf)).min(axis=1)
    return np.hstack([low, high]), 1 / np.sqrt(np.minimum.reduceat(inverse, starts))


def cut_top(blocks: Array, bounds: Array, step: float) -> Top:
    """Cut space in the middle of the longest edge until about ROOTS parts are left.

    Parameters
    ----------
    blocks, bounds : as `blocks.make_blocks` gives them
    step : float
        Longest step of the samples, in radii.
    """
    boxes, longest = _groups(blocks, bounds)
    most = max(len(boxes) // ROOTS, PER_GROUP)
    top = Top([], [], [], [])
    everything = np.array([-FAR] * 3 + [FAR] * 3)
    pending = [(np.arange(len(boxes)), everything, -1, 0)]
    while pending:
        rows, cell, parent, side = pending.pop()
        # A part that no group overlaps becomes a root with an inverted box.
        low, high = boxes[rows, :3].min(axis=0, initial=FAR), boxes[rows, 3:].max(axis=0, initial=-FAR)
        cell = np.concatenate([np.maximum(cell[:3], low), np.minimum(cell[3:], high)])
        around = step * float(longest[rows].max(initial=0.0))
        axis = int(np.argmax(cell[3:] - cell[:3]))
        parts = []
        for half, face in ((0, 3 + axis), (1, axis)):
            part = cell.copy()
            part[face] = (cell[axis] + cell[3 + axis]) / 2
            meets = (boxes[rows, :3] <= part[3:] + around) & (boxes[rows, 3:] >= part[:3] - around)
            parts.append((rows[meets.all(axis=1)], part, len(top.children), half))
        whole = len(rows) <= most or max(len(part[0]) for part in parts) == len(rows)
        number = ~len(top.boxes) if whole else len(top.children)
        if parent >= 0:
            top.children[parent][side] = number
        if whole:
            top.boxes.append(cell)
            top.groups.append(rows)
            top.around.append(around)
        else:
            top.children.append([0, 0])
            pending += parts
    return top


def build_cells(
    blocks: NDArray[np.float32], bounds: NDArray[np.float32], width: float, step: float, threads: int | None
) -> Cells:
    """The binary kd-tree over the blocks.

    Parameters
    ----------
    blocks, bounds : as `blocks.make_blocks` gives them
    width : float
        Greatest width of the voxels, in mean radii.
    step : float
        Longest step of the samples, in radii.
    """
    top = cut_top(blocks, bounds, step)
    sizes = np.array([len(groups) * PER_GROUP for groups in top.groups])
    room = np.stack([sizes // 2 + 64, 8 * sizes + 4096], axis=1)  # nodes, references
    while True:
        firsts = np.zeros((len(sizes) + 1, 3), np.int64)
        firsts[1:, :2] = room.cumsum(axis=0)
        firsts[1:, 2] = np.cumsum([len(groups) for groups in top.groups])
        nodes = firsts[-1, 0]
        cells = Cells(
            np.empty((nodes, 2), np.int32),
            np.empty((nodes, 6), np.float32),
            np.zeros((nodes, 2), np.int64),
            np.empty(firsts[-1, 1], np.int32),
            np.empty(nodes, np.float32),
        )
        cells.boxes[firsts[:-1, 0]] = top.boxes
        used = np.zeros(len(sizes), np.int64)
        roots = firsts, np.concatenate(top.groups), np.array(top.around)
        run(cut_roots, len(sizes), blocks, roots, (float(width), step, PER_GROUP), (cells, used), threads=threads)
        if (used != FULL).all():
            return _joined(top, cells, firsts, used)
        room[used == FULL] *= 2


def _joined(top: Top, cells: Cells, firsts: Array, used: Array) -> Cells:
    """Join the top and all roots into one tree whose nodes have no gaps between them."""
    above = len(top.children)
    starts = above + np.cumsum(used) - used
    count = above + int(used.sum())
    joined = Cells(
        np.empty((count, 2), np.int32),
        np.empty((count, 6), np.float32),
        np.zeros((count, 2), np.int64),
        cells.refs,
        np.empty(count, np.float32),
    )
    for node, children in enumerate(top.children):
        joined.children[node] = [child if child >= 0 else starts[~child] for child in children]
    for root, start in enumerate(starts):
        here, there = slice(start, start + used[root]), slice(firsts[root, 0], firsts[root, 0] + used[root])
        own = cells.children[there]
        joined.children[here] = np.where(own < 0, -1, own + start)
        joined.boxes[here], joined.least[here] = cells.boxes[there], cells.least[there]
        joined.spans[here] = cells.spans[there] + firsts[root, 1]
    return joined
