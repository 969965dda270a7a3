"""Robust fits to a point's neighbourhood: a quadric over a plane; distant points get little weight."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from ...engine.jit import Array, f64, inline, routine
from ...engine.kernels.vec import Vec3, tangents
from ..normals.planes import plane
from ..normals.quadrics import TERMS, solve

# One thread's memory: places in the unit ball, weights, residuals, sizes, scratch; terms, coefficients and factor of
# the quadric; variances and axes of the plane.
Memory: TypeAlias = tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array, Array]

PLANES, QUADRICS = 3, 2  # rounds of reweighting
EVEN = 3.0  # largest residual, in spreads, with which no further round is needed
ROUND = 0.25  # ratio of the plane's two least variances above which a second start is tried
START = 14  # points of the second start
RIDGE = 1e-3  # added to the square terms
SPREAD = 1.5  # standard deviation over the median absolute residual, for six fitted terms


@inline
def new_memory(k: int) -> Memory:
    """Return the memory of one thread for robust fits of a plane and a quadric to k points.

    A tuple of arrays: offsets, weights and residuals of the points; two arrays of k floats for sorting; terms,
    coefficients and Cholesky factor of the quadric; eigenvalues and eigenvectors for the plane.
    """
    d, terms = np.empty((k, 3)), np.empty((k, TERMS + 1))
    w, r, sizes, scratch = np.empty(k), np.empty(k), np.empty(k), np.empty(k)
    x, m, a, v = np.empty(TERMS), np.zeros((TERMS, TERMS)), np.empty((3, 3)), np.empty((3, 3))
    return d, w, r, sizes, scratch, terms, x, m, a, v


@routine
def nth(values: Array, k: int, rank: int, scratch: Array) -> float:
    """Return the value with the given rank, from 0, among the first k: Hoare's quickselect.

    It takes a third of the time of an insertion sort for k = 48.

    scratch : memory for k values
    """
    for i in range(k):
        scratch[i] = values[i]
    low, high = 0, k - 1
    while low < high:
        pivot, i, j = scratch[(low + high) // 2], low, high
        while i <= j:
            while scratch[i] < pivot:
                i += 1
            while scratch[j] > pivot:
                j -= 1
            if i <= j:
                scratch[i], scratch[j] = scratch[j], scratch[i]
                i, j = i + 1, j - 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return scratch[rank]


@inline
def _weigh(r: Array, k: int, sizes: Array, scratch: Array, w: Array) -> tuple[float, float]:
    """Compute weights of k points from their residuals, so that distant points hardly count.

    Returns the standard deviation, estimated from the median residual, and the largest residual relative to it.

    r, w : (k,) residuals; receives the weights
    sizes, scratch : memory for k values each
    """
    most = 0.0
    for j in range(k):
        sizes[j] = abs(r[j])
        most = max(most, sizes[j])
    spread = SPREAD * nth(sizes, k, k // 2, scratch)
    square = 4.0 * spread * spread + 1e-12
    for j in range(k):
        w[j] = 1.0 / (1.0 + r[j] * r[j] / square) ** 2
    return spread, most / max(spread, 1e-300)


@inline
def _least_ratio(a: Array) -> float:
    """Return the least variance of k points over the second least: small if they are flat.

    a : (3, 3) diagonalised covariance matrix
    """
    low, high = min(a[0, 0], a[1, 1]), max(a[0, 0], a[1, 1])
    least = min(low, a[2, 2])
    return least / max(max(low, min(high, a[2, 2])), 1e-300)


@routine
def _start(d: Array, k: int, w: Array, sizes: Array, scratch: Array) -> int:
    """Give weight 1 to the points nearest to the middle one of the list, and 0 to others; return 0.

    Next to a stray, nearer points of the list may be strays, too; those in the middle lie on the surface.

    d : (k, 3) neighbours of a point, nearest first
    w : (k,) receives the weights
    sizes, scratch : memory for k values each
    """
    c = k // 2
    for j in range(k):
        sizes[j] = (d[j, 0] - d[c, 0]) ** 2 + (d[j, 1] - d[c, 1]) ** 2 + (d[j, 2] - d[c, 2]) ** 2
    limit = nth(sizes, k, min(START, k - 1), scratch)
    for j in range(k):
        w[j] = 1.0 if sizes[j] <= limit else 0.0
    return 0


@routine
def _planes(d: Array, k: int, second: bool, memory: Memory) -> Vec3:
    """Fit a plane through most of k points robustly; return its normal, and leave weights in the memory for a quadric.

    d : (k, 3) neighbours of a point, nearest first, as offsets from it
    second : whether to start with the points in the middle of the list, for a point off the surface
    """
    _, w, r, sizes, scratch, _, _, _, a, v = memory
    for j in range(k):
        w[j] = 1.0
    if second:
        _start(d, k, w, sizes, scratch)
    n = (0.0, 0.0, 1.0)
    for turn in range(PLANES):
        n = plane(d, w, k, a, v)
        if turn == 0 and not second and _least_ratio(a) > ROUND:
            _start(d, k, w, sizes, scratch)
            n = plane(d, w, k, a, v)
        total = middle = 0.0
        for j in range(k):
            r[j] = d[j, 0] * n[0] + d[j, 1] * n[1] + d[j, 2] * n[2]
            total += w[j]
            middle += w[j] * r[j]
        for j in range(k):
            r[j] -= middle / total
        _, most = _weigh(r, k, sizes, scratch, w)
        if most < EVEN and not second:
            break
    return n


@inline
def into_ball(positions: Array, row: int, near: Array, i: int, k: int, d: Array) -> float:
    """Write to `d` the offsets of k neighbours from a point, scaled into the unit ball; return the radius before.

    near : (m, k) rows of neighbours; near[i] are those of the point positions[row]
    d : (k, 3)
    """
    far = 1e-30
    for j in range(k):
        for c in range(3):
            d[j, c] = f64(positions[near[i, j], c]) - f64(positions[row, c])
        far = max(far, math.sqrt(d[j, 0] ** 2 + d[j, 1] ** 2 + d[j, 2] ** 2))
    for j in range(k):
        for c in range(3):
            d[j, c] /= far
    return far


@routine
def fit(
    positions: Array, row: int, near: Array, i: int, k: int, second: bool, memory: Memory
) -> tuple[Vec3, float, float]:
    """Fit a plane, then a quadric over it, robustly to the neighbours near[i] of the point positions[row].

    Returns the plane's normal; the noise (standard deviation of the neighbours from the quadric), relative to the
    radius; the radius: distance of the farthest neighbour. Coefficients, terms and residuals stay in the memory.

    k : number of neighbours
    second : whether to start with the neighbours in the middle of the list instead of all, for a point off the surface
    """
    d, w, r, sizes, scratch, terms, x, m, _, _ = memory
    far = into_ball(positions, row, near, i, k, d)
    n = _planes(d, k, second, memory)
    one, two = tangents(n)
    for j in range(k):
        p = d[j, 0] * one[0] + d[j, 1] * one[1] + d[j, 2] * one[2]
        q = d[j, 0] * two[0] + d[j, 1] * two[1] + d[j, 2] * two[2]
        terms[j, 0], terms[j, 1], terms[j, 2] = 1.0, p, q
        terms[j, 3], terms[j, 4], terms[j, 5] = p * p, p * q, q * q
        terms[j, TERMS] = d[j, 0] * n[0] + d[j, 1] * n[1] + d[j, 2] * n[2]
    spread = 0.0
    for _ in range(QUADRICS):
        solve(terms, w, k, RIDGE, m, x)
        for j in range(k):
            r[j] = terms[j, TERMS]
            for b in range(TERMS):
                r[j] -= x[b] * terms[j, b]
        spread, most = _weigh(r, k, sizes, scratch, w)
        if most < EVEN and not second:
            break
    return n, spread, far
