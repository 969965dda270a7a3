"""Rays from mirrors, glass and narrow lobes, kept on a stack for each ray of the tile until they are traced."""

from __future__ import annotations

import numpy as np

from ..engine.jit import inline
from ..engine.kernels import scratch as sc
from ..engine.kernels.records import DIELECTRIC, MATERIAL_KIND, World
from ..engine.kernels.scratch import Scratch, load3, store3
from ..engine.kernels.vec import BLACK, Vec3, load3_flat, multiply, scale
from ..surface.trace.world import NO_RAY, set_ray, set_ray_from
from .bsdf import is_specular, sample_bsdf
from .materials.specular import glass
from .shading_points import is_shaded, shading_point, start_of

FAINT = 1e-3  # rays of lower throughput are not traced


@inline
def begin_specular(scratch: Scratch) -> None:
    """Clear the stacks of pending rays from mirrors and glass, one stack for each ray of the tile."""
    for i in range(sc.TILE):
        scratch.numbers[sc.WAITING_COUNT + i] = 0
        scratch.shading_points[sc.SHADING_DEPTH + i] = 0.0


@inline
def push_ray(scratch: Scratch, i: int, d: Vec3, weight: Vec3, side: float) -> None:
    """Push a ray that leaves surface point i in direction d onto the stack of rays to trace later.

    Rays of throughput below FAINT are dropped.

    weight : throughput, RGB; side : of the surface on which the ray leaves, +1 or -1
    """
    count = scratch.numbers[sc.WAITING_COUNT + i]
    if max(weight[0], weight[1], weight[2]) < FAINT or count == sc.MOST_WAITING:
        return
    at, x = (i * sc.MOST_WAITING + count) * sc.WAITING, start_of(scratch, i, side)
    for c in range(3):
        scratch.waiting[at + sc.WAIT_ORIGIN + c] = x[c]
        scratch.waiting[at + sc.WAIT_DIRECTION + c] = d[c]
        scratch.waiting[at + sc.WAIT_THROUGHPUT + c] = weight[c]
    scratch.waiting[at + sc.WAIT_SIDE] = side
    scratch.waiting[at + sc.WAIT_DEPTH] = scratch.shading_points[sc.SHADING_DEPTH + i] + 1.0
    scratch.numbers[sc.WAITING_COUNT + i] = count + 1


@inline
def spawn_specular(world: World, max_depth: int, scratch: Scratch) -> None:
    """Push the reflected and refracted rays of the tile's hits on mirrors and glass onto its stacks of pending rays.

    max_depth : largest number of such reflections and refractions along a ray
    """
    for i in range(sc.TILE):
        if not is_shaded(scratch, i) or scratch.shading_points[sc.SHADING_DEPTH + i] >= max_depth:
            continue
        material, point = shading_point(world, scratch, i)
        if not is_specular(world, material):
            continue
        weight, side = load3(scratch.shading_points, sc.THROUGHPUT + i), scratch.shading_points[sc.SHADING_SIDE + i]
        if world.materials[material + MATERIAL_KIND] == DIELECTRIC:
            reflected, refracted, share = glass(world, material, point)
            push_ray(scratch, i, reflected, scale(weight, share), side)
            push_ray(scratch, i, refracted, scale(weight, 1.0 - share), -side)
        else:
            d, tint, _, side = sample_bsdf(world, material, point, 0.0, 0.0, 0.0)
            push_ray(scratch, i, d, multiply(weight, tint), side)


@inline
def set_specular_rays(scratch: Scratch) -> bool:
    """Replace each ray of the tile by the last pending one of its stack, or by none; return whether there are any."""
    some = False
    for i in range(sc.TILE):
        count = scratch.numbers[sc.WAITING_COUNT + i] - 1
        if count < 0:
            set_ray(scratch, i, NO_RAY)
            # It hits nothing, and must not add the background.
            store3(scratch.shading_points, sc.THROUGHPUT + i, BLACK)
            continue
        some = True
        scratch.numbers[sc.WAITING_COUNT + i] = count
        at = (i * sc.MOST_WAITING + count) * sc.WAITING
        o, d = load3_flat(scratch.waiting, at + sc.WAIT_ORIGIN), load3_flat(scratch.waiting, at + sc.WAIT_DIRECTION)
        set_ray_from(scratch, i, (o, d, 0.0, np.inf), scratch.waiting[at + sc.WAIT_SIDE])
        store3(scratch.shading_points, sc.THROUGHPUT + i, load3_flat(scratch.waiting, at + sc.WAIT_THROUGHPUT))
        scratch.shading_points[sc.SHADING_DEPTH + i] = scratch.waiting[at + sc.WAIT_DEPTH]
    return some
