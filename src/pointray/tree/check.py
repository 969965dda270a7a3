"""The validator: is a tree whole? Each rule of `records.py`, checked with NumPy, slowly and plainly."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..records import BLOCK, CELL, GROUP, LEAF, NO_CHILD, NODE, SLAB, SLAB_HI, SLAB_LO, WIDTH, Tree

Floats = NDArray[np.float32]


def check_tree(tree: Tree, places: int = 20_000, seed: int = 0) -> list[str]:
    """What is wrong with a tree; an empty list if it is whole.

    Parameters
    ----------
    places : int
        Random points near splats at which the leaves are asked for what they know.
    """
    problems = _check_lengths(tree)
    if problems:
        return problems
    boxes, parents, problems = _check_nodes(tree)
    if problems:
        return problems
    return problems + _check_spheres(tree) + _check_places(tree, boxes, parents, places, seed)


def _check_lengths(tree: Tree) -> list[str]:
    """Lengths fit together and indices point inside."""
    leaves, groups, blocks = tree.leaves.size // LEAF, tree.refs.size // 16, tree.blocks.size // BLOCK
    wrong = []
    if tree.boxes.size * WIDTH != tree.children.size * NODE:
        wrong.append("boxes and children are of different lengths")
    if tree.spans.size != 2 * leaves or tree.spheres.size != groups * GROUP or tree.order.size != 4 * blocks:
        wrong.append("spans, spheres or order are of the wrong length")
    if tree.colors.size not in (0, tree.order.size):
        wrong.append("colors is of the wrong length")
    if tree.refs.size and not 0 <= tree.refs.min() <= tree.refs.max() < blocks:
        wrong.append("a reference is no block")
    first, count = tree.spans.reshape(-1, 2).T
    if ((count < 0) | (first < 0) | (first + count > groups)).any():
        wrong.append("a leaf's span lies outside of the groups")
    rows = tree.order[tree.order >= 0]
    if len(np.unique(rows)) != len(rows):
        wrong.append("a row of the points is in two slots")
    return wrong


def _check_nodes(tree: Tree) -> tuple[Floats, NDArray[np.int64], list[str]]:
    """Boxes of the leaves (leaves, 6), empty where a leaf hangs nowhere; every node and leaf is reached once."""
    children = tree.children.reshape(-1, WIDTH)
    rows = tree.boxes.reshape(-1, 6, WIDTH)
    leaves = tree.leaves.size // LEAF
    boxes = np.tile(np.float32([np.inf] * 3 + [-np.inf] * 3), (leaves, 1))
    seen_nodes, seen_leaves = np.zeros(len(children), int), np.zeros(leaves, int)
    seen_nodes[0] = 1
    problems: list[str] = []
    for node, kids in enumerate(children):
        for k, child in enumerate(kids):
            box = rows[node, :, k]
            if child == NO_CHILD:
                if (box[:3] <= box[3:]).all():
                    problems.append(f"node {node}: a child that is none has a box")
            elif child >= len(children) or ~child >= leaves:
                problems.append(f"node {node}: child {child} does not exist")
            elif child >= 0:
                seen_nodes[child] += 1
                inner = rows[child]
                if (inner[:3].min(axis=1) < box[:3]).any() or (inner[3:].max(axis=1) > box[3:]).any():
                    problems.append(f"node {node}: the box of child {child} does not enclose it")
            else:
                seen_leaves[~child] += 1
                boxes[~child] = box
    if (seen_nodes != 1).any() or (seen_leaves > 1).any():
        problems.append("a node or leaf is not reached exactly once")
    if (seen_leaves[tree.spans[1::2] > 0] == 0).any():
        problems.append("a leaf with splats is never reached")
    return boxes, seen_leaves, problems


def _splats(tree: Tree) -> tuple[Floats, NDArray[np.int64]]:
    """Rows x y z nx ny nz r of the splats, and the block of each."""
    used = np.flatnonzero(tree.order >= 0)
    rows = tree.blocks.reshape(-1, 7, 4).transpose(0, 2, 1).reshape(-1, 7)[used].copy()
    rows[:, 6] = 1 / np.sqrt(rows[:, 6])
    return rows, used // 4


def _check_spheres(tree: Tree) -> list[str]:
    """Each bounding sphere encloses the supports of its block."""
    rows, block = _splats(tree)
    spheres = tree.spheres.reshape(-1, 4, 16).transpose(0, 2, 1).reshape(-1, 4)
    listed = spheres[:, 3] > 0
    order = np.argsort(block, kind="stable")
    start = np.searchsorted(block[order], tree.refs[listed])
    problems = []
    for k in range(4):
        at = np.minimum(start + k, len(order) - 1)
        mine = block[order[at]] == tree.refs[listed]
        splat = rows[order[at[mine]]]
        sphere = spheres[listed][mine]
        reach = np.linalg.norm(splat[:, :3] - sphere[:, :3], axis=1) + splat[:, 6]
        if (reach > np.sqrt(sphere[:, 3]) * (1 + 1e-5)).any():
            problems.append("a bounding sphere does not enclose its block")
    return problems


def _check_places(tree: Tree, boxes: Floats, parents: NDArray[Any], places: int, seed: int) -> list[str]:
    """At random points around splats: one voxel holds each, and knows every splat over it; the surface is enclosed."""
    rows, block = _splats(tree)
    rng = np.random.default_rng(seed)
    chosen = rows[rng.integers(len(rows), size=places)]
    x = chosen[:, :3] + chosen[:, 6:] * rng.uniform(-0.5, 0.5, (places, 3)).astype(np.float32)
    leaves = tree.leaves.reshape(-1, LEAF)
    low, high = leaves[:, CELL : CELL + 3], leaves[:, CELL + 3 : CELL + 6]
    middle = cKDTree((low + high) / 2)
    near = middle.query(x, k=min(64, len(leaves)))[1].reshape(places, -1)
    inside = ((low[near] <= x[:, None]) & (x[:, None] <= high[near])).all(axis=2)
    over = cKDTree(rows[:, :3])
    reach = np.quantile(rows[:, 6], 0.999)
    problems = []
    lost = missing = outside = 0
    for i in range(places):
        splats = np.array(over.query_ball_point(x[i], reach), int)
        splats = splats[np.linalg.norm(rows[splats, :3] - x[i], axis=1) < rows[splats, 6] * (1 - 1e-5)]
        held = near[i][inside[i]]
        if not len(held):
            lost += len(splats) > 0
            continue
        for leaf in held:
            first, count = tree.spans[2 * leaf : 2 * leaf + 2]
            if count == 0:
                continue
            missing += not np.isin(block[splats], tree.refs[16 * first : 16 * (first + count)]).all()
        outside += _surface_outside(rows[splats], x[i], leaves[held], boxes[held], parents[held])
    if lost:
        problems.append(f"{lost} of {places} places under splats lie in no voxel")
    if missing:
        problems.append(f"{missing} leaves do not know every splat over a place in them")
    if outside:
        problems.append(f"{outside} places of the surface lie outside of their leaf's slab or box, or in an empty leaf")
    return problems


def _surface_outside(splats: Floats, x: Floats, leaves: Floats, boxes: Floats, reached: NDArray[Any]) -> bool:
    """Whether the surface passes at x (planes of its splats on both sides within 1e-4 radii) and no leaf encloses it."""
    if len(splats) == 0:
        return False
    height = np.einsum("ij,ij->i", x - splats[:, :3], splats[:, 3:6])
    w = (1 - np.square(x - splats[:, :3]).sum(axis=1) / splats[:, 6] ** 2) ** 2
    if abs((w * height).sum() / w.sum()) > 1e-2 * splats[:, 6].mean():
        return False
    # x is within 1% of a radius of the zero set of `imls`: enclosed but for that much.
    slack = 0.03 * splats[:, 6].mean()
    m = leaves[:, SLAB : SLAB + 3] @ x
    good = (m >= leaves[:, SLAB_LO] - slack) & (m <= leaves[:, SLAB_HI] + slack) & (reached > 0)
    good &= (boxes[:, :3] - slack <= x).all(axis=1) & (x <= boxes[:, 3:] + slack).all(axis=1)
    return not bool(good.any())
