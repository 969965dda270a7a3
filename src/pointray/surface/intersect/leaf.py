"""Search of one leaf for the first hits of one ray, or of rays of a tile, including the lists of splats near them."""

from __future__ import annotations

from ...engine.jit import Array, i64, inline
from ...engine.kernels import scratch as sc
from ...engine.kernels.scratch import Scratch
from ...engine.kernels.tree import DISC, LEAF, SHEETED, SURFACE, Hit, Ray, Tree
from ...engine.simd import (
    INF,
    ONE,
    ZERO,
    Bits,
    Real,
    bits,
    broadcast16,
    count_bits,
    count_trailing_zeros,
    lane,
    load16,
    load_register,
    mask16,
    mask_register,
    number_like,
    register_lanes,
    repeat4,
    select,
    store_packed,
)
from .columns import Along, Axes, axes_of, narrow, narrow_one
from .disc import search_discs
from .gather import around, gather, keep_sheet, list_blocks, list_splats, list_splats_of, lists_sheets, segment
from .lattice import SampleRange, base_spacing, sample_range, span
from .march import Found, Lift, search, search_one
from .refine import Frame
from .surface import HALF

BEYOND = i64(-(2**63))  # a bit beyond those of all rays but the last one; read where no ray is left


@inline
def together(tree: Tree) -> bool:
    """Return whether leaves of a tree are searched for several rays together: not for surfaces of discs."""
    return int(tree.head[SURFACE]) != DISC


@inline
def search_alone(
    tree: Tree, leaf: int, ray: Ray, interval: tuple[float, float, float, float], lift: Lift, scratch: Scratch
) -> tuple[Hit, Lift]:
    """Find the first hit of a ray in a leaf's voxel; return the hit, and the lift after the search (start rule).

    interval : (enter, leave, low, high), t where the ray enters and leaves the voxel, and between which (low, high) the
        surface can be
    lift : the lift so far

    Where two sheets are close together their normals cancel, and one step may cross both. So the sheets that face the
    ray are searched first, and then those that face away, each as if the others did not exist.
    """
    enter, leave, low, high = interval
    hit, height, end = Hit(INF, ZERO, ZERO, ZERO, -1), ZERO, ZERO
    o, d, inverse = (ray.ox, ray.oy, ray.oz), (ray.dx, ray.dy, ray.dz), (ray.ix, ray.iy, ray.iz)
    u, v, w = axes = axes_of(tree, leaf)
    along = (o[u], o[v], o[w]), (d[u], d[v], d[w]), (inverse[u], inverse[v])
    low, high = narrow_one(tree, leaf, axes, along, (low, high))
    if not low <= high:
        return hit, lift
    sampled, fine = sample_range(
        tree, leaf, (broadcast16(enter), broadcast16(low), broadcast16(high)), broadcast16(ray.t_min)
    )
    if bits(fine) == 0:
        return hit, lift
    first, last = span(tree, leaf, sampled)
    capsule, start = segment(o, d, lane(first, 0), lane(last, 0)), lane(first, 0)
    if int(tree.head[SURFACE]) == DISC:
        position = o[0] + start * d[0], o[1] + start * d[1], o[2] + start * d[2]
        list_blocks(tree, leaf, capsule, scratch)
        return search_discs(tree, leaf, scratch, (position, start, ray), max(enter, abs(ray.t_min)), leave), lift
    frame = Frame(
        broadcast16(o[0]),
        broadcast16(o[1]),
        broadcast16(o[2]),
        broadcast16(d[0]),
        broadcast16(d[1]),
        broadcast16(d[2]),
        base_spacing(tree, leaf),
        broadcast16(ray.side),
    )
    lifts = Lift(broadcast16(lift.height), broadcast16(lift.end))
    sought_side = ONE if tree.leaves[leaf * LEAF + SHEETED] != ZERO else ZERO
    list_blocks(tree, leaf, capsule, scratch)
    gather(tree, scratch)
    while True:
        list_splats(scratch, capsule)
        if sought_side > ZERO and not lists_sheets(tree, scratch):
            sought_side = ZERO  # the leaf has sheets, but not near this ray
        if sought_side != ZERO:
            keep_sheet(tree, scratch, frame, sought_side, 1)
        if scratch.counts[sc.COUNT_SPLATS] > 0:
            found = search_one(tree, leaf, frame, sampled, (sought_side, lifts), scratch)
            height, end = max(height, found.lift.height), max(end, found.lift.end)
            if found.t < hit.t:
                hit = Hit(found.t, found.nx, found.ny, found.nz, leaf)
        else:
            height, end = max(height, lift.height), max(end, lift.end)
        if not sought_side > ZERO:
            return hit, Lift(height, end)
        sought_side = -ONE


@inline
def _along(axes: Axes, rows: Array, v: int) -> Along[Real]:
    """Load as many rays of the tile as a register holds, from index v on, in the coordinates of a leaf's columns.

    axes : (u, v, w) of the columns, which run along w; rows : `Scratch.model`, the rays

    Returns origins and directions along u, v, w, and inverse directions along u and v.
    """
    x, y, z = axes[0] * sc.TILE + v, axes[1] * sc.TILE + v, axes[2] * sc.TILE + v
    return (
        (load_register(rows, sc.OX + x), load_register(rows, sc.OX + y), load_register(rows, sc.OX + z)),
        (load_register(rows, sc.DX + x), load_register(rows, sc.DX + y), load_register(rows, sc.DX + z)),
        (load_register(rows, sc.IX + x), load_register(rows, sc.IX + y)),
    )


@inline
def _take(tree: Tree, leaf: int, passing: Bits, scratch: Scratch) -> Bits:
    """Copy the rays of the tile that enter a leaf into `scratch.part`; return the copied rays as bits of the tile.

    Rays that miss the surface in every column are left out, as are those whose samples are not distinct in float32.

    passing : bits of the rays that enter the leaf
    """
    rows, part, n, taken = scratch.model, scratch.part, 0, i64(0)
    axes = axes_of(tree, leaf)
    lanes = register_lanes()
    for v in range(0, sc.TILE, lanes):
        word = (passing >> v) & ((1 << lanes) - 1)
        if word == 0:
            continue
        low, high = narrow(
            tree,
            leaf,
            axes,
            _along(axes, rows, v),
            (load_register(rows, sc.FIRST + v), load_register(rows, sc.LAST + v)),
        )
        met = low <= high
        interval = load_register(rows, sc.ENTER + v), select(met, low, ZERO), select(met, high, ZERO)
        sampled, fine = sample_range(tree, leaf, interval, load_register(rows, sc.BEGIN + v))
        word &= bits(fine & met)
        if word == 0:
            continue
        active = mask_register(word)
        first, last = span(tree, leaf, sampled)
        center, half = HALF * (first + last), HALF * (last - first)
        dx, dy, dz = load_register(rows, sc.DX + v), load_register(rows, sc.DY + v), load_register(rows, sc.DZ + v)
        store_packed(part, sc.AT_X + n, active, load_register(rows, sc.OX + v) + center * dx)
        store_packed(part, sc.AT_Y + n, active, load_register(rows, sc.OY + v) + center * dy)
        store_packed(part, sc.AT_Z + n, active, load_register(rows, sc.OZ + v) + center * dz)
        store_packed(part, sc.AT_DX + n, active, dx)
        store_packed(part, sc.AT_DY + n, active, dy)
        store_packed(part, sc.AT_DZ + n, active, dz)
        store_packed(part, sc.AT_OX + n, active, load_register(rows, sc.OX + v))
        store_packed(part, sc.AT_OY + n, active, load_register(rows, sc.OY + v))
        store_packed(part, sc.AT_OZ + n, active, load_register(rows, sc.OZ + v))
        store_packed(part, sc.AT_HALF + n, active, half)
        store_packed(part, sc.AT_T + n, active, number_like(INF, dx))
        store_packed(part, sc.AT_FIRST + n, active, sampled.first)
        store_packed(part, sc.AT_LAST + n, active, sampled.last)
        store_packed(part, sc.AT_BEGIN + n, active, sampled.begin)
        store_packed(part, sc.AT_SIDE + n, active, load_register(rows, sc.SIDE + v))
        n += count_bits(word)
        taken |= word << v
    return taken


@inline
def _gather_for(tree: Tree, leaf: int, first: int, count: int, scratch: Scratch) -> None:
    """Copy the splats of a leaf's blocks near up to 16 rays to `scratch.splats`.

    first, count : index of the first of these rays in `scratch.part`, and their number
    """
    part = scratch.part
    frame = Frame(
        load16(part, sc.AT_X + first),
        load16(part, sc.AT_Y + first),
        load16(part, sc.AT_Z + first),
        load16(part, sc.AT_DX + first),
        load16(part, sc.AT_DY + first),
        load16(part, sc.AT_DZ + first),
        load16(part, sc.AT_FIRST + first),
        load16(part, sc.AT_SIDE + first),
    )
    active, ends = mask16((1 << count) - 1), (first, first + count - 1)
    list_blocks(tree, leaf, around(part, ends, frame, load16(part, sc.AT_HALF + first), active), scratch)
    gather(tree, scratch)


@inline
def _four(tree: Tree, leaf: int, part: Array, first: int) -> tuple[Frame, SampleRange]:
    """Load the rays first to first + 3 of `Scratch.part`, and the ranges of their samples in a leaf."""
    sampled = SampleRange(
        repeat4(part, sc.AT_FIRST + first), repeat4(part, sc.AT_LAST + first), repeat4(part, sc.AT_BEGIN + first)
    )
    frame = Frame(
        repeat4(part, sc.AT_OX + first),
        repeat4(part, sc.AT_OY + first),
        repeat4(part, sc.AT_OZ + first),
        repeat4(part, sc.AT_DX + first),
        repeat4(part, sc.AT_DY + first),
        repeat4(part, sc.AT_DZ + first),
        base_spacing(tree, leaf),
        repeat4(part, sc.AT_SIDE + first),
    )
    return frame, sampled


@inline
def _keep(leaf: int, found: Found, asked: Bits, rays: Bits, first: int, scratch: Scratch) -> Bits:
    """Store in `scratch` the hits of four rays that are nearer than earlier ones in a leaf.

    Returns the rays that must be traced singly, by the start rule, as bits of the tile.

    found : hits of the four rays; asked : 4 bits, rays whose hits count
    rays : the four rays, as bits of the tile; with fewer than four bits the last lanes of `found` have no hit
    first : index of the first of the four in `scratch.part`

    The loop always takes four steps, so that lanes are compile-time constants, which saves 1 to 2% of the time.
    """
    rows, part, lifted = scratch.model, scratch.part, i64(0)
    hits, lifts = bits(found.t < repeat4(part, sc.AT_T + first)) & asked, bits(found.lift.height > ZERO) & asked
    for i in range(4):
        k = count_trailing_zeros(rays | BEYOND)
        rays &= rays - 1
        lifted |= ((lifts >> i) & 1) << k
        if (hits >> i) & 1 != 0:
            rows[sc.HIT_T + k] = part[sc.AT_T + first + i] = lane(found.t, i)
            rows[sc.LENGTH + k] = rows[sc.ENTER + k]
            rows[sc.NX + k], rows[sc.NY + k], rows[sc.NZ + k] = lane(found.nx, i), lane(found.ny, i), lane(found.nz, i)
            scratch.numbers[sc.FOUND + k] = leaf
    return lifted


@inline
def search_together(tree: Tree, leaf: int, passing: Bits, scratch: Scratch) -> Bits:
    """Search a leaf for hits of rays of the tile, four rays at a time, and store the hits in `scratch`.

    Returns the rays that must be traced singly, by the start rule, as bits of the tile.

    Where two sheets are close together, each ray sees one at a time: those that face it first, then those that face
    away. Rays that see the same sheet are searched together.

    passing : bits of the rays to search for
    """
    left = _take(tree, leaf, passing, scratch)
    part, lifted, first = scratch.part, i64(0), 0
    sheeted = tree.leaves[leaf * LEAF + SHEETED] != ZERO
    while left != 0:
        if first % sc.LANES == 0:
            _gather_for(tree, leaf, first, min(count_bits(left), sc.LANES), scratch)
        four = i64(0)
        for _ in range(4):
            four |= left & -left
            left &= left - 1
        rays = (1 << count_bits(four)) - 1
        frame, sampled = _four(tree, leaf, part, first)
        sought_side, waiting = (ONE if sheeted else ZERO), rays
        while waiting != 0:
            list_splats_of(scratch, first, first + count_bits(four))
            if sought_side > ZERO and not lists_sheets(tree, scratch):
                sought_side = ZERO
            now = keep_sheet(tree, scratch, frame, sought_side, waiting) if sought_side != ZERO else waiting
            waiting &= ~now
            found = search(tree, leaf, frame, sampled, now, sought_side, scratch)
            if bits((found.t < INF) | (found.lift.height > ZERO)) != 0:
                lifted |= _keep(leaf, found, now, four, first, scratch)
            if waiting == 0 and sought_side > ZERO:
                sought_side, waiting = -ONE, rays
        first += 4
    return lifted
