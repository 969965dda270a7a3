"""Intersection of rays with planes, and the planes' colours."""

from __future__ import annotations

import math

import numpy as np

from ...engine.jit import i64, inline
from ...engine.kernels import records as rec, scratch as sc
from ...engine.kernels.records import World
from ...engine.kernels.scratch import Scratch, load3, store3
from ...engine.kernels.vec import Vec3, add, dot, length, load3_flat, scale, sub
from ...engine.simd import ZERO
from .space import WorldRay

ON_PLANE = 1e-12  # share of the coordinates within which a ray starts on a plane: some thousand rounding errors


@inline
def _plane_hit(world: World, plane: int, ray: WorldRay, start_rule: tuple[float, float]) -> float:
    """Return t of a ray's hit with a plane, inf for a miss.

    A ray that starts on the plane hits it only if it goes to the other side, or if a clip plane has cut it there.

    plane : where the plane's record begins in `World.planes`; ray : origin, direction, t_min, t_max
    start_rule : (side, cut), +1 or -1 for the side of the surface on which the ray starts; nonzero if a clip plane has
        cut the ray
    """
    o, d, t_min, t_max = ray
    side, cut = start_rule
    normal, point = (
        load3_flat(world.planes, plane + rec.PLANE_NORMAL),
        load3_flat(world.planes, plane + rec.PLANE_POINT),
    )
    height, rise = dot(normal, sub(o, point)), dot(normal, d)
    if t_min > -np.inf and abs(height + t_min * rise) <= ON_PLANE * (length(add(o, scale(d, t_min))) + length(point)):
        return t_min if (cut > ZERO or rise * side < 0.0) and t_min <= t_max else np.inf
    t = -height / rise
    return t if t >= t_min and t <= t_max else np.inf


@inline
def plane_color(world: World, plane: int, x: Vec3) -> Vec3:
    """Return a plane's colour at a point x, linear RGB: plain, or a checker with every other square half as bright.

    plane : offset of its record in `World.planes`
    """
    color = load3_flat(world.planes, plane + rec.PLANE_COLOR)
    edge = world.planes[plane + rec.PLANE_CHECKER]
    if edge > 0.0:
        v = sub(x, load3_flat(world.planes, plane + rec.PLANE_POINT))
        a = math.floor(dot(v, load3_flat(world.planes, plane + rec.PLANE_U)) / edge)
        b = math.floor(dot(v, load3_flat(world.planes, plane + rec.PLANE_V)) / edge)
        if int(a + b) % 2 != 0:
            return scale(color, 0.5)
    return color


@inline
def tile_on_plane(world: World, plane: int, scratch: Scratch) -> None:
    """Find hits of the tile's rays with a plane that are nearer than earlier hits.

    plane : offset of its record in `World.planes`
    """
    wide, numbers = scratch.world, scratch.numbers
    for i in range(sc.TILE):
        o, d = load3(wide, sc.ORIGIN + i), load3(wide, sc.DIRECTION + i)
        start_rule = wide[sc.SIDE_OF + i], scratch.model[sc.CUT + i]
        t = _plane_hit(world, plane, (o, d, wide[sc.T_MIN + i], wide[sc.NEAREST + i]), start_rule)
        if t < np.inf:
            wide[sc.NEAREST + i] = t
            store3(wide, sc.NORMAL + i, load3_flat(world.planes, plane + rec.PLANE_NORMAL))
            store3(wide, sc.COLOR + i, plane_color(world, plane, add(o, scale(d, t))))
            numbers[sc.INSTANCE_OF + i], numbers[sc.LEAF_OF + i] = i64(world.planes[plane + rec.PLANE_INSTANCE]), -1
