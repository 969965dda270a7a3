"""Validation of all indices of a tree, which trees from files must pass before the first ray is traced.

All arithmetic is in int64: the arrays are int32, in which sums of numbers from a file can overflow.
"""

from __future__ import annotations

import numpy as np

from ...base.choices import SURFACES
from ...engine.kernels import tree as tr
from ...engine.kernels.tree import Tree

DEEPEST = 64  # levels of nodes of eight: each level leaves up to 7 children on a ray's stack, which has room for 512
LARGEST_SAMPLES = 64  # maximum number of samples per radius


def check_lengths(tree: Tree) -> list[str]:
    """Check that the lengths of a tree's arrays are consistent and its indices in range; return what is wrong."""
    leaves, groups, blocks = tree.leaves.size // tr.LEAF, tree.refs.size // 16, tree.blocks.size // tr.BLOCK
    wrong = []
    if tree.boxes.size * tr.WIDTH != tree.children.size * tr.NODE:
        wrong.append("boxes and children do not match in length")
    if tree.spans.size != 2 * leaves or tree.spheres.size != groups * tr.GROUP or tree.order.size != 4 * blocks:
        wrong.append("spans, spheres or order have an invalid length")
    if tree.patches.size != leaves * tr.PATCH:
        wrong.append("patches has an invalid length")
    if tree.colors.size not in (0, tree.order.size) or tree.borders.size not in (0, 3 * tree.order.size):
        wrong.append("colors or borders has an invalid length")
    if tree.facing.size not in (0, 3 * tree.order.size):
        wrong.append("facing has an invalid length")
    if tree.noise.size not in (0, blocks):
        wrong.append("noise has an invalid length")
    if tree.refs.size and not 0 <= tree.refs.min() <= tree.refs.max() < blocks:
        wrong.append("a reference is not a block")
    first, count = tree.spans.reshape(-1, 2).T.astype(np.int64)
    if ((count < 0) | (first < 0) | (first + count > groups)).any():
        wrong.append("a leaf's span is outside of the groups")
    return wrong


def check_indices(tree: Tree, points: int) -> list[str]:
    """Return what in a tree could cause an invalid index, an endless loop or a stack overflow when a ray is traced.

    Trees from files must pass with an empty list.

    Parameters
    ----------
    points : int
        Number of the caller's points.
    """
    if tree.head.size != tr.HEAD or tree.children.size == 0:
        return ["head or nodes are missing"]
    lengths = {
        "boxes": tr.NODE,
        "leaves": tr.LEAF,
        "spheres": tr.GROUP,
        "blocks": tr.BLOCK,
        "spans": 2,
        "refs": 16,
        "order": 4,
    }
    if any(getattr(tree, name).size % length for name, length in lengths.items()) or tree.children.size % tr.WIDTH:
        return ["a record is truncated"]
    problems = check_lengths(tree)
    if problems:
        return problems
    head = tree.head
    if not (0 <= head[tr.SURFACE] < len(SURFACES) and head[tr.SURFACE] % 1 == 0 and 0 <= head[tr.REFINE] <= 16):
        return ["unknown surface or refinement"]
    if not (head[tr.TRIM] > 0 and head[tr.OVERHANG] > 0 and np.isfinite(head[tr.BOUNDS : tr.BOUNDS + 6]).all()):
        return ["trim, overhang or bounds are not valid numbers"]
    if not ((tree.noise >= 0) & (tree.noise < np.inf)).all():
        return ["noise is not a valid number"]
    if head[tr.SCATTER] not in (0, tr.SPHERES, tr.DISCS) or not 0 <= head[tr.SCATTER_LEAVES] < np.inf:
        return ["invalid kind or number of scattered points"]
    if not 0 <= head[tr.LONGEST] < np.inf:
        return ["the longest step is not a valid number"]
    if tree.order.min(initial=-1) < -1 or tree.order.max(initial=-1) >= points:
        return ["a slot refers to a row that does not exist"]
    if (16 * tree.spans[1::2].astype(np.int64)).max(initial=0) > tree.refs.size:
        return ["a leaf has more entries than all groups"]
    flags = tree.leaves.reshape(-1, tr.LEAF)
    if (flags[:, tr.BORDERED].any() and not tree.borders.size) or (flags[:, tr.SHEETED].any() and not tree.facing.size):
        return ["a leaf refers to borders or sheets that do not exist"]
    if not (flags[:, tr.STEP] >= flags[:, tr.LEAST] / LARGEST_SAMPLES).all():
        return ["the samples of a leaf are too close"]
    return _check_children(tree)


def _check_children(tree: Tree) -> list[str]:
    """Check that each child is a later node, a leaf, or empty with an empty box, and that the tree is not too deep.

    Returns what is wrong.
    """
    children = tree.children.reshape(-1, tr.WIDTH).astype(np.int64)
    number = np.arange(len(children))[:, None]
    none, inner = children == tr.NO_CHILD, children >= 0
    leaf = ~none & (children < 0) & (~children < min(tree.leaves.size // tr.LEAF, tr.SCATTERED))
    if tree.head[tr.SCATTER]:
        leaf |= (
            ~none
            & (~children >= tr.SCATTERED)
            & (~children < tr.SCATTERED + tree.blocks.size // tr.BLOCK - (tr.LEAF_BLOCKS - 1))
        )
    if not (none | leaf | (inner & (children > number) & (children < len(children)))).all():
        return ["a node's child does not exist"]
    boxes = tree.boxes.reshape(-1, 6, tr.WIDTH)
    empty = (boxes[:, :3] == np.inf).all(axis=1) & (boxes[:, 3:] == -np.inf).all(axis=1)
    if (none & ~empty).any():
        return ["an empty child has a box"]
    if np.bincount(children[inner], minlength=len(children)).max(initial=0) > 1:
        return ["a node has two parents"]
    level, depth = np.array([0]), 0
    while len(level):
        depth += 1
        if depth > DEEPEST:
            return ["the tree is too deep"]
        below = children[level]
        level = below[below >= 0]
    return []
