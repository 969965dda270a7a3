"""Propagation of light along links: each bounce computes irradiance as pi times the mean radiance of a patch's links.

The links of a patch are cosine-distributed, so pi times the mean of their radiance is the irradiance. Pi times the mean
of radiance times a spherical harmonic is that harmonic of radiance times the cosine (see `shade/baked_code.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..engine.jit import Array, borrow, f32, f64, i64, inline, kernel, next_tile
from ..engine.kernels import vec
from ..engine.kernels.records import World
from ..engine.kernels.sampling import hash32
from ..engine.kernels.vec import Vec3
from ..shade.choice import meets_lamp
from ..shade.harmonics import band_1, band_2
from ..shade.rgbe import unpack_rgbe
from .directions import MOMENTS, link_cell, link_direction
from .gather import PATCHES, SKY, Patches, normal_of

PER_SOURCE = 4  # float32 of a source: RGB radiance, and one unused, so that a source does not straddle cache lines
CHUNK = 1024
FLAT = 1e-3  # smallest cosine at which the plane of a patch is intersected
# Per-patch values besides irradiance: moments minus those of uniform light (8 of luminance, 3 of red, 3 of blue), the
# fraction of links that lead to the sky, and the variance of the irradiance's luminance.
GRAY, RED, BLUE, SEES_SKY, VARIANCE, FACTS = 0, 8, 11, 14, 15, 16
# Sums of a patch: the moments of `directions.cell_moments` for luminance, the first three of them for red and for blue.
RED_SUM, BLUE_SUM, SUMS = 9, 12, 15


class Links(NamedTuple):
    """Links of m patches: `count` rays that each patch sent in one round, and the source of light that each ray met.

    links : (m * count,) int32, for each of a patch's rays the row of a table of sources (darkness, texels of the sky,
        patches); ~light, negative, for a light seen in a mirror or through glass
    tints : (m * count,), RGB9E5 colour of mirrors and glass on the way; empty in scenes without these
    rows : (m,) int32, indices of the patches
    share : (m,) float32, weight of this round for each patch: `count` over its number of links of all rounds
    hidden : (m * bytes_of(count),) uint8, a bit for each link, 1 if an area light blocks it; empty without area lights
    parts : (rows, columns) of the strata of the hemisphere, one for each link
    seed : of the random numbers that give the ray directions
    """

    links: Array
    tints: Array
    rows: Array
    share: Array
    hidden: Array
    parts: tuple[int, int]
    seed: int


@inline
def bytes_of(links: int) -> int:
    """Return the bytes of a bit mask with one bit for each of a patch's links, its rays to sources of light."""
    return (links + 7) // 8


@inline
def _is_hidden(links: Links, m: int, k: int) -> bool:
    """Return whether an area light blocks a link (a ray from a patch to a source of light), so that it brings no light.

    m, k : index of the patch in `links.rows`; index of the link among those of the patch
    """
    if links.hidden.size == 0:
        return False
    at = m * bytes_of(links.parts[0] * links.parts[1]) + k // 8
    return (links.hidden[at] >> (k % 8)) & 1 != 0


@inline
def _radiance(links: Links, at: int, sources: Array, lamps: Array) -> Vec3:
    """Return the RGB radiance that arrives along a link (a ray from a patch to a source of light).

    The radiance is tinted by mirrors and glass on the way, as given by `links.tints`.

    at : index of the link in `links.links`
    sources : flat float32, PER_SOURCE numbers with the radiance of each texel of the sky and each patch
    lamps : (lights * 3,) float64, radiance of the lights, for links that lead to one through a mirror or glass
    """
    link = i64(links.links[at])
    if link >= 0:
        k = PER_SOURCE * link
        light = f64(sources[k]), f64(sources[k + 1]), f64(sources[k + 2])
    elif 3 * ~link < lamps.size:
        light = lamps[3 * ~link], lamps[3 * ~link + 1], lamps[3 * ~link + 2]
    else:  # the lamp was removed
        light = vec.BLACK
    return vec.multiply(light, unpack_rgbe(i64(links.tints[at]))) if links.tints.size > 0 else light


@kernel
def add_irradiance(work: Array, links: Links, sources: Array, lamps: Array, every: int, out: Array) -> None:
    """Add the light that arrives along links (rays from patches to sources of light) to the irradiance in `out`.

    A patch's irradiance is pi times the mean radiance of its links, as these are cosine-distributed.

    sources : flat, radiance of sky texels and patches
    lamps : flat, radiance of lights
    every : follow one link in `every`; neighbouring patches follow different ones
    out : (patches * 3,) float32, irradiance
    """
    links, sources, lamps, out = borrow(links), borrow(sources), borrow(lamps), borrow(out)
    rows, columns = links.parts
    count = rows * columns
    chunk = next_tile(work)
    while chunk >= 0:
        for m in range(chunk * CHUNK, min((chunk + 1) * CHUNK, links.rows.size)):
            total, used = vec.BLACK, 0
            for row in range(rows):
                for k in range(row * columns + (hash32(links.rows[m]) + 2 * row) % every, (row + 1) * columns, every):
                    used += 1
                    if not _is_hidden(links, m, k):
                        total = vec.add(total, _radiance(links, m * count + k, sources, lamps))
            total = vec.scale(total, math.pi / max(used, 1) * links.share[m])
            patch = 3 * i64(links.rows[m])
            for c in range(3):
                out[patch + c] += f32(total[c])
        chunk = next_tile(work)


@kernel
def reflect(
    work: Array, arriving: tuple[Array, Array], surface: tuple[Array, Array], sources: Array, changes: Array
) -> None:
    """Write the radiance that each patch emits and reflects to `sources`: emission + albedo / pi * irradiance.

    arriving : (irradiance from lights, irradiance along links), (patches * 3,) float32 each
    surface : (albedo, emitted radiance), (patches * 3,) float32 each
    sources : flat float32, PER_SOURCE numbers for each texel of the sky, which stay, and for each patch
    changes : (chunks * 2,) float64, written, two sums over each CHUNK patches, by which convergence is judged: of the
        absolute change of radiance, and of the radiance
    """
    direct, indirect = borrow(arriving)
    albedo, emitted = borrow(surface)
    sources = borrow(sources)
    chunk = next_tile(work)
    while chunk >= 0:
        change = total = 0.0
        for patch in range(chunk * CHUNK, min((chunk + 1) * CHUNK, direct.size // 3)):
            for c in range(3):
                k, at = 3 * patch + c, PER_SOURCE * (PATCHES + patch) + c
                light = emitted[k] + albedo[k] * f32(1.0 / math.pi) * (direct[k] + indirect[k])
                change += abs(light - sources[at]) * 1.0
                total += light * 1.0
                sources[at] = light
        changes[2 * chunk], changes[2 * chunk + 1] = change, total
        chunk = next_tile(work)


@inline
def _add_moments(light: Vec3, moments: Array, at: int, sums: Array) -> None:
    """Add light from one direction to the sums from which a patch's spherical harmonics are computed.

    light : RGB
    moments : flat, from index `at` nine products x, y, z, xx, xy, xz, yy, yz, zz of the direction's components; for
        uniform light, their sums over directions
    sums : (SUMS,), changed in place: luminance times each of the nine products, red times x, y, z, blue times x, y, z
    """
    gray = vec.luminance(light)
    for b in range(MOMENTS):
        sums[b] += gray * moments[at + b]
    for b in range(3):
        sums[RED_SUM + b] += light[0] * moments[at + b]
        sums[BLUE_SUM + b] += light[2] * moments[at + b]


@inline
def _write_moments(sums: Array, normal: Vec3, scaled: float, out: Array, at: int) -> None:
    """Compute the spherical harmonics (bands 1 and 2, world space) of a patch's light, and add them to out[at:].

    sums : (SUMS,), light times products of direction components in the frame of the normal, from `_add_moments`
    scaled : factor for the harmonics
    """
    first, second = vec.tangents(normal)
    frame = first, second, normal
    gray = band_1(vec.turned(vec.load3_flat(sums, 0), frame))
    red = band_1(vec.turned(vec.load3_flat(sums, RED_SUM), frame))
    blue = band_1(vec.turned(vec.load3_flat(sums, BLUE_SUM), frame))
    for b in range(3):
        out[at + GRAY + b] += f32(gray[b] * scaled)
        out[at + RED + b] += f32(red[b] * scaled)
        out[at + BLUE + b] += f32(blue[b] * scaled)
    outer = vec.turned_matrix((sums[3], sums[4], sums[5], sums[6], sums[7], sums[8]), frame)
    rest = band_2(outer)
    for b in range(5):
        out[at + GRAY + 3 + b] += f32(rest[b] * scaled)


@kernel
def add_facts(
    work: Array, links: Links, patches: Patches, sources: Array, lamps: Array, moments: Array, out: Array
) -> None:
    """Add the contribution of links (rays from patches to sources of light) to the FACTS values of each patch in `out`.

    These are spherical harmonics of the arriving light minus those of uniform light, the fraction of links that lead to
    the sky, and the variance of the irradiance. The harmonics of uniform light are computed from the same links, so
    uniform light has no noise. All sums are taken in the frame of the normal with tabulated products of direction
    components: recomputing each direction took half of the time of all bounces.

    sources : flat, radiance of sky texels and patches
    lamps : flat, radiance of lights
    moments : flat float64, the tabulated products, from `directions.cell_moments`
    out : (patches * FACTS,) float32
    """
    links, patches = borrow(links), borrow(patches)
    sources, lamps, moments, out = borrow(sources), borrow(lamps), borrow(moments), borrow(out)
    count, sums, even = links.parts[0] * links.parts[1], np.zeros(SUMS), np.zeros(MOMENTS)
    chunk = next_tile(work)
    while chunk >= 0:
        for m in range(chunk * CHUNK, min((chunk + 1) * CHUNK, links.rows.size)):
            patch, share = i64(links.rows[m]), links.share[m] / count
            total, square, before, sky = vec.BLACK, 0.0, 0.0, 0
            sums[:] = 0.0
            even[:] = 0.0
            for k in range(count):
                seen = vec.BLACK if _is_hidden(links, m, k) else _radiance(links, m * count + k, sources, lamps)
                cell = MOMENTS * link_cell(patch, k, links.seed)
                _add_moments(seen, moments, cell, sums)
                for b in range(MOMENTS):
                    even[b] += moments[cell + b]
                total, light = vec.add(total, seen), vec.luminance(seen)
                sky += 1 if SKY <= links.links[m * count + k] < PATCHES else 0
                # Neighbouring strata see nearly the same, so their differences estimate the remaining noise.
                if k % links.parts[1] > 0:
                    square += (light - before) ** 2
                before = light
            _add_moments(vec.scale(total, -1.0 / count), even, 0, sums)
            _write_moments(sums, normal_of(patches, patch), math.pi * share, out, FACTS * patch)
            out[FACTS * patch + SEES_SKY] += f32(sky * share)
            pairs = count - links.parts[0]
            if pairs > 0:
                variance = 0.5 * square / pairs * math.pi**2 / count
                out[FACTS * patch + VARIANCE] += f32(variance * links.share[m] ** 2)
        chunk = next_tile(work)


@inline
def _is_blocked_by_lamp(world: World, patches: Patches, patch: int, d: Vec3, link: int) -> bool:
    """Return whether an area light lies on a patch's ray in direction d, before the source of light that the ray met.

    link : the source: PATCHES + index of a patch, or less for a texel of the sky or darkness
    """
    x, end = vec.load3_flat(patches.positions, 3 * patch), np.inf
    if link >= PATCHES:  # the ray met the plane of that patch, not its centre
        normal = normal_of(patches, link - PATCHES)
        to_middle = vec.sub(vec.load3_flat(patches.positions, 3 * (link - PATCHES)), x)
        end = vec.dot(to_middle, normal) / vec.dot(d, normal) if vec.dot(d, normal) < -FLAT else vec.length(to_middle)
    return meets_lamp(world, (x, d), end * (1.0 - 1e-6))


@kernel
def hide_links(work: Array, world: World, links: Links, patches: Patches) -> None:
    """Mark in `links.hidden` the links (rays from patches to sources of light) that an area light blocks.

    When links are found, rays pass through area lights, except after a mirror or glass; links can then be reused when
    lights change.
    """
    world, links, patches = borrow(world), borrow(links), borrow(patches)
    count = links.parts[0] * links.parts[1]
    chunk = next_tile(work)
    while chunk >= 0:
        for m in range(chunk * CHUNK, min((chunk + 1) * CHUNK, links.rows.size)):
            patch = i64(links.rows[m])
            normal, at = normal_of(patches, patch), m * bytes_of(count)
            for k in range(bytes_of(count)):
                links.hidden[at + k] = 0
            for k in range(count):
                d = link_direction(normal, patch, k, links.parts, links.seed)
                if _is_blocked_by_lamp(world, patches, patch, d, i64(links.links[m * count + k])):
                    links.hidden[at + k // 8] |= 1 << (k % 8)
        chunk = next_tile(work)
