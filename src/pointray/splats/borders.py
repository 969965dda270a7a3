"""Which splats lie on an open border: seen from one, its neighbours leave a wide gap in the tangent plane."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..jit import borrow, kernel, run, take
from ..neighbors import neighbors

NEIGHBORS = 20  # of so many evenly random directions, one in 1,000 sets leaves a gap of GAP
GAP = math.radians(140)  # a straight border leaves 180 degrees
COMPANY = 0  # a border is a curve: so many of the nearest neighbours must lie on it too
TILE = 2048


@kernel
def _find_gaps(work, positions, normals, near, out):  # type: ignore[no-untyped-def]
    """out[i]: 1 where the directions to the neighbours, in the tangent plane, leave a gap wider than GAP."""
    positions, normals, near, out = borrow(positions), borrow(normals), borrow(near), borrow(out)
    angles = np.empty(near.shape[1])
    tile = take(work)
    while tile >= 0:
        for i in range(tile * TILE, min((tile + 1) * TILE, len(out))):
            nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
            # Two axes of the tangent plane (Duff et al. 2017).
            sign = 1.0 if nz >= 0.0 else -1.0
            a = -1.0 / (sign + nz)
            b = nx * ny * a
            count = 0
            for j in near[i]:
                x, y, z = (
                    positions[j, 0] - positions[i, 0],
                    positions[j, 1] - positions[i, 1],
                    positions[j, 2] - positions[i, 2],
                )
                u = (1.0 + sign * nx * nx * a) * x + sign * b * y - sign * nx * z
                v = b * x + (sign + ny * ny * a) * y - ny * z
                if u != 0.0 or v != 0.0:
                    angles[count] = math.atan2(v, u)
                    count += 1
            found = np.sort(angles[:count])
            gap = 2.0 * math.pi if count < 2 else found[0] + 2.0 * math.pi - found[count - 1]
            for k in range(1, count):
                gap = max(gap, found[k] - found[k - 1])
            out[i] = gap > GAP
        tile = take(work)
    return 0


def find_borders(positions: NDArray[np.float32], normals: NDArray[np.float32]) -> NDArray[np.uint8]:
    """1 for each point on an open border, else 0.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32, unit

    Returns
    -------
    (n,) uint8
    """
    if len(positions) <= NEIGHBORS:
        return np.zeros(len(positions), np.uint8)
    _, near = neighbors(positions, NEIGHBORS + 1)
    out = np.zeros(len(positions), np.uint8)
    run(_find_gaps, -(-len(out) // TILE), positions, normals, np.ascontiguousarray(near), out)
    # Alone, a gap is chance: uneven sampling, or a crevice.
    company: NDArray[np.bool_] = out[near[:, 1:13]].sum(axis=1) >= COMPANY
    return np.where(company, out, np.uint8(0))
