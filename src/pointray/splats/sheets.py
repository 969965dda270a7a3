"""Which splats belong to sheets so close together that the supports of one reach the other, as at a thin wall.

Normals of both sides cancel there, so rays see one side at a time (`intersect/leaf.py`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit import Array, borrow, i64, kernel, next_tile, run
from ..kernels.vec import dot, load3_flat, sub

OPPOSED = math.cos(math.radians(150))  # cosine of two normals below which they are of two sheets
BESIDE = 8  # neighbours
CHUNK = 2048


@kernel
def _find(work: Array, positions: Array, normals: Array, radii: Array, near: Array, out: Array) -> int:
    """Set out[i] to 1 where a neighbour of splat i faces away from it and one's support reaches the other's sheet."""
    positions, normals, radii, near, out = borrow(positions), borrow(normals), borrow(radii), borrow(near), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            at, n = load3_flat(positions, 3 * i), load3_flat(normals, 3 * i)
            for j in near[i]:
                if dot(n, load3_flat(normals, 3 * i64(j))) < OPPOSED:
                    d = sub(load3_flat(positions, 3 * i64(j)), at)
                    both, height = radii[i] + radii[j], dot(d, n)
                    if dot(d, d) < both * both and abs(height) < max(radii[i], radii[j]):
                        out[i] = out[j] = 1
        tile = next_tile(work)
    return 0


def find_sheets(
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
    radii: NDArray[np.float32],
    near: NDArray[np.integer[Any]],
) -> NDArray[np.int8] | None:
    """1 for splats of sheets close together, 0 for all others; None where there are none.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32, unit
    radii : (n,) float32
    near : (n, k) int
        Rows of each point's neighbours, itself first.

    Returns
    -------
    (n,) int8 or None
    """
    found = np.zeros(len(positions), np.int8)
    flat = np.ascontiguousarray(positions).reshape(-1), np.ascontiguousarray(normals).reshape(-1)
    run(_find, -(-len(found) // CHUNK), *flat, np.ascontiguousarray(radii), np.ascontiguousarray(near), found)
    # Splats beside them are included: a fragment of a sheet whose other splats are ignored would be seen by itself.
    found |= found[near[:, : BESIDE + 1]].any(axis=1)
    return found if found.any() else None
