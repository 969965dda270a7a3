"""Frames: blocks of pixels that threads take, tiles of 8 x 8 pixels in them, samples of these, one after the other.

A frame may be a pass of several: `film` (h, w, k) float32 keeps the first k of the sums of the samples so far (RGB, how
often something was met, the square of the luminance; how often a shadow catcher was, the light that would arrive there
and that does; see `pixels.LIGHT_SUMS`); an empty film where one pass is all. Within a pass sums are float64, for which
a large picture's film has no room; they are rounded where passes may end (`pixels.round_sums`), so that the picture
does not depend on how it is cut into passes. After 65,536 samples a sum is off by 2e-5 at most. `image` (h, w, 4) has
the means, over the background.

how, for both kernels
---------------------
samples : seed, samples a pixel at most, filter; span : numbers of the first sample and of the one after the last
window : pixels (left, top, right, bottom) outside of which nothing is met; background : RGB and alpha
"""

from __future__ import annotations

import numpy as np

from ..jit import borrow, cancelled, i64, inline, keep_alive, kernel, next_tile
from ..kernels.records import borrow_world
from ..kernels.scratch import (
    CAUGHT,
    COUNT_LEAVES,
    COUNT_NODES,
    DIRECTION,
    ORIGIN,
    SEEN_ONLY,
    SHADING_POINT,
    SHADING_WO,
    TILE,
    borrow_scratch,
    load3,
    new_scratch,
    store3,
)
from ..kernels.vec import add, scale
from ..shade.ambient import see_sky
from ..shade.bsdf import base_color
from ..shade.catcher import catch_direct, catch_occlusion, find_caught, show_caught
from ..shade.direct import light_tile
from ..shade.path import begin_paths, trace_paths
from ..shade.shading_points import add_radiance, begin_radiance, is_shaded, store_shading_points
from ..shade.sky import has_sky, sky_radiance
from ..shade.specular_rays import begin_specular, set_specular_rays, spawn_specular
from ..trace.hits import describe_tile, material_at, tile_hit
from ..trace.world import NO_RAY, meets_nothing, set_ray, trace_tile
from .film import (
    EDGE,
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

BLOCK = 16  # pixels a side of what a thread takes at a time: 4 tiles of 8 x 8


@inline
def look(world, hit, ray, camera, integrator):  # type: ignore[no-untyped-def]
    """Colour of what a camera ray (o, d) has hit, by an integrator that needs no light."""
    if integrator == NORMAL:
        return add(scale(hit.normal, 0.5), (0.5, 0.5, 0.5))
    if integrator == DEPTH:
        depth = depth_of(camera, ray, hit.t)
        return depth, depth, depth
    return base_color(world, material_at(world, hit.instance), hit.color)


@inline
def cost(world, ray, scratch):  # type: ignore[no-untyped-def]
    """Nodes and leaves that a ray (o, d) visits when it is traced alone, as a colour."""
    scratch.counts[COUNT_NODES], scratch.counts[COUNT_LEAVES] = 0, 0
    set_ray(scratch, 0, (ray[0], ray[1], 0.0, np.inf))
    for k in range(1, TILE):
        set_ray(scratch, k, NO_RAY)
    trace_tile(world, scratch)
    nodes, leaves = float(scratch.counts[COUNT_NODES]), float(scratch.counts[COUNT_LEAVES])
    return nodes, leaves, (nodes + leaves) / 64.0


@inline
def _costs(world, scratch):  # type: ignore[no-untyped-def]
    """Add the costs of the tile's rays, each traced alone."""
    points = scratch.shading_points
    for i in range(TILE):
        o, d = _tile_ray(scratch, i)
        store3(points, SHADING_POINT + i, o)
        store3(points, SHADING_WO + i, d)
    for i in range(TILE):
        add_color(scratch, i, cost(world, (load3(points, SHADING_POINT + i), load3(points, SHADING_WO + i)), scratch))


@inline
def _tile_ray(scratch, i):  # type: ignore[no-untyped-def]
    """(o, d) of ray i of the tile, in the world."""
    return load3(scratch.world, ORIGIN + i), load3(scratch.world, DIRECTION + i)


@inline
def _corner(block, tile, width):  # type: ignore[no-untyped-def]
    """Where a tile of a block begins: column, row."""
    across = (width + BLOCK - 1) // BLOCK
    return block % across * BLOCK + tile % 2 * EDGE, block // across * BLOCK + tile // 2 * EDGE


@inline
def _is_beside(corner, window):  # type: ignore[no-untyped-def]
    """Whether a tile lies outside of the window."""
    beside = (corner[0] + EDGE <= window[0]) | (corner[0] >= window[2])
    return beside | (corner[1] + EDGE <= window[1]) | (corner[1] >= window[3])


@inline
def _direct(world, how, look, background, scratch):  # type: ignore[no-untyped-def]
    """Radiance along the tile's rays, which are traced: direct light, and what comes by mirrors and glass.

    how : depth, shadows, sky_shows: whether a camera's ray that meets nothing sees the sky; look : see
    `find_sky_seen`. Returns the rays that have met anything (bits).
    """
    met = i64(0)
    most, shadows, sky_shows = how
    begin_radiance(scratch)
    begin_specular(scratch)
    first = True
    while True:
        store_shading_points(scratch)
        for i in range(TILE):
            hit = is_shaded(scratch, i)
            if first and (hit or sky_shows):
                met |= i64(1) << i
            if not hit and (sky_shows or not first):
                d = load3(scratch.world, DIRECTION + i)
                add_radiance(scratch, i, sky_radiance(world, d) if has_sky(world) or sky_shows else background)
        if first and find_caught(world, scratch) != 0:
            catch_direct(world, scratch.counts[CAUGHT], shadows, scratch)
            show_caught(world, sky_shows, scratch)
        # Shadow rays take the place of the tile's: what goes on is put down before.
        spawn_specular(world, most, scratch)
        light_tile(world, shadows, look, scratch)
        if not set_specular_rays(scratch):
            break
        trace_tile(world, scratch)
        describe_tile(world, scratch)
        first = False
    return met


@kernel
def quick_frame(work, world, camera, how, film, image):  # type: ignore[no-untyped-def]
    """Direct light, or what is at the first hit. how : integrator, shadows, depth, whether the sky shows, rays by which
    it is looked for and their reach, samples, span, window, background."""
    memory = new_scratch(world.longest)
    scratch, world = borrow_scratch(memory), borrow_world(world)
    scratch.counts[SEEN_ONLY] = 1
    integrator, shadows, most, sky_shows, sky_rays, reach, samples, span, window, background = how
    camera = borrow(camera)
    height, width = image.shape[:2]
    block = next_tile(work)
    while block >= 0:
        for tile in range(BLOCK * BLOCK // TILE):
            corner = _corner(block, tile, width)
            if corner[0] >= width or corner[1] >= height:
                continue
            if _is_beside(corner, window):
                fill_tile(corner, background, image)
                continue
            if samples[1] > 1 or sky_rays > 0:  # else nothing is left to chance: 2% of a lit frame
                begin_tile(corner, (width, height), samples[0], scratch)
            begin_sums(corner, span[0], film, scratch)
            for sample in range(span[0], span[1]):
                if cancelled(work):  # a block of many samples takes long
                    break
                round_sums(sample, span[0], scratch)
                set_pixel_rays(camera, (width, height), corner, sample, samples, scratch)
                if integrator == COST:
                    _costs(world, scratch)
                    continue
                trace_tile(world, scratch)
                if meets_nothing(scratch) and not sky_shows:  # background alone: empty frames in 0.6 of the time
                    continue
                if integrator in (PHONG, COLOR):
                    describe_tile(world, scratch)
                if integrator == PHONG:
                    way, look_up = (most, shadows != 0, sky_shows != 0), (sample, sky_rays, reach)
                    add_sample(_direct(world, way, look_up, background[:3], scratch), scratch)
                    continue
                for i in range(TILE):
                    hit = tile_hit(scratch, i)
                    if hit.instance >= 0:
                        add_color(scratch, i, look(world, hit, _tile_ray(scratch, i), camera, integrator))
            finish_sums(corner, span[1], background, film, image, scratch)
        block = next_tile(work)
    keep_alive(memory)
    return 0


@inline
def _occlusion(world, sample, reach, sky_shows, scratch):  # type: ignore[no-untyped-def]
    """Ambient occlusion along the tile's rays; returns those that have met anything (bits), if only the sky."""
    trace_tile(world, scratch)
    describe_tile(world, scratch)
    met = i64(0)
    store_shading_points(scratch)
    for i in range(TILE):
        hit = is_shaded(scratch, i)
        met |= i64(hit or sky_shows) << i
        if not hit and sky_shows:
            add_radiance(scratch, i, sky_radiance(world, load3(scratch.world, DIRECTION + i)))
    caught = find_caught(world, scratch)
    see_sky(world, sample, reach, scratch)
    catch_occlusion(caught, scratch)
    show_caught(world, sky_shows, scratch)
    return met


@kernel
def sampled_frame(work, world, camera, how, film, image):  # type: ignore[no-untyped-def]
    """Ambient occlusion and path tracing. how : integrator, reach, depth, whether the sky shows, samples, span,
    window, background."""
    memory = new_scratch(world.longest)
    scratch, world = borrow_scratch(memory), borrow_world(world)
    scratch.counts[SEEN_ONLY] = 1
    integrator, reach, most, sky_shows, samples, span, window, background = how
    camera = borrow(camera)
    height, width = image.shape[:2]
    block = next_tile(work)
    while block >= 0:
        for tile in range(BLOCK * BLOCK // TILE):
            corner = _corner(block, tile, width)
            if corner[0] >= width or corner[1] >= height:
                continue
            if _is_beside(corner, window):
                fill_tile(corner, background, image)
                continue
            begin_tile(corner, (width, height), samples[0], scratch)
            begin_sums(corner, span[0], film, scratch)
            for sample in range(span[0], span[1]):
                if cancelled(work):
                    break
                round_sums(sample, span[0], scratch)
                set_pixel_rays(camera, (width, height), corner, sample, samples, scratch)
                begin_radiance(scratch)
                if integrator == AO:
                    met = _occlusion(world, sample, reach, sky_shows != 0, scratch)
                else:
                    begin_paths(scratch)
                    met = trace_paths(world, sample, most, sky_shows != 0, scratch)
                add_sample(met, scratch)
            finish_sums(corner, span[1], background, film, image, scratch)
        block = next_tile(work)
    keep_alive(memory)
    return 0
