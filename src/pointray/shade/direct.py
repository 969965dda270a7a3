"""Direct light at the hits of a tile: each light, the shadow rays to it together, and the material's BRDF (Phong)."""

from __future__ import annotations

import math

from ..jit import inline
from ..records import (
    BASE_COLOR,
    EXPONENT,
    INSTANCE,
    LIGHT,
    MATERIAL,
    MATERIAL_KIND,
    MATERIAL_SIZE,
    OWN_COLOR,
    PHONG,
    SPECULAR,
)
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
from ..trace.world import NOWHERE, aim, aim_from, trace_tile
from ..vec import add, dot, multiply, scale, sub, triple, unit
from .emitters import BLACK, from_middle


@inline
def reflectance(world, spot, to_light):  # type: ignore[no-untyped-def]
    """BRDF times the cosine at the light's side. spot : normal and direction to the eye, colour, instance."""
    normal, to_eye, color, instance = spot
    cosine = dot(normal, to_light)
    if cosine <= 0.0:
        return BLACK
    at = int(world.instances[instance * INSTANCE + MATERIAL]) * MATERIAL_SIZE
    if world.materials[at + OWN_COLOR] == 0.0:
        color = triple(world.materials, at + BASE_COLOR)
    specular = world.materials[at + SPECULAR]
    diffuse = scale(color, (1.0 - specular) * cosine / math.pi)
    if world.materials[at + MATERIAL_KIND] != PHONG or specular == 0.0:
        return diffuse
    mirrored = sub(scale(normal, 2.0 * cosine), to_light)
    exponent = world.materials[at + EXPONENT]
    lobe = max(dot(mirrored, to_eye), 0.0) ** exponent * (exponent + 2.0) / (2.0 * math.pi) * specular * cosine
    return add(diffuse, (lobe, lobe, lobe))


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
    """What `reflectance` needs of a surface point."""
    return (
        row(spots, SPOT_NORMAL + i),
        row(spots, SPOT_EYE + i),
        row(spots, SPOT_COLOR + i),
        int(spots[SPOT_INSTANCE + i]),
    )


@inline
def _light_from(world, at, scratch):  # type: ignore[no-untyped-def]
    """What one light adds where nothing is in its way; returns whether it adds anything."""
    spots, lit = scratch.spots, False
    for i in range(TILE):
        put(spots, GAIN + i, BLACK)
        if spots[SPOT_INSTANCE + i] < 0.0:
            continue
        arrival = from_middle(world, at, row(spots, SPOT + i))
        gain = multiply(reflectance(world, _spot(spots, i), arrival.to_light), arrival.light)
        put(spots, GAIN + i, gain)
        if gain[0] + gain[1] + gain[2] > 0.0:
            lit = True
    return lit


@inline
def _shade_from(world, at, scratch):  # type: ignore[no-untyped-def]
    """Take away the gain where something is between a surface point and a light."""
    spots = scratch.spots
    for i in range(TILE):
        gain = row(spots, GAIN + i)
        if gain[0] + gain[1] + gain[2] > 0.0:
            x = row(spots, SPOT + i)
            arrival = from_middle(world, at, x)
            aim_from(scratch, i, (x, arrival.to_light, 0.0, arrival.distance), spots[SPOT_SIDE + i])
        else:
            aim(scratch, i, NOWHERE)
    trace_tile(world, scratch)
    for i in range(TILE):
        if scratch.numbers[INSTANCE_OF + i] >= 0:
            put(spots, GAIN + i, BLACK)


@inline
def light_tile(world, shadows, scratch):  # type: ignore[no-untyped-def]
    """Radiance that the tile's surface points send to the eye, in RADIANCE. Uses the tile's rays as shadow rays.

    A scene without lights has a headlight: at the eye, without fall-off and shadows, irradiance pi.
    """
    spots = scratch.spots
    if world.lights.size == 0:
        for i in range(TILE):
            if spots[SPOT_INSTANCE + i] >= 0.0:
                put(spots, RADIANCE + i, scale(reflectance(world, _spot(spots, i), row(spots, SPOT_EYE + i)), math.pi))
        return
    for k in range(world.lights.size // LIGHT):
        if _light_from(world, k * LIGHT, scratch) and shadows:
            _shade_from(world, k * LIGHT, scratch)
        for i in range(TILE):
            put(spots, RADIANCE + i, add(row(spots, RADIANCE + i), row(spots, GAIN + i)))
