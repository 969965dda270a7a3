"""Least-squares fits of quadrics from the moments of their points, in sixteen lanes.

The normal matrix of the terms 1, p, q, pp, pq, qq consists of the moments up to order 4. It is factored in halves: the
linear terms, then the Schur complement of the square terms.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

from ...engine.jit import f32, inline
from ...engine.simd import F16, ONE, ZERO, broadcast16, vmax
from .fit_batch import Sextuple, Triple, inner, zeros

RIDGE = f32(1e-4)  # added to the square terms, times the sum of weights: points on a line still have a solution
LEAST = f32(1e-7)  # lower limit of pivots, times the sum of weights: the precision of float32

Half: TypeAlias = Sextuple  # a unit lower triangular 3 x 3 matrix, l10 l20 l21, and the inverse of a diagonal matrix


class Moments(NamedTuple):
    """Weighted sums over the neighbours of sixteen points, by which quadrics are fitted, one point in each lane.

    mij is the sum of w p^i q^j, where p and q are coordinates in a plane and w is the weight; hij is that of w h p^i
    q^j, where h is the height above the plane.
    """

    m00: F16
    m10: F16
    m01: F16
    m20: F16
    m11: F16
    m02: F16
    m30: F16
    m21: F16
    m12: F16
    m03: F16
    m40: F16
    m31: F16
    m22: F16
    m13: F16
    m04: F16
    h00: F16
    h10: F16
    h01: F16
    h20: F16
    h11: F16
    h02: F16


class Factor(NamedTuple):
    """Factor L D L' of the 6 x 6 normal matrix of a quadric 1, p, q, pp, pq, qq, in sixteen lanes.

    top, low : L and D of the upper left and lower right 3 x 3 quarters: l10, l20, l21 and the inverse of D
    across : rows of the lower left quarter of L
    """

    top: Half
    across: tuple[Triple, Triple, Triple]
    low: Half


@inline
def no_moments() -> Moments:
    z = zeros()
    return Moments(z, z, z, z, z, z, z, z, z, z, z, z, z, z, z, z, z, z, z, z, z)


@inline
def add_place(m: Moments, w: F16, p: F16, q: F16, h: F16) -> Moments:
    """Return the sums for quadrics with one more neighbour in each lane.

    w : weight; p, q : coordinates in the plane; h : height above it
    """
    wp, wq = w * p, w * q
    wpp, wpq, wqq = wp * p, wp * q, wq * q
    pp, pq, qq = p * p, p * q, q * q
    return Moments(
        *(m.m00 + w, m.m10 + wp, m.m01 + wq, m.m20 + wpp, m.m11 + wpq, m.m02 + wqq),
        *(m.m30 + wpp * p, m.m21 + wpp * q, m.m12 + wqq * p, m.m03 + wqq * q),
        *(m.m40 + wpp * pp, m.m31 + wpp * pq, m.m22 + wpp * qq, m.m13 + wqq * pq, m.m04 + wqq * qq),
        *(m.h00 + w * h, m.h10 + wp * h, m.h01 + wq * h, m.h20 + wpp * h, m.h11 + wpq * h, m.h02 + wqq * h),
    )


@inline
def factor(m: Moments) -> Factor:
    least, ridge = LEAST * m.m00, RIDGE * m.m00
    top = _factor3((m.m00, m.m10, m.m01, m.m20, m.m11, m.m02), least)
    a, b, c = (
        _forward(top, (m.m20, m.m30, m.m21)),
        _forward(top, (m.m11, m.m21, m.m12)),
        _forward(top, (m.m02, m.m12, m.m03)),
    )
    e, f, g = _scaled(top, a), _scaled(top, b), _scaled(top, c)
    left = (
        *(m.m40 + ridge - inner(a, e), m.m31 - inner(a, f), m.m22 - inner(a, g)),
        *(m.m22 + ridge - inner(b, f), m.m13 - inner(b, g), m.m04 + ridge - inner(c, g)),
    )
    return Factor(top, (e, f, g), _factor3(left, least))


@inline
def _factor3(a: Sextuple, least: F16) -> Half:
    """Factor a symmetric 3 x 3 matrix into L D L': return l10, l20, l21 and the inverse of D.

    a : xx xy xz yy yz zz
    least : lower limit of the pivots
    """
    i0 = ONE / vmax(a[0], least)
    l10, l20 = a[1] * i0, a[2] * i0
    i1 = ONE / vmax(a[3] - l10 * a[1], least)
    t = a[4] - l20 * a[1]
    l21 = t * i1
    return l10, l20, l21, i0, i1, ONE / vmax(a[5] - l20 * a[2] - l21 * t, least)


@inline
def _forward(half: Half, b: Triple) -> Triple:
    """Solve L y = b, where L is unit lower triangular: half[0:3] are l10, l20, l21."""
    y = b[1] - half[0] * b[0]
    return b[0], y, b[2] - half[1] * b[0] - half[2] * y


@inline
def _backward(half: Half, z: Triple) -> Triple:
    """Solve L' x = z, where L is unit lower triangular: half[0:3] are l10, l20, l21."""
    y = z[1] - half[2] * z[2]
    return z[0] - half[0] * y - half[1] * z[2], y, z[2]


@inline
def _scaled(half: Half, y: Triple) -> Triple:
    """Solve D z = y, where D is diagonal: half[3:6] are the inverse elements."""
    return y[0] * half[3], y[1] * half[4], y[2] * half[5]


@inline
def solve(f: Factor, h: Sextuple) -> Sextuple:
    """Return the six coefficients of quadrics, 1 p q pp pq qq, in each lane, from the factored normal matrix.

    h : right-hand side: weighted sums of the heights times 1 p q pp pq qq
    """
    top = _forward(f.top, (h[0], h[1], h[2]))
    known = _times(f.across, top)
    low = _forward(f.low, (h[3] - known[0], h[4] - known[1], h[5] - known[2]))
    d = _backward(f.low, _scaled(f.low, low))
    a = _scaled(f.top, top)
    x = _backward(
        f.top,
        (
            a[0] - f.across[0][0] * d[0] - f.across[1][0] * d[1] - f.across[2][0] * d[2],
            a[1] - f.across[0][1] * d[0] - f.across[1][1] * d[1] - f.across[2][1] * d[2],
            a[2] - f.across[0][2] * d[0] - f.across[1][2] * d[1] - f.across[2][2] * d[2],
        ),
    )
    return x[0], x[1], x[2], d[0], d[1], d[2]


@inline
def _times(rows: tuple[Triple, Triple, Triple], y: Triple) -> Triple:
    return inner(rows[0], y), inner(rows[1], y), inner(rows[2], y)


@inline
def _variance(f: Factor, unit: Triple) -> F16:
    """Return one diagonal element of the inverse normal matrix: the variance of a coefficient of the quadric.

    unit : (1, 0, 0), (0, 1, 0) or (0, 0, 1), for the coefficient of 1, p or q
    """
    top = _forward(f.top, unit)
    across = _times(f.across, top)
    low = _forward(f.low, (ZERO - across[0], ZERO - across[1], ZERO - across[2]))
    return inner(top, _scaled(f.top, top)) + inner(low, _scaled(f.low, low))


@inline
def height_variance(f: Factor) -> F16:
    """Return the variance of each fitted quadric's height at its point, for heights of unit variance."""
    return _variance(f, (broadcast16(ONE), zeros(), zeros()))


@inline
def slope_variance(f: Factor) -> F16:
    """Return the variance of each fitted quadric's slope, summed over p and q, for heights of unit variance."""
    return _variance(f, (zeros(), broadcast16(ONE), zeros())) + _variance(f, (zeros(), zeros(), broadcast16(ONE)))


@inline
def polynomial(x: Sextuple, p: F16, q: F16) -> F16:
    """Return the heights of quadrics with coefficients x, 1 p q pp pq qq, at coordinates p and q."""
    return x[0] + p * (x[1] + x[3] * p + x[4] * q) + q * (x[2] + x[5] * q)
