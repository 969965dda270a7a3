"""Lookup of baked light at the hits of a tile: selection and weights of records.

On a model, records of splats are blended with the weights of the surface, reduced where a splat's normal differs from
the hit's: a splat across an edge receives other light. On a plane the four cells around the hit are blended. Coarser
light has fewer records than splats: each splat blends four of them, see `records.SPREAD`.
"""

from __future__ import annotations

from ..engine.jit import Array, array_at, borrow, f32, f64, i32, i64, inline, routine
from ..engine.kernels import records as rec, scratch as sc
from ..engine.kernels.records import World
from ..engine.kernels.scratch import Scratch, load3, store3
from ..engine.kernels.tree import BLOCK, LEAF, NX, NY, NZ, SCATTERED, SHEETED, Tree, tree_at
from ..engine.kernels.vec import BLACK
from ..engine.simd import (
    ONE,
    ZERO,
    bits,
    broadcast16,
    count_trailing_zeros,
    lane,
    quarters,
    repeat4,
    store,
    vmax,
    vsqrt,
)
from ..surface.intersect.gather import nearest_slot
from ..surface.intersect.surface import FourPoints, weights_seen
from ..surface.trace.hits import list_around, material_at, next_of_leaf
from ..surface.trace.paint import Four
from ..surface.trace.space import matrix_at, of_size_one
from . import baked_sums
from .grid import corner_cell, grid_cell, grid_frame
from .lobes import is_wide, lobe_of


@inline
def _records(world: World, instance: int, side: float) -> Array:
    """Return the light records of one side of an instance, flat int32, 4 numbers each; empty if the side is dark.

    side : positive for the front, to which normals point
    """
    row = instance * rec.BAKED
    address = world.baked[row + (rec.BAKED_FRONT if side > 0.0 else rec.BAKED_BACK)]
    return array_at(address, rec.RECORD * world.baked[row + rec.BAKED_COUNT] if address != 0 else i64(0), i32(0))


@inline
def _spread(world: World, instance: int) -> Array:
    """Return the table that interpolates an instance's light records to its splats, see `records.SPREAD`.

    It is empty if each splat has a record of its own.
    """
    row = instance * rec.BAKED
    return array_at(world.baked[row + rec.BAKED_SPREAD], world.baked[row + rec.BAKED_SPREAD_COUNT], i32(0))


@inline
def _normals(world: World, instance: int, four: Four, scratch: Scratch) -> FourPoints:
    """Return the unit normals at four of the tile's hits, in model space, turned to the front.

    They are the vectors x, y and z of 16 lanes, a quarter for each hit.

    four : rays of the tile
    """
    points, m = scratch.shading_points, of_size_one(matrix_at(world, instance * rec.INSTANCE))
    side = points[sc.SHADING_SIDE + four[0]]
    a, b = load3(points, sc.SHADING_NORMAL + four[0]), load3(points, sc.SHADING_NORMAL + four[1])
    c, d = load3(points, sc.SHADING_NORMAL + four[2]), load3(points, sc.SHADING_NORMAL + four[3])
    x = quarters(f32(a[0]), f32(b[0]), f32(c[0]), f32(d[0])) * f32(side)
    y = quarters(f32(a[1]), f32(b[1]), f32(c[1]), f32(d[1])) * f32(side)
    z = quarters(f32(a[2]), f32(b[2]), f32(c[2]), f32(d[2])) * f32(side)
    nx = x * f32(m[0][0]) + y * f32(m[0][1]) + z * f32(m[0][2])
    ny = x * f32(m[1][0]) + y * f32(m[1][1]) + z * f32(m[1][2])
    nz = x * f32(m[2][0]) + y * f32(m[2][1]) + z * f32(m[2][2])
    size = ONE / vsqrt(nx * nx + ny * ny + nz * nz)
    return nx * size, ny * size, nz * size


@inline
def _weigh(world: World, tree: Tree, four: Four, scratch: Scratch) -> None:
    """Find the splats whose baked light is blended at four hits in one leaf, and their weights.

    The indices of the splats' blocks are written to `Scratch.near`, and 16 weights for each block to `Scratch.splats`:
    lane 4 r + j for splat j of the block at hit r. The weights at hit r, which are not normalized, sum to the number at
    SUM_WEIGHTS + 4 r in `Scratch.part`.

    Weights are those of the surface, reduced where a splat's normal differs from the hit's. If no splat has weight, the
    nearest one gets weight 1. A scattered point takes only its own light.

    four : indices of the four rays in the tile
    """
    part, splats = scratch.part, scratch.splats
    leaf, instance = scratch.numbers[sc.LEAF_OF + four[0]], scratch.numbers[sc.INSTANCE_OF + four[0]]
    if leaf >= SCATTERED:
        scratch.counts[sc.COUNT_NEAR] = 0
        for r in range(4):
            part[baked_sums.SUM_WEIGHTS + 4 * r] = f32(1.0)
            baked_sums.list_record((leaf - SCATTERED) // 4, r, (leaf - SCATTERED) % 4, 1.0, scratch)
        return
    nx, ny, nz = _normals(world, instance, four, scratch)
    sheet = tree.leaves[leaf * LEAF + SHEETED] != ZERO, (f64(lane(nx, 0)), f64(lane(ny, 0)), f64(lane(nz, 0)))
    places = list_around(tree, four, scratch)
    total = zero = broadcast16(ZERO)
    count = 0
    for k in range(scratch.counts[sc.COUNT_NEAR]):
        block = i64(scratch.near[k])
        w = weights_seen(tree, block, places, sheet, part)
        if bits(w > zero) == 0:  # saves reading its records
            continue
        at = block * BLOCK
        cosine = (
            nx * repeat4(tree.blocks, at + NX) + ny * repeat4(tree.blocks, at + NY) + nz * repeat4(tree.blocks, at + NZ)
        )
        gate = vmax(cosine, zero)
        gate = gate * gate
        w = w * (gate * gate)
        total = total + w
        scratch.near[count] = block
        store(splats, count * sc.LANES, w)
        count += 1
    scratch.counts[sc.COUNT_NEAR] = count
    store(part, baked_sums.SUM_WEIGHTS, total)
    for r in range(4):
        at = baked_sums.SUM_WEIGHTS + 4 * r
        part[at] = part[at] + part[at + 1] + part[at + 2] + part[at + 3]
        if not part[at] > ZERO:
            x = load3(scratch.world, sc.LOCAL + four[r])
            slot = nearest_slot(tree, leaf, f32(x[0]), f32(x[1]), f32(x[2]))
            baked_sums.list_record(slot // 4, r, slot % 4, 1.0, scratch)
            part[at] = f32(1.0)


@inline
def _weigh_cells(world: World, four: Four, scratch: Scratch) -> None:
    """Find the four cells around each of four hits on a plane, and the weights to interpolate baked light from them.

    Groups of four consecutive cells are listed in `Scratch.near`, and 16 weights for each group are written to
    `Scratch.splats`: lane 4 r + j for cell j of the group at hit r.

    four : indices of the four rays in the tile
    """
    instance = scratch.numbers[sc.INSTANCE_OF + four[0]]
    plane = int(world.instances[instance * rec.INSTANCE + rec.SHAPE_ROW]) * rec.PLANE_SIZE
    frame = grid_frame(world.baked_frames, instance)
    scratch.counts[sc.COUNT_NEAR] = 0
    for r in range(4):
        scratch.part[baked_sums.SUM_WEIGHTS + 4 * r] = f32(1.0)
        if r > 0 and four[r] == four[0]:  # a repeated hit: its sums are not used
            continue
        x, total = load3(scratch.shading_points, sc.SHADING_POINT + four[r]), 0.0
        for corner in range(4):
            cell, share = corner_cell(world, plane, frame, x, corner)
            total += share
            if share > 0.0:
                baked_sums.list_record(cell // 4, r, cell % 4, share, scratch)
        if total == 0.0:
            cell, total = grid_cell(world, plane, frame, x), 1.0
            baked_sums.list_record(cell // 4, r, cell % 4, 1.0, scratch)
        scratch.part[baked_sums.SUM_WEIGHTS + 4 * r] = f32(total)


@inline
def _find_four(world: World, four: Four, first: bool, scratch: Scratch) -> None:
    """Look up the irradiance of baked light at four hits on the same side of one leaf or plane.

    The result is in rows ARRIVING of the scratch.

    four : indices of the four rays in the tile; unused places repeat the first
    first : whether these are the camera's first hits; if so, only indirect light is looked up
    """
    instance, points = scratch.numbers[sc.INSTANCE_OF + four[0]], scratch.shading_points
    records = _records(world, instance, points[sc.SHADING_SIDE + four[0]])
    if records.size == 0:
        for r in range(4):
            store3(points, sc.ARRIVING + four[r], BLACK)
        return
    if world.instances[instance * rec.INSTANCE + rec.KIND] == rec.MODEL:
        _weigh(
            world, tree_at(world.table, i64(world.instances[instance * rec.INSTANCE + rec.SHAPE_ROW])), four, scratch
        )
        if world.baked[instance * rec.BAKED + rec.BAKED_SPREAD] != 0:
            baked_sums.spread_out(_spread(world, instance), scratch)
    else:
        _weigh_cells(world, four, scratch)
    # Only materials with a wide lobe need moments.
    moments = first and is_wide(lobe_of(world, material_at(world, instance)))
    if moments:
        baked_sums.sum_moments(records, scratch)
    else:
        baked_sums.sum_light(records, rec.INDIRECT, baked_sums.SUM_LIGHT, scratch)
    if not first:
        baked_sums.sum_light(records, rec.DIRECT, baked_sums.SUM_DIRECT, scratch)
    unit_of = world.baked_frames[instance * rec.BAKED_FRAME + rec.BAKED_UNIT]
    for r in range(4):
        if r == 0 or four[r] != four[0]:
            baked_sums.store_light(four[r], r, unit_of, not first, scratch)
            if moments:
                baked_sums.store_moments(four[r], r, unit_of, scratch)


@inline
def _same_side(points: Array, i: int, k: int) -> int:
    """Return k if hits k and i are on the same side of the surface, so that their light is looked up together, else i.

    points : rows of surface points of the tile, with SHADING_SIDE
    """
    return k if points[sc.SHADING_SIDE + k] == points[sc.SHADING_SIDE + i] else i


@inline
def _is_sheeted(world: World, i: int, scratch: Scratch) -> bool:
    """Return whether ray i has hit a leaf with two sheets, where splats' weights depend on the sheet that it meets."""
    instance = scratch.numbers[sc.INSTANCE_OF + i] * rec.INSTANCE
    if world.instances[instance + rec.KIND] != rec.MODEL:
        return False
    tree = tree_at(world.table, i64(world.instances[instance + rec.SHAPE_ROW]))
    leaf = scratch.numbers[sc.LEAF_OF + i]
    return leaf < SCATTERED and tree.leaves[leaf * LEAF + SHEETED] != ZERO


@routine
def find_baked(world: World, first: bool, scratch: Scratch) -> None:
    """Look up the irradiance of baked light at the tile's hits. The result is in rows ARRIVING of the scratch.

    first : whether these are the camera's first hits. If so, it is indirect light only, and for materials with a wide
        glossy lobe also spherical harmonics of it are stored; else the baked direct light is added
    """
    scratch, world = borrow(scratch), borrow(world)
    numbers, points, left = scratch.numbers, scratch.shading_points, i64(0)
    for i in range(sc.TILE):
        left |= i64(numbers[sc.INSTANCE_OF + i] >= 0) << i
    while left != 0:
        a = count_trailing_zeros(left)
        left &= left - 1
        b = c = d = a
        if not _is_sheeted(world, a, scratch):
            b = _same_side(points, a, next_of_leaf(numbers, left, a))
            left &= ~(i64(b != a) << b)
            c = _same_side(points, a, next_of_leaf(numbers, left, a))
            left &= ~(i64(c != a) << c)
            d = _same_side(points, a, next_of_leaf(numbers, left, a))
            left &= ~(i64(d != a) << d)
        _find_four(world, (a, b, c, d), first, scratch)
