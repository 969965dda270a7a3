"""Shadow catchers: planes that show only shadows, from the light that arrives and the light without occlusion.

The shadow is 1 - LIT / UNLIT, of sums over a pixel's samples (`rendering/film.py`). Both sums use the same samples, so
that it is exactly 0 without occlusion. Light is counted as luminance times cosine; light that other surfaces reflect
onto a catcher is not counted.
"""

from __future__ import annotations

import math

import numpy as np

from ..engine.jit import i64, inline
from ..engine.kernels import scratch as sc
from ..engine.kernels.records import CATCHER, INSTANCE, KIND, LIGHT, LIGHT_KIND, World
from ..engine.kernels.sampling import DIRECTION_OF, ON_LIGHT, ON_PATH, sample_pair
from ..engine.kernels.scratch import Scratch, load3, store3
from ..engine.kernels.vec import BLACK, Vec3, dot, luminance, scale
from ..engine.simd import Bits, count_trailing_zeros
from ..surface.trace.world import NO_RAY, is_blocked, occlude_tile, set_ray, set_ray_from
from .choice import meets_lamp
from .emitters import from_center, sample_light
from .materials.diffuse import sample_diffuse
from .shading_points import add_radiance
from .sky import has_sky, is_importance_sampled, sample_sky, sky_irradiance, sky_radiance


@inline
def find_caught(world: World, scratch: Scratch) -> Bits:
    """Find which of the camera's first hits are on shadow catchers, planes that show only shadows; return them (bits).

    They are also stored in CAUGHT of the scratch. Their sums of light with and without occlusion, in rows LIT and
    UNLIT, are cleared.
    """
    bits, points = i64(0), scratch.shading_points
    if world.catchers > 0:
        for i in range(sc.TILE):
            instance = int(points[sc.SHADING_INSTANCE + i])
            if instance >= 0 and world.instances[instance * INSTANCE + KIND] == CATCHER:
                bits |= i64(1) << i
                points[sc.UNLIT + i] = points[sc.LIT + i] = 0.0
    scratch.counts[sc.CAUGHT] = bits
    return bits


@inline
def _clear_rays(scratch: Scratch) -> None:
    for i in range(sc.TILE):
        set_ray(scratch, i, NO_RAY)


@inline
def _set_shadow_ray(scratch: Scratch, i: int, light: float, wi: Vec3, distance: float) -> None:
    """Set a shadow ray from the hit of ray i on a shadow catcher to a light, and store its light if unoccluded.

    light : luminance times cosine; wi, distance : unit direction and distance of the light
    """
    scratch.shading_points[sc.GAIN + i] = light
    if light > 0.0:
        ray = load3(scratch.shading_points, sc.SHADING_POINT + i), wi, 0.0, distance
        set_ray_from(scratch, i, ray, scratch.shading_points[sc.SHADING_SIDE + i])


@inline
def _add_unblocked(world: World, caught: Bits, shadows: bool, scratch: Scratch) -> None:
    """Trace the shadow rays of shadow catchers, and add the light stored for each to the catcher's sums.

    The sums are UNLIT, of all light, and LIT, of light that is not blocked.

    caught : the rays of the tile that have hit a catcher; shadows : whether to trace, else nothing is blocked
    """
    points = scratch.shading_points
    if shadows:
        occlude_tile(world, scratch)
    while caught != 0:
        i = count_trailing_zeros(caught)
        caught &= caught - 1
        points[sc.UNLIT + i] += points[sc.GAIN + i]
        if not shadows or not is_blocked(scratch, i):
            points[sc.LIT + i] += points[sc.GAIN + i]


@inline
def _exclude(caught: Bits, scratch: Scratch) -> None:
    """Mark hits on shadow catchers as misses without radiance, so that they are not shaded like surfaces.

    caught : the rays of the tile that have hit a catcher
    """
    for i in range(sc.TILE):
        if (caught >> i) & 1 != 0:
            scratch.shading_points[sc.SHADING_INSTANCE + i] = -1.0
            store3(scratch.shading_points, sc.RADIANCE + i, BLACK)


@inline
def _unshadowed(world: World, i: int, scratch: Scratch) -> float:
    """Return the light at the hit of ray i on a shadow catcher that direct lighting treats as unoccluded.

    It is the luminance of the sky's irradiance, or 1 for the headlight of a scene without lights.
    """
    if has_sky(world):
        return luminance(sky_irradiance(world, load3(scratch.shading_points, sc.SHADING_NORMAL + i)))
    return 1.0 if world.lights.size == 0 else 0.0


@inline
def catch_direct(world: World, caught: Bits, shadows: bool, scratch: Scratch) -> None:
    """Compute direct light, with and without occlusion, where the tile's rays have hit shadow catchers.

    Light comes from the centre of each light. Overwrites the tile's rays.

    caught : the rays that have hit a catcher; shadows : whether to trace shadow rays
    """
    for i in range(sc.TILE):
        if (caught >> i) & 1 != 0:
            light = _unshadowed(world, i, scratch)
            scratch.shading_points[sc.UNLIT + i], scratch.shading_points[sc.LIT + i] = light, light
    for at in range(0, world.lights.size, LIGHT):
        _clear_rays(scratch)
        for i in range(sc.TILE):
            if (caught >> i) & 1 != 0:
                incoming = from_center(
                    world, at, world.lights[at + LIGHT_KIND], load3(scratch.shading_points, sc.SHADING_POINT + i)
                )
                cosine = max(dot(load3(scratch.shading_points, sc.SHADING_NORMAL + i), incoming.wi), 0.0)
                _set_shadow_ray(scratch, i, luminance(incoming.light) * cosine, incoming.wi, incoming.distance)
        _add_unblocked(world, caught, shadows, scratch)
    _exclude(caught, scratch)


@inline
def catch_occlusion(caught: Bits, scratch: Scratch) -> None:
    """Store at shadow catchers whether their ambient occlusion rays, already traced, are blocked.

    caught : the rays of the tile that have hit a catcher
    """
    for i in range(sc.TILE):
        if (caught >> i) & 1 != 0:
            scratch.shading_points[sc.UNLIT + i] = 1.0
            scratch.shading_points[sc.LIT + i] = 0.0 if is_blocked(scratch, i) else 1.0
    _exclude(caught, scratch)


@inline
def _sample_lamp_at(world: World, light: int, i: int, sample: int, scratch: Scratch) -> None:
    """Sample a point on a light, and set a shadow ray to it from the hit of ray i on a shadow catcher.

    light : offset of its record in `world.lights`; sample : index of the sample
    """
    x, normal = (
        load3(scratch.shading_points, sc.SHADING_POINT + i),
        load3(scratch.shading_points, sc.SHADING_NORMAL + i),
    )
    u, v = sample_pair(int(scratch.shading_points[sc.KEY + i]), sample, ON_PATH + ON_LIGHT)
    incoming = sample_light(world, light, x, u, v)
    cosine = max(dot(normal, incoming.wi), 0.0)
    _set_shadow_ray(scratch, i, luminance(incoming.light) * cosine, incoming.wi, incoming.distance)


@inline
def _sample_sky_at(world: World, i: int, sample: int, scratch: Scratch) -> None:
    """Sample a direction of the sky, and set a shadow ray in it from the hit of ray i on a shadow catcher.

    An environment image is importance sampled, other skies by the cosine. sample : index of the sample
    """
    x, normal = (
        load3(scratch.shading_points, sc.SHADING_POINT + i),
        load3(scratch.shading_points, sc.SHADING_NORMAL + i),
    )
    u, v = sample_pair(int(scratch.shading_points[sc.KEY + i]), sample, ON_PATH + DIRECTION_OF)
    if is_importance_sampled(world):
        incoming = sample_sky(world, u, v)
        d, light = incoming.wi, scale(incoming.light, max(dot(normal, incoming.wi), 0.0))
    else:
        d = sample_diffuse(normal, u, v)
        light = scale(sky_radiance(world, d), math.pi)
    _set_shadow_ray(scratch, i, 0.0 if meets_lamp(world, (x, d), np.inf) else luminance(light), d, np.inf)


@inline
def catch_paths(world: World, sample: int, sky_shows: bool, scratch: Scratch) -> Bits:
    """Sample a point on each light and one direction of the sky, with shadow rays, at the hits on shadow catchers.

    All lights are sampled, not a random one: UNLIT then varies little between samples, which keeps the bias of the
    quotient LIT / UNLIT small. Half below a rectangle whose light varies threefold, the mean quotient is 0.40 with 1
    sample, 0.307 with 4, 0.303 with 64.

    sky_shows : whether the sky is visible behind catchers, which then darken it; else they become alpha

    Returns
    -------
    Bits
        The camera rays whose catchers become alpha.
    """
    caught, sky = scratch.counts[sc.CAUGHT], world.lights.size
    for light in range(0, sky + LIGHT, LIGHT):
        if light == sky and not has_sky(world):
            continue
        _clear_rays(scratch)
        for i in range(sc.TILE):
            if (caught >> i) & 1 != 0:
                if light == sky:
                    _sample_sky_at(world, i, sample, scratch)
                else:
                    _sample_lamp_at(world, light, i, sample, scratch)
        _add_unblocked(world, caught, True, scratch)
    _exclude(caught, scratch)
    return show_caught(world, sky_shows, scratch)


@inline
def show_caught(world: World, sky_shows: bool, scratch: Scratch) -> Bits:
    """Add the sky seen through shadow catchers, darkened by their shadow. Change nothing if the sky is not visible.

    sky_shows : whether the sky is visible

    Returns
    -------
    Bits
        The rays of the tile whose catchers become alpha: all or none.
    """
    caught, points = scratch.counts[sc.CAUGHT], scratch.shading_points
    if not sky_shows:
        return caught
    scratch.counts[sc.CAUGHT] = 0
    for i in range(sc.TILE):
        if (caught >> i) & 1 != 0:
            behind = sky_radiance(world, scale(load3(points, sc.SHADING_WO + i), -1.0))
            add_radiance(
                scratch,
                i,
                scale(behind, points[sc.LIT + i] / points[sc.UNLIT + i] if points[sc.UNLIT + i] > 0.0 else 1.0),
            )
    return i64(0)
