"""Helpers for models in parts: the splats that a tree was built from, and trees without unused blocks."""

from __future__ import annotations

import numpy as np

from ...base.arrays import Floats
from ...engine.kernels.tree import BLOCK, Tree, first_scattered
from .build import Splats
from .stored import stored_splats

# Length of each array of a tree per block.
WIDTHS = {"blocks": BLOCK, "order": 4, "borders": 12, "facing": 12, "colors": 4, "noise": 1}


def surface_of(tree: Tree) -> Tree:
    """Return a tree without the blocks of its scattered points, from which only the surface's splats are read back.

    The nodes still refer to the removed blocks, so the result must not be traced.
    """
    first = first_scattered(tree)
    return tree._replace(**{name: getattr(tree, name)[: first * width] for name, width in WIDTHS.items()})


def splats_of(tree: Tree, radii: Floats) -> Splats:
    """Return the splats that a tree was built from, in the order in which the tree stores them.

    radii : (n,), support radii of all the caller's rows; these are returned, because those in the tree are rounded
    """
    rows, positions, normals, noise = stored_splats(tree, by_row=False)
    there = tree.order >= 0
    borders = tree.borders.reshape(-1, 3)[there].astype(np.float32) / np.float32(127) if tree.borders.size else None
    sheets = np.any(tree.facing.reshape(-1, 3)[there], axis=1).astype(np.int8) if tree.facing.size else None
    colors = tree.colors[there].astype("<i4").view(np.uint8).reshape(-1, 4)[:, :3] if tree.colors.size else None
    return Splats(positions, normals, radii[rows], rows.astype(np.int32), colors, borders, sheets, noise)


def without_unused(tree: Tree) -> Tree:
    """Return a tree without the blocks that no leaf lists.

    In a part of a model these hold splats near it whose supports do not reach into it.
    """
    refs, spheres = tree.refs.reshape(-1, 16), tree.spheres.reshape(-1, 4, 16)
    valid = ~np.isnan(spheres[:, 3])  # False for empty slots
    used = np.zeros(tree.blocks.size // BLOCK, np.bool_)
    used[refs[valid]] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    kept = {
        name: getattr(tree, name).reshape(-1, width)[used].reshape(-1)
        for name, width in WIDTHS.items()
        if getattr(tree, name).size
    }
    return tree._replace(refs=np.where(valid, number[refs], 0).astype(np.int32).reshape(-1), **kept)
