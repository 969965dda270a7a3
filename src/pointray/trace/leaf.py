"""The intersection of a ray with the surface inside of one voxel (paper, part III).

Samples lie on a lattice along the ray, t = k * step, and where the ray enters and leaves the voxel: f there is the
same from both sides but for rounding, so that voxels overlap by OVERLAP. The slab and the tight box only choose which
part of this sequence is looked at; so neither they nor the size of the voxels decide what is found. Four samples are
evaluated at once.

Three things can be between two neighbouring samples that both have support:
- a sign change: a crossing;
- the same sign, but a lowest |f| between them, as the slopes tell: a grazing ray, or one through a crevice, that may
  cross twice; or support that begins or ends close to the surface. Four more samples decide;
- else nothing.

Start rule: a ray that starts within START radii of the surface starts *on* it, on the side that `Ray.side` tells.
Until f has once been on that side it counts as lifted by this much: such a ray is not blocked by the splats around
its origin when it leaves, however flat, and is when it goes to the other side.
"""

from __future__ import annotations

import numpy as np

from ..jit import inline
from ..records import (
    BORDERED,
    CELL,
    COUNT_NEAR,
    COUNT_OWNER,
    COUNT_PART,
    DISC,
    GROUP,
    LEAF,
    LEAST,
    OVERHANG,
    RADIUS,
    REFINE,
    SLAB,
    SLAB_HI,
    SLAB_LO,
    STEP,
    SURFACE,
    TRIM,
    Hit,
)
from ..simd import bits, lane, load16, lowest, pack, quarters, shift_quarter, spread16, store, vabs, vmax, vmin
from .disc import search_discs
from .surface import HALF, NAN, ONE, TWO, ZERO, local_radius, normal, offset, overhang, sums, value

START, START_UNREFINED = np.float32(0.01), np.float32(0.05)  # radii; the latter where refine is 0
BORDER_SHARE = np.float32(0.4)  # of the weight: from here on a hit counts as one on a border
GRAZING = np.float32(0.02)  # radii: how far from zero two tangents may meet and still be looked into
# f jumps where supports end; a crossing counts only where f comes this near to zero (radii).
JUMP, JUMP_UNREFINED = np.float32(0.05), np.float32(0.25)
OVERLAP = np.float32(1e-3)  # radii: without it one in two million rays slips through between two voxels
INF = np.float32(np.inf)
FIRST_LANES = 0x1111  # the first lane of each quarter
# Where the four samples of a secant step lie about the estimate, in lengths of the bracket: close, the next linear
# interpolation is exact to a thousandth of the radius, and two farther out for where the estimate is off.
CLOSE = np.float32(0.02), np.float32(0.12)
EVEN = np.float32(0.1), np.float32(0.3)  # about the middle of the bracket: where there is no estimate
CREVICE = np.float32(0.1)  # radii: how low |f| must be to be looked into without an estimate


@inline
def voxel_interval(tree, leaf, ray):  # type: ignore[no-untyped-def]
    """Where the ray enters and leaves the leaf's voxel, within its own interval."""
    at = leaf * LEAF + CELL
    ax, bx = (tree.leaves[at] - ray.ox) * ray.ix, (tree.leaves[at + 3] - ray.ox) * ray.ix
    ay, by = (tree.leaves[at + 1] - ray.oy) * ray.iy, (tree.leaves[at + 4] - ray.oy) * ray.iy
    az, bz = (tree.leaves[at + 2] - ray.oz) * ray.iz, (tree.leaves[at + 5] - ray.oz) * ray.iz
    enter = max(max(min(ax, bx), min(ay, by)), max(min(az, bz), ray.t_min))
    leave = min(min(max(ax, bx), max(ay, by)), min(max(az, bz), ray.t_max))
    return enter, leave


@inline
def slab_interval(tree, leaf, ray, enter, leave):  # type: ignore[no-untyped-def]
    """The part of an interval inside of the leaf's slab; empty where enter > leave."""
    at = leaf * LEAF
    mx, my, mz = tree.leaves[at + SLAB], tree.leaves[at + SLAB + 1], tree.leaves[at + SLAB + 2]
    height = mx * ray.ox + my * ray.oy + mz * ray.oz
    rise = mx * ray.dx + my * ray.dy + mz * ray.dz
    if abs(rise) < np.float32(1e-6):
        rise = np.float32(1e-6)
    rise = ONE / rise
    a, b = (tree.leaves[at + SLAB_LO] - height) * rise, (tree.leaves[at + SLAB_HI] - height) * rise
    return max(enter, min(a, b)), min(leave, max(a, b))


@inline
def gather_near(tree, leaf, scratch, middle, d, half):  # type: ignore[no-untyped-def]
    """List the leaf's blocks whose bounding sphere is near the segment of half length `half` along d about a point."""
    first, count = tree.spans[2 * leaf], tree.spans[2 * leaf + 1]
    n = 0
    for group in range(first, first + count):
        at = np.int64(group) * GROUP
        x = load16(tree.spheres, at) - middle[0]
        y = load16(tree.spheres, at + 16) - middle[1]
        z = load16(tree.spheres, at + 32) - middle[2]
        along = x * d[0] + y * d[1] + z * d[2]
        beyond = vmax(vabs(along) - half, spread16(ZERO))
        square = x * x + y * y + z * z - along * along + beyond * beyond
        near = square < load16(tree.spheres, at + 48)
        n += pack(near, tree.refs, np.int64(group) * 16, scratch.near, n)
    scratch.counts[COUNT_NEAR], scratch.counts[COUNT_OWNER] = n, -1


@inline
def means_at(tree, scratch, frame, t):  # type: ignore[no-untyped-def]
    """The weighted means at four t: frame is (middle, t, ray)."""
    middle, center, ray = frame
    s = t - center
    return sums(tree, scratch, s * ray.dx + middle[0], s * ray.dy + middle[1], s * ray.dz + middle[2])


@inline
def evaluate(tree, scratch, frame, t):  # type: ignore[no-untyped-def]
    """f, counted positive on the ray's own side, and its slope along the ray, at four t."""
    ray = frame[2]
    means = means_at(tree, scratch, frame, t)
    f, _ = value(int(tree.head[SURFACE]), means)
    slope = means[3] * ray.dx + means[4] * ray.dy + means[5] * ray.dz
    return f * ray.side, slope * ray.side


@inline
def store_means(memory, means):  # type: ignore[no-untyped-def]
    """Keep the means at four samples for `means_between`."""
    store(memory, 0, means[0])
    store(memory, 16, means[1])
    store(memory, 32, means[2])
    store(memory, 48, means[3])
    store(memory, 64, means[4])
    store(memory, 80, means[5])
    store(memory, 96, means[6])
    store(memory, 112, means[7])
    store(memory, 128, means[8])


@inline
def _between(memory, at, share):  # type: ignore[no-untyped-def]
    before = load16(memory, at - 4)
    return before + (load16(memory, at) - before) * share


@inline
def means_between(memory, part, share):  # type: ignore[no-untyped-def]
    """The means between samples part - 1 and part, in the first lane: they are so close that a line will do."""
    at = 4 * part
    return (
        _between(memory, at, share),
        _between(memory, at + 16, share),
        _between(memory, at + 32, share),
        _between(memory, at + 48, share),
        _between(memory, at + 64, share),
        _between(memory, at + 80, share),
        _between(memory, at + 96, share),
        _between(memory, at + 112, share),
        _between(memory, at + 128, share),
    )


@inline
def crossing(a, b):  # type: ignore[no-untyped-def]
    """Whether the sign changes between two values that both exist (zero counts as positive)."""
    return ((a < ZERO) & (b >= ZERO)) | ((a >= ZERO) & (b < ZERO))


@inline
def secant(tree, scratch, frame, bracket, around, spread):  # type: ignore[no-untyped-def]
    """Four samples in a bracket (t, f, t, f), about `around` of its length: the first of the five parts that crosses.

    spread : how far from there the inner and the outer two lie, in lengths of the bracket.

    Returns that part as a bracket, or one whose end is inf if none crosses.
    """
    ta, fa, tb, fb = bracket
    span = tb - ta
    middle = min(max(around, ZERO), ONE)
    t = quarters(
        ta + span * max(middle - spread[1], ZERO),
        ta + span * max(middle - spread[0], ZERO),
        ta + span * min(middle + spread[0], ONE),
        ta + span * min(middle + spread[1], ONE),
    )
    means = means_at(tree, scratch, frame, t)
    store_means(scratch.means, means)
    f, _ = value(int(tree.head[SURFACE]), means)
    f = f * frame[2].side + scratch.lift[0]
    scratch.counts[COUNT_PART] = 0
    before, t_before = shift_quarter(spread16(fa), f), shift_quarter(spread16(ta), t)
    found = bits(crossing(before, f)) & FIRST_LANES
    if found != 0:
        i = lowest(found)
        scratch.counts[COUNT_PART] = i // 4
        return lane(t_before, i), lane(before, i), lane(t, i), lane(f, i)
    last = lane(f, 12)
    if (last < ZERO) != (fb < ZERO):
        return lane(t, 12), last, tb, fb
    return ta, fa, INF, fb


@inline
def root(bracket):  # type: ignore[no-untyped-def]
    """Where the line between a bracket's ends is zero, as a share of its length."""
    return bracket[1] / (bracket[1] - bracket[3])


@inline
def refine(tree, scratch, frame, bracket):  # type: ignore[no-untyped-def]
    """t of the crossing in a bracket, after the model's number of secant steps, and where it is in the last part.

    Where the last step's estimate was off (the crossing is not between its two close samples), one more follows.
    """
    steps = int(tree.head[REFINE])
    scratch.counts[COUNT_PART] = 0
    k, span = 0, bracket[2] - bracket[0]
    while k < steps or (k == steps and bracket[2] - bracket[0] > np.float32(3.0) * CLOSE[0] * span and steps > 0):
        span = bracket[2] - bracket[0]
        bracket = secant(tree, scratch, frame, bracket, root(bracket), CLOSE)
        if bracket[2] == INF:
            return INF, ZERO
        k += 1
    share = root(bracket)
    return bracket[0] + (bracket[2] - bracket[0]) * share, share


@inline
def accept(tree, scratch, frame, leaf, at):  # type: ignore[no-untyped-def]
    """The hit at t, or a miss: f jumps from sign to sign, or the splats' middle is farther than the trim allows."""
    middle, center, ray = frame
    t, share = at
    s = t - center
    x, y, z = s * ray.dx + middle[0], s * ray.dy + middle[1], s * ray.dz + middle[2]
    # Evaluated afresh at every hit: 15% of the time of all.
    part = scratch.counts[COUNT_PART]
    means = means_between(scratch.means, part, share) if part > 0 else means_at(tree, scratch, frame, spread16(t))
    miss = Hit(INF, ZERO, ZERO, ZERO, -1)
    if not lane(means[8], 0) > ZERO:
        return miss
    surface = int(tree.head[SURFACE])
    f, _ = value(surface, means)
    away, gap = offset(means), abs(lane(f, 0)) - scratch.lift[0]
    jump = JUMP if tree.head[REFINE] > ZERO else JUMP_UNREFINED
    # Most hits pass with the least radius of the leaf; the local one costs a second pass over the splats.
    least = tree.leaves[leaf * LEAF + LEAST]
    if away > tree.head[TRIM] * least or gap > jump * least:
        radius = local_radius(tree, scratch, x, y, z)
        if away > tree.head[TRIM] * radius or gap > jump * radius:
            return miss
    if tree.leaves[leaf * LEAF + BORDERED] != ZERO:
        share, out = overhang(tree, scratch, x, y, z)
        if share > BORDER_SHARE and out > tree.head[OVERHANG] * local_radius(tree, scratch, x, y, z):
            return miss
    nx, ny, nz = normal(surface, means)
    return Hit(t, nx, ny, nz, leaf)


@inline
def look_into(tree, scratch, frame, pair, crosses):  # type: ignore[no-untyped-def]
    """`refine` of the first crossing between two samples (t, f, slope, t, f, slope); t is inf if there is none."""
    ta, fa, ga, tb, fb, gb = pair
    bracket = (ta, fa, tb, fb)
    if not crosses:
        if (fa * ga < ZERO) & (fb * gb > ZERO):
            # The slopes' zero, by linear interpolation: the lowest place of a parabola.
            bracket = secant(tree, scratch, frame, bracket, ga / (ga - gb), CLOSE)
        else:
            bracket = secant(tree, scratch, frame, bracket, HALF, EVEN)
        if bracket[2] == INF:
            return INF, ZERO
    return refine(tree, scratch, frame, bracket)


@inline
def search_leaf(tree, leaf, ray, scratch, near, far):  # type: ignore[no-untyped-def]
    """The first hit in a leaf's voxel: near, far is where the ray is inside of the leaf's tight box."""
    enter, leave = voxel_interval(tree, leaf, ray)
    low, high = slab_interval(tree, leaf, ray, max(near, enter), min(far, leave))
    miss = Hit(INF, ZERO, ZERO, ZERO, -1)
    if not (low <= high):
        return miss
    overlap = OVERLAP * tree.leaves[leaf * LEAF + RADIUS]
    enter, leave = max(enter - overlap, ray.t_min), min(leave + overlap, ray.t_max)
    starts = enter <= ray.t_min  # the ray's origin is in this voxel: the start rule needs f there
    if starts:
        low = enter
    step = tree.leaves[leaf * LEAF + STEP]
    # One step more on both sides: a bracket may reach out of the slab.
    # t is never negative here: truncation is the floor (a call to floor would spill every vector register).
    first, last = np.float32(np.int32(low / step)), np.float32(np.int32(high / step) + 1)
    t_low, t_high = max(first * step, enter), min(last * step, leave)
    center = HALF * (t_low + t_high)
    middle = (ray.ox + center * ray.dx, ray.oy + center * ray.dy, ray.oz + center * ray.dz)
    gather_near(tree, leaf, scratch, middle, (ray.dx, ray.dy, ray.dz), HALF * (t_high - t_low))
    if scratch.counts[COUNT_NEAR] == 0:
        return miss
    frame = (middle, center, ray)
    if int(tree.head[SURFACE]) == DISC:
        return search_discs(tree, leaf, scratch, frame, enter, leave)
    # Of the least radius, which does not depend on the size of the voxels.
    margin = GRAZING * tree.leaves[leaf * LEAF + LEAST]
    low_enough = CREVICE * tree.leaves[leaf * LEAF + LEAST]

    t_before = f_before = slope_before = spread16(NAN)
    k = first
    while k <= last:
        t = quarters(k * step, (k + ONE) * step, (k + TWO) * step, (k + np.float32(3.0)) * step)
        t = vmin(vmax(t, spread16(t_low)), spread16(t_high))
        f, slope = evaluate(tree, scratch, frame, t)
        if starts:
            starts = False
            share = START if tree.head[REFINE] > ZERO else START_UNREFINED
            reach = share * tree.leaves[leaf * LEAF + LEAST]
            scratch.lift[0] = reach if abs(lane(f, 0)) < reach else ZERO
        f = f + scratch.lift[0]

        t_a, f_a, slope_a = shift_quarter(t_before, t), shift_quarter(f_before, f), shift_quarter(slope_before, slope)
        change = crossing(f_a, f)
        # A lowest place between them: rare, so that the rest is done only then. One slope tells where |f| changes by
        # less than 3/4 of what it foresees.
        falls, rises = f_a * slope_a < ZERO, f * slope > ZERO
        gain, part = vabs(f) - vabs(f_a), np.float32(0.75) * (t - t_a)
        early, late = falls & (gain > vabs(slope_a) * (ZERO - part)), rises & (gain < vabs(slope) * part)
        # And where support begins or ends between them, close to the surface.
        begins, ends = rises & (vabs(f) < vabs(slope) * (t - t_a)), falls & (vabs(f_a) < vabs(slope_a) * (t - t_a))
        rim = (begins ^ (begins & (f_a * f_a >= ZERO))) | (ends ^ (ends & (f * f >= ZERO)))
        sinks = ((f_a * f > ZERO) & ((falls & rises) | early | late)) | rim
        if bits(sinks) & FIRST_LANES != 0:
            # Both tangents meet below the margin: the lowest place is above theirs where f is convex.
            meet = f_a + slope_a * ((f - f_a - slope * (t - t_a)) / (slope_a - slope))
            graze = falls & rises & ((meet * f < ZERO) | (vabs(meet) < spread16(margin)))
            crevice = (falls ^ rises) & (vmin(vabs(f), vabs(f_a)) < spread16(low_enough))
            sinks = sinks & (graze | crevice | rim)
        changes = bits(change) & FIRST_LANES
        events = changes | (bits(sinks) & FIRST_LANES)
        while events != 0:
            i = lowest(events)
            events &= events - 1
            pair = (lane(t_a, i), lane(f_a, i), lane(slope_a, i), lane(t, i), lane(f, i), lane(slope, i))
            at = look_into(tree, scratch, frame, pair, (changes >> i) & 1 != 0)
            if at[0] < INF:
                hit = accept(tree, scratch, frame, leaf, at)
                if hit.leaf >= 0:
                    return hit
        if scratch.lift[0] != ZERO and bits(f >= scratch.lift[0]) & FIRST_LANES != 0:
            scratch.lift[0] = ZERO
        t_before, f_before, slope_before = t, f, slope
        k += np.float32(4.0)
    return miss
