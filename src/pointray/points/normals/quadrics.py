"""The quadric over a plane, by weighted least squares: coefficients, residuals, and how sure height and slope are."""

from __future__ import annotations

import math

from ...jit import Array, inline, routine

TERMS = 6  # of a quadric over two variables: 1, p, q, pp, pq, qq; a seventh column of the terms is the height


@routine
def solve(terms: Array, w: Array, k: int, ridge: float, m: Array, x: Array) -> float:
    """Least squares by Cholesky: x the coefficients, m the factor below its diagonal; returns the sum of weights.

    ridge : of the three square terms, times the sum of weights
    """
    total = 0.0
    for a in range(TERMS):
        x[a] = 0.0
        for b in range(a + 1):
            m[a, b] = 0.0
    for j in range(k):
        total += w[j]
        for a in range(TERMS):
            g = w[j] * terms[j, a]
            x[a] += g * terms[j, TERMS]
            for b in range(a + 1):
                m[a, b] += g * terms[j, b]
    for a in range(TERMS):
        for b in range(a + 1):
            s = m[a, b] + (ridge * total if a == b and a > 2 else 0.0)
            for c in range(b):
                s -= m[a, c] * m[b, c]
            m[a, b] = math.sqrt(max(s, 1e-9 * total)) if a == b else s / m[b, b]
        for c in range(a):
            x[a] -= m[a, c] * x[c]
        x[a] /= m[a, a]
    for a in range(TERMS - 1, -1, -1):
        for c in range(a + 1, TERMS):
            x[a] -= m[c, a] * x[c]
        x[a] /= m[a, a]
    return total


@inline
def residual(terms: Array, x: Array, j: int) -> float:
    r = terms[j, TERMS]
    for a in range(TERMS):
        r -= x[a] * terms[j, a]
    return r


@inline
def slope_variance(m: Array) -> float:
    """The slope's variance for unit noise at unit weights: two entries of the inverse normal matrix, summed."""
    total = 0.0
    y = (0.0, 0.0, 0.0, 0.0, 0.0)
    for t in range(1, 3):
        y0 = 1.0 / m[t, t]
        y1 = -m[2, 1] * y0 / m[2, 2] if t == 1 else 0.0
        y2 = -(m[3, t] * y0 + m[3, 2] * y1) / m[3, 3]
        y3 = -(m[4, t] * y0 + m[4, 2] * y1 + m[4, 3] * y2) / m[4, 4]
        y4 = -(m[5, t] * y0 + m[5, 2] * y1 + m[5, 3] * y2 + m[5, 4] * y3) / m[5, 5]
        y = (y0, y1, y2, y3, y4)
        for c in range(5):
            total += y[c] * y[c]
    return total


@inline
def height_variance(m: Array) -> float:
    """The same of the height over the point: the first entry of the inverse normal matrix."""
    y0 = 1.0 / m[0, 0]
    y1 = -m[1, 0] * y0 / m[1, 1]
    y2 = -(m[2, 0] * y0 + m[2, 1] * y1) / m[2, 2]
    y3 = -(m[3, 0] * y0 + m[3, 1] * y1 + m[3, 2] * y2) / m[3, 3]
    y4 = -(m[4, 0] * y0 + m[4, 1] * y1 + m[4, 2] * y2 + m[4, 3] * y3) / m[4, 4]
    y5 = -(m[5, 0] * y0 + m[5, 1] * y1 + m[5, 2] * y2 + m[5, 3] * y3 + m[5, 4] * y4) / m[5, 5]
    return y0 * y0 + y1 * y1 + y2 * y2 + y3 * y3 + y4 * y4 + y5 * y5
