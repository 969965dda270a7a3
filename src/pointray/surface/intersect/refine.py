"""Refinement of a bracket to the root of f along a ray (`look_into`): four samples a step, then linear interpolation.

Four rays are processed together: lane 4 s + r holds sample s of ray r; values of a ray are repeated in all quarters.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ...engine.jit import f32, inline
from ...engine.kernels.scratch import Scratch
from ...engine.kernels.tree import REFINE, SURFACE, Tree
from ...engine.simd import (
    F16,
    INF,
    ONE,
    ZERO,
    Bits,
    Mask,
    bits,
    broadcast16,
    last_quarter,
    mask16,
    quarters,
    select,
    shift_quarter,
    sum_over_quarters,
    vmax,
    vmin,
    vsqrt,
)
from .lattice import base_of
from .surface import HALF, TWO, Means, sums, value

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

    x: F16
    y: F16
    z: F16
    dx: F16
    dy: F16
    dz: F16
    base_spacing: F16
    side: F16


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

    nx: F16
    ny: F16
    nz: F16
    away: F16


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
def place(frame: Frame, t: F16, start: F16) -> tuple[F16, F16, F16]:
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
def evaluate(tree: Tree, scratch: Scratch, frame: Frame, t: F16) -> tuple[F16, F16]:
    """Return f at t on the rays, and its slope along them, from the splats listed in `scratch`.

    The sign of both is that of the ray's side (`Frame.side`): f is positive on the side on which the ray starts.
    """
    means = means_at(scratch, frame, t, base_of(t, frame.base_spacing))
    f, _ = value(int(tree.head[SURFACE]), means)
    slope = means.nx * frame.dx + means.ny * frame.dy + means.nz * frame.dz
    return f * frame.side, slope * frame.side


@inline
def crossing(a: F16, b: F16) -> Mask:
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
        fresh = means_at(scratch, frame, t, start)
        f, u4 = value(int(tree.head[SURFACE]), fresh)
        f = f * frame.side + lift
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
        foot = choose(all_samples(fold(line)), _between(foot_of(fresh, u4), line, share), foot)
        step = step + select(go, broadcast16(ONE), none)
    t = select(all_samples(todo), ta + (tb - ta) * share, broadcast16(INF))
    return Root(t, HALF * (fb - fa), all_samples(joined & todo), foot)
