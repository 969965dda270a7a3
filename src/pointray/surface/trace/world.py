"""Intersection of a tile of rays with the scene: candidate instances, all planes, and the nearest hit.

Rays are float64 in world space.
"""

from __future__ import annotations

import numpy as np

from ...engine.jit import borrow, i64, inline, routine
from ...engine.kernels import scratch as sc
from ...engine.kernels.records import CLIP, CLIP_OFFSET, INSTANCE, PLANE_SIZE, World
from ...engine.kernels.scratch import Scratch, load3, store3
from ...engine.kernels.vec import Vec3, dot, either, length, load3_flat
from ...engine.simd import ONE, ZERO
from .instance import through_instance
from .instance_bvh import begin_walk, open_node, shorten, still_open
from .plane import ON_PLANE, tile_on_plane
from .space import WorldRay

NO_RAY = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, -1.0)  # a ray that hits nothing, for free slots in a tile


@inline
def is_ray(o: Vec3, d: Vec3, t_min: float, t_max: float) -> bool:
    """Return whether a ray can hit anything: finite, with a nonzero direction and a nonempty interval."""
    square = dot(d, d)
    return (square > 0.0) & (square < np.inf) & (dot(o, o) < np.inf) & (t_min <= t_max)


@inline
def set_ray(scratch: Scratch, i: int, ray: WorldRay) -> None:
    """Set ray i of the tile, like that of a camera or a caller: outside of the surface that it may start on.

    ray : origin, direction, t_min, t_max
    """
    set_ray_from(scratch, i, ray, sc.ANYWHERE)


@inline
def set_ray_from(scratch: Scratch, i: int, ray: WorldRay, side: float) -> None:
    """Set ray i of the tile, which may start on a surface.

    ray : origin, direction, t_min, t_max
    side : +1 if it starts outside of that surface (where normals point), -1 if inside
    """
    wide = scratch.world
    wide[sc.SIDE_OF + i] = side
    store3(wide, sc.ORIGIN + i, ray[0])
    store3(wide, sc.DIRECTION + i, ray[1])
    wide[sc.T_MIN + i], wide[sc.NEAREST + i] = ray[2], ray[3]


@inline
def _settle(scratch: Scratch) -> None:
    """Reset all hits of the tile; make degenerate rays miss everything. No branches: rays are processed as vectors."""
    wide = scratch.world
    for i in range(sc.TILE):
        o, d, t_min, t_max = (
            load3(wide, sc.ORIGIN + i),
            load3(wide, sc.DIRECTION + i),
            wide[sc.T_MIN + i],
            wide[sc.NEAREST + i],
        )
        good = is_ray(o, d, t_min, t_max)
        store3(wide, sc.ORIGIN + i, either(good, o, (0.0, 0.0, 0.0)))
        store3(wide, sc.DIRECTION + i, either(good, d, (1.0, 0.0, 0.0)))
        wide[sc.T_MIN + i], wide[sc.NEAREST + i] = (t_min if good else 0.0), (t_max if good else -1.0)
    for i in range(sc.TILE):
        scratch.numbers[sc.INSTANCE_OF + i] = -1


@inline
def _cut_by(world: World, clip: int, scratch: Scratch) -> None:
    """Cut the tile's rays by one clip plane. No branches: the rays are processed as vectors.

    clip : offset of the plane in `World.clips`
    """
    wide = scratch.world
    normal, offset = load3_flat(world.clips, clip), world.clips[clip + CLIP_OFFSET]
    for i in range(sc.TILE):
        o, d, t_min = load3(wide, sc.ORIGIN + i), load3(wide, sc.DIRECTION + i), wide[sc.T_MIN + i]
        height, rise = dot(normal, o) - offset, dot(normal, d)
        t = -height / rise
        # A ray parallel to the plane is kept or cut as a whole.
        low = t if rise < 0.0 else -np.inf
        high = t if rise > 0.0 else (-np.inf if (rise == 0.0) & (height > 0.0) else np.inf)
        # The start of a ray on a surface that touches the plane may lie beyond the plane by a rounding error.
        beyond = height + t_min * rise > ON_PLANE * (length(o) + abs(offset))
        scratch.model[sc.CUT + i] = ONE if (low > t_min) & beyond else scratch.model[sc.CUT + i]
        wide[sc.T_MIN + i] = low if low > t_min else t_min
        wide[sc.NEAREST + i] = high if high < wide[sc.NEAREST + i] else wide[sc.NEAREST + i]


@inline
def _cut(world: World, scratch: Scratch) -> None:
    """Cut the tile's rays by all clip planes of the scene; a ray without a remaining part misses everything."""
    wide = scratch.world
    for i in range(sc.TILE):
        scratch.model[sc.CUT + i] = ZERO
    for clip in range(0, world.clips.size, CLIP):
        _cut_by(world, clip, scratch)
    for i in range(sc.TILE):
        left = (wide[sc.T_MIN + i] <= wide[sc.NEAREST + i]) & (wide[sc.T_MIN + i] < np.inf)
        wide[sc.T_MIN + i], wide[sc.NEAREST + i] = (
            (wide[sc.T_MIN + i] if left else 0.0),
            (wide[sc.NEAREST + i] if left else -1.0),
        )


@inline
def _end_where_hit(scratch: Scratch) -> None:
    """End the tile's rays that have a hit, so that the search for occlusion ignores them from now on."""
    for i in range(sc.TILE):
        wide = scratch.world
        wide[sc.NEAREST + i] = -1.0 if scratch.numbers[sc.INSTANCE_OF + i] >= 0 else wide[sc.NEAREST + i]


@routine
def find_hits(world: World, any_hit: bool, scratch: Scratch) -> None:
    """Find the nearest hits of the tile's rays with everything in the scene; for occlusion (`any_hit`) any hits."""
    # Borrow again: a routine does not know that its caller already did.
    scratch, world = borrow(scratch), borrow(world)
    _settle(scratch)
    if world.clips.size > 0:
        _cut(world, scratch)
    for plane in range(0, world.planes.size, PLANE_SIZE):
        tile_on_plane(world, plane, scratch)
    if any_hit:
        _end_where_hit(scratch)
    waiting = begin_walk(world, scratch)
    while waiting > 0:
        waiting -= 1
        what, rays = scratch.top_what[waiting], still_open(world, waiting, scratch)
        if rays == 0:
            continue
        if what >= 0:
            waiting = open_node(world, what, rays, waiting, scratch)
        else:
            through_instance(world, i64(~what) * INSTANCE, rays, any_hit, scratch)
            if any_hit:
                _end_where_hit(scratch)
            shorten(world, scratch)


@inline
def trace_tile(world: World, scratch: Scratch) -> None:
    """Find the nearest hits of the tile's rays with everything in the scene; `hits.tile_hit` returns them."""
    find_hits(world, False, scratch)


@inline
def occlude_tile(world: World, scratch: Scratch) -> None:
    """Find out which of the tile's rays hit anything; `is_blocked` returns it. Their hits are undefined afterwards."""
    find_hits(world, True, scratch)


@inline
def is_blocked(scratch: Scratch, i: int) -> bool:
    """Return whether ray i of the tile has hit anything, after `trace_tile` or `occlude_tile`."""
    return scratch.numbers[sc.INSTANCE_OF + i] >= 0


@inline
def meets_nothing(scratch: Scratch) -> bool:
    """Return whether all of the tile's rays miss, after `trace_tile` or `occlude_tile`."""
    greatest = i64(-1)
    for i in range(sc.TILE):
        greatest = max(greatest, scratch.numbers[sc.INSTANCE_OF + i])
    return greatest < 0
