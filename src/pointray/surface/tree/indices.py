"""Checks that every index of a tree is valid; a tree from a file must pass them before the first ray.

All arithmetic is in int64: the arrays hold int32, in which the sum of two numbers from a file can wrap around.
"""

from __future__ import annotations

import numpy as np

from ...base.choices import SURFACES
from ...engine.kernels.tree import (
    BLOCK,
    BORDERED,
    BOUNDS,
    DISCS,
    GROUP,
    HEAD,
    LEAF,
    LEAF_BLOCKS,
    LEAST,
    LONGEST,
    NO_CHILD,
    NODE,
    OVERHANG,
    PATCH,
    REFINE,
    SCATTER,
    SCATTER_LEAVES,
    SCATTERED,
    SHEETED,
    SPHERES,
    STEP,
    SURFACE,
    TRIM,
    WIDTH,
    Tree,
)

DEEPEST = 64  # levels of nodes of eight: each level leaves up to 7 children on a ray's stack, which has room for 512
LARGEST_SAMPLES = 64  # the most samples in a radius


def check_lengths(tree: Tree) -> list[str]:
    """Check that lengths fit together and that indices are in range."""
    leaves, groups, blocks = tree.leaves.size // LEAF, tree.refs.size // 16, tree.blocks.size // BLOCK
    wrong = []
    if tree.boxes.size * WIDTH != tree.children.size * NODE:
        wrong.append("boxes and children are of different lengths")
    if tree.spans.size != 2 * leaves or tree.spheres.size != groups * GROUP or tree.order.size != 4 * blocks:
        wrong.append("spans, spheres or order are of the wrong length")
    if tree.patches.size != leaves * PATCH:
        wrong.append("patches are of the wrong length")
    if tree.colors.size not in (0, tree.order.size) or tree.borders.size not in (0, 3 * tree.order.size):
        wrong.append("colors or borders is of the wrong length")
    if tree.facing.size not in (0, 3 * tree.order.size):
        wrong.append("facing is of the wrong length")
    if tree.noise.size not in (0, blocks):
        wrong.append("noise is of the wrong length")
    if tree.refs.size and not 0 <= tree.refs.min() <= tree.refs.max() < blocks:
        wrong.append("a reference is no block")
    first, count = tree.spans.reshape(-1, 2).T.astype(np.int64)
    if ((count < 0) | (first < 0) | (first + count > groups)).any():
        wrong.append("a leaf's span lies outside of the groups")
    return wrong


def check_indices(tree: Tree, points: int) -> list[str]:
    """Find what could lead a ray out of an array, round in a circle, or past the end of its stack.

    Parameters
    ----------
    points : int
        Number of the caller's points.
    """
    if tree.head.size != HEAD or tree.children.size == 0:
        return ["it has no head or no node"]
    lengths = {"boxes": NODE, "leaves": LEAF, "spheres": GROUP, "blocks": BLOCK, "spans": 2, "refs": 16, "order": 4}
    if any(getattr(tree, name).size % length for name, length in lengths.items()) or tree.children.size % WIDTH:
        return ["a record is cut off"]
    problems = check_lengths(tree)
    if problems:
        return problems
    head = tree.head
    if not (0 <= head[SURFACE] < len(SURFACES) and head[SURFACE] % 1 == 0 and 0 <= head[REFINE] <= 16):
        return ["the surface or its refinement is unknown"]
    if not (head[TRIM] > 0 and head[OVERHANG] > 0 and np.isfinite(head[BOUNDS : BOUNDS + 6]).all()):
        return ["trim, overhang or bounds are no numbers"]
    if not ((tree.noise >= 0) & (tree.noise < np.inf)).all():
        return ["the noise is no number"]
    if head[SCATTER] not in (0, SPHERES, DISCS) or not 0 <= head[SCATTER_LEAVES] < np.inf:
        return ["invalid kind or number of scattered points"]
    if not 0 <= head[LONGEST] < np.inf:
        return ["the longest step is no number"]
    if tree.order.min(initial=-1) < -1 or tree.order.max(initial=-1) >= points:
        return ["a slot names a row that is none"]
    if (16 * tree.spans[1::2].astype(np.int64)).max(initial=0) > tree.refs.size:
        return ["a leaf is longer than all groups"]
    flags = tree.leaves.reshape(-1, LEAF)
    if (flags[:, BORDERED].any() and not tree.borders.size) or (flags[:, SHEETED].any() and not tree.facing.size):
        return ["a leaf speaks of borders or sheets that are not there"]
    if not (flags[:, STEP] >= flags[:, LEAST] / LARGEST_SAMPLES).all():
        return ["a leaf's samples are too close"]
    return _check_children(tree)


def _check_children(tree: Tree) -> list[str]:
    """Check that each child is a later node, a leaf, or none with an empty box, and that the tree is not too deep."""
    children = tree.children.reshape(-1, WIDTH).astype(np.int64)
    number = np.arange(len(children))[:, None]
    none, inner = children == NO_CHILD, children >= 0
    leaf = ~none & (children < 0) & (~children < min(tree.leaves.size // LEAF, SCATTERED))
    if tree.head[SCATTER]:
        leaf |= (
            ~none & (~children >= SCATTERED) & (~children < SCATTERED + tree.blocks.size // BLOCK - (LEAF_BLOCKS - 1))
        )
    if not (none | leaf | (inner & (children > number) & (children < len(children)))).all():
        return ["a node's child is none"]
    boxes = tree.boxes.reshape(-1, 6, WIDTH)
    empty = (boxes[:, :3] == np.inf).all(axis=1) & (boxes[:, 3:] == -np.inf).all(axis=1)
    if (none & ~empty).any():
        return ["a child that is none has a box"]
    if np.bincount(children[inner], minlength=len(children)).max(initial=0) > 1:
        return ["a node hangs in two places"]
    level, depth = np.array([0]), 0
    while len(level):
        depth += 1
        if depth > DEEPEST:
            return ["the tree is too deep"]
        below = children[level]
        level = below[below >= 0]
    return []
