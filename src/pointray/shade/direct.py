"""Direct light at the hits of a tile: each light, the shadow rays to it together, and what the material scatters."""

from __future__ import annotations

import math

import numpy as np

from ..jit import inline
from ..records import LIGHT, LIGHT_KIND, LIGHT_PLACE, LIGHT_POWER, POINT_LIGHT
from ..scratch import (
    GAIN,
    INSTANCE_OF,
    RADIANCE,
    SPOT,
    SPOT_COLOR,
    SPOT_EYE,
    SPOT_INSTANCE,
    SPOT_NORMAL,
    SPOT_SIDE,
    TILE,
    put,
    row,
)
from ..trace.world import NOWHERE, aim, trace_tile
from ..vec import add, dot, length, multiply, scale, sub, triple, unit
from .bsdf import BLACK, Place, base_color, emitted, material_at, scatter


@inline
def towards_light(world, at, x):  # type: ignore[no-untyped-def]
    """(unit direction to the light, distance, irradiance on a surface that faces it)."""
    power = triple(world.lights, at + LIGHT_POWER)
    place = triple(world.lights, at + LIGHT_PLACE)
    if world.lights[at + LIGHT_KIND] == POINT_LIGHT:
        v = sub(place, x)
        distance = length(v)
        return scale(v, 1.0 / max(distance, 1e-300)), distance, scale(power, 1.0 / max(distance * distance, 1e-300))
    return scale(place, -1.0), np.inf, power


@inline
def reflectance(world, spot, to_light):  # type: ignore[no-untyped-def]
    """BRDF times the cosine at the light's side. spot : see `_spot`."""
    normal, to_eye, color, side, instance = spot
    at = material_at(world, instance)
    return scatter(world, at, Place(normal, to_eye, base_color(world, at, color), side), to_light)[0]


@inline
def keep_spot(scratch, i, hit, ray):  # type: ignore[no-untyped-def]
    """Put what ray i of the tile, (o, d), has hit where `light_tile` finds it: surfaces shade both sides."""
    spots = scratch.spots
    spots[SPOT_INSTANCE + i] = hit.instance
    put(spots, RADIANCE + i, BLACK)
    if hit.instance < 0:
        return
    to_eye = scale(unit(ray[1]), -1.0)
    # The side the eye is on: where the start rule puts shadow rays, and where the normal is turned.
    side = 1.0 if dot(hit.normal, to_eye) >= 0.0 else -1.0
    put(spots, SPOT + i, add(ray[0], scale(ray[1], hit.t)))
    put(spots, SPOT_NORMAL + i, scale(hit.normal, side))
    put(spots, SPOT_EYE + i, to_eye)
    put(spots, SPOT_COLOR + i, hit.color)
    spots[SPOT_SIDE + i] = side


@inline
def _spot(spots, i):  # type: ignore[no-untyped-def]
    """Normal and direction to the eye, the surface's own colour, the side the eye is on, the instance."""
    return (
        row(spots, SPOT_NORMAL + i),
        row(spots, SPOT_EYE + i),
        row(spots, SPOT_COLOR + i),
        spots[SPOT_SIDE + i],
        int(spots[SPOT_INSTANCE + i]),
    )


@inline
def _light_from(world, at, scratch):  # type: ignore[no-untyped-def]
    """What one light adds where nothing is in its way. Returns from which sides of surfaces it is seen, as bits.

    1 : from the outer side, 2 : from the inner side
    """
    spots, sides = scratch.spots, 0
    for i in range(TILE):
        put(spots, GAIN + i, BLACK)
        if spots[SPOT_INSTANCE + i] < 0.0:
            continue
        to_light, _, irradiance = towards_light(world, at, row(spots, SPOT + i))
        gain = multiply(reflectance(world, _spot(spots, i), to_light), irradiance)
        put(spots, GAIN + i, gain)
        if gain[0] + gain[1] + gain[2] > 0.0:
            sides |= 1 if spots[SPOT_SIDE + i] > 0.0 else 2
    return sides


@inline
def _shade_from(world, at, side, scratch):  # type: ignore[no-untyped-def]
    """Take away the gain where something is between surface points on one side of their surface and a light."""
    spots = scratch.spots
    for i in range(TILE):
        gain = row(spots, GAIN + i)
        if gain[0] + gain[1] + gain[2] > 0.0 and spots[SPOT_SIDE + i] == side:
            x = row(spots, SPOT + i)
            to_light, distance, _ = towards_light(world, at, x)
            aim(scratch, i, (x, to_light, 0.0, distance))
        else:
            aim(scratch, i, NOWHERE)
    trace_tile(world, side, scratch)
    for i in range(TILE):
        if scratch.numbers[INSTANCE_OF + i] >= 0:
            put(spots, GAIN + i, BLACK)


@inline
def light_tile(world, shadows, scratch):  # type: ignore[no-untyped-def]
    """Radiance that the tile's surface points send to the eye, in RADIANCE. Uses the tile's rays as shadow rays.

    A scene without lights has a headlight: at the eye, without fall-off and shadows, irradiance pi.
    """
    spots = scratch.spots
    for i in range(TILE):
        if spots[SPOT_INSTANCE + i] >= 0.0:
            put(spots, RADIANCE + i, emitted(world, material_at(world, int(spots[SPOT_INSTANCE + i]))))
    if world.lights.size == 0:
        for i in range(TILE):
            if spots[SPOT_INSTANCE + i] >= 0.0:
                lit = scale(reflectance(world, _spot(spots, i), row(spots, SPOT_EYE + i)), math.pi)
                put(spots, RADIANCE + i, add(row(spots, RADIANCE + i), lit))
        return
    for k in range(world.lights.size // LIGHT):
        sides = _light_from(world, k * LIGHT, scratch)
        if shadows:
            for j in range(2):
                if (sides >> j) & 1 != 0:
                    _shade_from(world, k * LIGHT, 1.0 - 2.0 * j, scratch)
        for i in range(TILE):
            put(spots, RADIANCE + i, add(row(spots, RADIANCE + i), row(spots, GAIN + i)))
