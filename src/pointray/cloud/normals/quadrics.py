"""Quadric over a plane, fitted to one point's neighbours by weighted least squares."""

from __future__ import annotations

import math

from ...engine.jit import Array, routine

TERMS = 6  # 1, p, q, pp, pq, qq; a seventh column of the terms holds the height


@routine
def solve(terms: Array, w: Array, k: int, ridge: float, m: Array, x: Array) -> float:
    """Fit a quadric to k weighted points by least squares (Cholesky); return the sum of the weights.

    terms : (k, 7) 1, p, q, pp, pq, qq and the height of each point
    w : (k,) weights
    ridge : added to the three square terms, times the sum of weights, so that points on a line have a solution
    m : (6, 6) receives the Cholesky factor, in the lower triangle
    x : (6,) receives the coefficients
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
