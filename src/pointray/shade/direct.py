"""Direct light at the hits of a tile: one shadow ray to the centre of each light; the sky by its irradiance.

Rays of mirrors and glass are in `shade/specular_rays.py`.
"""

from __future__ import annotations

import math

from ..engine.jit import inline
from ..engine.kernels import scratch as sc
from ..engine.kernels.records import LIGHT, LIGHT_KIND, POINT_LIGHT, SUN_LIGHT, World
from ..engine.kernels.scratch import Scratch, load3, store3
from ..engine.kernels.vec import BLACK, either, multiply, scale
from ..surface.trace.world import NO_RAY, is_blocked, occlude_tile, set_ray, set_ray_from
from .ambient import find_sky_seen
from .bsdf import ambient, emitted, eval_bsdf
from .emitters import from_center
from .shading_points import add_radiance, is_shaded, shading_point, start_of
from .sky import has_sky, sky_irradiance


@inline
def _arrive(world: World, light: int, kind: float, scratch: Scratch) -> None:
    """Set a ray from each of the tile's surface points to the centre of a light; store its unoccluded light (row GAIN).

    Rays without a surface point are computed too: a loop without branches is vectorized.

    light : offset of its record in `world.lights`; kind : of the light, as in `records.LIGHT_KIND`
    """
    points = scratch.shading_points
    for i in range(sc.TILE):
        x = start_of(scratch, i, points[sc.SHADING_SIDE + i])
        incoming = from_center(world, light, kind, x)
        store3(points, sc.GAIN + i, incoming.light)
        set_ray_from(scratch, i, (x, incoming.wi, 0.0, incoming.distance), points[sc.SHADING_SIDE + i])


@inline
def _light_from(world: World, light: int, scratch: Scratch) -> bool:
    """Set shadow rays to the centre of a light; store what the tile's points reflect if unoccluded (row GAIN).

    Returns whether the light adds anything. light : offset of its record in `world.lights`
    """
    points, lit, kind = scratch.shading_points, False, world.lights[light + LIGHT_KIND]
    if kind == POINT_LIGHT:
        _arrive(world, light, POINT_LIGHT, scratch)
    elif kind == SUN_LIGHT:
        _arrive(world, light, SUN_LIGHT, scratch)
    else:
        _arrive(world, light, kind, scratch)
    for i in range(sc.TILE):
        gain = BLACK
        if is_shaded(scratch, i):
            material, point = shading_point(world, scratch, i)
            wi = load3(scratch.world, sc.DIRECTION + i)
            gain = multiply(eval_bsdf(world, material, point, wi)[0], load3(points, sc.GAIN + i))
        store3(points, sc.GAIN + i, gain)
        if gain[0] + gain[1] + gain[2] > 0.0:
            lit = True
        else:
            set_ray(scratch, i, NO_RAY)
    return lit


@inline
def shade_gains(scratch: Scratch) -> None:
    """Set a light's contribution to the tile's points (row GAIN) to 0 where their traced shadow rays are blocked.

    It has no branches, so that it is vectorized.
    """
    points = scratch.shading_points
    for i in range(sc.TILE):
        store3(points, sc.GAIN + i, either(is_blocked(scratch, i), BLACK, load3(points, sc.GAIN + i)))


@inline
def light_tile(world: World, shadows: bool, look: tuple[int, int, float], scratch: Scratch) -> None:
    """Add the radiance that the tile's surface points reflect along its rays. Overwrites the rays.

    A scene without lights has a headlight at the origin of the rays, of irradiance pi, without fall-off and shadows.

    shadows : whether to trace shadow rays to lights
    look : (sample index, rays per point, ray length) of ambient occlusion, by which the sky's light is reduced
    """
    dark = world.lights.size == 0 and not has_sky(world)
    if has_sky(world):
        find_sky_seen(world, look, scratch)
    for i in range(sc.TILE):
        if is_shaded(scratch, i):
            material, point = shading_point(world, scratch, i)
            add_radiance(scratch, i, emitted(world, material))
            if dark:
                add_radiance(scratch, i, scale(eval_bsdf(world, material, point, point.wo)[0], math.pi))
            elif has_sky(world):
                even = sky_irradiance(world, load3(scratch.shading_points, sc.SHADING_NORMAL + i))
                share = scratch.shading_points[sc.SKY_SEEN + i] / math.pi
                add_radiance(scratch, i, multiply(ambient(world, material, point), scale(even, share)))
    for light in range(0, world.lights.size, LIGHT):
        if not _light_from(world, light, scratch):
            continue
        if shadows:
            occlude_tile(world, scratch)
            shade_gains(scratch)
        for i in range(sc.TILE):
            add_radiance(scratch, i, load3(scratch.shading_points, sc.GAIN + i))
