"""Which splats lie on an open border, and where it faces: their neighbours leave a wide gap in the tangent plane.

A neighbour closes the direction it lies in. Where the surface is folded sharply (a crest, a crevice), it goes on in the
other sheet, which may lie on the same side as the first. So a neighbour whose normal differs much also closes the
direction of the fold: the direction that its normal leans to if it lies below the tangent plane, the opposite direction
if it lies above.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit import Array, borrow, f64, inline, kernel, next_tile, run
from ..kernels.vec import Vec3, tangents

GAP = math.radians(115)  # a straight border leaves 180 degrees; one in 75 sets of 20 random directions leaves this
FOLD = math.cos(math.radians(45))  # cosine of two normals between which the surface counts as folded
COMPANY = 2  # a border is a curve: at least this many of a splat's neighbours lie on it too
CHUNK = 2048


@inline
def _closed_angles(
    positions: Array, normals: Array, i: int, near: Array, axes: tuple[Vec3, Vec3], angles: Array
) -> int:
    """Angles in the tangent plane of splat i that its neighbours close; returns their number."""
    u, v = axes
    count = 0
    for j in near:
        height = lean_u = lean_v = at_u = at_v = cosine = 0.0
        for c in range(3):
            d = positions[j, c] - positions[i, c]
            height += d * normals[i, c]
            cosine += normals[j, c] * normals[i, c]
            at_u += d * u[c]
            at_v += d * v[c]
            lean_u += normals[j, c] * u[c]
            lean_v += normals[j, c] * v[c]
        if at_u != 0.0 or at_v != 0.0:
            angles[count] = math.atan2(at_v, at_u)
            count += 1
        if cosine < FOLD and (lean_u != 0.0 or lean_v != 0.0):
            side = -1.0 if height > 0.0 else 1.0
            angles[count] = math.atan2(side * lean_v, side * lean_u)
            count += 1
    return count


@kernel
def _find_gaps(work: Array, positions: Array, normals: Array, rows: Array, near: Array, out: Array) -> int:
    """Write to out the direction of the middle of each splat's widest gap, or zero if it is no wider than GAP."""
    positions, normals, near, out = borrow(positions), borrow(normals), borrow(near), borrow(out)
    angles = np.empty(2 * near.shape[1])
    tile = next_tile(work)
    while tile >= 0:
        for at in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            i = rows[at]
            n = (f64(normals[i, 0]), f64(normals[i, 1]), f64(normals[i, 2]))
            axes = tangents(n)
            count = _closed_angles(positions, normals, i, near[i], axes, angles)
            found = np.sort(angles[:count])
            gap, middle = 2.0 * math.pi, 0.0
            if count > 0:
                gap = found[0] + 2.0 * math.pi - found[count - 1]
                middle = found[0] - 0.5 * gap
            for k in range(1, count):
                if found[k] - found[k - 1] > gap:
                    gap = found[k] - found[k - 1]
                    middle = found[k] - 0.5 * gap
            for c in range(3):
                outward = math.cos(middle) * axes[0][c] + math.sin(middle) * axes[1][c]
                out[at, c] = outward if gap > GAP else 0.0
        tile = next_tile(work)
    return 0


def find_gaps(
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
    rows: NDArray[np.int64],
    near: NDArray[np.integer[Any]],
) -> NDArray[np.float32]:
    """The direction out of the surface for points on what may be an open border, else zero.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32, unit
    rows : (m,) int64
        The points to examine.
    near : (n, k) int
        Rows of each point's neighbours, itself first.

    Returns
    -------
    (m, 3) float32, unit or zero
    """
    out = np.zeros((len(rows), 3), np.float32)
    arrays = [np.ascontiguousarray(array) for array in (positions, normals, rows, near)]
    run(_find_gaps, -(-len(out) // CHUNK), *arrays, out)
    return out


def drop_lone(borders: NDArray[np.float32], near: NDArray[np.integer[Any]]) -> None:
    """Set borders to zero, in place, where too few neighbours lie on one too: a single gap occurs by chance."""
    found: NDArray[np.bool_] = np.any(borders, axis=1)
    rows = np.flatnonzero(found)
    borders[rows[found[near[rows, 1:]].sum(axis=1) < COMPANY]] = 0
