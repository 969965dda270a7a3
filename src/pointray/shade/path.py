"""Path tracing (Kajiya 1986): the 64 paths of a tile are traced together, one bounce at a time.

At each surface point a point on one light is sampled, and the BSDF is sampled to continue the path. Both strategies are
combined by the power heuristic (Veach and Guibas 1995). Russian roulette ends paths of low throughput. The estimate is
unbiased for any number of samples.
"""

from __future__ import annotations

import numpy as np

from ..engine.jit import i64, inline
from ..engine.kernels import scratch as sc
from ..engine.kernels.records import LIGHT, World
from ..engine.kernels.sampling import DIRECTION_OF, ON_LIGHT, ON_PATH, PER_SCATTERING, ROULETTE, WHICH, sample_pair
from ..engine.kernels.scratch import Scratch, load3, store3
from ..engine.kernels.vec import BLACK, Vec3, add, multiply, scale
from ..engine.simd import Bits
from ..surface.trace.hits import describe_tile, tile_hit
from ..surface.trace.world import NO_RAY, occlude_tile, set_ray, set_ray_from, trace_tile
from .bsdf import emitted, eval_bsdf, is_specular, sample_bsdf
from .catcher import catch_paths, find_caught
from .choice import choose_light, light_probability, meets_lamp, nearest_lamp, sky_probability, sun_after
from .direct import shade_gains
from .emitters import LightSample, light_pdf, light_radiance, sample_light
from .shading_points import add_radiance, is_shaded, shading_point, start_of, store_shading_points
from .sky import sample_sky, sky_pdf, sky_radiance

FAINT = 0.05  # below this throughput Russian roulette ends a path or raises it to this throughput


@inline
def begin_paths(scratch: Scratch) -> None:
    """Start paths with the tile's camera rays: no BSDF has sampled these, so lights that they hit count fully."""
    for i in range(sc.TILE):
        scratch.shading_points[sc.PDF + i] = 0.0


@inline
def mis_weight(pdf: float, other: float) -> float:
    """Return the weight of a sample in multiple importance sampling, by the power heuristic.

    pdf : with which the sample was taken; 0 stands for a direction that only this strategy can sample
    other : pdf of the other strategy for the same direction
    """
    if pdf == 0.0:
        return 1.0
    ratio = other / pdf
    return 1.0 / (1.0 + ratio * ratio)


@inline
def _add_distant(world: World, i: int, ray: tuple[Vec3, Vec3], scratch: Scratch) -> None:
    """Add the radiance of the sky and of suns along ray i (origin, direction) of a path, which has hit nothing."""
    pdf = scratch.shading_points[sc.PDF + i]
    light = scale(sky_radiance(world, ray[1]), mis_weight(pdf, sky_pdf(world, ray[1]) * sky_probability(world)))
    k = 0
    while True:
        k, sun, radiance, chosen = sun_after(world, k, ray[1])
        if k == 0:
            break
        light = add(light, scale(radiance, mis_weight(pdf, chosen * light_probability(world, sun))))
    add_radiance(scratch, i, light)


@inline
def receive(world: World, depth: int, sky_shows: bool, scratch: Scratch) -> Bits:
    """Add the radiance of lights and emissive surfaces that the tile's rays hit, and store their surface points.

    depth : number of bounces before these rays; sky_shows : whether camera rays that hit nothing see the sky

    Returns
    -------
    Bits
        The rays that have hit a surface or light, or see the sky.
    """
    points, met = scratch.shading_points, i64(0)
    store_shading_points(world, scratch)
    for i in range(sc.TILE):
        weight = load3(points, sc.THROUGHPUT + i)
        if weight[0] + weight[1] + weight[2] == 0.0:
            points[sc.SHADING_INSTANCE + i] = -1.0
            continue
        ray, hit = (load3(scratch.world, sc.ORIGIN + i), load3(scratch.world, sc.DIRECTION + i)), tile_hit(scratch, i)
        t, light = nearest_lamp(world, ray, hit.t)
        if light >= 0:
            chosen = light_pdf(world, light, ray[0], ray[1], t) * light_probability(world, light // LIGHT)
            radiance = light_radiance(world, light)
            add_radiance(scratch, i, scale(radiance, mis_weight(points[sc.PDF + i], chosen)))
            points[sc.SHADING_INSTANCE + i] = -1.0
            met |= i64(1) << i
        elif hit.instance < 0:
            if depth > 0 or sky_shows:
                _add_distant(world, i, ray, scratch)
                met |= i64(1) << i
        else:
            add_radiance(scratch, i, emitted(world, shading_point(world, scratch, i)[0]))
            met |= i64(1) << i
    return met


@inline
def _pair(scratch: Scratch, i: int, sample: int, depth: int, which: int) -> tuple[float, float]:
    """Return two random numbers in [0, 1) for a decision of the path of ray i at a bounce.

    sample, depth : indices of the sample and of the bounce
    which : the decision, one of those in `sampling.py`, such as ON_LIGHT
    """
    return sample_pair(int(scratch.shading_points[sc.KEY + i]), sample, ON_PATH + depth * PER_SCATTERING + which)


@inline
def _light_at(world: World, x: Vec3, which: int, random: tuple[float, float]) -> LightSample:
    """Sample the light at x from light number `which`; an environment image has the number after the last light.

    random : two numbers in [0, 1)
    """
    u, v = random
    if which * LIGHT < world.lights.size:
        return sample_light(world, which * LIGHT, x, u, v)
    return sample_sky(world, u, v)


@inline
def _continue(world: World, i: int, sample: int, depth: int, lobe: float, scratch: Scratch) -> None:
    """Sample the next direction of a path from surface point i, or end the path by Russian roulette.

    The direction, the new throughput (black at the end of a path), pdf and side are stored in rows NEXT*.

    sample, depth : indices of the sample and of the bounce; lobe : random number in [0, 1) that chooses the lobe
    """
    points = scratch.shading_points
    material, point = shading_point(world, scratch, i)
    u, v = _pair(scratch, i, sample, depth, DIRECTION_OF)
    d, weight, pdf, side = sample_bsdf(world, material, point, lobe, u, v)
    weight = multiply(load3(points, sc.THROUGHPUT + i), weight)
    largest = max(weight[0], weight[1], weight[2])
    if largest < FAINT:
        share = largest / FAINT
        weight = scale(weight, 1.0 / share) if _pair(scratch, i, sample, depth, ROULETTE)[0] < share else BLACK
    store3(points, sc.NEXT + i, d)
    store3(points, sc.NEXT_THROUGHPUT + i, weight)
    points[sc.NEXT_PDF + i], points[sc.NEXT_SIDE + i] = pdf, side


@inline
def scatter_paths(world: World, sample: int, depth: int, scratch: Scratch) -> None:
    """At each of the tile's surface points, add the light of one sampled light, and sample the next ray of the path.

    sample, depth : indices of the sample and of the bounce
    """
    points, lit = scratch.shading_points, False
    for i in range(sc.TILE):
        store3(points, sc.GAIN + i, BLACK)
        store3(points, sc.NEXT_THROUGHPUT + i, BLACK)
        set_ray(scratch, i, NO_RAY)
        if not is_shaded(scratch, i):
            continue
        choice, lobe = _pair(scratch, i, sample, depth, WHICH)
        _continue(world, i, sample, depth, lobe, scratch)
        material, point = shading_point(world, scratch, i)
        which, chance = choose_light(world, choice)
        if chance == 0.0 or is_specular(world, material):
            continue
        x = start_of(scratch, i, point.side)
        incoming = _light_at(world, x, which, _pair(scratch, i, sample, depth, ON_LIGHT))
        share, pdf = eval_bsdf(world, material, point, incoming.wi)
        gain = multiply(share, scale(incoming.light, mis_weight(incoming.pdf * chance, pdf) / chance))
        # Paths end at the front of a light, so other lights must block this one too.
        end = incoming.distance * (1.0 - 1e-6)
        if gain[0] + gain[1] + gain[2] > 0.0 and not meets_lamp(world, (x, incoming.wi), end):
            store3(points, sc.GAIN + i, gain)
            set_ray_from(scratch, i, (x, incoming.wi, 0.0, incoming.distance), point.side)
            lit = True
    if lit:
        occlude_tile(world, scratch)
        shade_gains(scratch)
        for i in range(sc.TILE):
            add_radiance(scratch, i, load3(points, sc.GAIN + i))


@inline
def follow(scratch: Scratch) -> bool:
    """Set the tile's rays to the sampled next rays of its paths; return whether any path continues."""
    points, some = scratch.shading_points, False
    for i in range(sc.TILE):
        weight = load3(points, sc.NEXT_THROUGHPUT + i)
        store3(points, sc.THROUGHPUT + i, weight)
        if weight[0] + weight[1] + weight[2] > 0.0:
            side = points[sc.NEXT_SIDE + i]
            set_ray_from(scratch, i, (start_of(scratch, i, side), load3(points, sc.NEXT + i), 0.0, np.inf), side)
            points[sc.PDF + i] = points[sc.NEXT_PDF + i]
            some = True
        else:
            set_ray(scratch, i, NO_RAY)
    return some


@inline
def trace_paths(world: World, sample: int, max_depth: int, sky_shows: bool, scratch: Scratch) -> Bits:
    """Trace paths from the tile's camera rays, and add their radiance to row RADIANCE of the scratch.

    sample : index of the sample; max_depth : maximum number of bounces
    sky_shows : whether camera rays that hit nothing see the sky

    Returns
    -------
    Bits
        The camera rays that cover the background: they have hit something, or see the sky.
    """
    covered = i64(0)
    for depth in range(max_depth + 1):
        trace_tile(world, scratch)
        describe_tile(world, True, scratch)
        met = receive(world, depth, sky_shows, scratch)
        if depth == 0:
            covered = met
            if find_caught(world, scratch) != 0:
                covered &= ~catch_paths(world, sample, sky_shows, scratch)
        if depth == max_depth:
            break
        scatter_paths(world, sample, depth, scratch)
        if not follow(scratch):
            break
    return covered
