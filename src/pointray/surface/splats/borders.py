"""Splats on open borders and their outward direction: the neighbours leave a wide gap in the tangent plane.

A neighbour closes the direction in which it lies. At a sharp fold (a crest, a crevice) the surface continues in the
other sheet, which may lie on the same side as the first. So a neighbour with a very different normal also closes the
direction of the fold: the direction in which its normal leans if it lies below the tangent plane, else the opposite.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats
from ...engine.jit import Array, borrow, f64, i64, inline, keep_alive, kernel, next_tile, run
from ...engine.kernels.vec import Vec3, tangents

GAP = math.radians(115)  # a straight border leaves 180 degrees; of sets of 20 random directions, 1 in 75 leaves this
TURNED = 1.2  # `_turn` increases by at least 1.22 over an angle of GAP
FOLD = math.cos(math.radians(45))  # cosine of two normals below which the surface counts as folded
BORDER_NEIGHBORS = 2  # a border is a curve: at least this many neighbours of a border splat are on it too
CHUNK = 2048


@inline
def _turn(x: float, y: float) -> float:
    """Return a number from -2 to 2 that increases with the angle of (x, y), which is not (0, 0); faster than atan2."""
    share = y / (abs(x) + abs(y))
    return share if x >= 0.0 else math.copysign(2.0, y) - share


@inline
def insert(found: Array, count: int, x: float, y: float) -> int:
    """Insert a direction (x, y), unless it is zero, into the `count` rows of `found`; return the new number of rows.

    Columns are turn, x, y. Rows are sorted by turn, a number from -2 to 2 that increases with the angle.
    """
    if x == 0.0 and y == 0.0:
        return count
    turn, k = _turn(x, y), count
    while k > 0 and found[k - 1, 0] > turn:
        for c in range(3):
            found[k, c] = found[k - 1, c]
        k -= 1
    found[k, 0], found[k, 1], found[k, 2] = turn, x, y
    return count + 1


@inline
def _closed_directions(
    positions: Array, normals: Array, i: int, near: Array, axes: tuple[Vec3, Vec3], found: Array
) -> int:
    """Write the tangent directions in which the surface continues from splat i to its neighbours; return their number.

    near : rows of the neighbours; axes : two tangents
    found : output, rows turn, x, y, sorted by turn, a number that increases with the angle

    A neighbour across a fold (a crest, a crevice) also adds the direction towards the fold: the surface continues
    there, even if that neighbour itself lies in another direction.
    """
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
        count = insert(found, count, at_u, at_v)
        if cosine < FOLD:
            side = -1.0 if height > 0.0 else 1.0
            count = insert(found, count, side * lean_u, side * lean_v)
    return count


@inline
def widest(found: Array, count: int) -> tuple[float, float]:
    """Return the widest angle without a direction in it, 0 if it is below 115 degrees, and the angle of its middle.

    Both are in radians. found : `count` rows turn, x, y, sorted by turn, a number that increases with the angle
    """
    gap, middle = (2.0 * math.pi, 0.0) if count == 0 else (0.0, 0.0)
    for k in range(count):
        before = k - 1 if k > 0 else count - 1
        whole = 0.0 if k > 0 else 1.0
        if found[k, 0] + 4.0 * whole - found[before, 0] > TURNED:
            angle = math.atan2(found[k, 2], found[k, 1])
            here = angle + 2.0 * math.pi * whole - math.atan2(found[before, 2], found[before, 1])
            if here > gap:
                gap, middle = here, angle - 0.5 * here
    return gap if gap > GAP else 0.0, middle


@kernel
def _find_gaps(work: Array, positions: Array, normals: Array, rows: Array, near: Array, out: Array) -> None:
    """Write the outward direction of each splat on a possible open border, else zero.

    It is the middle of the widest angle in the tangent plane without a neighbour, if this angle is over 115 degrees.

    rows : (m,) the splats; near : (m, k) rows of these and their neighbours
    out : (m, 3) output
    """
    positions, normals, near, out = borrow(positions), borrow(normals), borrow(near), borrow(out)
    memory = np.empty((2 * near.shape[1], 3))
    found = borrow(memory)
    tile = next_tile(work)
    while tile >= 0:
        for at in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            i = i64(rows[at])
            axes = tangents((f64(normals[i, 0]), f64(normals[i, 1]), f64(normals[i, 2])))
            gap, middle = widest(found, _closed_directions(positions, normals, i, near[at], axes, found))
            for c in range(3):
                outward = math.cos(middle) * axes[0][c] + math.sin(middle) * axes[1][c] if gap > 0.0 else 0.0
                out[at, c] = outward
        tile = next_tile(work)
    keep_alive(memory)


def find_gaps(positions: Floats, normals: Floats, rows: NDArray[np.int64], near: NDArray[np.integer[Any]]) -> Floats:
    """Find the outward direction of points on a possible open border.

    It is the middle of the widest angle in the tangent plane without a neighbour, if this angle is over 115 degrees.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32
        Unit normals.
    rows : (m,) int64
        The points to examine.
    near : (m, k) int
        Rows of these points and their neighbours.

    Returns
    -------
    (m, 3) float32
        Unit direction, or zero where no such angle is that wide.
    """
    out = np.zeros((len(rows), 3), np.float32)
    arrays = [np.ascontiguousarray(array) for array in (positions, normals, rows, near)]
    run(_find_gaps, -(-len(out) // CHUNK), *arrays, out)
    return out


def isolated_borders(found: Flags, near: NDArray[np.integer[Any]]) -> Flags:
    """Return which border points have fewer than two neighbours on a border, (m,): single gaps occur by chance.

    found : (n,) bool, border points; near : (m, k), rows of border points and their neighbours
    """
    return np.asarray(found[near[:, 1:]].sum(axis=1) < BORDER_NEIGHBORS)
