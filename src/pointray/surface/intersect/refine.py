"""Refinement of a bracket to the root of f along a ray (`look_into`): four samples a step, then linear interpolation.

Four rays are processed together: lane 4 s + r holds sample s of ray r; values of a ray are repeated in all quarters.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...engine.jit import f32, inline
from ...engine.kernels.scratch import Scratch
from ...engine.kernels.tree import REFINE, SURFACE, Tree
from ...engine.simd import (
    F8,
    F16,
    INF,
    ONE,
    ZERO,
    Bits,
    Mask,
    Real,
    bits,
    broadcast16,
    by_width,
    extend_lane,
    extend_quarter,
    last_quarter,
    low_half,
    mask16,
    middle_half,
    outer_half,
    put_around,
    quarters,
    select,
    shift_quarter,
    sum_over_quarters,
    swap_halves,
    vmax,
    vmin,
    vsqrt,
)
from .lattice import base_of
from .surface import HALF, TWO, Means, sums, sums_at_eight, value

# The four samples of a secant step lie around the estimate, at these distances in lengths of the bracket: two so close
# that the next linear interpolation is exact to a thousandth of the radius, and two farther out for wrong estimates.
CLOSE = f32(0.02), f32(0.12)
MORE = f32(3.0)  # additional secant steps if an estimate was off
EVEN = f32(0.1), f32(0.3)  # distances from the middle of the bracket, without an estimate
# The squared length of a mean of unit normals below which rounding decides its direction.
CANCELLED = f32(1e-12)
FAINT = f32(0.1)  # weight (1 in the middle of a splat) below which a sample is at the rim of its supports


class Frame(NamedTuple):
    """Rays in a voxel, in vectors: four rays, with sample s of ray r in lane 4 s + r, or sixteen rays.

    x, y, z : origin; dx, dy, dz : unit direction
    base_spacing : length of ray segments in which positions are relative to the same point, for precision in float32
    side : +1 if a ray that starts on the surface is outside, -1 if it is inside
    """

    x: Real
    y: Real
    z: Real
    dx: Real
    dy: Real
    dz: Real
    base_spacing: Real
    side: Real


class Pair(NamedTuple):
    """Two neighbouring samples of each ray, between which f may be zero: t, f and its slope along the ray.

    ta, fa, slope_a : at the first; tb, fb, slope_b : at the second
    """

    ta: F16
    fa: F16
    slope_a: F16
    tb: F16
    fb: F16
    slope_b: F16


class Foot(NamedTuple):
    """Unnormalized normal at a root of f and its distance from the splats, which decide whether the root is a hit.

    nx, ny, nz : direction in which f rises, not of unit length
    away : squared distance of the root from the mean centre of the splats around it
    """

    nx: Real
    ny: Real
    nz: Real
    away: Real


class Values(NamedTuple):
    """f at samples of rays, with the sign of the ray's side; the foot there (`foot_of`), and the sum of weights."""

    f: Real
    foot: Foot
    weight: Real


class Root(NamedTuple):
    """A root of f between two samples of each of four rays.

    t : t of the root, inf for none; rise : half of the rise of f over the last interval around the root
    joined : mask of the rays for which `foot` is known, interpolated between two close samples
    foot : unnormalized normal at the root, and its squared distance from the mean centre of the splats; they decide
        whether the root is a hit
    """

    t: F16
    rise: F16
    joined: Mask
    foot: Foot


@inline
def fold(word: Bits) -> Bits:
    """Return the rays with a bit in any of their samples, 4 bits. word : 16 bits, sample s of ray r at 4 s + r"""
    return (word | (word >> 4) | (word >> 8) | (word >> 12)) & 15


@inline
def all_samples(rays: Bits) -> Mask:
    """Return the mask of all samples of the given rays (4 bits): sample s of ray r is lane 4 s + r."""
    return mask16(rays * 0x1111)


@inline
def first_samples(word: Bits) -> Bits:
    """Keep, for each ray, only the bit of its first sample. word : 16 bits, sample s of ray r at 4 s + r"""
    seen = word | (word << 4)
    seen |= seen << 8
    return word & ~(seen << 4) & 0xFFFF


@inline
def sample(vector: F16, one: Mask) -> F16:
    """Repeat the selected sample of each of four rays in all four lanes of the ray; 0 for rays without one.

    one : mask of the selected lanes, at most one for each ray; sample s of ray r is in lane 4 s + r
    """
    return sum_over_quarters(select(one, vector, broadcast16(ZERO)))


@inline
def place(frame: Frame, t: Real, start: Real) -> tuple[Real, Real, Real]:
    """Return the points at t on the rays, as vectors x, y, z.

    start : t of a base point on each ray nearby; positions are computed relative to it, which is precise in float32
    """
    x, y, z = start * frame.dx + frame.x, start * frame.dy + frame.y, start * frame.dz + frame.z
    s = t - start
    return s * frame.dx + x, s * frame.dy + y, s * frame.dz + z


@inline
def means_at(scratch: Scratch, frame: Frame, t: F16, start: F16) -> Means:
    """Return the weighted means over the splats listed in `scratch` at points t on the rays, from which f is computed.

    start : t of a base point on each ray nearby; positions are computed relative to it, which is precise in float32
    """
    x, y, z = place(frame, t, start)
    return sums(scratch, x, y, z)


@inline
def _along(frame: Frame, means: Means, surface: int) -> tuple[Real, Real]:
    """Return f from the means at points on rays, and its slope along them, both with the sign of the ray's side."""
    f, _ = value(surface, means)
    slope = means.nx * frame.dx + means.ny * frame.dy + means.nz * frame.dz
    return f * frame.side, slope * frame.side


@inline
def evaluate(tree: Tree, scratch: Scratch, frame: Frame, t: F16) -> tuple[F16, F16]:
    """Return f at t on the rays, and its slope along them, from the splats listed in `scratch`.

    The sign of both is that of the ray's side (`Frame.side`): f is positive on the side on which the ray starts.
    """
    means = means_at(scratch, frame, t, base_of(t, frame.base_spacing))
    return _along(frame, means, int(tree.head[SURFACE]))


@inline
def _halved(frame: Frame) -> Frame:
    """Return the first half of the lanes of a frame. With four rays, all quarters are equal."""
    return Frame(
        low_half(frame.x),
        low_half(frame.y),
        low_half(frame.z),
        low_half(frame.dx),
        low_half(frame.dy),
        low_half(frame.dz),
        low_half(frame.base_spacing),
        low_half(frame.side),
    )


@inline
def _evaluate_eight(tree: Tree, scratch: Scratch, frame: Frame, t: F16) -> tuple[F8, F8]:
    """Return what `evaluate` does in the first eight lanes."""
    half = _halved(frame)
    x, y, z = place(half, low_half(t), base_of(low_half(t), half.base_spacing))
    return _along(half, sums_at_eight(scratch, x, y, z), int(tree.head[SURFACE]))


@inline
def _evaluate_all(tree: Tree, scratch: Scratch, frame: Frame, t: F16, few: bool) -> tuple[F16, F16]:
    """Return what `evaluate` does."""
    return evaluate(tree, scratch, frame, t)


@inline
def _evaluate_two(tree: Tree, scratch: Scratch, frame: Frame, t: F16, few: bool) -> tuple[F16, F16]:
    """Return what `evaluate` does for four samples of four rays; if `few`, t does not change after the second."""
    if not few:
        return evaluate(tree, scratch, frame, t)
    f, slope = _evaluate_eight(tree, scratch, frame, t)
    return extend_quarter(f), extend_quarter(slope)


@inline
def _evaluate_half(tree: Tree, scratch: Scratch, frame: Frame, t: F16, few: bool) -> tuple[F16, F16]:
    """Return what `evaluate` does for sixteen samples of one ray; if `few`, t does not change after the eighth."""
    if not few:
        return evaluate(tree, scratch, frame, t)
    f, slope = _evaluate_eight(tree, scratch, frame, t)
    return extend_lane(f), extend_lane(slope)


# `evaluate` without those samples that are equal. Where one register holds all sixteen this saves nothing.
evaluate_four_rays = by_width(_evaluate_all, _evaluate_two, _evaluate_two)
evaluate_one_ray = by_width(_evaluate_all, _evaluate_half, _evaluate_half)


@inline
def crossing(a: Real, b: Real) -> Mask:
    """Return whether the signs of two values differ: zero counts as positive, and NaN has no sign."""
    return ((a < ZERO) & (b >= ZERO)) | ((a >= ZERO) & (b < ZERO))


@inline
def foot_of(means: Means, u4: F16) -> Foot:
    """Return at sixteen points the direction in which f rises, and the squared distance from the splats' mean centre.

    Where a point is a root of f, these decide whether it is a hit, and give its normal.

    means : weighted means over the splats near each point, of their positions, normals and products of these
    u4 : curvature term of the fitted sphere, 0 except for apss
    """
    bend = TWO * u4
    return Foot(
        means.nx - bend * means.qx,
        means.ny - bend * means.qy,
        means.nz - bend * means.qz,
        means.qx * means.qx + means.qy * means.qy + means.qz * means.qz,
    )


@inline
def unit(foot: Foot) -> tuple[tuple[F16, F16, F16], Mask]:
    """Return unit normals at roots of f, and a mask of where they exist: not where normals cancel or are NaN.

    foot : direction in which f rises at each root, not of unit length (its squared distance is not used)
    """
    square = foot.nx * foot.nx + foot.ny * foot.ny + foot.nz * foot.nz
    scale = ONE / vsqrt(square)
    return (foot.nx * scale, foot.ny * scale, foot.nz * scale), (square > CANCELLED) & (square < INF)


@inline
def _between(foot: Foot, after: Any, share: F16) -> Foot:
    """Interpolate normal and squared distance from the splats at a root of f between two successive samples of a ray.

    foot : these values at all samples of four rays, sample s of ray r in lane 4 s + r
    after : bits of the second samples, at most one for each ray; a ray without a bit gets zeros
    share : position of the root, 0 at the first sample, 1 at the second
    """
    before, after = mask16(after >> 4), mask16(after)
    nothing = broadcast16(ZERO)
    weight, both = select(after, share, ONE - share), before | after
    return Foot(
        sum_over_quarters(select(both, foot.nx * weight, nothing)),
        sum_over_quarters(select(both, foot.ny * weight, nothing)),
        sum_over_quarters(select(both, foot.nz * weight, nothing)),
        sum_over_quarters(select(both, foot.away * weight, nothing)),
    )


@inline
def choose(mask: Mask, a: Foot, b: Foot) -> Foot:
    """Return, lane by lane, normal and squared distance from the splats at roots of f: `a` in the mask, else `b`."""
    return Foot(
        select(mask, a.nx, b.nx), select(mask, a.ny, b.ny), select(mask, a.nz, b.nz), select(mask, a.away, b.away)
    )


@inline
def _four_t(ta: F16, tb: F16, around: F16, inner: F16, outer: F16) -> F16:
    """Return four t for each ray, within its interval from ta to tb, at which f is evaluated next.

    around : place in the interval to search around, 0 at ta to 1 at tb
    inner, outer : distances from there, on both sides, of the two nearer and the two farther t, in interval lengths
    """
    near = mask16(0x0FF0)
    sign = quarters(-ONE, -ONE, ONE, ONE)
    share = vmin(vmax(around, broadcast16(ZERO)), broadcast16(ONE)) + sign * select(near, inner, outer)
    return ta + (tb - ta) * vmin(vmax(share, broadcast16(ZERO)), broadcast16(ONE))


@inline
def _values(surface: int, frame: Frame, means: Means, lift: Real) -> Values:
    """Return f at some points on rays, and what decides whether they are hits, from the means over the splats there."""
    f, u4 = value(surface, means)
    return Values(f * frame.side + lift, foot_of(means, u4), means.weight)


@inline
def _at_four(tree: Tree, scratch: Scratch, frame: Frame, t: F16, start: F16, lift: F16, fa: F16, doing: Bits) -> Values:
    """Evaluate f at four samples of each of four rays."""
    return _values(int(tree.head[SURFACE]), frame, means_at(scratch, frame, t, start), lift)


@inline
def _at_two(tree: Tree, scratch: Scratch, frame: Frame, t: F16, start: F16, lift: F16, fa: F16, doing: Bits) -> Values:
    """Evaluate f at the second and third of four samples first; if it changes sign between them, that is all.

    The first and the last sample then get the values of their neighbours, as if f did not change sign there.

    fa : f at the beginning of the interval; doing : bits of the samples of rays that count
    """
    half, surface = _halved(frame), int(tree.head[SURFACE])
    start, lift = low_half(start), low_half(lift)
    x, y, z = place(half, middle_half(t), start)
    middle = outer = _values(surface, half, sums_at_eight(scratch, x, y, z), lift)
    before, after = bits(crossing(low_half(fa), middle.f)), bits(crossing(middle.f, swap_halves(middle.f)))
    if (before | ~after) & doing & 15 != 0:
        x, y, z = place(half, outer_half(t), start)
        outer = _values(surface, half, sums_at_eight(scratch, x, y, z), lift)
    foot = Foot(
        put_around(outer.foot.nx, middle.foot.nx),
        put_around(outer.foot.ny, middle.foot.ny),
        put_around(outer.foot.nz, middle.foot.nz),
        put_around(outer.foot.away, middle.foot.away),
    )
    return Values(put_around(outer.f, middle.f), foot, put_around(outer.weight, middle.weight))


_evaluate_around = by_width(_at_four, _at_two, _at_two)


@inline
def look_into(tree: Tree, scratch: Scratch, frame: Frame, pair: Pair, crosses: Mask, todo: Bits, lift: F16) -> Root:
    """Find the first zero of f between two samples of each of four rays, with the model's number of secant steps.

    pair : the two samples of each ray; todo : 4 bits, the rays to search for
    crosses : mask of the rays whose two samples have different signs; for the others four samples between them look for
        a change of sign first
    lift : constant that is added to f of rays that start on the surface (start rule)

    A step evaluates four samples around the estimate of the zero; the first interval between them with a change of
    sign comes next. Where an estimate was off (the zero is not between the two close samples), up to three more steps
    follow. With one more, up to 17 of 1.4 million rays on a scan ended more than 2% of the radius apart in different
    trees; with three, none did on ten of twelve scans, and 7 did on the noisiest.
    """
    ta, fa, tb, fb = pair.ta, pair.fa, pair.tb, pair.fb
    steps = tree.head[REFINE]
    most = steps + MORE if steps > ZERO else ZERO
    inner, outer, step, share = broadcast16(CLOSE[0]), broadcast16(CLOSE[1]), broadcast16(ZERO), fa / (fa - fb)
    if bits(crosses) & todo != todo:
        # Without a crossing: the zero of the slope by linear interpolation (a parabola's minimum), or evenly spaced.
        grazes = (fa * pair.slope_a < ZERO) & (fb * pair.slope_b > ZERO)
        estimate = select(grazes, pair.slope_a / (pair.slope_a - pair.slope_b), broadcast16(HALF))
        wide = mask16(bits(crosses | grazes) ^ 0xFFFF)
        inner, outer = select(wide, broadcast16(EVEN[0]), inner), select(wide, broadcast16(EVEN[1]), outer)
        step, share = select(crosses, step, broadcast16(-ONE)), select(crosses, share, estimate)
    span, start = tb - ta, base_of(ta, frame.base_spacing)
    none = broadcast16(ZERO)
    foot = Foot(none, none, none, none)
    joined = 0
    while True:
        go = (step < steps) | ((step < most) & (tb - ta > f32(3.0) * CLOSE[0] * span))
        doing = bits(go) & (todo * 0x1111)
        if doing == 0:
            break
        go = mask16(doing)
        t = _four_t(ta, tb, share, inner, outer)
        inner, outer = broadcast16(CLOSE[0]), broadcast16(CLOSE[1])
        fresh = _evaluate_around(tree, scratch, frame, t, start, lift, fa, doing)
        f = fresh.f
        before, t_before = shift_quarter(fa, f), shift_quarter(ta, t)
        one = first_samples(bits(crossing(before, f)) & doing)
        part = mask16(one)
        found = fold(one)
        # No crossing up to the last sample: it lies behind that sample, or nowhere.
        last = last_quarter(f)
        behind = bits((last < ZERO) ^ (fb < ZERO)) & doing & ~(found * 0x1111)
        here, rest = all_samples(found), mask16(behind)
        span = select(go & (step >= ZERO), tb - ta, span)
        ta = select(here, sample(t_before, part), select(rest, last_quarter(t), ta))
        fa = select(here, sample(before, part), select(rest, last, fa))
        tb, fb = select(here, sample(t, part), tb), select(here, sample(f, part), fb)
        span = select(go & (step < ZERO), tb - ta, span)
        todo &= ~(fold(doing) & ~found & ~fold(behind))
        share = fa / (fa - fb)
        # The foot is interpolated between two close samples too, which saves 15% of the time. Where supports begin and
        # end it is evaluated instead.
        firm = (fresh.weight > FAINT) & (shift_quarter(none, fresh.weight) > FAINT)
        line = one & bits(firm)
        joined = (joined & ~fold(doing)) | fold(line)
        foot = choose(all_samples(fold(line)), _between(fresh.foot, line, share), foot)
        step = step + select(go, broadcast16(ONE), none)
    t = select(all_samples(todo), ta + (tb - ta) * share, broadcast16(INF))
    return Root(t, HALF * (fb - fa), all_samples(joined & todo), foot)
