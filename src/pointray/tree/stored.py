"""The splats that a tree keeps, read back."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.tree import BLOCK, NX, PX, Tree

Floats = NDArray[np.float32]


class Stored(NamedTuple):
    """Splats in the order of their rows.

    rows : (m,) int64, the caller's row of each
    positions, normals : (m, 3) float32
    noise : (m,) float32, what was smoothed away, of four splats side by side the most; None if nothing was
    """

    rows: NDArray[np.int64]
    positions: Floats
    normals: Floats
    noise: Floats | None


def stored_splats(tree: Tree) -> Stored:
    """All splats of a tree, as new arrays."""
    at = np.flatnonzero(tree.order >= 0)
    at = at[np.argsort(tree.order[at])]
    table = tree.blocks.reshape(-1, BLOCK // 4, 4).transpose(0, 2, 1).reshape(-1, BLOCK // 4)[at]
    noise = tree.noise[at // 4] if tree.noise.size else None
    positions, normals = (table[:, first // 4 : first // 4 + 3] for first in (PX, NX))
    return Stored(tree.order[at].astype(np.int64), positions, normals, noise)
