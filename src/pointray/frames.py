"""Frames: blocks of pixels that threads take, tiles of 8 x 8 pixels in them, samples of these, one after the other.

A frame may be a pass of several: `film` (h, w, 8) float64 keeps the sums of the samples so far (RGB, how often
something was met, the square of the luminance; how often a shadow catcher was, the light that would arrive there and
that does), in the order of the samples, so that the picture does not depend on how it is cut into passes; an empty film
where one pass is all. `image` (h, w, 4) has the means, over the background.

how, for both kernels
---------------------
samples : seed, samples a pixel at most, filter; span : numbers of the first sample and of the one after the last
background : RGB and alpha
"""

from __future__ import annotations

import numpy as np

from .jit import borrow, cancelled, inline, keep, kernel, take
from .lens import camera_ray, depth_of
from .records import lend_world
from .sampling import pixel_key
from .scratch import (
    CAUGHT,
    COUNT_LEAVES,
    COUNT_NODES,
    DIRECTION,
    LIT,
    ORIGIN,
    RADIANCE,
    TILE,
    UNLIT,
    lend_scratch,
    new_scratch,
    row,
)
from .settings import AO, COLOR, COST, DEPTH, NORMAL, PHONG
from .shade.ambient import see_sky
from .shade.bsdf import base_color, material_at
from .shade.catcher import catch_direct, catch_occlusion, find_caught
from .shade.direct import light_tile
from .shade.onward import aim_onward, begin_onward, send_onward
from .shade.path import begin_paths, trace_paths
from .shade.sky import has_sky, sky_radiance
from .shade.spots import add_radiance, begin_radiance, keep_spot
from .simd import lowest
from .trace.hits import describe_tile, tile_hit
from .trace.world import NOWHERE, aim, trace_tile
from .vec import add, along_curve, luminance, scale

BLOCK = 16  # pixels a side of what a thread takes at a time: 4 tiles of 8 x 8
SUMS = 8


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
    aim(scratch, 0, (ray[0], ray[1], 0.0, np.inf))
    for k in range(1, TILE):
        aim(scratch, k, NOWHERE)
    trace_tile(world, scratch)
    nodes, leaves = float(scratch.counts[COUNT_NODES]), float(scratch.counts[COUNT_LEAVES])
    return nodes, leaves, (nodes + leaves) / 64.0


@inline
def _add(total, i, color, met):  # type: ignore[no-untyped-def]
    """Add a sample to a pixel's sums."""
    light = luminance(color)
    for c in range(3):
        total[i, c] += color[c]
    total[i, 3] += 1.0 if met else 0.0
    total[i, 4] += light * light


@inline
def _add_tile(total, met, scratch):  # type: ignore[no-untyped-def]
    """Add a sample of the tile's radiance to its pixels. met : the rays that have met anything (bits)"""
    spots, caught = scratch.spots, scratch.counts[CAUGHT]
    met &= ~caught
    for i in range(TILE):
        _add(total, i, row(spots, RADIANCE + i), (met >> i) & 1 != 0)
    while caught != 0:
        i = lowest(caught)
        caught &= caught - 1
        total[i, 5] += 1.0
        total[i, 6] += spots[UNLIT + i]
        total[i, 7] += spots[LIT + i]


@inline
def _covered(total, i):  # type: ignore[no-untyped-def]
    """How many of a pixel's samples are covered: those on shadow catchers by the share of the light they lack."""
    if total[i, 6] <= 0.0:
        return total[i, 3]
    return total[i, 3] + total[i, 5] * (1.0 - total[i, 7] / total[i, 6])


@inline
def _aim_pixels(camera, image, corner, sample, samples, scratch):  # type: ignore[no-untyped-def]
    """The tile's rays become those of one sample of 8 x 8 pixels; those beyond the image's edge repeat its last ones.

    The pixels follow a Morton curve: four rays in a row are neighbours.
    """
    height, width = image.shape[:2]
    for i in range(TILE):
        x, y = along_curve(i)
        pixel = min(corner[0] + x, width - 1), min(corner[1] + y, height - 1)
        o, d = camera_ray(camera, (width, height), pixel, sample, samples)
        aim(scratch, i, (o, d, 0.0, np.inf))


@inline
def _tile_ray(scratch, i):  # type: ignore[no-untyped-def]
    """(o, d) of ray i of the tile, in the world."""
    return row(scratch.world, ORIGIN + i), row(scratch.world, DIRECTION + i)


@inline
def _costs(world, camera, image, corner, sample, samples, out):  # type: ignore[no-untyped-def]
    """Add the cost of one sample of 8 x 8 pixels, each ray traced alone. out : total, scratch."""
    height, width = image.shape[:2]
    for i in range(TILE):
        x, y = along_curve(i)
        ray = camera_ray(camera, (width, height), (corner[0] + x, corner[1] + y), sample, samples)
        _add(out[0], i, cost(world, ray, out[1]), True)


@inline
def _begin(total, corner, first, film):  # type: ignore[no-untyped-def]
    """The sums of 8 x 8 pixels so far."""
    total[:] = 0.0
    if first == 0:
        return
    height, width = film.shape[:2]
    for i in range(TILE):
        x, y = along_curve(i)
        x, y = corner[0] + x, corner[1] + y
        if x < width and y < height:
            for c in range(SUMS):
                total[i, c] = film[y, x, c]


@inline
def _finish(total, corner, done, background, out):  # type: ignore[no-untyped-def]
    """Write the means of 8 x 8 pixels, over the background, and keep the sums. out : film, image."""
    film, image = out
    height, width = image.shape[:2]
    for i in range(TILE):
        x, y = along_curve(i)
        x, y = corner[0] + x, corner[1] + y
        if x < width and y < height:
            covered = _covered(total, i)
            for c in range(3):
                image[y, x, c] = (total[i, c] + (done - covered) * background[c]) / done
            image[y, x, 3] = (covered + (done - covered) * background[3]) / done
            if film.size > 0:
                for c in range(SUMS):
                    film[y, x, c] = total[i, c]


@inline
def _corner(block, tile, width):  # type: ignore[no-untyped-def]
    """Where a tile of a block begins: column, row."""
    across = (width + BLOCK - 1) // BLOCK
    return block % across * BLOCK + tile % 2 * 8, block // across * BLOCK + tile // 2 * 8


@inline
def _direct(world, most, shadows, background, scratch):  # type: ignore[no-untyped-def]
    """Radiance along the tile's rays, which are traced: direct light, and what comes by mirrors and glass."""
    begin_radiance(scratch)
    begin_onward(scratch)
    first = True
    while True:
        for i in range(TILE):
            ray, hit = _tile_ray(scratch, i), tile_hit(scratch, i)
            keep_spot(scratch, i, hit, ray)
            if not first and hit.instance < 0:
                add_radiance(scratch, i, sky_radiance(world, ray[1]) if has_sky(world) else background)
        if first and find_caught(world, scratch) != 0:
            catch_direct(world, scratch.counts[CAUGHT], shadows, scratch)
        # Shadow rays take the place of the tile's: what goes on is put down before.
        send_onward(world, most, scratch)
        light_tile(world, shadows, scratch)
        if not aim_onward(scratch):
            break
        trace_tile(world, scratch)
        describe_tile(world, scratch)
        first = False


@kernel
def quick_frame(work, world, camera, how, film, image):  # type: ignore[no-untyped-def]
    """Direct light, or what is at the first hit. how : integrator, shadows, depth, samples, span, background."""
    memory = new_scratch(world.longest)
    scratch, world = lend_scratch(memory), lend_world(world)
    integrator, shadows, most, samples, span, background = how
    camera = borrow(camera)
    height, width = image.shape[:2]
    total = np.empty((TILE, SUMS), np.float64)
    block = take(work)
    while block >= 0:
        for tile in range(BLOCK * BLOCK // TILE):
            corner = _corner(block, tile, width)
            if corner[0] >= width or corner[1] >= height:
                continue
            _begin(total, corner, span[0], film)
            for sample in range(span[0], span[1]):
                if cancelled(work):  # a block of many samples takes long
                    break
                if integrator == COST:
                    _costs(world, camera, image, corner, sample, samples, (total, scratch))
                    continue
                _aim_pixels(camera, image, corner, sample, samples, scratch)
                trace_tile(world, scratch)
                if integrator in (PHONG, COLOR):
                    describe_tile(world, scratch)
                met = np.int64(0)
                for i in range(TILE):
                    hit = tile_hit(scratch, i)
                    if hit.instance >= 0:
                        met |= np.int64(1) << i
                        if integrator != PHONG:
                            _add(total, i, look(world, hit, _tile_ray(scratch, i), camera, integrator), True)
                if integrator == PHONG:
                    _direct(world, most, shadows != 0, background[:3], scratch)
                    _add_tile(total, met, scratch)
            _finish(total, corner, span[1], background, (film, image))
        block = take(work)
    keep(memory)
    keep(total)
    return 0


@inline
def _occlusion(world, keys, sample, reach, scratch):  # type: ignore[no-untyped-def]
    """Ambient occlusion along the tile's rays; returns those that have met anything (bits)."""
    trace_tile(world, scratch)
    describe_tile(world, scratch)
    met = np.int64(0)
    for i in range(TILE):
        hit = tile_hit(scratch, i)
        keep_spot(scratch, i, hit, _tile_ray(scratch, i))
        met |= np.int64(hit.instance >= 0) << i
    caught = find_caught(world, scratch)
    see_sky(world, keys, sample, reach, scratch)
    catch_occlusion(caught, scratch)
    return met


@kernel
def sampled_frame(work, world, camera, how, film, image):  # type: ignore[no-untyped-def]
    """Ambient occlusion and path tracing. how : integrator, reach, depth, whether the sky shows, samples, span,
    background."""
    memory = new_scratch(world.longest)
    scratch, world = lend_scratch(memory), lend_world(world)
    integrator, reach, most, sky_shows, samples, span, background = how
    camera = borrow(camera)
    height, width = image.shape[:2]
    total, keys = np.empty((TILE, SUMS), np.float64), np.empty(TILE, np.int64)
    block = take(work)
    while block >= 0:
        for tile in range(BLOCK * BLOCK // TILE):
            corner = _corner(block, tile, width)
            if corner[0] >= width or corner[1] >= height:
                continue
            _begin(total, corner, span[0], film)
            for i in range(TILE):
                x, y = along_curve(i)
                keys[i] = pixel_key(corner[0] + x, corner[1] + y, samples[0])
            for sample in range(span[0], span[1]):
                if cancelled(work):
                    break
                _aim_pixels(camera, image, corner, sample, samples, scratch)
                begin_radiance(scratch)
                if integrator == AO:
                    met = _occlusion(world, keys, sample, reach, scratch)
                else:
                    begin_paths(keys, scratch)
                    met = trace_paths(world, sample, most, sky_shows != 0, scratch)
                _add_tile(total, met, scratch)
            _finish(total, corner, span[1], background, (film, image))
        block = take(work)
    keep(memory)
    keep(total)
    keep(keys)
    return 0
