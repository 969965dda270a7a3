"""The intersection of a ray with the surface inside of one voxel (paper, part III).

Samples lie on a lattice along the ray, t = k * step, from the last one before the voxel to the first one behind it.
The voxel, the slab and the tight box only choose which part of this sequence is looked at; so neither they nor the
size of the voxels decide what is found. Four samples are evaluated at once.

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
from ..records import BORDERED, DISC, LEAF, LEAST, OVERHANG, REFINE, SHEETED, STEP, SURFACE, TRIM, Hit
from ..scratch import COUNT_NEAR, COUNT_PART
from ..simd import bits, lane, lowest, quarters, shift_quarter, spread16, vabs, vmax, vmin
from .disc import search_discs
from .near import gather_near, keep_sheet
from .root import FIRST_LANES, INF, crossing, evaluate, least_weight, look_into, means_at, means_between
from .surface import HALF, NAN, ONE, TWO, ZERO, local_radius, normal, offset, overhang, value

START, START_UNREFINED = np.float32(0.01), np.float32(0.05)  # radii; the latter where refine is 0
BORDER_SHARE = np.float32(0.4)  # of the weight: from here on a hit counts as one on a border
GRAZING = np.float32(0.02)  # radii: how far from zero two tangents may meet and still be looked into
# f jumps where supports end; a crossing counts only where f comes this near to zero (radii).
JUMP, JUMP_UNREFINED = np.float32(0.05), np.float32(0.25)
MOST_STEPS = np.float32(2.0**22)  # from where a ray enters the model's bounds
FAINT = np.float32(0.1)  # the weight, of 1 in the middle of a splat, below which a sample is at the rim of its supports
CREVICE = np.float32(0.1)  # radii: how low |f| must be to be looked into without an estimate


@inline
def accept(tree, scratch, frame, leaf, at, way):  # type: ignore[no-untyped-def]
    """The hit at t, or a miss: f jumps from sign to sign, or the splats' middle is farther than the trim allows.

    way : 1, -1 where only a side is sought that faces the ray, or faces away; else 0
    """
    middle, center, ray = frame
    t, share, rise = at
    s = t - center
    x, y, z = s * ray.dx + middle[0], s * ray.dy + middle[1], s * ray.dz + middle[2]
    # Evaluated afresh at every hit: 15% of the time of all. But no line joins samples where supports begin and end.
    part = scratch.counts[COUNT_PART]
    joined = part > 0 and least_weight(scratch.means, part) > FAINT
    means = means_between(scratch.means, part, share) if joined else means_at(tree, scratch, frame, spread16(t))
    miss = Hit(INF, ZERO, ZERO, ZERO, -1)
    if not lane(means[8], 0) > ZERO or way * rise * ray.side > ZERO:
        return miss
    surface = int(tree.head[SURFACE])
    f, _ = value(surface, means)
    away, gap = offset(means), abs(rise) if joined else abs(lane(f, 0)) - scratch.lift[0]
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
def search_leaf(tree, leaf, ray, scratch, interval):  # type: ignore[no-untyped-def]
    """The first hit in a leaf's voxel.

    Where two sheets are close together their normals cancel, and a step may pass both. So of those the ones that face
    the ray are searched first and then those that face away, each as if the others were not there.
    interval : where the ray enters and leaves the voxel, and the part in which the surface can be (tight box, slab)
    """
    way, lift = (ONE if tree.leaves[leaf * LEAF + SHEETED] != ZERO else ZERO), scratch.lift[0]
    hit, lifted = Hit(INF, ZERO, ZERO, ZERO, -1), ZERO
    while True:
        scratch.lift[0] = lift
        found = _search(tree, leaf, ray, scratch, interval, way)
        lifted = max(lifted, scratch.lift[0])
        if found.t < hit.t:
            hit = found
        if not way > ZERO:
            scratch.lift[0] = lifted
            return hit
        way = -ONE


@inline
def _search(tree, leaf, ray, scratch, interval, way):  # type: ignore[no-untyped-def]
    """The first hit in a leaf's voxel; way : 1, -1 for the sheets that face the ray or face away, 0 for all."""
    enter, leave, low, high = interval
    miss = Hit(INF, ZERO, ZERO, ZERO, -1)
    if enter <= ray.t_min:  # the ray's origin is in this voxel: the start rule needs f there
        low = ray.t_min
    step = tree.leaves[leaf * LEAF + STEP]
    if not high < MOST_STEPS * step:  # float32 does not tell the samples apart any more
        return miss
    # The lattice's next samples on both sides, out of the slab and out of the voxel: see `tree/cells.py`.
    # t is never negative here: truncation is the floor (a call to floor would spill every vector register).
    first, last = np.float32(np.int32(low / step)), np.float32(np.int32(high / step) + 1)
    t_low, t_high = max(first * step, ray.t_min), min(last * step, ray.t_max)
    starts = t_low == ray.t_min
    center = HALF * (t_low + t_high)
    middle = (ray.ox + center * ray.dx, ray.oy + center * ray.dy, ray.oz + center * ray.dz)
    gather_near(tree, leaf, scratch, middle, (ray.dx, ray.dy, ray.dz), HALF * (t_high - t_low))
    if way != ZERO:
        keep_sheet(tree, scratch, (way * ray.dx, way * ray.dy, way * ray.dz))
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
                hit = accept(tree, scratch, frame, leaf, at, way)
                if hit.leaf >= 0:
                    return hit
        if scratch.lift[0] != ZERO and bits(f >= scratch.lift[0]) & FIRST_LANES != 0:
            scratch.lift[0] = ZERO
        t_before, f_before, slope_before = t, f, slope
        k += np.float32(4.0)
    return miss
