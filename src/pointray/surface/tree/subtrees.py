"""Voxels below the roots: each root is cut by one thread, then all are joined into one tree."""

from __future__ import annotations

import numpy as np

from ...base.arrays import Floats
from ...engine.jit import Array, run
from .cells import FULL, Cells, cut_roots
from .top import PER_GROUP, Top


def build_cells(blocks: Floats, top: Top, width: float, step: float, threads: int | None = None) -> Cells:
    """Build the binary kd-tree over the blocks, whose leaves are voxels.

    Parameters
    ----------
    blocks : (b * 28,) float32
        From `blocks.make_blocks`.
    top : Top
        Uppermost nodes of the tree, from `cut_top` for the groups of these blocks.
    width : float
        Maximum width of voxels, in mean radii.
    step : float
        Maximum sample distance along rays, in radii.
    """
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
    """Join the uppermost nodes and the subtrees of all roots into one tree with consecutive nodes.

    top : the uppermost nodes; their leaves, the roots, are boxes that one thread each has cut into voxels
    cells : the subtrees, each in its own range of the arrays
    firsts : (roots + 1, 3), where in `cells` each root's nodes, references and groups begin
    used : (roots,) number of nodes of each subtree
    """
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
