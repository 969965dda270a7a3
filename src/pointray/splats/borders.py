"""Which splats lie on an open border, and which way it faces: their neighbours leave a wide gap in the tangent plane.

A neighbour closes the direction it lies in. Where the surface is folded sharply (a crest, a crevice), it goes on in the
other sheet, which may lie on the same side as the first; so a neighbour whose normal differs much also closes the
direction in which the fold is: the one its normal leans to where it lies below the tangent plane, the opposite one
where it lies above.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit import borrow, inline, kernel, run, take

NEIGHBORS = 20  # of so many evenly random directions, one in 250 sets leaves a gap of GAP
GAP = math.radians(130)  # a straight border leaves 180 degrees
FOLD = math.cos(math.radians(45))  # cosine of two normals between which the surface counts as folded
AHEAD = math.cos(math.radians(60))  # how near the direction out of a border a splat must lie to close it
COMPANY = 2  # a border is a curve: at least so many of a splat's neighbours lie on it too
TILE = 2048


@inline
def _axes(n):  # type: ignore[no-untyped-def]
    """Two axes of the tangent plane (Duff et al. 2017)."""
    sign = 1.0 if n[2] >= 0.0 else -1.0
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return (1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]), (b, sign + n[1] * n[1] * a, -n[1])


@inline
def _closed_angles(positions, normals, i, near, axes, angles):  # type: ignore[no-untyped-def]
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
def _find_gaps(work, positions, normals, near, out):  # type: ignore[no-untyped-def]
    """out[i]: the direction of the middle of the widest gap around splat i, zero where none is wider than GAP."""
    positions, normals, near, out = borrow(positions), borrow(normals), borrow(near), borrow(out)
    angles = np.empty(2 * near.shape[1])
    tile = take(work)
    while tile >= 0:
        for i in range(tile * TILE, min((tile + 1) * TILE, len(out))):
            n = (np.float64(normals[i, 0]), np.float64(normals[i, 1]), np.float64(normals[i, 2]))
            axes = _axes(n)
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
                out[i, c] = outward if gap > GAP else 0.0
        tile = take(work)
    return 0


@kernel
def _close_steps(work, positions, radii, near, reach, out):  # type: ignore[no-untyped-def]
    """Where dense points end and sparse ones go on, no border: a splat ahead, too far to be a neighbour, overlaps.

    The sparse splat has dense ones among its own neighbours, so every splat looks at those.
    """
    positions, radii, near, reach, out = borrow(positions), borrow(radii), borrow(near), borrow(reach), borrow(out)
    tile = take(work)
    while tile >= 0:
        for i in range(tile * TILE, min((tile + 1) * TILE, len(out))):
            for j in near[i]:
                ahead = square = 0.0
                for c in range(3):
                    d = np.float64(positions[i, c]) - np.float64(positions[j, c])
                    ahead += d * out[j, c]
                    square += d * d
                distance = math.sqrt(square)
                if ahead > AHEAD * distance and distance > reach[j] and distance < radii[i] + radii[j]:
                    out[j, 0] = out[j, 1] = out[j, 2] = 0.0
        tile = take(work)
    return 0


def find_borders(
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
    radii: NDArray[np.float32],
    near: NDArray[np.integer[Any]],
    reach: NDArray[np.floating[Any]],
) -> NDArray[np.float32]:
    """The direction out of the surface for each point on an open border, else zero.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32, unit
    radii : (n,) float32
    near : (n, NEIGHBORS + 1) int
        Rows of each point's neighbours, itself first.
    reach : (n,) float
        Distance to the last of them.

    Returns
    -------
    (n, 3) float32, unit or zero
    """
    out = np.zeros((len(positions), 3), np.float32)
    near, tiles = np.ascontiguousarray(near), -(-len(out) // TILE)
    run(_find_gaps, tiles, positions, normals, near, out)
    run(_close_steps, tiles, positions, radii, near, np.ascontiguousarray(reach), out)
    # Alone, a gap is chance.
    found = np.abs(out).sum(axis=1) > 0
    rows = np.flatnonzero(found)
    out[rows[found[near[rows, 1:]].sum(axis=1) < COMPANY]] = 0
    return out
