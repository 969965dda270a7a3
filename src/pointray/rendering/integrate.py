"""Kernels of a pass: threads take blocks of pixels and trace the samples of their tiles of 8 x 8 pixels.

A frame is one pass or several. `film` (h, w, k) float32 keeps the first k sums of the samples so far: RGB, number of
hits, squared luminance; hits of shadow catchers, their unoccluded light and their arriving light (`film.LIGHT_SUMS`).
It is empty for a single pass. Within a pass sums are float64, which would be too large for the film; they are rounded
where passes may end (`film.round_sums`), so that the image does not depend on the passes. After 65,536 samples the
error of a sum is at most 2e-5. `image` (h, w, 4) holds the means over the background.

An integrator is a function of one sample of a tile, which adds the light along the tile's rays to the pixel sums. The
two kernels at the end of this file contain several. A new one is a file with a kernel made of `render_tiles`, an entry
in `choices.INTEGRATORS` and a line in `picture.KERNELS`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from ..engine.jit import Array, borrow, cancelled, i64, inline, keep_alive, kernel, next_tile
from ..engine.kernels import scratch as sc
from ..engine.kernels.records import World, WorldHit
from ..engine.kernels.scratch import Scratch, load3, new_scratch, store3
from ..engine.kernels.vec import Vec3, add, scale
from ..engine.simd import Bits
from ..shade.ambient import see_sky
from ..shade.backfaces import mute_back_faces
from ..shade.bsdf import base_color
from ..shade.catcher import catch_direct, catch_occlusion, find_caught, show_caught
from ..shade.direct import light_tile
from ..shade.path import begin_paths, trace_paths
from ..shade.shading_points import add_radiance, begin_radiance, is_shaded, store_shading_points
from ..shade.sky import has_sky, sky_radiance
from ..shade.specular_rays import begin_specular, set_specular_rays, spawn_specular
from ..surface.trace.hits import describe_tile, material_at, tile_hit
from ..surface.trace.world import NO_RAY, meets_nothing, set_ray, trace_tile
from .film import (
    EDGE,
    Background,
    Corner,
    Window,
    add_color,
    add_sample,
    begin_sums,
    begin_tile,
    fill_tile,
    finish_sums,
    round_sums,
    set_pixel_rays,
)
from .lens import depth_of
from .settings import AO, COLOR, COST, DEPTH, NORMAL, PHONG

BLOCK_EDGE = 16  # pixels a side of a block, the unit of work of a thread: 4 tiles of 8 x 8
RayPair: TypeAlias = tuple[Vec3, Vec3]  # origin and direction, world


class Pass(NamedTuple):
    """Parameters of a pass (a range of samples of all pixels) for kernels, besides the world and the camera.

    integrator : number in `choices.INTEGRATORS`
    shadows : whether direct light casts shadows
    muted : whether back faces are desaturated and lit without shadows, so that holes of a scan are not black
    max_depth : maximum number of bounces of a path; for "phong" and "baked", of successive mirrors and glass surfaces
    sky_shows : whether camera rays that hit nothing see the sky
    sky_rays : rays a sample that test whether the sky is visible, 0 for none
    ao_distance : length of these rays, and of those of ambient occlusion, in world units
    seed : seed of the random numbers
    spp : samples a pixel after the last pass
    filter : number of the pixel filter in `choices.FILTERS`
    draws : whether random numbers are needed: for several samples a pixel, for `sky_rays`, or by the integrator
    first, end : range of the sample indices of this pass
    window : (left, top, right, bottom) in pixels; rays through pixels outside hit nothing
    background : RGB and alpha
    """

    integrator: int
    shadows: bool
    muted: bool
    max_depth: int
    sky_shows: bool
    sky_rays: int
    ao_distance: float
    seed: int
    spp: int
    filter: int
    draws: bool
    first: int
    end: int
    window: Window
    background: Background


@inline
def _corner(block: int, tile: int, width: int) -> Corner:
    """Return column and row of the first pixel of a tile (8 x 8 pixels) in a block (16 x 16).

    block : number in the image, row by row; tile : 0 to 3 in the block; width : of the image, in pixels
    """
    across = (width + BLOCK_EDGE - 1) // BLOCK_EDGE
    return block % across * BLOCK_EDGE + tile % 2 * EDGE, block // across * BLOCK_EDGE + tile // 2 * EDGE


@inline
def _is_beside(corner: Corner, window: Window) -> bool:
    """Return whether a tile is outside the part of the image that models can cover, and needs no rays.

    corner : column and row of its first pixel; window : left, top, right, bottom of that part, in pixels
    """
    beside = (corner[0] + EDGE <= window[0]) | (corner[0] >= window[2])
    return beside | (corner[1] + EDGE <= window[1]) | (corner[1] >= window[3])


@inline
def begin_sample(world: World, corner: Corner, sample: int, scratch: Scratch) -> None:
    """Do nothing before a sample of a tile.

    A version for worlds whose hits are read from a table (`ReplayWorld`) notes which sample begins.

    corner : column and row of the tile's first pixel; sample : index of the sample
    """


@inline
def render_tiles(
    integrate: Callable[[World, Array, Pass, int, Scratch], None],
    work: Array,
    world: World,
    camera: Array,
    job: Pass,
    film: Array,
    image: Array,
) -> None:
    """Render the blocks of an image that a thread takes, tile by tile and sample by sample.

    This is the loop of all rendering kernels.

    integrate : adds one sample of a tile to its pixel sums in scratch memory
    work : counter from which threads take blocks; camera : (16,), eye, axes, projection and lens
    job : settings and range of samples; image : (h, w, 4), the result, mean RGB over the background and alpha
    film : (h, w, k), updated, k sums over the samples of each pixel (RGB, hits and so on), or empty to keep none
    """
    memory = new_scratch(world.longest)
    scratch, world, camera = borrow(memory), borrow(world), borrow(camera)
    height, width = image.shape[:2]
    block = next_tile(work)
    while block >= 0:
        for tile in range(BLOCK_EDGE * BLOCK_EDGE // sc.TILE):
            corner = _corner(block, tile, width)
            if corner[0] >= width or corner[1] >= height:
                continue
            if _is_beside(corner, job.window):
                fill_tile(corner, job.background, image)
                continue
            if job.draws:  # saves 2% of a lit frame
                begin_tile(corner, (width, height), job.seed, scratch)
            begin_sums(corner, job.first, film, scratch)
            for sample in range(job.first, job.end):
                if cancelled(work):  # a block of many samples takes long, so poll here
                    break
                round_sums(sample, job.first, scratch)
                begin_sample(world, corner, sample, scratch)
                set_pixel_rays(camera, (width, height), corner, sample, (job.spp, job.filter), scratch)
                integrate(world, camera, job, sample, scratch)
            finish_sums(corner, job.end, job.background, film, image, scratch)
        block = next_tile(work)
    keep_alive(memory)


@inline
def _tile_ray(scratch: Scratch, i: int) -> RayPair:
    return load3(scratch.world, sc.ORIGIN + i), load3(scratch.world, sc.DIRECTION + i)


@inline
def _look(world: World, hit: WorldHit, ray: RayPair, camera: Array, integrator: int) -> Vec3:
    """Return what the integrators "normal", "depth" and "color" show at the hit of a camera ray, as RGB.

    ray : origin and direction; camera : (16,), eye, axes, projection and lens; integrator : number of one of the three
    """
    if integrator == NORMAL:
        return add(scale(hit.normal, 0.5), (0.5, 0.5, 0.5))
    if integrator == DEPTH:
        depth = depth_of(camera, ray, hit.t)
        return depth, depth, depth
    return base_color(world, material_at(world, hit.instance), hit.color)


@inline
def _cost(world: World, ray: RayPair, scratch: Scratch) -> Vec3:
    """Return the numbers of nodes and leaves that a ray visits in traversal, and 1/64 of their sum, as RGB.

    ray : origin and direction, traced alone in its tile
    """
    scratch.counts[sc.COUNT_NODES], scratch.counts[sc.COUNT_LEAVES] = 0, 0
    set_ray(scratch, 0, (ray[0], ray[1], 0.0, np.inf))
    for k in range(1, sc.TILE):
        set_ray(scratch, k, NO_RAY)
    trace_tile(world, scratch)
    nodes, leaves = float(scratch.counts[sc.COUNT_NODES]), float(scratch.counts[sc.COUNT_LEAVES])
    return nodes, leaves, (nodes + leaves) / 64.0


@inline
def _add_costs(world: World, scratch: Scratch) -> None:
    """Add the traversal costs of the tile's rays (nodes and leaves visited), traced one by one, to the pixel sums."""
    points = scratch.shading_points
    for i in range(sc.TILE):
        o, d = _tile_ray(scratch, i)
        store3(points, sc.COST_ORIGIN + i, o)
        store3(points, sc.COST_DIRECTION + i, d)
    for i in range(sc.TILE):
        add_color(
            scratch, i, _cost(world, (load3(points, sc.COST_ORIGIN + i), load3(points, sc.COST_DIRECTION + i)), scratch)
        )


@inline
def _integrate_first_hit(world: World, camera: Array, job: Pass, sample: int, scratch: Scratch) -> None:
    """Integrators "normal", "depth", "color", "cost": add one sample of a tile, the value shown, to the pixel sums.

    Shown is the normal, depth or colour at the first hits; for "cost" the nodes and leaves visited, also by a miss.

    camera : (16,), eye, axes, projection and lens; job : settings of the pass; sample : not used
    """
    if job.integrator == COST:
        _add_costs(world, scratch)
        return
    trace_tile(world, scratch)
    if meets_nothing(scratch):
        return
    if job.integrator == COLOR:
        describe_tile(world, True, scratch)
    for i in range(sc.TILE):
        hit = tile_hit(scratch, i)
        if hit.instance >= 0:
            add_color(scratch, i, _look(world, hit, _tile_ray(scratch, i), camera, job.integrator))


@inline
def _direct_light(world: World, job: Pass, sample: int, scratch: Scratch) -> Bits:
    """Compute direct light along the tile's traced rays, through mirrors and glass, as radiance in scratch memory.

    Returns the rays that have hit anything (bits).

    job : settings of the pass; sample : index of the sample, for random numbers
    """
    met = i64(0)
    begin_radiance(scratch)
    begin_specular(scratch)
    first = True
    while True:
        store_shading_points(world, scratch)
        for i in range(sc.TILE):
            hit = is_shaded(scratch, i)
            if first and (hit or job.sky_shows):
                met |= i64(1) << i
            if not hit and (job.sky_shows or not first):
                d = load3(scratch.world, sc.DIRECTION + i)
                seen = sky_radiance(world, d) if has_sky(world) or job.sky_shows else job.background[:3]
                add_radiance(scratch, i, seen)
        if first and find_caught(world, scratch) != 0:
            catch_direct(world, scratch.counts[sc.CAUGHT], job.shadows, scratch)
            show_caught(world, job.sky_shows, scratch)
        # Shadow rays overwrite the tile's rays, so specular rays are stored first.
        spawn_specular(world, job.max_depth, scratch)
        light_tile(world, job.shadows, (sample, job.sky_rays, job.ao_distance), scratch)
        if first and job.muted:
            mute_back_faces(world, scratch)
        if not set_specular_rays(scratch):
            break
        trace_tile(world, scratch)
        describe_tile(world, True, scratch)
        first = False
    return met


@inline
def _integrate_direct(world: World, camera: Array, job: Pass, sample: int, scratch: Scratch) -> None:
    """Integrator "phong": add one sample of a tile to the pixel sums: direct light, hard shadows, mirrors, glass.

    job : settings of the pass; sample : index of the sample, for random numbers; camera : not used
    """
    trace_tile(world, scratch)
    if meets_nothing(scratch) and not job.sky_shows:  # only background: saves 40% of an empty frame
        return
    describe_tile(world, True, scratch)
    add_sample(_direct_light(world, job, sample, scratch), scratch)


@inline
def _integrate_occlusion(world: World, camera: Array, job: Pass, sample: int, scratch: Scratch) -> None:
    """Integrator "ao": add one sample of a tile, with ambient occlusion at the first hits, to the pixel sums.

    job : settings of the pass; sample : index of the sample, for random numbers; camera : not used
    """
    begin_radiance(scratch)
    trace_tile(world, scratch)
    describe_tile(world, True, scratch)
    met = i64(0)
    store_shading_points(world, scratch)
    for i in range(sc.TILE):
        hit = is_shaded(scratch, i)
        met |= i64(hit or job.sky_shows) << i
        if not hit and job.sky_shows:
            add_radiance(scratch, i, sky_radiance(world, load3(scratch.world, sc.DIRECTION + i)))
    caught = find_caught(world, scratch)
    see_sky(world, sample, job.ao_distance, scratch)
    catch_occlusion(caught, scratch)
    show_caught(world, job.sky_shows, scratch)
    add_sample(met, scratch)


@inline
def _integrate_paths(world: World, camera: Array, job: Pass, sample: int, scratch: Scratch) -> None:
    """Integrator "path": add one sample of a tile, a path with all its bounces for each ray, to the pixel sums.

    job : settings of the pass; sample : index of the sample, for random numbers; camera : not used
    """
    begin_radiance(scratch)
    begin_paths(scratch)
    add_sample(trace_paths(world, sample, job.max_depth, job.sky_shows, scratch), scratch)


@inline
def _integrate_quick(world: World, camera: Array, job: Pass, sample: int, scratch: Scratch) -> None:
    if job.integrator == PHONG:
        _integrate_direct(world, camera, job, sample, scratch)
    else:
        _integrate_first_hit(world, camera, job, sample, scratch)


@inline
def _integrate_sampled(world: World, camera: Array, job: Pass, sample: int, scratch: Scratch) -> None:
    if job.integrator == AO:
        _integrate_occlusion(world, camera, job, sample, scratch)
    else:
        _integrate_paths(world, camera, job, sample, scratch)


# Two kernels, not one an integrator: the traversal in each takes about 20 s to compile.
@kernel
def quick_frame(work: Array, world: World, camera: Array, job: Pass, film: Array, image: Array) -> None:
    """Render blocks of an image with the integrator "phong", "normal", "depth", "color" or "cost", as set in `job`.

    work : counter from which threads take blocks; camera : (16,), eye, axes, projection and lens
    job : settings and range of samples; image : (h, w, 4), the result, mean RGB over the background and alpha
    film : (h, w, k), updated, k sums over the samples of each pixel (RGB, hits and so on), or empty to keep none
    """
    render_tiles(_integrate_quick, work, world, camera, job, film, image)


@kernel
def sampled_frame(work: Array, world: World, camera: Array, job: Pass, film: Array, image: Array) -> None:
    """Render blocks of an image with the integrator "ao" or "path", as set in `job`.

    work : counter from which threads take blocks; camera : (16,), eye, axes, projection and lens
    job : settings and range of samples; image : (h, w, 4), the result, mean RGB over the background and alpha
    film : (h, w, k), updated, k sums over the samples of each pixel (RGB, hits and so on), or empty to keep none
    """
    render_tiles(_integrate_sampled, work, world, camera, job, film, image)
