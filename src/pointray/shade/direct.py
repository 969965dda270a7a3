"""Direct light at a hit: each light, its shadow ray, and the material's BRDF (Phong)."""

from __future__ import annotations

import math

import numpy as np

from ..jit import inline
from ..records import (
    BASE_COLOR,
    EXPONENT,
    INSTANCE,
    LIGHT,
    LIGHT_KIND,
    LIGHT_PLACE,
    LIGHT_POWER,
    MATERIAL,
    MATERIAL_KIND,
    MATERIAL_SIZE,
    OWN_COLOR,
    PHONG,
    POINT_LIGHT,
    SPECULAR,
)
from ..trace.world import occluded_in
from ..vec import add, dot, length, multiply, scale, sub, triple, unit

BLACK = (0.0, 0.0, 0.0)


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
def reflectance(world, hit, normal, to_light, to_eye):  # type: ignore[no-untyped-def]
    """BRDF times the cosine at the light's side; `normal` is turned to the eye."""
    cosine = dot(normal, to_light)
    if cosine <= 0.0:
        return BLACK
    at = int(world.instances[hit.instance * INSTANCE + MATERIAL]) * MATERIAL_SIZE
    color = hit.color if world.materials[at + OWN_COLOR] != 0.0 else triple(world.materials, at + BASE_COLOR)
    specular = world.materials[at + SPECULAR]
    diffuse = scale(color, (1.0 - specular) * cosine / math.pi)
    if world.materials[at + MATERIAL_KIND] != PHONG or specular == 0.0:
        return diffuse
    mirrored = sub(scale(normal, 2.0 * cosine), to_light)
    exponent = world.materials[at + EXPONENT]
    lobe = max(dot(mirrored, to_eye), 0.0) ** exponent * (exponent + 2.0) / (2.0 * math.pi) * specular * cosine
    return add(diffuse, (lobe, lobe, lobe))


@inline
def direct_light(world, hit, ray, shadows, scratch):  # type: ignore[no-untyped-def]
    """Radiance that a hit sends back along its ray (o, d): surfaces shade both sides.

    A scene without lights has a headlight: at the eye, without fall-off and shadows, irradiance pi.
    """
    x, to_eye = add(ray[0], scale(ray[1], hit.t)), scale(unit(ray[1]), -1.0)
    # The side the eye is on: where the start rule puts shadow rays, and where the normal is turned.
    side = 1.0 if dot(hit.normal, to_eye) >= 0.0 else -1.0
    normal = scale(hit.normal, side)
    if world.lights.size == 0:
        return scale(reflectance(world, hit, normal, to_eye, to_eye), math.pi)
    total = BLACK
    for k in range(world.lights.size // LIGHT):
        to_light, distance, irradiance = towards_light(world, k * LIGHT, x)
        light = multiply(reflectance(world, hit, normal, to_light, to_eye), irradiance)
        if light[0] + light[1] + light[2] <= 0.0:
            continue
        if shadows and occluded_in(world, (x, to_light, 0.0, distance), side, scratch):
            continue
        total = add(total, light)
    return total
