"""Splats on sheets so close together that the supports of one reach the other, as at a thin wall.

The normals of both sides cancel there, so rays see one side at a time (`surface/intersect/leaf.py`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats
from ...engine.jit import Array, borrow, i64, kernel, next_tile, run
from ...engine.kernels.vec import dot, load3_flat, sub
from .voronoi import Neighborhood

OPPOSED = math.cos(math.radians(150))  # cosine of two normals below which their points are on different sheets
BESIDE = 8  # nearest neighbours
CHUNK = 2048


@kernel
def _find(work: Array, cloud: tuple[Array, Array, Array], neighborhood: tuple[Array, Array], out: Array) -> None:
    """Set `out` to 1 for pairs of splats that face away from each other, if a support reaches the other's sheet.

    cloud : flat positions, normals and radii of n splats
    neighborhood : rows of the splats to examine (m,), and each of these with its neighbours (m, k)
    out : (n,), initially 0
    """
    (positions, normals, radii), (rows, near), out = borrow(cloud), borrow(neighborhood), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for at in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            i = i64(rows[at])
            p, n = load3_flat(positions, 3 * i), load3_flat(normals, 3 * i)
            for j in near[at]:
                if dot(n, load3_flat(normals, 3 * i64(j))) < OPPOSED:
                    d = sub(load3_flat(positions, 3 * i64(j)), p)
                    both, height = radii[i] + radii[j], dot(d, n)
                    if dot(d, d) < both * both and abs(height) < max(radii[i], radii[j]):
                        out[i] = out[j] = 1
        tile = next_tile(work)


@kernel
def _widen(work: Array, found: Array, near: Array, out: Array) -> None:
    """Set out[i] to 1 where splat i or one of its 8 nearest neighbours is set in `found`. near : (n, k) rows"""
    found, near, out = borrow(found), borrow(near), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            for k in range(min(BESIDE + 1, near.shape[1])):
                out[i] |= found[near[i, k]]
        tile = next_tile(work)


def find_sheets(
    positions: Floats, normals: Floats, radii: Floats, near: NDArray[np.int32], facing: Neighborhood
) -> NDArray[np.int8] | None:
    """Find splats on sheets close together, as at a thin wall: the normals of both sides would cancel in the blend.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32
        Unit normals.
    radii : (n,) float32
        Support radii.
    near : (n, k) int32
        Rows of each point and at least its 8 nearest neighbours.
    facing : Neighborhood
        The splats that may have neighbours with opposite normals, and their neighbours.

    Returns
    -------
    (n,) int8 or None
        1 for splats on sheets close together and their nearest neighbours, else 0. None if no splat is.
    """
    found = np.zeros(len(positions), np.int8)
    flat = [np.ascontiguousarray(array).reshape(-1) for array in (positions, normals, radii)]
    neighborhood = np.ascontiguousarray(facing.rows, np.int64), np.ascontiguousarray(facing.near)
    run(_find, -(-len(neighborhood[0]) // CHUNK), tuple(flat), neighborhood, found)
    if not found.any():
        return None
    # Include neighbours: a fragment of a sheet would stay visible if its other splats were ignored.
    out = found.copy()
    run(_widen, -(-len(found) // CHUNK), found, np.ascontiguousarray(near), out)
    return out
