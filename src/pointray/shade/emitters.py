"""Sampling of lights, and intersection of rays with them.

Pdfs are per solid angle; 0 stands for a light without size, which rays cannot hit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..engine.jit import inline
from ..engine.kernels import records as rec
from ..engine.kernels.records import World
from ..engine.kernels.sampling import on_disc
from ..engine.kernels.vec import BLACK, Vec3, add, dot, length, load3_flat, scale, sub, tangents, turned

TINY = 1e-300


class LightSample(NamedTuple):
    """Sample of the light that arrives at a surface point, without occlusion.

    wi : unit direction to the light
    distance : from the surface point to the light, inf for a sun
    light : RGB, radiance over the pdf; if pdf is 0, the irradiance of a surface that faces the light
    pdf : density per solid angle with which the direction was sampled; 0 for a light without size, or if all light is
        taken to come from the light's centre
    """

    wi: Vec3
    distance: float
    light: Vec3
    pdf: float


@inline
def _nothing() -> LightSample:
    return LightSample((0.0, 0.0, 1.0), 0.0, BLACK, 0.0)


@inline
def _in_cone(axis: Vec3, missing: float, u: float, v: float) -> Vec3:
    """Sample a direction uniformly in a cone about a unit axis.

    missing : 1 - cosine of the half angle of the cone; u, v : random numbers in [0, 1)
    """
    x, y = on_disc(u, v)
    square = x * x + y * y
    drop = missing * square  # 1 - cosine, without cancellation
    wide = math.sqrt(max(missing * (2.0 - drop), 0.0))
    first, second = tangents(axis)
    return turned((wide * x, wide * y, 1.0 - drop), (first, second, axis))


@inline
def _cone_of_sphere(world: World, light: int, x: Vec3) -> tuple[Vec3, float, float]:
    """Return the cone in which a sphere light is seen from x: (unit direction to its centre, distance of that, width).

    The width is 1 - cosine of the half angle, or 0 inside the sphere, where the direction is not normalized.

    light : offset of its record in `world.lights`
    """
    v = sub(load3_flat(world.lights, light + rec.LIGHT_POSITION), x)
    distance, radius = length(v), world.lights[light + rec.LIGHT_RADIUS]
    if distance <= radius:
        return v, distance, 0.0
    share = (radius / distance) ** 2
    return scale(v, 1.0 / distance), distance, share / (1.0 + math.sqrt(1.0 - share))


@inline
def from_center(world: World, light: int, kind: float, x: Vec3) -> LightSample:
    """Return the light at x as if all of it came from the centre of the light, which gives hard shadows.

    light : offset of its record in `world.lights`; kind : of the light, as in `records.LIGHT_KIND`
    """
    position, power = (
        load3_flat(world.lights, light + rec.LIGHT_POSITION),
        load3_flat(world.lights, light + rec.LIGHT_POWER),
    )
    if kind == rec.SUN_LIGHT:
        return LightSample(scale(position, -1.0), np.inf, power, 0.0)
    v = sub(position, x)
    square = max(dot(v, v), TINY)
    distance = math.sqrt(square)
    wi = scale(v, 1.0 / distance)
    if kind == rec.POINT_LIGHT:
        return LightSample(wi, distance, scale(power, 1.0 / square), 0.0)
    if kind == rec.SPHERE_LIGHT:
        radius = world.lights[light + rec.LIGHT_RADIUS]
        if distance <= radius:
            return _nothing()
        return LightSample(wi, distance - radius, scale(power, math.pi * radius * radius / square), 0.0)
    cosine = max(-dot(load3_flat(world.lights, light + rec.LIGHT_FACING), wi), 0.0)
    # On its axis a disk of radius r at distance d gives pi r^2 / (d^2 + r^2); 1 / d^2 alone is too bright close by.
    area = world.lights[light + rec.LIGHT_AREA]
    return LightSample(wi, distance, scale(power, area * cosine / (square + area / math.pi)), 0.0)


@inline
def sample_light(world: World, light: int, x: Vec3, u: float, v: float) -> LightSample:
    """Sample a point on a light, and return its unoccluded light at x.

    light : offset of its record in `world.lights`; u, v : random numbers in [0, 1)
    """
    kind, power = world.lights[light + rec.LIGHT_KIND], load3_flat(world.lights, light + rec.LIGHT_POWER)
    position = load3_flat(world.lights, light + rec.LIGHT_POSITION)
    if kind == rec.POINT_LIGHT:
        return from_center(world, light, kind, x)
    if kind == rec.SUN_LIGHT:
        missing = world.lights[light + rec.LIGHT_RADIUS]
        if missing == 0.0:
            return from_center(world, light, kind, x)
        wi = _in_cone(scale(position, -1.0), missing, u, v)
        return LightSample(wi, np.inf, _sun_share(power, missing), 1.0 / (2.0 * math.pi * missing))
    if kind == rec.SPHERE_LIGHT:
        axis, distance, missing = _cone_of_sphere(world, light, x)
        if missing == 0.0:
            return _nothing()
        wi = _in_cone(axis, missing, u, v)
        pdf = 1.0 / (2.0 * math.pi * missing)
        t = _intersect_sphere(scale(axis, distance), world.lights[light + rec.LIGHT_RADIUS], wi)
        return LightSample(wi, min(t, distance), scale(power, 1.0 / pdf), pdf)
    a, b = 2.0 * u - 1.0, 2.0 * v - 1.0
    if kind == rec.DISK_LIGHT:
        a, b = on_disc(u, v)
    aside = add(
        scale(load3_flat(world.lights, light + rec.LIGHT_U), a), scale(load3_flat(world.lights, light + rec.LIGHT_V), b)
    )
    to_position = add(sub(position, x), aside)
    distance = length(to_position)
    if distance == 0.0:
        return _nothing()
    wi = scale(to_position, 1.0 / distance)
    pdf = _flat_pdf(world, light, wi, distance)
    if pdf == 0.0:
        return _nothing()
    return LightSample(wi, distance, scale(power, 1.0 / pdf), pdf)


@inline
def _sun_share(irradiance: Vec3, missing: float) -> Vec3:
    """Return radiance over pdf of a direction sampled in a sun's disk, whose projected solid angle is pi sin^2.

    irradiance : of a surface that faces the sun; missing : 1 - cosine of the disk's angular radius
    """
    sine_square = missing * (2.0 - missing)
    return scale(irradiance, 2.0 * missing / sine_square)


@inline
def _flat_pdf(world: World, light: int, wi: Vec3, distance: float) -> float:
    """Return the pdf per solid angle of a direction to a point sampled uniformly on a flat light; 0 from behind.

    light : offset of its record in `world.lights`; distance : of the point
    """
    cosine = -dot(load3_flat(world.lights, light + rec.LIGHT_FACING), wi)
    return distance * distance / (cosine * world.lights[light + rec.LIGHT_AREA]) if cosine > 1e-12 else 0.0


@inline
def _intersect_sphere(to_middle: Vec3, radius: float, d: Vec3) -> float:
    """Return the distance at which a ray of unit direction d, from outside, hits a sphere; inf for a miss.

    to_middle : vector from the ray's origin to the sphere's centre
    """
    along = dot(to_middle, d)
    aside = sub(to_middle, scale(d, along))
    rest = radius * radius - dot(aside, aside)
    t = along - math.sqrt(max(rest, 0.0))
    return t if rest >= 0.0 and t > 0.0 else np.inf


@inline
def intersect_light(world: World, light: int, o: Vec3, d: Vec3) -> float:
    """Return the distance at which a ray of unit direction hits the front of a light; inf for a miss.

    Point lights and suns are never hit. light : offset of its record in `world.lights`
    """
    kind, position = world.lights[light + rec.LIGHT_KIND], load3_flat(world.lights, light + rec.LIGHT_POSITION)
    if kind in (rec.POINT_LIGHT, rec.SUN_LIGHT):
        return np.inf
    if kind == rec.SPHERE_LIGHT:
        return _intersect_sphere(sub(position, o), world.lights[light + rec.LIGHT_RADIUS], d)
    facing = load3_flat(world.lights, light + rec.LIGHT_FACING)
    fall = -dot(facing, d)
    if fall <= 1e-12:
        return np.inf
    t = dot(facing, sub(o, position)) / fall
    x = sub(add(o, scale(d, t)), position)
    u, v = load3_flat(world.lights, light + rec.LIGHT_U), load3_flat(world.lights, light + rec.LIGHT_V)
    # Coordinates along u and v, which need not be orthogonal.
    uu, uv, vv, xu, xv = dot(u, u), dot(u, v), dot(v, v), dot(x, u), dot(x, v)
    whole = uu * vv - uv * uv
    a, b = (xu * vv - xv * uv) / whole, (xv * uu - xu * uv) / whole
    inside = a * a + b * b <= 1.0 if kind == rec.DISK_LIGHT else max(abs(a), abs(b)) <= 1.0
    return t if t > 0.0 and inside else np.inf


@inline
def light_pdf(world: World, light: int, o: Vec3, d: Vec3, t: float) -> float:
    """Return the pdf per solid angle with which `sample_light` at o samples direction d.

    The pdf is used to weight rays that hit the light by chance (multiple importance sampling).

    light : offset of its record in `world.lights`; t : distance at which the ray hits the light
    """
    if world.lights[light + rec.LIGHT_KIND] == rec.SPHERE_LIGHT:
        missing = _cone_of_sphere(world, light, o)[2]
        return 1.0 / (2.0 * math.pi * missing) if missing > 0.0 else 0.0
    return _flat_pdf(world, light, d, t)


@inline
def light_radiance(world: World, light: int) -> Vec3:
    """Return the radiance that an area light emits, RGB. light : offset of its record in `world.lights`"""
    return load3_flat(world.lights, light + rec.LIGHT_POWER)


@inline
def sun_in(world: World, light: int, d: Vec3) -> tuple[Vec3, float]:
    """Return (radiance, pdf per solid angle) of a sun's disk in a unit direction.

    Both are 0 outside the disk, and for other lights. light : offset of its record in `world.lights`
    """
    missing = world.lights[light + rec.LIGHT_RADIUS]
    if world.lights[light + rec.LIGHT_KIND] != rec.SUN_LIGHT or missing == 0.0:
        return BLACK, 0.0
    if 1.0 + dot(load3_flat(world.lights, light + rec.LIGHT_POSITION), d) > missing:
        return BLACK, 0.0
    pdf = 1.0 / (2.0 * math.pi * missing)
    return scale(_sun_share(load3_flat(world.lights, light + rec.LIGHT_POWER), missing), pdf), pdf
