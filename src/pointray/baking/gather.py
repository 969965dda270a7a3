"""The rays of a bake: link rays, which find where each patch receives light from, and shadow rays to the lights.

A link is a number: BLACK; INSIDE, the dark side of a surface; a texel of the sky, from SKY; a patch, from PATCHES; or
~(number of a light), negative, for a light seen in a mirror or through glass. Light that patches receive directly from
lights is found by shadow rays instead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..engine.jit import Array, borrow, f32, f64, i32, i64, inline, keep_alive, kernel, next_tile
from ..engine.kernels import records as rec, scratch as sc
from ..engine.kernels.records import World, WorldHit
from ..engine.kernels.sampling import ON_LIGHT, WHICH, hash32, sample_pair
from ..engine.kernels.scratch import Scratch, load3, new_scratch, store3
from ..engine.kernels.vec import BLACK as NO_LIGHT, WHITE, Vec3, add, dot, load3_flat, multiply, scale
from ..shade.bsdf import is_specular, sample_bsdf
from ..shade.choice import choose_light, meets_lamp, nearest_lamp
from ..shade.direct import shade_gains
from ..shade.emitters import sample_light
from ..shade.grid import grid_cell, grid_frame
from ..shade.rgbe import pack_rgbe, signed
from ..shade.shading_points import shading_point, start_of, store_shading_points
from ..surface.trace.hits import describe_tile, material_at, tile_hit
from ..surface.trace.world import NO_RAY, is_blocked, occlude_tile, set_ray, set_ray_from, trace_tile
from .directions import SKY_TEXELS, link_direction, texel_of

BLACK, INSIDE, SKY = 0, 1, 2
PATCHES = SKY + SKY_TEXELS

FIND_LINKS, FIND_DIRECT, FIND_SUNS = range(3)
MOST_MIRRORS = 16  # longest chain of mirrors and glass surfaces
FEW_LIGHTS = 16  # up to this number, each light gets its own shadow rays
MANY_LIGHT_SAMPLES = 64  # shadow rays of a patch in scenes with more lights
SUN_SAMPLES = 4  # shadow rays to a sun with a radius

TARGET = 3  # int64 per instance: its first patch on the front and on the back, or -1; the start of its patch_of
ONE_TILE = 3  # int64 per tile: its first row, its number of rows, its side (1 or -1)


class Patches(NamedTuple):
    """The patches of all sides of surfaces, and the rows of those to process in one call of a kernel.

    positions : (n * 3,) float64, world
    normals : (n * 3,) float32, unit, pointing to the side that receives light
    rows : (m,) int32, the patches to process, one side after the other
    tiles : (tiles * ONE_TILE,) int64, for each tile of up to 64 patches of one side: its first index in `rows`, its
        number of patches, and 1 for fronts or -1 for backs
    """

    positions: Array
    normals: Array
    rows: Array
    tiles: Array


class Targets(NamedTuple):
    """Tables that map a ray's hit to the patch that represents it.

    rows : (instances * TARGET,) int64, for each instance the first patch of its front and of its back, or -1 if that
        side is dark, and where its model begins in `patch_of`
    patch_of : int32, for each splat of each model, in the order of its tree, its patch as an index among the model's
    frames : (instances * BAKED_FRAME,) float64, for planes the grid whose cells are patches, see `records.BAKED_FRAME`
    """

    rows: Array
    patch_of: Array
    frames: Array


class Rays(NamedTuple):
    """Parameters of the rays that patches send.

    stage : kind of the rays, FIND_LINKS (over the hemisphere, to find what each patch sees), FIND_DIRECT (shadow rays
        to lights) or FIND_SUNS (shadow rays to bright spots of the sky)
    parts : (rows, columns) of the strata of the hemisphere, with one FIND_LINKS ray each
    seed : of the random numbers
    samples : shadow rays to each area light
    tinted : whether there are mirrors or glass, which colour what is seen in them
    suns : (n * 3,) float64, directions to bright spots of the sky
    """

    stage: int
    parts: tuple[int, int]
    seed: int
    samples: int
    tinted: bool
    suns: Array


class Found(NamedTuple):
    """Results of the rays that m patches send; arrays that a kind of ray does not fill are empty.

    links : (m * rays,) int32, what each ray met: BLACK (no light), INSIDE (a dark side), SKY + texel, PATCHES + patch,
        or ~light, negative, for a light seen in a mirror or through glass
    tints : (m * rays,), RGB9E5 colour of mirrors and glass on the way; empty without these
    nearness : (m,) float32, for each patch the sum of the inverse distances at which its rays first hit something
    direct : for shadow rays to lights (m * 3,) float32, irradiance from lights other than sky and emissive surfaces;
        for those to bright spots of the sky (m * suns,), the cosine to each spot, 0 where it is occluded
    """

    links: Array
    tints: Array
    nearness: Array
    direct: Array


@inline
def _patch_at(world: World, targets: Targets, hit: WorldHit, ray: tuple[Vec3, Vec3]) -> int:
    """Return PATCHES + the patch that a ray (o, d) hit, on the side that it came from; INSIDE if that side is dark.

    targets : tables that map a hit to a patch
    """
    row = hit.instance * TARGET
    first = targets.rows[row] if dot(hit.normal, ray[1]) < 0.0 else targets.rows[row + 1]
    if first < 0:
        return INSIDE
    record = hit.instance * rec.INSTANCE
    if world.instances[record + rec.KIND] == rec.MODEL:
        return i64(PATCHES + first + targets.patch_of[targets.rows[row + 2] + hit.slot])
    plane, frame = (
        int(world.instances[record + rec.SHAPE_ROW]) * rec.PLANE_SIZE,
        grid_frame(targets.frames, hit.instance),
    )
    return i64(PATCHES + first + grid_cell(world, plane, frame, add(ray[0], scale(ray[1], hit.t))))


@inline
def _continue_ray(world: World, i: int, key: int, depth: int, scratch: Scratch) -> bool:
    """Reflect or refract ray i, which hit a mirror or glass; return whether its new throughput is above 0.

    key : of the random numbers, which choose between reflection and refraction; depth : number of earlier such hits
    """
    points = scratch.shading_points
    material, point = shading_point(world, scratch, i)
    which, _ = sample_pair(key, depth, WHICH)
    d, weight, _, side = sample_bsdf(world, material, point, which, 0.0, 0.0)
    throughput = multiply(load3(points, sc.THROUGHPUT + i), weight)
    store3(points, sc.THROUGHPUT + i, throughput)
    set_ray_from(scratch, i, (start_of(scratch, i, side), d, 0.0, np.inf), side)
    return max(throughput[0], throughput[1], throughput[2]) > 0.0


@inline
def _resolve(world: World, targets: Targets, i: int, depth: int, key: int, scratch: Scratch) -> tuple[int, bool]:
    """Return (source of light that ray i met, whether the ray continues from a mirror or glass instead).

    The source is BLACK (no light), INSIDE (a dark side), SKY + texel, PATCHES + patch, or ~light, negative.

    targets : tables that map a hit to a patch; depth : number of earlier mirrors and glass surfaces
    key : of the random numbers
    """
    ray, hit = (load3(scratch.world, sc.ORIGIN + i), load3(scratch.world, sc.DIRECTION + i)), tile_hit(scratch, i)
    if depth > 0:
        light = nearest_lamp(world, ray, hit.t)[1]
        if light >= 0:
            return i64(~(light // rec.LIGHT)), False
    if hit.instance < 0:
        return i64(SKY + texel_of(ray[1])), False
    if is_specular(world, material_at(world, hit.instance)):
        return i64(BLACK), depth < MOST_MIRRORS and _continue_ray(world, i, key, depth, scratch)
    return _patch_at(world, targets, hit, ray), False


@inline
def _trace_links(
    world: World, targets: Targets, tile: tuple[int, int, int], rays: Rays, k: int, found: Found, scratch: Scratch
) -> None:
    """Trace the tile's rays through mirrors and glass until each meets a source of light, and store this in `found`.

    targets : tables that map a hit to a patch
    tile : first index in `Patches.rows`, number of patches, and 1 for fronts or -1 for backs
    k : each patch of the tile sends its k-th ray
    """
    count = rays.parts[0] * rays.parts[1]
    for i in range(sc.TILE):
        store3(scratch.shading_points, sc.THROUGHPUT + i, WHITE)
    left, depth = i64(-1), 0
    while left != 0:
        trace_tile(world, scratch)
        describe_tile(world, False, scratch)
        if rays.tinted:
            store_shading_points(world, scratch)
        onward = i64(0)
        for i in range(tile[1]):
            if (left >> i) & 1 == 0:
                continue
            at = (tile[0] + i) * count + k
            if depth == 0 and scratch.world[sc.NEAREST + i] > 0.0:
                found.nearness[tile[0] + i] += f32(1.0 / scratch.world[sc.NEAREST + i])
            link, goes = _resolve(world, targets, i, depth, hash32((rays.seed + at) & 0xFFFFFFFF), scratch)
            found.links[at] = i32(link)
            if goes:
                onward |= i64(1) << i
                continue
            if rays.tinted:
                found.tints[at] = i32(signed(pack_rgbe(load3(scratch.shading_points, sc.THROUGHPUT + i))))
            set_ray(scratch, i, NO_RAY)
        left, depth = onward, depth + 1


@inline
def _find_links(
    world: World,
    patches: Patches,
    targets: Targets,
    tile: tuple[int, int, int],
    rays: Rays,
    found: Found,
    scratch: Scratch,
) -> None:
    """Send rays from each patch of a tile over its hemisphere, and store what they meet in `found.links`.

    targets : tables that map a hit to a patch
    tile : first index in `patches.rows`, number of patches, and 1 for fronts or -1 for backs
    """
    for k in range(rays.parts[0] * rays.parts[1]):
        for i in range(sc.TILE):
            set_ray(scratch, i, NO_RAY)
        for i in range(tile[1]):
            patch = patches.rows[tile[0] + i]
            d = link_direction(normal_of(patches, patch), patch, k, rays.parts, rays.seed)
            ray = load3_flat(patches.positions, 3 * patch), d, 0.0, np.inf
            set_ray_from(scratch, i, ray, f64(tile[2]))
        _trace_links(world, targets, tile, rays, k, found, scratch)


@inline
def normal_of(patches: Patches, patch: int) -> Vec3:
    """Return the unit normal of a patch, which is stored as float32, as float64."""
    n = load3_flat(patches.normals, 3 * patch)
    return f64(n[0]), f64(n[1]), f64(n[2])


@inline
def _samples_to(world: World, light: int, rays: Rays) -> int:
    """Return the number of shadow rays from a patch to a light. light : offset of its record in `world.lights`"""
    if world.lights[light + rec.LIGHT_AREA] > 0.0:
        return rays.samples
    return SUN_SAMPLES if world.lights[light + rec.LIGHT_RADIUS] > 0.0 else 1


@inline
def _add_light(
    world: World, patches: Patches, tile: tuple[int, int, int], which: tuple[int, int, int], seed: int, scratch: Scratch
) -> None:
    """Add one sample of a light, with a shadow ray, to the irradiance of each patch of a tile (row RADIANCE).

    tile : first index in `patches.rows`, number of patches, and 1 for fronts or -1 for backs
    which : (light, sample, samples), the index of the light, or -1 to choose one at random, the index of the sample,
        and the number of samples, by which the light is divided
    """
    points, lit = scratch.shading_points, False
    for i in range(sc.TILE):
        store3(points, sc.GAIN + i, NO_LIGHT)
        set_ray(scratch, i, NO_RAY)
    for i in range(tile[1]):
        patch = patches.rows[tile[0] + i]
        x, n = load3_flat(patches.positions, 3 * patch), normal_of(patches, patch)
        key, light, chance = hash32((seed + patch) & 0xFFFFFFFF), which[0], 1.0
        if light < 0:
            light, chance = choose_light(world, sample_pair(key, which[1], WHICH)[0])
            if chance == 0.0 or light * rec.LIGHT >= world.lights.size:  # the sky is sampled by links
                continue
        u, v = sample_pair((key + light) & 0xFFFFFFFF, which[1], ON_LIGHT)
        arriving = sample_light(world, light * rec.LIGHT, x, u, v)
        gain = scale(arriving.light, max(dot(n, arriving.wi), 0.0) / (chance * which[2]))
        end = arriving.distance * (1.0 - 1e-6)
        if gain[0] + gain[1] + gain[2] > 0.0 and not meets_lamp(world, (x, arriving.wi), end):
            store3(points, sc.GAIN + i, gain)
            set_ray_from(scratch, i, (x, arriving.wi, 0.0, arriving.distance), f64(tile[2]))
            lit = True
    if lit:
        occlude_tile(world, scratch)
        shade_gains(scratch)
        for i in range(sc.TILE):
            store3(points, sc.RADIANCE + i, add(load3(points, sc.RADIANCE + i), load3(points, sc.GAIN + i)))


@inline
def _find_direct(
    world: World, patches: Patches, tile: tuple[int, int, int], rays: Rays, found: Found, scratch: Scratch
) -> None:
    """Compute the irradiance of a tile's patches from lights other than sky and emissive surfaces, in `found.direct`.

    tile : first index in `patches.rows`, number of patches, and 1 for fronts or -1 for backs
    rays : gives number and seed of the shadow rays
    """
    points = scratch.shading_points
    for i in range(sc.TILE):
        store3(points, sc.RADIANCE + i, NO_LIGHT)
    lights = world.lights.size // rec.LIGHT
    if lights > FEW_LIGHTS:
        for sample in range(MANY_LIGHT_SAMPLES):
            _add_light(world, patches, tile, (-1, sample, MANY_LIGHT_SAMPLES), rays.seed, scratch)
    else:
        for light in range(lights):
            samples = _samples_to(world, light * rec.LIGHT, rays)
            for sample in range(samples):
                _add_light(world, patches, tile, (light, sample, samples), rays.seed, scratch)
    for i in range(tile[1]):
        light_at = load3(points, sc.RADIANCE + i)
        for c in range(3):
            found.direct[3 * (tile[0] + i) + c] = f32(light_at[c])


@inline
def _find_suns(
    world: World, patches: Patches, tile: tuple[int, int, int], rays: Rays, found: Found, scratch: Scratch
) -> None:
    """Store the cosine of each patch of a tile to each bright spot of the sky in `found.direct`; 0 where occluded.

    tile : first index in `patches.rows`, number of patches, and 1 for fronts or -1 for backs
    rays : gives the directions to the spots
    """
    count = rays.suns.size // 3
    for sun in range(count):
        d, lit = load3_flat(rays.suns, 3 * sun), False
        for i in range(sc.TILE):
            set_ray(scratch, i, NO_RAY)
        for i in range(tile[1]):
            patch = patches.rows[tile[0] + i]
            x, cosine = load3_flat(patches.positions, 3 * patch), dot(normal_of(patches, patch), d)
            found.direct[(tile[0] + i) * count + sun] = f32(max(cosine, 0.0))
            if cosine > 0.0 and not meets_lamp(world, (x, d), np.inf):
                set_ray_from(scratch, i, (x, d, 0.0, np.inf), f64(tile[2]))
                lit = True
        if lit:
            occlude_tile(world, scratch)
            for i in range(tile[1]):
                if is_blocked(scratch, i):
                    found.direct[(tile[0] + i) * count + sun] = f32(0.0)


@kernel
def send_rays(work: Array, world: World, patches: Patches, targets: Targets, rays: Rays, found: Found) -> None:
    """Send the rays of the selected patches and store what they find, tile by tile.

    targets : tables that map a hit to a patch
    rays : which of three kinds of rays to send, and their parameters
    found : arrays to which the results are written, by index in `patches.rows`
    """
    patches, targets, found = borrow(patches), borrow(targets), borrow(found)
    memory = new_scratch(world.longest)
    scratch, world = borrow(memory), borrow(world)
    at = next_tile(work)
    while at >= 0:
        k = at * ONE_TILE
        tile = patches.tiles[k], patches.tiles[k + 1], patches.tiles[k + 2]
        if rays.stage == FIND_LINKS:
            _find_links(world, patches, targets, tile, rays, found, scratch)
        elif rays.stage == FIND_DIRECT:
            _find_direct(world, patches, tile, rays, found, scratch)
        else:
            _find_suns(world, patches, tile, rays, found, scratch)
        at = next_tile(work)
    keep_alive(memory)
