"""Plane through weighted points: its normal is the direction of least variance."""

from __future__ import annotations

import math

from ...engine.jit import Array, inline, routine
from ...engine.kernels.vec import Vec3


@inline
def least_axis(a: Array, v: Array) -> Vec3:
    """Return the eigenvector of the smallest eigenvalue: column of `v` for the smallest diagonal element of `a`.

    a, v : (3, 3) diagonalised matrix, and its eigenvectors
    """
    b = 1 if a[1, 1] < a[0, 0] else 0
    if a[2, 2] < a[b, b]:
        b = 2
    return v[0, b], v[1, b], v[2, b]


@routine
def _least_direction(a: Array, v: Array) -> Vec3:
    """Return the eigenvector of a symmetric matrix's smallest eigenvalue by Jacobi rotations.

    a : (3, 3) the matrix, which becomes diagonal
    v : (3, 3) receives the eigenvectors as columns
    """
    for i in range(3):
        for j in range(3):
            v[i, j] = 1.0 if i == j else 0.0
    for turn in range(24):
        p = 0 if turn % 3 < 2 else 1
        q = 1 if turn % 3 == 0 else 2
        size = a[0, 0] + a[1, 1] + a[2, 2]
        if a[0, 1] ** 2 + a[0, 2] ** 2 + a[1, 2] ** 2 <= 1e-26 * size * size:
            break
        if a[p, q] == 0.0:
            continue
        half = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
        t = (1.0 if half >= 0.0 else -1.0) / (abs(half) + math.sqrt(half * half + 1.0))
        c = 1.0 / math.sqrt(t * t + 1.0)
        s = t * c
        for k in range(3):
            a[k, p], a[k, q] = c * a[k, p] - s * a[k, q], s * a[k, p] + c * a[k, q]
        for k in range(3):
            a[p, k], a[q, k] = c * a[p, k] - s * a[q, k], s * a[p, k] + c * a[q, k]
            v[k, p], v[k, q] = c * v[k, p] - s * v[k, q], s * v[k, p] + c * v[k, q]
    return least_axis(a, v)


@routine
def plane(d: Array, w: Array, k: int, a: Array, v: Array) -> Vec3:
    """Return the unit normal of the plane fitted to k weighted points: the direction of least variance.

    d, w : (k, 3) positions, and (k,) weights
    a, v : (3, 3) receive the eigenvalues, on the diagonal, and the eigenvectors
    """
    total = x = y = z = 0.0
    for j in range(k):
        total += w[j]
        x += w[j] * d[j, 0]
        y += w[j] * d[j, 1]
        z += w[j] * d[j, 2]
    x, y, z = x / total, y / total, z / total
    xx = xy = xz = yy = yz = zz = 0.0
    for j in range(k):
        p, q, r = d[j, 0] - x, d[j, 1] - y, d[j, 2] - z
        xx += w[j] * p * p
        xy += w[j] * p * q
        xz += w[j] * p * r
        yy += w[j] * q * q
        yz += w[j] * q * r
        zz += w[j] * r * r
    a[0, 0], a[1, 1], a[2, 2] = xx, yy, zz
    a[0, 1] = a[1, 0] = xy
    a[0, 2] = a[2, 0] = xz
    a[1, 2] = a[2, 1] = yz
    return _least_direction(a, v)
