"""Jets: quadrics over the planes through the neighbours of sixteen points at once.

The quadric (Cazals and Pouget 2003) is fitted twice: first with weights by distance, then with less weight on points
far off the first fit. The second fit solves for the residuals of the first, which also corrects rounding errors, so
that float32 gives normals as accurate as float64.
"""

from __future__ import annotations

from ...engine.jit import Array, f32, inline, routine
from ...engine.simd import F16, ONE, Mask, broadcast16, load16, select, store, vmax, vmin, vsqrt
from .axes import Plane, fit_plane
from .fit_batch import LANES, ROW, FitBatch16, Sextuple, Triple, load_place, zeros
from .moments import (
    RIDGE,
    Factor,
    Moments,
    add_place,
    factor,
    height_variance,
    no_moments,
    polynomial,
    slope_variance,
    solve,
)

TERMS = 6
JET_LEAST = 8  # fewer points are fitted by a plane
SLIM = 0.2  # ratio of the plane's variances below which points lie on one or two lines, and more points are used
LINE = 0.05  # ratio below which a plane is fitted if there are no more points
SLIM_VARIANCE = f32(1e30)  # variance of the slope where no quadric was fitted
LARGEST_VARIANCE = f32(1e29)
ALIKE = f32(1e-12)  # mean square of residuals, in radii, below which all points have the same weight
# Rows of `results`: normals of the quadric and of the plane; RMS residual; variances of slope and height for unit
# noise; height of the quadric at the point, along the plane's normal.
NORMAL, AXIS, RESIDUAL, SLOPE, HEIGHT, SPREAD = 0, 3, 6, 7, 8, 9


@routine
def jet(k: int, slim: float, memory: FitBatch16) -> None:
    """Fit a quadric to the k nearest neighbours of each of sixteen points; write the results to the memory.

    Rows of 16 floats: the quadric's normal at the point, the normal of the plane it is fitted over, RMS residual,
    variance of the slope for unit noise, height of the quadric at the point along the plane's normal, variance of that
    height for unit noise. Lengths are relative to the distance of the farthest loaded neighbour.

    Where there are fewer than 8 neighbours, or these lie on a line, the normal is the plane's, the residual 0 and the
    variance of the slope 1e30.

    slim : ratio of the two largest variances of the neighbours below which they lie on a line
    """
    plane = fit_plane(k, memory)
    store_triple(memory, AXIS, plane.normal)
    points = vmin(load16(memory.counts, 0), broadcast16(f32(k)))
    sound = (plane.slimness >= f32(slim)) & (points >= f32(JET_LEAST))
    moments = _lay_down(k, plane, memory)
    x = solve(factor(moments), _right(moments))
    square = _first_residuals(k, x, memory) / moments.m00
    moments, squares, left = _second_round(k, ONE / (4.0 * square + ALIKE), memory)
    f, total = factor(moments), moments.m00
    x, left = _corrected(f, moments, x, left)
    effective = total * total / squares
    left = left * effective / (total * vmax(effective - f32(TERMS), broadcast16(ONE)))
    slope = slope_variance(f) * squares / (total * plane.reach * plane.reach)
    none = zeros()
    store(memory.results, LANES * RESIDUAL, select(sound, plane.reach * vsqrt(left), none))
    store(
        memory.results,
        LANES * SLOPE,
        select(sound, vmin(slope, broadcast16(LARGEST_VARIANCE)), broadcast16(SLIM_VARIANCE)),
    )
    store(memory.results, LANES * HEIGHT, select(sound, plane.reach * x[0], none))
    store(memory.results, LANES * SPREAD, height_variance(f) * squares / total)
    _store_normal(plane, x, sound, memory)


@inline
def store_triple(memory: FitBatch16, at: int, v: Triple) -> None:
    store(memory.results, LANES * at, v[0])
    store(memory.results, LANES * (at + 1), v[1])
    store(memory.results, LANES * (at + 2), v[2])


@inline
def take_triple(mask: Mask, a: Array, at_a: int, b: Array, at_b: int, out: Array, at: int) -> None:
    """Write three rows of 16 floats: those of `a` in lanes where the mask is set, those of `b` elsewhere.

    at_a, at_b, at : first row in `a`, in `b` and in `out`
    """
    for c in range(3):
        store(out, LANES * (at + c), select(mask, load16(a, LANES * (at_a + c)), load16(b, LANES * (at_b + c))))


@inline
def _lay_down(k: int, plane: Plane, memory: FitBatch16) -> Moments:
    """Write the k nearest neighbours in the axes of a plane to the memory; return the sums over them for a quadric.

    For each neighbour, two coordinates in the plane and the height above it are written to `memory.local`. They are
    scaled so that the farthest neighbour is at distance 1.
    """
    scale = ONE / plane.reach
    u, v, n = plane.one, plane.two, plane.normal
    u = (u[0] * scale, u[1] * scale, u[2] * scale)
    v = (v[0] * scale, v[1] * scale, v[2] * scale)
    n = (n[0] * scale, n[1] * scale, n[2] * scale)
    moments = no_moments()
    for j in range(k):
        x, y, z = load_place(memory.places, j)
        p = x * u[0] + y * u[1] + z * u[2]
        q = x * v[0] + y * v[1] + z * v[2]
        h = x * n[0] + y * n[1] + z * n[2]
        store(memory.local, ROW * j, p)
        store(memory.local, ROW * j + LANES, q)
        store(memory.local, ROW * j + 2 * LANES, h)
        moments = add_place(moments, load16(memory.weights, LANES * j), p, q, h)
    return moments


@inline
def _right(m: Moments) -> Sextuple:
    return m.h00, m.h10, m.h01, m.h20, m.h11, m.h02


@inline
def _first_residuals(k: int, x: Sextuple, memory: FitBatch16) -> F16:
    """Write the residuals of the k nearest neighbours from a quadric; return the weighted sum of their squares.

    x : coefficients of the quadric, 1 p q pp pq qq
    """
    total = zeros()
    for j in range(k):
        p, q, h = load_place(memory.local, j)
        r = h - polynomial(x, p, q)
        store(memory.residuals, LANES * j, r)
        total = total + load16(memory.weights, LANES * j) * r * r
    return total


@inline
def _second_round(k: int, inverse: F16, memory: FitBatch16) -> tuple[Moments, F16, F16]:
    """Weight the k nearest neighbours by their residuals from a first quadric, those far off less, for a second fit.

    Returns the sums for a fit to the residuals, the sum of squared weights, and that of weighted squared residuals.

    inverse : reciprocal square of the residual that gets a quarter of the weight
    """
    moments, squares, left = no_moments(), zeros(), zeros()
    for j in range(k):
        p, q = load16(memory.local, ROW * j), load16(memory.local, ROW * j + LANES)
        r = load16(memory.residuals, LANES * j)
        away = ONE + r * r * inverse
        w = load16(memory.weights, LANES * j) / (away * away)
        moments = add_place(moments, w, p, q, r)
        squares, left = squares + w * w, left + w * r * r
    return moments, squares, left


@inline
def _corrected(f: Factor, m: Moments, x: Sextuple, left: F16) -> tuple[Sextuple, F16]:
    """Correct the coefficients of a quadric by a fit to its residuals.

    Returns the new coefficients, and the weighted sum of squared residuals that remain.

    f, m : factored normal matrix, and sums over the residuals
    x : coefficients before the correction, of 1 p q pp pq qq
    left : weighted sum of squared residuals before the correction
    """
    b, ridge = _right(m), RIDGE * m.m00
    d = solve(f, (b[0], b[1], b[2], b[3] - ridge * x[3], b[4] - ridge * x[4], b[5] - ridge * x[5]))
    x = (x[0] + d[0], x[1] + d[1], x[2] + d[2], x[3] + d[3], x[4] + d[4], x[5] + d[5])
    gone = d[0] * b[0] + d[1] * b[1] + d[2] * b[2] + d[3] * b[3] + d[4] * b[4] + d[5] * b[5]
    gone = gone + ridge * (d[3] * x[3] + d[4] * x[4] + d[5] * x[5])
    return x, vmax(left - gone, zeros())


@inline
def _store_normal(plane: Plane, x: Sextuple, sound: Mask, memory: FitBatch16) -> None:
    u, v, n = plane.one, plane.two, plane.normal
    a = n[0] - x[1] * u[0] - x[2] * v[0]
    b = n[1] - x[1] * u[1] - x[2] * v[1]
    c = n[2] - x[1] * u[2] - x[2] * v[2]
    length = ONE / vsqrt(a * a + b * b + c * c)
    slanted = (select(sound, a * length, n[0]), select(sound, b * length, n[1]), select(sound, c * length, n[2]))
    store_triple(memory, NORMAL, slanted)
