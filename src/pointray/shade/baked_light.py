"""Shading with baked light: direct light is computed with sharp shadows; light of the sky and of surfaces is looked up.

Wide lobes are evaluated from the baked moments. Narrower lobes send one more ray and read the baked light where it
hits. There, as behind mirrors and glass, direct light is looked up too.
"""

from __future__ import annotations

import math

from ..engine.jit import i64, inline
from ..engine.kernels import scratch as sc
from ..engine.kernels.records import LIGHT, LIGHT_KIND, PHONG, World
from ..engine.kernels.sampling import DIRECTION_OF, ON_LIGHT, ON_PATH, PER_SCATTERING, sample_pair
from ..engine.kernels.scratch import Scratch, load3, store3
from ..engine.kernels.vec import BLACK, Vec3, add, around, dot, mirrored, multiply, scale
from ..engine.simd import Bits
from ..surface.trace.hits import tile_hit
from ..surface.trace.world import NO_RAY, occlude_tile, set_ray, set_ray_from
from .baked import find_baked
from .bsdf import emitted, eval_bsdf, lobes_of
from .choice import nearest_lamp
from .direct import shade_gains
from .emitters import from_center, light_radiance, sample_light
from .lobes import Lobe, is_wide, lobe_of, reflect_baked
from .shading_points import add_radiance, is_shaded, shading_point, start_of
from .specular_rays import push_ray


@inline
def meet_lamps(world: World, scratch: Scratch) -> Bits:
    """Add the radiance of area lights that the tile's rays hit; return the rays that hit one (bits).

    Surfaces that these rays hit behind the light are discarded.
    """
    met = i64(0)
    if world.lamps.lights.size == 0:
        return met
    for i in range(sc.TILE):
        ray, hit = (load3(scratch.world, sc.ORIGIN + i), load3(scratch.world, sc.DIRECTION + i)), tile_hit(scratch, i)
        light = nearest_lamp(world, ray, hit.t)[1]
        if light >= 0:
            add_radiance(scratch, i, light_radiance(world, light))
            scratch.shading_points[sc.SHADING_INSTANCE + i] = -1.0
            met |= i64(1) << i
    return met


@inline
def _reflect_narrow(world: World, i: int, gloss: Vec3, lobe: Lobe, sample: int, scratch: Scratch) -> None:
    """Push a ray from surface point i into a narrow glossy lobe onto the stack of rays to trace later.

    Baked light is looked up where the ray hits.

    gloss : albedo of the lobe, RGB; lobe : (kind of material, exponent)
    sample : index of the sample, which selects the direction; -1 for the mirrored direction
    """
    points, (kind, e) = scratch.shading_points, lobe
    point = shading_point(world, scratch, i)[1]
    d = mirrored(point.wo, point.normal)
    if sample >= 0:
        u, v = sample_pair(int(points[sc.KEY + i]), sample, ON_PATH + DIRECTION_OF)
        d = around(d, (1.0 - u) ** (1.0 / (e + 1.0)), v)
    cosine = dot(d, point.normal)
    if cosine <= 0.0:
        return
    share = cosine * (e + 2.0) / (e + 1.0) if kind == PHONG else 1.0
    weight = multiply(load3(points, sc.THROUGHPUT + i), scale(gloss, share))
    push_ray(scratch, i, d, weight, points[sc.SHADING_SIDE + i])


@inline
def add_baked(world: World, first: bool, sample: int, scratch: Scratch) -> None:
    """Add the light that the tile's surface points emit, and what they reflect of baked light.

    first : whether these are the camera's first hits, whose narrow lobes send rays and whose direct light is added by
        `add_live`; other hits reflect all light diffusely, including baked direct light
    sample : index of the sample, which selects the directions of rays into lobes; -1 for the mirrored direction
    """
    find_baked(world, first, scratch)
    for i in range(sc.TILE):
        if not is_shaded(scratch, i):
            continue
        material, point = shading_point(world, scratch, i)
        even, gloss = lobes_of(world, material, point)
        if not first:
            even, gloss = add(even, gloss), BLACK
        arriving = load3(scratch.shading_points, sc.ARRIVING + i)
        light = add(emitted(world, material), scale(multiply(even, arriving), 1.0 / math.pi))
        if gloss[0] + gloss[1] + gloss[2] > 0.0:
            lobe = lobe_of(world, material)
            if is_wide(lobe):
                r = mirrored(point.wo, point.normal)
                light = add(light, multiply(gloss, reflect_baked(scratch, i, lobe, point.normal, r)))
            else:
                _reflect_narrow(world, i, gloss, lobe, sample, scratch)
        add_radiance(scratch, i, light)


@inline
def _set_light(world: World, light: int, sample: int, scratch: Scratch) -> bool:
    """Set shadow rays from the tile's surface points to a light, and store what they add if unoccluded (row GAIN).

    Returns whether the light adds anything.

    light : offset of its record in `world.lights`
    sample : index of the sample, which selects a point on the light; -1: its centre
    """
    points, lit = scratch.shading_points, False
    for i in range(sc.TILE):
        store3(points, sc.GAIN + i, BLACK)
        set_ray(scratch, i, NO_RAY)
        if not is_shaded(scratch, i):
            continue
        material, point = shading_point(world, scratch, i)
        x = start_of(scratch, i, point.side)
        incoming = from_center(world, light, world.lights[light + LIGHT_KIND], x)
        if sample >= 0:
            u, v = sample_pair(int(points[sc.KEY + i]), sample, ON_PATH + ON_LIGHT + PER_SCATTERING * (light // LIGHT))
            incoming = sample_light(world, light, x, u, v)
        gain = multiply(eval_bsdf(world, material, point, incoming.wi)[0], incoming.light)
        if gain[0] + gain[1] + gain[2] > 0.0:
            store3(points, sc.GAIN + i, gain)
            set_ray_from(scratch, i, (x, incoming.wi, 0.0, incoming.distance), point.side)
            lit = True
    return lit


@inline
def add_live(world: World, shadows: bool, sample: int, scratch: Scratch) -> None:
    """Add the direct light of all lights but the sky at the tile's surface points. Overwrites the tile's rays.

    shadows : whether to trace shadow rays
    sample : index of the sample, which selects a point on each light; -1: its centre
    """
    for light in range(0, world.lights.size, LIGHT):
        if not _set_light(world, light, sample, scratch):
            continue
        if shadows:
            occlude_tile(world, scratch)
            shade_gains(scratch)
        for i in range(sc.TILE):
            add_radiance(scratch, i, load3(scratch.shading_points, sc.GAIN + i))
