"""Weighted plane fits: principal axes of the neighbours of sixteen points at once."""

from __future__ import annotations

from typing import NamedTuple

from ...engine.jit import f32, inline
from ...engine.simd import F16, ONE, ZERO, Mask, bits, broadcast16, load16, select, store, vabs, vmax, vmin, vsqrt
from .fit_batch import LANES, FitBatch16, Sextuple, Triple, distance_weight, inner, load_place, zeros

SWEEPS = 6  # sweeps of three rotations; 3 mostly suffice
ROUND_OFF = 1e-12  # squared off-diagonal elements, relative to the squared trace, that count as 0
SMALLEST = 1e-30  # replaces zero in divisions
NARROWEST = 1e-15  # lower limit of a neighbourhood's radius, in the unit of the places


class Plane(NamedTuple):
    """Planes fitted to the neighbours of sixteen points, one in each lane.

    Lengths are in the unit of the memory that the neighbours were loaded into: the distance of the farthest one.

    normal, one, two : orthogonal unit vectors; the last two lie in the plane
    mean : weighted mean of the neighbours, as an offset from the point
    reach : distance of the farthest neighbour that was used
    total : sum of the weights
    slimness : second largest variance over the largest; small if the neighbours lie on a line
    """

    normal: Triple
    one: Triple
    two: Triple
    mean: Triple
    reach: F16
    total: F16
    slimness: F16


@inline
def fit_plane(k: int, memory: FitBatch16) -> Plane:
    """Fit a plane to the k nearest neighbours of each of sixteen points, or to all if there are fewer.

    The weight falls with distance to 1/e at the farthest of them.

    memory : holds the neighbours, receives the weights
    """
    last = load_place(memory.places, k - 1)
    reach = vmax(vsqrt(inner(last, last)), broadcast16(f32(NARROWEST)))
    inverse = ONE / (reach * reach)
    total = x = y = z = xx = xy = xz = yy = yz = zz = zeros()
    counts = load16(memory.counts, 0)
    for j in range(k):
        p, q, r = load_place(memory.places, j)
        w = distance_weight(inverse * (p * p + q * q + r * r))
        w = select(counts > f32(j), w, zeros())
        store(memory.weights, LANES * j, w)
        wp, wq, wr = w * p, w * q, w * r
        total, x, y, z = total + w, x + wp, y + wq, z + wr
        xx, xy, xz = xx + wp * p, xy + wp * q, xz + wp * r
        yy, yz, zz = yy + wq * q, yz + wq * r, zz + wr * r
    share = ONE / total
    x, y, z = x * share, y * share, z * share
    variances = (xx * share - x * x, xy * share - x * y, xz * share - x * z)
    others = (yy * share - y * y, yz * share - y * z, zz * share - z * z)
    scaled = (
        *(variances[0] * inverse, variances[1] * inverse, variances[2] * inverse),
        *(others[0] * inverse, others[1] * inverse, others[2] * inverse),
    )
    normal, one, two, slimness = principal_axes(scaled)
    return Plane(normal, one, two, (x, y, z), reach, total, slimness)


@inline
def principal_axes(a: Sextuple) -> tuple[Triple, Triple, Triple, F16]:
    """Diagonalise a covariance matrix in each lane by Jacobi rotations.

    Returns three unit vectors, first the axis of least variance; and the second largest variance over the largest.

    a : xx xy xz yy yz zz of the matrix, at most of order 1
    """
    xx, xy, xz, yy, yz, zz = a
    zero, one = zeros(), broadcast16(ONE)
    u, v, w = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    for _ in range(SWEEPS):
        size = xx + yy + zz
        if bits(xy * xy + xz * xz + yz * yz > ROUND_OFF * size * size) == 0:
            break
        t, c, s = _rotation(xx, yy, xy)
        xx, yy, xy, xz, yz = xx - t * xy, yy + t * xy, zero, c * xz - s * yz, s * xz + c * yz
        u, v = _turn(u, v, c, s)
        t, c, s = _rotation(xx, zz, xz)
        xx, zz, xz, xy, yz = xx - t * xz, zz + t * xz, zero, c * xy - s * yz, s * xy + c * yz
        u, w = _turn(u, w, c, s)
        t, c, s = _rotation(yy, zz, yz)
        yy, zz, yz, xy, xz = yy - t * yz, zz + t * yz, zero, c * xy - s * xz, s * xy + c * xz
        v, w = _turn(v, w, c, s)
    swap = yy < xx
    low, high = vmin(xx, yy), vmax(xx, yy)
    u, v = _pick(swap, v, u), _pick(swap, u, v)
    slimness = vmax(low, vmin(high, zz)) / vmax(vmax(high, zz), broadcast16(f32(SMALLEST)))
    swap = zz < low
    return _pick(swap, w, u), v, _pick(swap, u, w), slimness


@inline
def _rotation(a: F16, b: F16, off: F16) -> Triple:
    """Return tangent, cosine and sine of the Jacobi rotation that zeroes an off-diagonal element of a symmetric matrix.

    a, b : the diagonal elements in the same rows and columns; off : the off-diagonal element
    """
    half = b - a
    t = 2.0 * off / (vabs(half) + vsqrt(half * half + 4.0 * off * off) + SMALLEST)
    t = select(half < ZERO, ZERO - t, t)
    c = ONE / vsqrt(ONE + t * t)
    return t, c, t * c


@inline
def _turn(u: Triple, v: Triple, c: F16, s: F16) -> tuple[Triple, Triple]:
    return (
        (c * u[0] - s * v[0], c * u[1] - s * v[1], c * u[2] - s * v[2]),
        (s * u[0] + c * v[0], s * u[1] + c * v[1], s * u[2] + c * v[2]),
    )


@inline
def _pick(mask: Mask, a: Triple, b: Triple) -> Triple:
    return select(mask, a[0], b[0]), select(mask, a[1], b[1]), select(mask, a[2], b[2])
