"""The intersection of rays with the surface inside of one voxel (paper, part III).

Samples lie on a lattice along each ray, t = k * step, from the last one before the voxel to the first one behind it.
The voxel, the slab and the tight box only choose which part of this sequence is looked at; so neither they nor the
size of the voxels decide what is found. Four samples of four rays are evaluated at once (lane 4 s + r: sample s of
ray r): neighbouring rays see the same splats, which are listed once for all four. A ray's hits do not depend on the
other three: splats that are not over its samples have no weight there.

Three things can be between two neighbouring samples that both have support:
- a sign change: a crossing;
- the same sign, but a lowest |f| between them, as the slopes tell: a grazing ray, or one through a crevice, that may
  cross twice; or support that begins or ends close to the surface. Four more samples decide;
- else nothing.

Start rule: a ray that starts within START radii of the surface starts *on* it, on the side that `Frame.side` tells.
Until f has once been on that side it counts as lifted by this much: such a ray is not blocked by the splats around
its origin when it leaves, however flat, and is when it goes to the other side. A ray that a clip plane cuts begins on
no surface: it has its first sample just behind 0.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..jit import inline
from ..records import BORDERED, LEAF, LEAST, OVERHANG, REFINE, STEP, SURFACE, TRIM
from ..scratch import COUNT_SPLATS
from ..simd import (
    bits,
    first_quarter,
    fours,
    lane,
    lowest,
    mask16,
    quarters,
    select,
    shift_lane,
    shift_quarter,
    spread16,
    vabs,
    vmax,
    vmin,
    vsqrt,
    whole,
)
from .root import (
    Pair,
    all_samples,
    choose,
    crossing,
    evaluate,
    first_samples,
    fold,
    foot_of,
    look_into,
    means_at,
    sample,
    unit,
)
from .surface import INF, NAN, ONE, ZERO, local_radius, overhang, value

START, START_UNREFINED = np.float32(0.01), np.float32(0.05)  # radii; the latter where refine is 0
BORDER_SHARE = np.float32(0.4)  # of the weight: from here on a hit counts as one on a border
GRAZING = np.float32(0.02)  # radii: how far from zero two tangents may meet and still be looked into
# f jumps where supports end; a crossing counts only where f comes this near to zero (radii).
JUMP, JUMP_UNREFINED = np.float32(0.05), np.float32(0.25)
MOST_STEPS = np.float32(2.0**22)  # from where a ray enters the model's bounds
CREVICE = np.float32(0.1)  # radii: how low |f| must be to be looked into without an estimate


class Reach(NamedTuple):
    """Which samples of rays are looked at: numbers of the first and the last, and where the rays begin and end."""

    first: Any
    last: Any
    t_low: Any
    t_high: Any


class Found(NamedTuple):
    """First hits in a voxel: t (inf: none), unit normal, and what the start rule has lifted the ray by (0: not)."""

    t: Any
    nx: Any
    ny: Any
    nz: Any
    lift: Any


@inline
def lattice(tree, leaf, interval, ends):  # type: ignore[no-untyped-def]
    """Which samples are looked at, and a mask of the rays that can tell them apart in float32.

    interval : where the rays enter the voxel, and the part in which the surface can be (tight box, slab)
    ends : where the rays begin (0, or just above where the start rule does not count) and end
    The lattice's next samples on both sides, out of the slab and out of the voxel: see `tree/cells.py`.
    """
    (enter, low, high), (begin, end) = interval, ends
    step = tree.leaves[leaf * LEAF + STEP]
    fine = high < MOST_STEPS * step
    # Where the origin is in this voxel the start rule needs f there.
    low = select(fine & (enter > begin), low, spread16(ZERO))
    high = select(fine, high, spread16(ZERO))
    # t is never negative here: truncation is the floor.
    first, last = whole(low / step), whole(high / step) + ONE
    return Reach(first, last, vmax(first * step, begin), vmin(last * step, end)), fine


@inline
def accept(tree, scratch, frame, leaf, root, limits):  # type: ignore[no-untyped-def]
    """Which rays hit at their roots, and the normals there. f may jump from sign to sign, or P be beyond the trim.

    limits : 1, -1 where only a side is sought that faces the rays, or faces away, else 0; and what f is lifted by
    """
    way, lift = limits
    asked = bits(root.t < INF)
    joined, foot, gap = root.joined, root.foot, vabs(root.rise)
    good = asked
    if bits(joined) & asked != asked:
        means = means_at(scratch, frame, root.t)
        f, u4 = value(int(tree.head[SURFACE]), means)
        foot, gap = choose(joined, foot, foot_of(means, u4)), select(joined, gap, vabs(f) - lift)
        good &= bits(joined | (means.weight > ZERO))
    if way != ZERO:
        good &= bits(way * root.rise * frame.side <= ZERO)
    away = vsqrt(foot.away)
    jump = JUMP if tree.head[REFINE] > ZERO else JUMP_UNREFINED
    trim = tree.head[TRIM]
    s = root.t - frame.center
    x, y, z = s * frame.dx + frame.x, s * frame.dy + frame.y, s * frame.dz + frame.z
    # Most hits pass with the least radius of the leaf; the local one costs a second pass over the splats.
    least = spread16(tree.leaves[leaf * LEAF + LEAST])
    over = bits((away > trim * least) | (gap > jump * least)) & good
    border = tree.leaves[leaf * LEAF + BORDERED] != ZERO
    if over != 0 or border:
        radius = local_radius(scratch, x, y, z)
        good &= ~bits((away > trim * radius) | (gap > jump * radius))
        if border:
            share, out = overhang(tree, scratch, x, y, z)
            good &= ~bits((share > BORDER_SHARE) & (out > tree.head[OVERHANG] * radius))
    nx, ny, nz = unit(foot)
    return fold(good), nx, ny, nz


@inline
def _events(tree, leaf, a, b):  # type: ignore[no-untyped-def]
    """Where there is a crossing, and where something else may be, between samples (t, f, slope) and those before."""
    (t_a, f_a, slope_a), (t, f, slope) = a, b
    changes = bits(crossing(f_a, f))
    # A lowest place between them: rare, so that the rest is done only then. One slope tells where |f| changes by
    # less than 3/4 of what it foresees.
    falls, rises = f_a * slope_a < ZERO, f * slope > ZERO
    gain, part = vabs(f) - vabs(f_a), np.float32(0.75) * (t - t_a)
    early, late = falls & (gain > vabs(slope_a) * (ZERO - part)), rises & (gain < vabs(slope) * part)
    # And where support begins or ends between them, close to the surface.
    begins, ends = rises & (vabs(f) < vabs(slope) * (t - t_a)), falls & (vabs(f_a) < vabs(slope_a) * (t - t_a))
    rim = (begins ^ (begins & (f_a * f_a >= ZERO))) | (ends ^ (ends & (f * f >= ZERO)))
    sinks = ((f_a * f > ZERO) & ((falls & rises) | early | late)) | rim
    if bits(sinks) != 0:
        # Of the least radius, which does not depend on the size of the voxels.
        least = tree.leaves[leaf * LEAF + LEAST]
        # Both tangents meet below the margin: the lowest place is above theirs where f is convex.
        meet = f_a + slope_a * ((f - f_a - slope * (t - t_a)) / (slope_a - slope))
        graze = falls & rises & ((meet * f < ZERO) | (vabs(meet) < spread16(GRAZING * least)))
        crevice = (falls ^ rises) & (vmin(vabs(f), vabs(f_a)) < spread16(CREVICE * least))
        sinks = sinks & (graze | crevice | rim)
    return changes, bits(sinks)


@inline
def _lift_of(tree, leaf, f):  # type: ignore[no-untyped-def]
    """What the start rule lifts rays by that have f where they start."""
    share = START if tree.head[REFINE] > ZERO else START_UNREFINED
    reach = spread16(share * tree.leaves[leaf * LEAF + LEAST])
    return select(vabs(f) < reach, reach, spread16(ZERO))


@inline
def _pair(before, after, one):  # type: ignore[no-untyped-def]
    """The samples (t, f, slope) that a mask with one lane a ray names, and those before them."""
    (t_a, f_a, slope_a), (t, f, slope) = before, after
    return Pair(
        sample(t_a, one),
        sample(f_a, one),
        sample(slope_a, one),
        sample(t, one),
        sample(f, one),
        sample(slope, one),
    )


@inline
def search(tree, leaf, frame, reach, rays, limits, scratch):  # type: ignore[no-untyped-def]
    """First hits of four rays in a leaf's voxel, from the listed splats.

    rays : 4 bits, those that are asked for
    limits : 1, -1 for the sheets that face the rays or face away, 0 for all; and what the start rule has lifted f by
    """
    way, lift = limits
    none = spread16(ZERO)
    t_hit, nx, ny, nz = spread16(INF), none, none, none
    step = tree.leaves[leaf * LEAF + STEP]
    starts = bits(reach.t_low <= ZERO)
    t_before = f_before = slope_before = spread16(NAN)
    k = reach.first + quarters(ZERO, ONE, np.float32(2.0), np.float32(3.0))
    left = rays if scratch.counts[COUNT_SPLATS] > 0 else 0
    while left != 0:
        t = vmin(vmax(k * step, reach.t_low), reach.t_high)
        f, slope = evaluate(tree, scratch, frame, t)
        if starts != 0:
            lift = select(mask16(starts), _lift_of(tree, leaf, first_quarter(f)), lift)
            starts = 0
        f = f + lift

        before = shift_quarter(t_before, t), shift_quarter(f_before, f), shift_quarter(slope_before, slope)
        after = t, f, slope
        changes, sinks = _events(tree, leaf, before, after)
        events = (changes | sinks) & (left * 0x1111)
        while events != 0:
            now = first_samples(events)
            events &= ~now
            one = mask16(now)
            pair = _pair(before, after, one)
            crosses = all_samples(fold(now & changes))
            root = look_into(tree, scratch, frame, pair, crosses, fold(now), lift)
            if bits(root.t < INF) != 0:
                good, mx, my, mz = accept(tree, scratch, frame, leaf, root, (way, lift))
                if good != 0:
                    here = all_samples(good)
                    t_hit = select(here, root.t, t_hit)
                    nx, ny, nz = select(here, mx, nx), select(here, my, ny), select(here, mz, nz)
                    left &= ~good
                    events &= ~(good * 0x1111)
        settled = fold(bits(f >= lift)) & left
        lift = select(all_samples(settled), none, lift)
        t_before, f_before, slope_before = t, f, slope
        k = k + np.float32(4.0)
        left &= bits(k <= reach.last)
    return Found(t_hit, nx, ny, nz, lift)


@inline
def search_one(tree, leaf, frame, reach, limits, scratch):  # type: ignore[no-untyped-def]
    """The same of one ray, which all lanes hold, as numbers: lane s is sample s, sixteen at once.

    Four at once, the ray in every quarter, bounces took 1.37 times as long at 32,000 points, at scans 1.1 to 1.3.
    """
    way, lift = limits
    none = spread16(ZERO)
    step = tree.leaves[leaf * LEAF + STEP]
    starts, last = lane(reach.t_low, 0) <= ZERO, lane(reach.last, 0)
    t_before = f_before = slope_before = spread16(NAN)
    two, three, four = np.float32(2.0), np.float32(3.0), np.float32(4.0)
    k = reach.first + (four * quarters(ZERO, ONE, two, three) + fours(ZERO, ONE, two, three))
    while True:
        t = vmin(vmax(k * step, reach.t_low), reach.t_high)
        f, slope = evaluate(tree, scratch, frame, t)
        if starts:
            lift = _lift_of(tree, leaf, spread16(lane(f, 0)))
            starts = False
        # Up to the quarter in which f is first on the ray's side.
        settled = bits(f + lift >= lift)
        lifted = select(mask16((16 << (lowest(settled) & 12)) - 1 if settled != 0 else 0xFFFF), lift, none)
        f = f + lifted

        before = shift_lane(t_before, t), shift_lane(f_before, f), shift_lane(slope_before, slope)
        after = t, f, slope
        changes, sinks = _events(tree, leaf, before, after)
        events = changes | sinks
        while events != 0:
            now = events & -events
            events &= events - 1
            here = mask16(now)
            pair = _pair(before, after, here)
            raised = sample(lifted, here)
            root = look_into(tree, scratch, frame, pair, all_samples(fold(now & changes)), fold(now), raised)
            if bits(root.t < INF) != 0:
                good, nx, ny, nz = accept(tree, scratch, frame, leaf, root, (way, raised))
                if good != 0:
                    i = lowest(good)
                    return Found(lane(root.t, i), lane(nx, i), lane(ny, i), lane(nz, i), lane(raised, i))
        lift = none if settled != 0 else lift
        t_before, f_before, slope_before = t, f, slope
        k = k + np.float32(16.0)
        if not lane(k, 0) <= last:
            return Found(INF, ZERO, ZERO, ZERO, lane(lift, 0))
