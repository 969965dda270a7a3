"""Intersection of a tile's rays with one instance: transform, traversal together or singly, and nearer hits."""

from __future__ import annotations

import math
from typing import TypeAlias

from ...engine.jit import Array, f32, f64, i64, inline
from ...engine.kernels import scratch as sc
from ...engine.kernels.records import INSTANCE, SHAPE_ROW, World
from ...engine.kernels.scratch import Scratch, load3, store3
from ...engine.kernels.tree import DISC, LONGEST, SCATTER, SURFACE, tree_at
from ...engine.kernels.vec import add, dot, either, scale, transform_transposed
from ...engine.simd import ONE, ZERO, Bits, broadcast16, count_bits, count_trailing_zeros, load16, select, store
from ..intersect.lattice import NONZERO_BEGIN
from .group import FAILURES, FEWEST, coherent, leaf_edge, pack_rays, restore_rays, save_hits, save_rays, similar_rays
from .space import Bounds, ToModel, into_model, matrix_at, model_bounds, of_size_one
from .tile import ALL, bits_of_row, closest_of_tile, tile_ray
from .traverse import closest, make_ray

# Up to this many rays of a tile are transformed one by one and traced singly; otherwise all 64 are transformed as
# vectors. 10,000 statues five pixels high take 0.95 of the time with 16, and 0.8 of that with 4; larger ones take the
# same. With 64, 24 statues a hundred pixels high take 1.11 times as long.
FEW_RAYS = 24

Box: TypeAlias = tuple[Bounds, tuple[float, float], bool, bool]  # see `_enter`


@inline
def _enter(matrix: ToModel, box: Box, i: int, scratch: Scratch) -> None:
    """Transform ray i of the tile into a model's space, starting where it enters the bounds, and store it in `scratch`.

    Its length there (row LENGTH) is negative if the ray misses the bounds. By the start rule, a ray from outside the
    bounds starts on no disc and on no scattered point, and a ray of a camera or of a caller on no disc.

    matrix : from the world to the model
    box : (bounds, step, discs, scattered), where
        `bounds` are the low and the high corner of the model
        `step` is the model's longest sample step, and 1 / step
        `discs` says whether the surface consists of discs
        `scattered` says whether there are scattered points
    """
    wide, rows, (bounds, step, discs, scattered) = scratch.world, scratch.model, box
    ray = (load3(wide, sc.ORIGIN + i), load3(wide, sc.DIRECTION + i), wide[sc.T_MIN + i], wide[sc.NEAREST + i])
    start, d, low, high, speed, begin = into_model(matrix, bounds, ray, step)
    store3(wide, sc.START + i, start)
    store3(wide, sc.HEADING + i, d)
    wide[sc.LOW + i], wide[sc.SPEED + i] = low, speed
    rows[sc.LENGTH + i] = f32(high - low + step[0]) if low <= high else -ONE
    begin = f32(begin)
    outside = (low > 0.0) & (begin == ZERO)
    on_none = outside | (wide[sc.SIDE_OF + i] == sc.ANYWHERE)
    elsewhere = (rows[sc.CUT + i] > ZERO) | (discs & on_none) | (scattered & outside)
    rows[sc.BEGIN + i] = -max(begin, NONZERO_BEGIN) if elsewhere else begin


@inline
def _narrow(i: int, scratch: Scratch) -> None:
    """Round ray i of the tile in the model's space to float32, and reset its hit with the model."""
    wide, rows = scratch.world, scratch.model
    ray = make_ray(load3(wide, sc.START + i), load3(wide, sc.HEADING + i), 0.0, 1.0)
    store3(rows, sc.OX + i, (ray.ox, ray.oy, ray.oz))
    store3(rows, sc.DX + i, (ray.dx, ray.dy, ray.dz))
    store3(rows, sc.IX + i, (ray.ix, ray.iy, ray.iz))
    rows[sc.END + i], rows[sc.SIDE + i] = rows[sc.LENGTH + i], f32(wide[sc.SIDE_OF + i])
    scratch.numbers[sc.FOUND + i] = -1


@inline
def _some_enter(matrix: ToModel, box: Box, rays: Bits, scratch: Scratch) -> Bits:
    """Transform the given rays into a model's space, one by one; return those that hit the model's bounds.

    matrix : from the world to the model; box : the model's bounds, sample step and kinds of splats
    rays : bits of the tile, as the result
    """
    meeting = i64(0)
    while rays != 0:
        i = count_trailing_zeros(rays)
        rays &= rays - 1
        _enter(matrix, box, i, scratch)
        if scratch.model[sc.LENGTH + i] >= ZERO:
            _narrow(i, scratch)
            meeting |= i64(1) << i
    return meeting


@inline
def _all_enter(matrix: ToModel, box: Box, rays: Bits, scratch: Scratch) -> Bits:
    """Transform all 64 rays of the tile into a model's space; return which of the given rays hit the model's bounds.

    matrix : from the world to the model; box : the model's bounds, sample step and kinds of splats
    rays : bits of the rays to test, as the result; all other rays become copies of one that hits

    It branches only if some rays of the tile miss: the rays are processed as vectors.
    """
    rows = scratch.model
    for i in range(sc.TILE):
        _enter(matrix, box, i, scratch)
    if rays != ALL:
        for i in range(sc.TILE):
            rows[sc.LENGTH + i] = rows[sc.LENGTH + i] if (rays >> i) & 1 != 0 else -ONE
    meeting = bits_of_row(rows, sc.LENGTH)
    if meeting == 0:
        return meeting
    for i in range(sc.TILE):
        _narrow(i, scratch)
    if meeting != ALL:
        # Rays that miss the bounds become copies of one that hits them, so that they do not widen the tile.
        first = count_trailing_zeros(meeting)
        for offset in range(0, sc.TILE, sc.LANES):
            meet = load16(rows, sc.LENGTH + offset) >= ZERO
            for k in range(0, 9 * sc.TILE, sc.TILE):
                store(rows, k + offset, select(meet, load16(rows, k + offset), broadcast16(rows[k + first])))
    return meeting


@inline
def _trace_groups(table: Array, model: int, entered: Bits, any_hit: bool, scratch: Scratch) -> Bits:
    """Trace groups of similar rays through a model; return the rays that must be traced singly, as bits of the tile.

    table : addresses of all models' arrays; model : index of the model
    entered : rays that hit the model's bounds, as bits; any_hit : whether any hit suffices, as for occlusion
    """
    rows, edge = scratch.model, leaf_edge(tree_at(table, model))
    whole = coherent(edge, rows)
    if not whole:
        save_rays(scratch)
    left, alone, failures = entered, i64(0), 0
    while left != 0:
        rays, end = left, sc.TILE
        if not whole:
            rays = similar_rays(edge, rows, left)
            if count_bits(rays) < FEWEST:
                failures += 1
                rays = left if failures == FAILURES else rays
                alone |= rays
                left &= ~rays
                continue
            end = pack_rays(rays, scratch)
        lifted = closest_of_tile(table, model, (0, end), any_hit, scratch)
        alone |= lifted if whole else save_hits(rays, lifted, scratch)
        left &= ~rays
    if not whole:
        restore_rays(scratch)
    return alone & entered


@inline
def through_instance(world: World, offset: int, rays: Bits, any_hit: bool, scratch: Scratch) -> None:
    """Find hits of rays with an instance, and store those that are nearer than earlier hits in `scratch`.

    offset : where the instance's record begins in `World.instances`
    rays : bits of the tile; any_hit : whether any hit suffices, as for occlusion
    """
    model = i64(world.instances[offset + SHAPE_ROW])
    tree = tree_at(world.table, model)
    step = f64(tree.head[LONGEST])
    kinds = int(tree.head[SURFACE]) == DISC, tree.head[SCATTER] > ZERO
    box = model_bounds(tree.head), (step, 1.0 / step), kinds[0], kinds[1]
    matrix = matrix_at(world, offset)
    rows, numbers = scratch.model, scratch.numbers
    few = count_bits(rays) <= FEW_RAYS
    alone = _some_enter(matrix, box, rays, scratch) if few else _all_enter(matrix, box, rays, scratch)
    if alone == 0:
        return
    entered = alone
    if not few:
        alone = _trace_groups(world.table, model, entered, any_hit, scratch)
    while alone != 0:
        i = count_trailing_zeros(alone)
        alone &= alone - 1
        hit = closest(world.table, model, tile_ray(rows, i), any_hit, scratch)
        numbers[sc.FOUND + i] = hit.leaf
        rows[sc.HIT_T + i] = hit.t
        store3(rows, sc.NX + i, (hit.nx, hit.ny, hit.nz))
    if few:
        while entered != 0:
            i = count_trailing_zeros(entered)
            entered &= entered - 1
            if numbers[sc.FOUND + i] >= 0:
                _keep_t(offset // INSTANCE, i, scratch)
                _keep_normal_and_position(of_size_one(matrix), i, scratch)
                _keep_leaf(offset, i, scratch)
    else:
        _keep_nearest(matrix, offset, scratch)


@inline
def _keep_t(row: int, i: int, scratch: Scratch) -> None:
    """Store t of ray i's hit with an instance if it is nearer than an earlier hit; otherwise discard the hit.

    row : index of the instance

    Of hits at the same t the one with the first instance wins, in any order of traversal; one with a plane comes last.
    """
    wide, numbers = scratch.world, scratch.numbers
    t, t_before, row_before = (
        (wide[sc.LOW + i] + f64(scratch.model[sc.HIT_T + i])) / wide[sc.SPEED + i],
        wide[sc.NEAREST + i],
        numbers[sc.INSTANCE_OF + i],
    )
    first = (row_before < 0) | (row < row_before) | (numbers[sc.LEAF_OF + i] < 0)
    better = (numbers[sc.FOUND + i] >= 0) & ((t < t_before) | ((t == t_before) & first))
    wide[sc.NEAREST + i] = t if better else wide[sc.NEAREST + i]
    numbers[sc.FOUND + i] = numbers[sc.FOUND + i] if better else -1


@inline
def _keep_normal_and_position(matrix: ToModel, i: int, scratch: Scratch) -> None:
    """Store normal (in world space) and position (in the model's) of ray i's hit, if it was nearer than earlier ones.

    matrix : from the world to the model, its components scaled to at most 1
    """
    wide, rows = scratch.world, scratch.model
    n = load3(rows, sc.NX + i)
    n = transform_transposed(matrix, (f64(n[0]), f64(n[1]), f64(n[2])))
    n = scale(n, 1.0 / math.sqrt(dot(n, n)))
    x = add(load3(wide, sc.START + i), scale(load3(wide, sc.HEADING + i), f64(rows[sc.HIT_T + i])))
    better = scratch.numbers[sc.FOUND + i] >= 0
    old_n, old_x = load3(wide, sc.NORMAL + i), load3(wide, sc.LOCAL + i)
    store3(wide, sc.NORMAL + i, either(better, n, old_n))
    store3(wide, sc.LOCAL + i, either(better, x, old_x))


@inline
def _keep_leaf(offset: int, i: int, scratch: Scratch) -> None:
    """Store the instance and the leaf of ray i's hit, if it was nearer than earlier ones.

    offset : of the instance's record in `World.instances`
    """
    numbers = scratch.numbers
    if numbers[sc.FOUND + i] >= 0:
        numbers[sc.INSTANCE_OF + i], numbers[sc.LEAF_OF + i] = offset // INSTANCE, numbers[sc.FOUND + i]


@inline
def _keep_nearest(matrix: ToModel, offset: int, scratch: Scratch) -> None:
    """Store the tile's hits in a model that are nearer than earlier hits. No branches: rays are processed as vectors.

    matrix : from the world to the model; offset : of the instance's record in `World.instances`
    """
    found = False
    for i in range(sc.TILE):
        found |= scratch.numbers[sc.FOUND + i] >= 0
    if not found:
        return
    for i in range(sc.TILE):
        _keep_t(offset // INSTANCE, i, scratch)
    matrix = of_size_one(matrix)
    for i in range(sc.TILE):
        _keep_normal_and_position(matrix, i, scratch)
    for i in range(sc.TILE):
        _keep_leaf(offset, i, scratch)
