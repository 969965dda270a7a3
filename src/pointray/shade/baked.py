"""Baked light at the hits of a tile: irradiance, and from which directions it comes.

Of the light L(w) that arrives at a splat the bake keeps, for the side with the unit normal n, the irradiance E in RGB,
and of F(w) = L(w) max(0, w.n), as luminance, the spherical harmonics of the bands 1 and 2, as shares of band 0:

    F_00 = E sqrt(1 / (4 pi)) is known; F_lm / F_00 lies within sqrt(3) in band 1 and within sqrt(5) in band 2.

A lobe max(0, w.r)^e about a direction r then sees a_0 F_00 Y_00 + a_1 sum F_1m Y_1m(r) + a_2 sum F_2m Y_2m(r), where
the a_l are the lobe's zonal harmonics. The cosine is in F already, so that a lobe close to the horizon sees no light
from below it.

At a hit the splats' light is blended by the weights of the surface, less where their normals differ from the hit's:
a splat across an edge sees another light. Coarser light has fewer records than splats: first the light of each splat is
blended from four of them, see `records.SPREAD`.
"""

from __future__ import annotations

import math

from ..intersect.gather import nearest_slot
from ..intersect.surface import FourPoints, Sheet, weights_seen
from ..jit import Array, array_at, borrow, f32, f64, i32, i64, inline, routine
from ..kernels.records import (
    BAKED,
    BAKED_BACK,
    BAKED_COUNT,
    BAKED_FRAME,
    BAKED_FRONT,
    BAKED_SPREAD,
    BAKED_SPREAD_COUNT,
    BAKED_UNIT,
    BANDS,
    DIRECT,
    INDIRECT,
    INSTANCE,
    KIND,
    MODEL,
    PLANE_SIZE,
    RECORD,
    SHAPE_ROW,
    SPREAD,
    SPREAD_RECORDS,
    SPREAD_SHARES,
    World,
)
from ..kernels.scratch import (
    ARRIVING,
    ARRIVING_BANDS,
    ARRIVING_DIRECT,
    COUNT_NEAR,
    INSTANCE_OF,
    LANES,
    LEAF_OF,
    LOCAL,
    SHADING_NORMAL,
    SHADING_POINT,
    SHADING_SIDE,
    TILE,
    Scratch,
    load3,
    store3,
)
from ..kernels.tree import BLOCK, LEAF, NX, NY, NZ, SHEETED, Tree, tree_at
from ..kernels.vec import BLACK, Vec3, scale, transform, unit
from ..simd import ZERO, broadcast16, count_trailing_zeros, quarters, repeat4, store, vmax
from ..trace.hits import list_around, next_of_leaf
from ..trace.paint import Four
from ..trace.space import matrix_at
from .grid import corner_cell, grid_cell, grid_frame
from .harmonics import BAND_0, harmonics
from .rgbe import unpack_rgbe

BAND_UNITS = (math.sqrt(3.0) / 127.0, math.sqrt(5.0) / 127.0)  # of a byte of band 1 and of band 2
ONE_SHARE = f32(1.0 / 255.0)  # see `records.SPREAD_SHARES`
SUMS = 15  # weight, irradiance (3), that of lights (3), bands (8)


@inline
def _records(world: World, instance: int, side: float) -> Array:
    """The records of one side of an instance; of length 0 where it is dark."""
    row = instance * BAKED
    address = world.baked[row + (BAKED_FRONT if side > 0.0 else BAKED_BACK)]
    return array_at(address, RECORD * world.baked[row + BAKED_COUNT] if address != 0 else i64(0), i32(0))


@inline
def _spread(world: World, instance: int) -> Array:
    """How an instance's records are spread over its splats; of length 0 where each has its own."""
    row = instance * BAKED
    return array_at(world.baked[row + BAKED_SPREAD], world.baked[row + BAKED_SPREAD_COUNT], i32(0))


@inline
def _byte(word: int, k: int) -> float:
    """Byte k of a word, as a signed number."""
    value = (word >> (8 * k)) & 255
    return f32(value - 256 if value > 127 else value)


@inline
def _read(records: Array, record: int, part: Array, to: int) -> None:
    """Write a record's numbers to part[to], part[to + 4] and so on, in the order of SUMS but for the weight."""
    at = RECORD * record
    light, direct = unpack_rgbe(i64(records[at + INDIRECT])), unpack_rgbe(i64(records[at + DIRECT]))
    first, second = i64(records[at + BANDS]), i64(records[at + BANDS + 1])
    for c in range(3):
        part[to + 4 * c], part[to + 12 + 4 * c] = light[c], direct[c]
    for k in range(4):
        part[to + 24 + 4 * k], part[to + 40 + 4 * k] = _byte(first, k), _byte(second, k)


@inline
def _read_block(records: Array, spread: Array, block: int, part: Array, to: int) -> None:
    """Write the numbers of a block's splats j to part[to + j], part[to + 4 + j] and so on, see `_read`."""
    coarse, at = spread.size > 0, block * SPREAD
    read = to + 4 * (SUMS - 1) if coarse else to
    for k in range(4):
        _read(records, i64(spread[at + SPREAD_RECORDS + k]) if coarse else 4 * block + k, part, read + k)
    if not coarse:
        return
    for j in range(4):
        word = i64(spread[at + SPREAD_SHARES + j])
        a, b, c, d = f32(word & 255), f32((word >> 8) & 255), f32((word >> 16) & 255), f32((word >> 24) & 255)
        for k in range(0, 4 * (SUMS - 1), 4):
            light = a * part[read + k] + b * part[read + k + 1] + c * part[read + k + 2] + d * part[read + k + 3]
            part[to + k + j] = light * ONE_SHARE


@inline
def _sum(
    tree: Tree, records: Array, spread: Array, seen: tuple[FourPoints, FourPoints, Sheet], scratch: Scratch
) -> None:
    """Store the sums of SUMS over the listed blocks, 16 lanes each: lane 4 r + j those of splats j at point r.

    seen : points and unit normals of four hits, a quarter each, in model space; and the sheet, see `weights_seen`
    """
    part, (points, normals, sheet) = scratch.part, seen
    read = LANES * SUMS
    zero = broadcast16(ZERO)
    total = r0 = r1 = r2 = d0 = d1 = d2 = b0 = b1 = b2 = b3 = b4 = b5 = b6 = b7 = zero
    for k in range(scratch.counts[COUNT_NEAR]):
        block = i64(scratch.near[k])
        w = weights_seen(tree, block, points, sheet, part)
        nx, ny, nz = normals
        at = block * BLOCK
        cosine = (
            nx * repeat4(tree.blocks, at + NX) + ny * repeat4(tree.blocks, at + NY) + nz * repeat4(tree.blocks, at + NZ)
        )
        gate = vmax(cosine, zero)
        gate = gate * gate
        w = w * (gate * gate)
        _read_block(records, spread, block, part, read)
        total = total + w
        r0, r1, r2 = r0 + w * repeat4(part, read), r1 + w * repeat4(part, read + 4), r2 + w * repeat4(part, read + 8)
        d0, d1 = d0 + w * repeat4(part, read + 12), d1 + w * repeat4(part, read + 16)
        d2, b0 = d2 + w * repeat4(part, read + 20), b0 + w * repeat4(part, read + 24)
        b1, b2 = b1 + w * repeat4(part, read + 28), b2 + w * repeat4(part, read + 32)
        b3, b4 = b3 + w * repeat4(part, read + 36), b4 + w * repeat4(part, read + 40)
        b5, b6 = b5 + w * repeat4(part, read + 44), b6 + w * repeat4(part, read + 48)
        b7 = b7 + w * repeat4(part, read + 52)
    sums = (total, r0, r1, r2, d0, d1, d2, b0, b1, b2, b3, b4, b5, b6, b7)
    for k in range(SUMS):
        store(part, k * LANES, sums[k])


@inline
def _keep(i: int, at: int, share: float, unit_of: float, scratch: Scratch) -> None:
    """Keep what arrives at surface point i: share times part[at], part[at + 4] and so on."""
    points, part = scratch.shading_points, scratch.part
    for c in range(3):
        points[ARRIVING + c * TILE + i] = f64(part[at + 4 * c]) * share * unit_of
        points[ARRIVING_DIRECT + c * TILE + i] = f64(part[at + 12 + 4 * c]) * share * unit_of
    for k in range(8):
        band = BAND_UNITS[0] if k < 3 else BAND_UNITS[1]
        points[ARRIVING_BANDS + k * TILE + i] = f64(part[at + 24 + 4 * k]) * share * band


@inline
def _keep_nothing(i: int, scratch: Scratch) -> None:
    points = scratch.shading_points
    store3(points, ARRIVING + i, BLACK)
    store3(points, ARRIVING_DIRECT + i, BLACK)
    for k in range(8):
        points[ARRIVING_BANDS + k * TILE + i] = 0.0


@inline
def _find_four(world: World, four: Four, scratch: Scratch) -> None:
    """Keep what arrives at four hits of one leaf, on the same side."""
    wide, numbers, part, points = scratch.world, scratch.numbers, scratch.part, scratch.shading_points
    instance, leaf = numbers[INSTANCE_OF + four[0]], numbers[LEAF_OF + four[0]]
    tree = tree_at(world.table, i64(world.instances[instance * INSTANCE + SHAPE_ROW]))
    side, matrix = points[SHADING_SIDE + four[0]], matrix_at(world, instance * INSTANCE)
    records, spread = _records(world, instance, side), _spread(world, instance)
    unit_of = world.baked_frames[instance * BAKED_FRAME + BAKED_UNIT]
    if records.size == 0:
        for r in range(4):
            _keep_nothing(four[r], scratch)
        return
    a, b, c, d = (
        unit(transform(matrix, scale(load3(points, SHADING_NORMAL + four[0]), side))),
        unit(transform(matrix, scale(load3(points, SHADING_NORMAL + four[1]), side))),
        unit(transform(matrix, scale(load3(points, SHADING_NORMAL + four[2]), side))),
        unit(transform(matrix, scale(load3(points, SHADING_NORMAL + four[3]), side))),
    )
    normals = (
        quarters(f32(a[0]), f32(b[0]), f32(c[0]), f32(d[0])),
        quarters(f32(a[1]), f32(b[1]), f32(c[1]), f32(d[1])),
        quarters(f32(a[2]), f32(b[2]), f32(c[2]), f32(d[2])),
    )
    sheet = tree.leaves[leaf * LEAF + SHEETED] != ZERO, a
    _sum(tree, records, spread, (list_around(tree, four, scratch), normals, sheet), scratch)
    for r in range(4):
        for k in range(SUMS):
            at = k * LANES + 4 * r
            part[at] = part[at] + part[at + 1] + part[at + 2] + part[at + 3]
    for r in range(4):
        i, total = four[r], part[4 * r]
        at = LANES * SUMS
        if total > ZERO:
            for k in range(SUMS - 1):
                part[at + 4 * k] = part[(k + 1) * LANES + 4 * r]
            _keep(i, at, 1.0 / f64(total), unit_of, scratch)
        else:
            x = load3(wide, LOCAL + i)
            slot = nearest_slot(tree, leaf, f32(x[0]), f32(x[1]), f32(x[2]))
            _read_block(records, spread, slot // 4, part, at)
            _keep(i, at + slot % 4, 1.0, unit_of, scratch)


@inline
def _find_on_plane(world: World, i: int, scratch: Scratch) -> None:
    """Keep what arrives at a hit on a plane: blended from the four cells around it."""
    instance, points = scratch.numbers[INSTANCE_OF + i], scratch.shading_points
    records = _records(world, instance, points[SHADING_SIDE + i])
    if records.size == 0:
        _keep_nothing(i, scratch)
        return
    plane, frame = (
        int(world.instances[instance * INSTANCE + SHAPE_ROW]) * PLANE_SIZE,
        grid_frame(world.baked_frames, instance),
    )
    x, part, read = load3(points, SHADING_POINT + i), scratch.part, 4 * SUMS
    total = 0.0
    for k in range(SUMS - 1):
        part[4 * k] = ZERO
    for corner in range(4):
        cell, share = corner_cell(world, plane, frame, x, corner)
        total += share
        if share > 0.0:
            _read(records, cell, part, read)
            for k in range(SUMS - 1):
                part[4 * k] += f32(share) * part[read + 4 * k]
    if total == 0.0:
        _read(records, grid_cell(world, plane, frame, x), part, 0)
        total = 1.0
    _keep(i, 0, 1.0 / total, world.baked_frames[instance * BAKED_FRAME + BAKED_UNIT], scratch)


@inline
def _same_side(points: Array, i: int, k: int) -> int:
    """k if its surface point is seen from the same side as that of i, else i."""
    return k if points[SHADING_SIDE + k] == points[SHADING_SIDE + i] else i


@routine
def find_baked(world: World, scratch: Scratch) -> None:
    """Find the baked light at the tile's surface points, whose hits are still known: the rows ARRIVING."""
    scratch, world = borrow(scratch), borrow(world)
    numbers, points, left = scratch.numbers, scratch.shading_points, i64(0)
    for i in range(TILE):
        if numbers[INSTANCE_OF + i] < 0:
            continue
        if world.instances[numbers[INSTANCE_OF + i] * INSTANCE + KIND] == MODEL:
            left |= i64(1) << i
        else:
            _find_on_plane(world, i, scratch)
    while left != 0:
        a = count_trailing_zeros(left)
        left &= left - 1
        tree = tree_at(world.table, i64(world.instances[numbers[INSTANCE_OF + a] * INSTANCE + SHAPE_ROW]))
        b = c = d = a
        if tree.leaves[numbers[LEAF_OF + a] * LEAF + SHEETED] == ZERO:
            b = _same_side(points, a, next_of_leaf(numbers, left, a))
            left &= ~(i64(b != a) << b)
            c = _same_side(points, a, next_of_leaf(numbers, left, a))
            left &= ~(i64(c != a) << c)
            d = _same_side(points, a, next_of_leaf(numbers, left, a))
            left &= ~(i64(d != a) << d)
        _find_four(world, (a, b, c, d), scratch)


@inline
def even_lobe(cosine: float, exponent: float) -> float:
    """What `lobe_of_baked` gives for even light of radiance 1. cosine : between normal and lobe"""
    e = exponent
    plane = 5.0 / 16.0 * (1.5 * cosine * cosine - 0.5)
    seen = 0.25 * (e + 2.0) / (e + 1.0) + 0.5 * cosine + e * (e + 2.0) / ((e + 1.0) * (e + 3.0)) * plane
    return max(seen, 0.05)


@inline
def lobe_of_baked(scratch: Scratch, i: int, r: Vec3, exponent: float) -> Vec3:
    """(exponent + 2) / (2 pi) times the integral of the baked light, its cosine, and the lobe max(0, w.r)^exponent.

    The lobe's zonal harmonics are 2 pi times the integrals of t^e P_l(t) over 0..1.
    """
    points = scratch.shading_points
    e = exponent
    first, second = harmonics(r)
    line = plane = 0.0
    for k in range(3):
        line += points[ARRIVING_BANDS + k * TILE + i] * first[k]
    for k in range(5):
        plane += points[ARRIVING_BANDS + (3 + k) * TILE + i] * second[k]
    seen = (e + 2.0) / (e + 1.0) * BAND_0 + line + e * (e + 2.0) / ((e + 1.0) * (e + 3.0)) * plane
    return scale(load3(points, ARRIVING + i), max(BAND_0 * seen, 0.0))
