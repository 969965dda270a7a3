"""Which splats lie at a sharp convex edge: their supports overlap more, so that no ray leaves the solid between them.

Past an edge the blended surface bulges out: what lies on one side is deep below the plane of the other. A ray from
inside that leaves along the bulge may reach the end of the supports before f changes its sign.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit import borrow, kernel, run, take
from ..vec import dot, sub, triple
from .voronoi import OTHER_SHEET

SHARP = math.cos(math.radians(75))  # cosine of two normals beyond which an edge is sharp
TILE = 2048


@kernel
def _find(work, positions, normals, reach, near, out):  # type: ignore[no-untyped-def]
    """out[i]: whether a neighbour of splat i lies close by on the other side of a sharp convex edge."""
    positions, normals, reach, near, out = borrow(positions), borrow(normals), borrow(reach), borrow(near), borrow(out)
    tile = take(work)
    while tile >= 0:
        for i in range(tile * TILE, min((tile + 1) * TILE, len(out))):
            at, n, found = triple(positions, 3 * i), triple(normals, 3 * i), False
            for j in near[i]:
                m = triple(normals, 3 * np.int64(j))
                if OTHER_SHEET < dot(n, m) < SHARP:
                    d = sub(triple(positions, 3 * np.int64(j)), at)
                    close = reach[i] + reach[j]
                    found = found or (dot(d, sub(m, n)) > 0.0 and dot(d, d) < close * close)
            out[i] = found
        tile = take(work)
    return 0


def find_crests(
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
    reach: NDArray[np.float32],
    near: NDArray[np.integer[Any]],
) -> NDArray[np.bool_]:
    """Which splats lie at a sharp convex edge.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32, unit
    reach : (n,) float32
        A point is close to another within the sum of both.
    near : (n, k) int
        Rows of each point's neighbours, itself first.

    Returns
    -------
    (n,) bool
    """
    found = np.zeros(len(positions), np.bool_)
    flat = np.ascontiguousarray(positions).reshape(-1), np.ascontiguousarray(normals).reshape(-1)
    run(_find, -(-len(found) // TILE), *flat, np.ascontiguousarray(reach), np.ascontiguousarray(near), found)
    return found
