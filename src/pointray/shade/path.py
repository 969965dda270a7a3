"""Path tracing (Kajiya 1986): 64 paths of a tile together, scattering after scattering.

At each surface point one light is chosen and a place on it, and the material chooses where the path goes on. Light that
both ways can find counts by the power heuristic (Veach and Guibas 1995); paths that carry little end by chance, and
those that go on count for them. So the mean is exact for any number of samples.
"""

from __future__ import annotations

import numpy as np

from ..jit import inline
from ..kernels.records import LIGHT
from ..kernels.sampling import DIRECTION_OF, ON_LIGHT, ON_PATH, PER_SCATTERING, ROULETTE, WHICH, sample_pair
from ..kernels.scratch import (
    DENSITY,
    DIRECTION,
    GAIN,
    KEY,
    NEXT,
    NEXT_DENSITY,
    NEXT_SIDE,
    NEXT_WEIGHT,
    ORIGIN,
    SPOT,
    SPOT_INSTANCE,
    SPOT_WEIGHT,
    TILE,
    load3,
    store3,
)
from ..kernels.vec import BLACK, add, multiply, scale
from ..trace.hits import describe_tile, tile_hit
from ..trace.world import NO_RAY, occlude_tile, set_ray, set_ray_from, trace_tile
from .bsdf import emitted, is_specular, sample_scatter, scatter
from .catcher import catch_paths, find_caught
from .choice import chance_of, choose_light, meets_lamp, nearest_lamp, sky_chance, sun_after
from .direct import shade_gains
from .emitters import density_of_light, light_radiance, sample_light
from .sky import sample_sky, sky_density, sky_radiance
from .spots import add_radiance, is_spot, keep_spots, place_of

FAINT = 0.05  # a path that carries less goes on with this much, or ends by chance


@inline
def begin_paths(scratch):  # type: ignore[no-untyped-def]
    """The tile's rays are the camera's."""
    for i in range(TILE):
        scratch.spots[DENSITY + i] = 0.0


@inline
def _share(density, other):  # type: ignore[no-untyped-def]
    """How much light counts that was found with one density and might have been with another: the power heuristic.

    A density of 0 for what was found stands for a direction that only this way can choose.
    """
    if density == 0.0:
        return 1.0
    ratio = other / density
    return 1.0 / (1.0 + ratio * ratio)


@inline
def _add_distant(world, i, ray, scratch):  # type: ignore[no-untyped-def]
    """Light from infinitely far along ray i, which has met nothing."""
    density = scratch.spots[DENSITY + i]
    light = scale(sky_radiance(world, ray[1]), _share(density, sky_density(world, ray[1]) * sky_chance(world)))
    k = 0
    while True:
        k, sun, radiance, chosen = sun_after(world, k, ray[1])
        if k == 0:
            break
        light = add(light, scale(radiance, _share(density, chosen * chance_of(world, sun))))
    add_radiance(scratch, i, light)


@inline
def receive(world, depth, sky_shows, scratch):  # type: ignore[no-untyped-def]
    """Add the light that the tile's rays have met, and put down where the paths go on.

    sky_shows : whether a camera's ray that meets nothing sees the sky. Returns the rays that have met anything (bits).
    """
    spots, met = scratch.spots, np.int64(0)
    keep_spots(scratch)
    for i in range(TILE):
        weight = load3(spots, SPOT_WEIGHT + i)
        if weight[0] + weight[1] + weight[2] == 0.0:
            spots[SPOT_INSTANCE + i] = -1.0
            continue
        ray, hit = (load3(scratch.world, ORIGIN + i), load3(scratch.world, DIRECTION + i)), tile_hit(scratch, i)
        t, light = nearest_lamp(world, ray, hit.t)
        if light >= 0:
            chosen = density_of_light(world, light, ray[0], ray[1], t) * chance_of(world, light // LIGHT)
            radiance = light_radiance(world, light)
            add_radiance(scratch, i, scale(radiance, _share(spots[DENSITY + i], chosen)))
            spots[SPOT_INSTANCE + i] = -1.0
            met |= np.int64(1) << i
        elif hit.instance < 0:
            if depth > 0 or sky_shows:
                _add_distant(world, i, ray, scratch)
                met |= np.int64(1) << i
        else:
            add_radiance(scratch, i, emitted(world, place_of(world, scratch, i)[0]))
            met |= np.int64(1) << i
    return met


@inline
def _pair(scratch, i, sample, depth, which):  # type: ignore[no-untyped-def]
    """Two numbers in 0..1 for a decision at a scattering."""
    return sample_pair(int(scratch.spots[KEY + i]), sample, ON_PATH + depth * PER_SCATTERING + which)


@inline
def _light_at(world, i, sample, depth, which, scratch):  # type: ignore[no-untyped-def]
    """What arrives at surface point i from a place on a light; the sky's picture comes after all lights."""
    u, v = _pair(scratch, i, sample, depth, ON_LIGHT)
    if which * LIGHT < world.lights.size:
        return sample_light(world, which * LIGHT, load3(scratch.spots, SPOT + i), u, v)
    return sample_sky(world, u, v)


@inline
def _go_on(world, i, sample, depth, lobe, scratch):  # type: ignore[no-untyped-def]
    """Choose where a path goes on from surface point i, and whether."""
    spots = scratch.spots
    at, place = place_of(world, scratch, i)
    u, v = _pair(scratch, i, sample, depth, DIRECTION_OF)
    d, weight, density, side = sample_scatter(world, at, place, lobe, u, v)
    weight = multiply(load3(spots, SPOT_WEIGHT + i), weight)
    most = max(weight[0], weight[1], weight[2])
    if most < FAINT:
        share = most / FAINT
        weight = scale(weight, 1.0 / share) if _pair(scratch, i, sample, depth, ROULETTE)[0] < share else BLACK
    store3(spots, NEXT + i, d)
    store3(spots, NEXT_WEIGHT + i, weight)
    spots[NEXT_DENSITY + i], spots[NEXT_SIDE + i] = density, side


@inline
def scatter_paths(world, sample, depth, scratch):  # type: ignore[no-untyped-def]
    """At the tile's surface points: light from a light, shadowed, and the rays on which the paths go on."""
    spots, lit = scratch.spots, False
    for i in range(TILE):
        store3(spots, GAIN + i, BLACK)
        store3(spots, NEXT_WEIGHT + i, BLACK)
        set_ray(scratch, i, NO_RAY)
        if not is_spot(scratch, i):
            continue
        choice, lobe = _pair(scratch, i, sample, depth, WHICH)
        _go_on(world, i, sample, depth, lobe, scratch)
        at, place = place_of(world, scratch, i)
        which, chance = choose_light(world, choice)
        if chance == 0.0 or is_specular(world, at):
            continue
        arrival = _light_at(world, i, sample, depth, which, scratch)
        share, density = scatter(world, at, place, arrival.to_light)
        gain = multiply(share, scale(arrival.light, _share(arrival.density * chance, density) / chance))
        # Paths that scatter end at the front of another light, too.
        ray = load3(spots, SPOT + i), arrival.to_light
        if gain[0] + gain[1] + gain[2] > 0.0 and not meets_lamp(world, ray, arrival.distance * (1.0 - 1e-6)):
            store3(spots, GAIN + i, gain)
            set_ray_from(scratch, i, (load3(spots, SPOT + i), arrival.to_light, 0.0, arrival.distance), place.side)
            lit = True
    if lit:
        occlude_tile(world, scratch)
        shade_gains(scratch)
        for i in range(TILE):
            add_radiance(scratch, i, load3(spots, GAIN + i))


@inline
def follow(scratch):  # type: ignore[no-untyped-def]
    """The tile's rays become those on which the paths go on; returns whether there is any."""
    spots, some = scratch.spots, False
    for i in range(TILE):
        weight = load3(spots, NEXT_WEIGHT + i)
        store3(spots, SPOT_WEIGHT + i, weight)
        if weight[0] + weight[1] + weight[2] > 0.0:
            ray = load3(spots, SPOT + i), load3(spots, NEXT + i), 0.0, np.inf
            set_ray_from(scratch, i, ray, spots[NEXT_SIDE + i])
            spots[DENSITY + i] = spots[NEXT_DENSITY + i]
            some = True
        else:
            set_ray(scratch, i, NO_RAY)
    return some


@inline
def trace_paths(world, sample, most, sky_shows, scratch):  # type: ignore[no-untyped-def]
    """From the tile's camera rays, which are aimed: radiance in RADIANCE; returns the rays that met anything (bits).

    most : scatterings
    """
    covered = np.int64(0)
    for depth in range(most + 1):
        trace_tile(world, scratch)
        describe_tile(world, scratch)
        met = receive(world, depth, sky_shows, scratch)
        if depth == 0:
            covered = met
            if find_caught(world, scratch) != 0:
                covered &= ~catch_paths(world, sample, sky_shows, scratch)
        if depth == most:
            break
        scatter_paths(world, sample, depth, scratch)
        if not follow(scratch):
            break
    return covered
