"""Normals fitted when a model was built, for points whose file has none."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Floats
from ..engine.kernels.tree import BLOCK, NX, Tree


def fitted_normals(tree: Tree, rows: NDArray[np.integer[Any]], count: int) -> Floats:
    """Return normals of some points from the splats of a model's tree, (m, 3); zero for points without a splat.

    They are read with NumPy alone, before kernels are compiled.

    rows : (m,), ascending, rows of the points; count : number of all points of the model
    """
    wanted = np.zeros(count, bool)
    wanted[rows] = True
    slots = np.flatnonzero(tree.order >= 0)
    slots = slots[wanted[tree.order[slots]]]
    normals = np.zeros((len(rows), 3), np.float32)
    first = slots // 4 * BLOCK + slots % 4 + NX
    normals[np.searchsorted(rows, tree.order[slots])] = tree.blocks[first[:, None] + 4 * np.arange(3)]
    return normals
