"""Confidence that the normals of two points face the same side: the rule by which signs propagate.

Two points with normals n and m and the connecting unit vector e obey the reflection rule (Koenig and Gumhold 2009) if
their signs agree: n - 2 (n.e) e faces the same side as m. The rule also holds around a rim, where n.m alone misleads.
Edges that leave the tangent planes count less, as they may cross a thin sheet. Where the rule contradicts n.m, the mean
of both counts, so that two layers of a noisy wall are not taken for a thin body (41% of a tower's wall faced away).
"""

from __future__ import annotations

from typing import TypeAlias

from ...engine.jit import Array, f32, inline
from ...engine.simd import ONE, ZERO, Real, select, vmax, vsqrt

Reals: TypeAlias = tuple[Real, Real, Real]

TINY = f32(1e-37)  # lower limit of squared distances


@inline
def _dot(a: Reals, b: Reals) -> Real:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def agreement_of(e: Reals, n: Reals, m: Reals) -> Real:
    """Return the signed confidence, -1 to 1, that two unit normals face the same side of a surface.

    It is large if one normal is the mirror image of the other in the plane between the points (Koenig and Gumhold
    2009). It is small if `e` leaves the tangent planes, as it may then cross a thin sheet.

    e : vector from the first point to the second
    n, m : normals of the first and the second point; floats, or vectors of lanes
    """
    square, a, b, nm = _dot(e, e), _dot(n, e), _dot(m, e), _dot(n, m)
    inverse = ONE / vmax(square, square * ZERO + TINY)
    steep = vsqrt(vmax(a * a, b * b) * inverse)
    reflected = nm - f32(2.0) * a * b * inverse
    mean = f32(0.5) * (nm + reflected)
    reflected = select(reflected * nm < ZERO, mean, reflected)
    return reflected * vmax(ONE - steep, square * ZERO)


@inline
def agreement(positions: Array, normals: Array, i: int, j: int) -> float:
    """Return the signed confidence, -1 to 1, that the normals of points i and j face the same side of a surface.

    positions, normals : (n, 3)
    """
    n, m = (normals[i, 0], normals[i, 1], normals[i, 2]), (normals[j, 0], normals[j, 1], normals[j, 2])
    e = positions[j, 0] - positions[i, 0], positions[j, 1] - positions[i, 1], positions[j, 2] - positions[i, 2]
    return agreement_of(e, n, m)
