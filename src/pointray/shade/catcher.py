"""Shadow catchers: planes that show only shadows; the light that arrives at them, and the light that would arrive.

Blocked light is 1 - LIT / UNLIT, with sums over a pixel's samples (`rendering/film.py`): the same samples find both
sums, so that nothing is taken away where nothing blocks. Light is counted as luminance, weighted by its cosine; light
that other surfaces reflect onto a catcher is not counted.
"""

from __future__ import annotations

import math

import numpy as np

from ..engine.jit import i64, inline
from ..engine.kernels.records import CATCHER, INSTANCE, KIND, LIGHT, LIGHT_KIND, World
from ..engine.kernels.sampling import DIRECTION_OF, ON_LIGHT, ON_PATH, sample_pair
from ..engine.kernels.scratch import (
    CAUGHT,
    GAIN,
    KEY,
    LIT,
    RADIANCE,
    SHADING_INSTANCE,
    SHADING_NORMAL,
    SHADING_POINT,
    SHADING_SIDE,
    SHADING_WO,
    TILE,
    UNLIT,
    Scratch,
    load3,
    store3,
)
from ..engine.kernels.vec import BLACK, Vec3, dot, luminance, scale
from ..engine.simd import Bits, count_trailing_zeros
from ..surface.trace.world import NO_RAY, is_blocked, occlude_tile, set_ray, set_ray_from
from .choice import meets_lamp
from .emitters import from_middle, sample_light
from .materials.diffuse import sample_diffuse
from .shading_points import add_radiance
from .sky import has_sky, is_chosen, sample_sky, sky_irradiance, sky_radiance


@inline
def find_caught(world: World, scratch: Scratch) -> Bits:
    """Store in CAUGHT which of the tile's surface points, at the camera's first hits, are a catcher's; returns them."""
    bits, points = i64(0), scratch.shading_points
    if world.catchers > 0:
        for i in range(TILE):
            instance = int(points[SHADING_INSTANCE + i])
            if instance >= 0 and world.instances[instance * INSTANCE + KIND] == CATCHER:
                bits |= i64(1) << i
                points[UNLIT + i] = points[LIT + i] = 0.0
    scratch.counts[CAUGHT] = bits
    return bits


@inline
def _ask_nothing(scratch: Scratch) -> None:
    for i in range(TILE):
        set_ray(scratch, i, NO_RAY)


@inline
def _ask(scratch: Scratch, i: int, light: float, wi: Vec3, distance: float) -> None:
    """Store light that would arrive at catcher i, and set the ray that tells whether it does."""
    scratch.shading_points[GAIN + i] = light
    if light > 0.0:
        ray = load3(scratch.shading_points, SHADING_POINT + i), wi, 0.0, distance
        set_ray_from(scratch, i, ray, scratch.shading_points[SHADING_SIDE + i])


@inline
def _answer(world: World, caught: Bits, shadows: bool, scratch: Scratch) -> None:
    """Add the stored light to what would arrive, and, where nothing blocks it, to what does arrive."""
    points = scratch.shading_points
    if shadows:
        occlude_tile(world, scratch)
    while caught != 0:
        i = count_trailing_zeros(caught)
        caught &= caught - 1
        points[UNLIT + i] += points[GAIN + i]
        if not shadows or not is_blocked(scratch, i):
            points[LIT + i] += points[GAIN + i]


@inline
def _leave(caught: Bits, scratch: Scratch) -> None:
    """Exclude catchers from the surface points that are shaded."""
    for i in range(TILE):
        if (caught >> i) & 1 != 0:
            scratch.shading_points[SHADING_INSTANCE + i] = -1.0
            store3(scratch.shading_points, RADIANCE + i, BLACK)


@inline
def _unshadowed(world: World, i: int, scratch: Scratch) -> float:
    """Light at catcher i that has no shadows with direct light: the sky's, or a headlight's."""
    if has_sky(world):
        return luminance(sky_irradiance(world, load3(scratch.shading_points, SHADING_NORMAL + i)))
    return 1.0 if world.lights.size == 0 else 0.0


@inline
def catch_direct(world: World, caught: Bits, shadows: bool, scratch: Scratch) -> None:
    """Direct light at the tile's catchers (bits), each light from its middle. Uses the tile's rays."""
    for i in range(TILE):
        if (caught >> i) & 1 != 0:
            light = _unshadowed(world, i, scratch)
            scratch.shading_points[UNLIT + i], scratch.shading_points[LIT + i] = light, light
    for at in range(0, world.lights.size, LIGHT):
        _ask_nothing(scratch)
        for i in range(TILE):
            if (caught >> i) & 1 != 0:
                incoming = from_middle(
                    world, at, world.lights[at + LIGHT_KIND], load3(scratch.shading_points, SHADING_POINT + i)
                )
                cosine = max(dot(load3(scratch.shading_points, SHADING_NORMAL + i), incoming.wi), 0.0)
                _ask(scratch, i, luminance(incoming.light) * cosine, incoming.wi, incoming.distance)
        _answer(world, caught, shadows, scratch)
    _leave(caught, scratch)


@inline
def catch_occlusion(caught: Bits, scratch: Scratch) -> None:
    """Count which rays of ambient occlusion are free, after they are traced."""
    for i in range(TILE):
        if (caught >> i) & 1 != 0:
            scratch.shading_points[UNLIT + i] = 1.0
            scratch.shading_points[LIT + i] = 0.0 if is_blocked(scratch, i) else 1.0
    _leave(caught, scratch)


@inline
def _ask_lamp(world: World, light: int, i: int, sample: int, scratch: Scratch) -> None:
    """Ask at catcher i for light from a point on a light."""
    x, normal = load3(scratch.shading_points, SHADING_POINT + i), load3(scratch.shading_points, SHADING_NORMAL + i)
    u, v = sample_pair(int(scratch.shading_points[KEY + i]), sample, ON_PATH + ON_LIGHT)
    incoming = sample_light(world, light, x, u, v)
    cosine = max(dot(normal, incoming.wi), 0.0)
    _ask(scratch, i, luminance(incoming.light) * cosine, incoming.wi, incoming.distance)


@inline
def _ask_sky(world: World, i: int, sample: int, scratch: Scratch) -> None:
    """Ask at catcher i for light from all around: a direction chosen by a sky picture's light, else by the cosine."""
    x, normal = load3(scratch.shading_points, SHADING_POINT + i), load3(scratch.shading_points, SHADING_NORMAL + i)
    u, v = sample_pair(int(scratch.shading_points[KEY + i]), sample, ON_PATH + DIRECTION_OF)
    if is_chosen(world):
        incoming = sample_sky(world, u, v)
        d, light = incoming.wi, scale(incoming.light, max(dot(normal, incoming.wi), 0.0))
    else:
        d = sample_diffuse(normal, u, v)
        light = scale(sky_radiance(world, d), math.pi)
    _ask(scratch, i, 0.0 if meets_lamp(world, (x, d), np.inf) else luminance(light), d, np.inf)


@inline
def catch_paths(world: World, sample: int, sky_shows: bool, scratch: Scratch) -> Bits:
    """All light at the tile's catchers, from a point on each light and from one direction of the sky.

    Every light is sampled, not one by chance: what would arrive is nearly the same in all samples, so a quotient of few
    sums is nearly right. Half below a rectangle whose light differs threefold from end to end, the quotient is 0.40 on
    average with 1 sample, 0.307 with 4, 0.303 with 64.

    sky_shows : whether the sky is seen behind them; catchers then darken it. Else they stay in CAUGHT, to become alpha.
    Returns those that stay.
    """
    caught, sky = scratch.counts[CAUGHT], world.lights.size
    for light in range(0, sky + LIGHT, LIGHT):
        if light == sky and not has_sky(world):
            continue
        _ask_nothing(scratch)
        for i in range(TILE):
            if (caught >> i) & 1 != 0:
                if light == sky:
                    _ask_sky(world, i, sample, scratch)
                else:
                    _ask_lamp(world, light, i, sample, scratch)
        _answer(world, caught, True, scratch)
    _leave(caught, scratch)
    return show_caught(world, sky_shows, scratch)


@inline
def show_caught(world: World, sky_shows: bool, scratch: Scratch) -> Bits:
    """Where the sky shows, catchers show it, scaled by their share of the light, and are no longer in CAUGHT.

    Returns those that still are, to become alpha.
    """
    caught, points = scratch.counts[CAUGHT], scratch.shading_points
    if not sky_shows:
        return caught
    scratch.counts[CAUGHT] = 0
    for i in range(TILE):
        if (caught >> i) & 1 != 0:
            behind = sky_radiance(world, scale(load3(points, SHADING_WO + i), -1.0))
            add_radiance(
                scratch, i, scale(behind, points[LIT + i] / points[UNLIT + i] if points[UNLIT + i] > 0.0 else 1.0)
            )
    return i64(0)
