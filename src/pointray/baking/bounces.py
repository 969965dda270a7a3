"""Light over links: every bounce is a pass of sums, irradiance = pi / links times the sum of what the links see.

The light along the links of a patch is cosine-distributed, so its mean times pi is the irradiance, and its mean times
pi times a spherical harmonic is that harmonic of the light times the cosine (see `shade/baked_code.py`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..jit import Array, borrow, f32, f64, i64, inline, kernel, next_tile
from ..kernels.vec import BLACK as NO_LIGHT
from ..kernels.vec import Vec3, add, luminance, multiply, scale
from ..shade.harmonics import harmonics
from ..shade.rgbe import unpack_rgbe
from .directions import link_direction
from .gather import INSIDE, PATCHES, SKY, Patches, normal_of

PER_SOURCE = 4  # float32 of a source: RGB radiance, and one unused, so that it lies in one cache line
CHUNK = 1024
# What is known of a patch besides irradiance: its moments less those of even light, 8 of luminance, 3 of red and 3 of
# blue; which share of its links leads to the sky, and which to the inside of a body; the variance of its irradiance's
# luminance.
GRAY, RED, BLUE, SEES_SKY, SEES_INSIDE, VARIANCE, FACTS = 0, 8, 11, 14, 15, 16, 17


class Links(NamedTuple):
    """The links of some patches.

    links, tints : see `gather.Found`; parts, seed : that their directions follow from
    rows : (m,) int32, the patches; share : (m,) float32, share of these links among all that a patch has
    """

    links: Array
    tints: Array
    rows: Array
    share: Array
    parts: tuple[int, int]
    seed: int


@inline
def _radiance(links: Links, at: int, sources: Array, lamps: Array) -> Vec3:
    """The radiance that comes along a link. lamps : (lights * 3,) float64"""
    link = i64(links.links[at])
    if link >= 0:
        k = PER_SOURCE * link
        light = f64(sources[k]), f64(sources[k + 1]), f64(sources[k + 2])
    elif 3 * ~link < lamps.size:
        light = lamps[3 * ~link], lamps[3 * ~link + 1], lamps[3 * ~link + 2]
    else:  # the lamp is gone
        light = NO_LIGHT
    return multiply(light, unpack_rgbe(i64(links.tints[at]))) if links.tints.size > 0 else light


@kernel
def add_irradiance(work: Array, links: Links, sources: Array, lamps: Array, out: Array) -> int:
    """Add to the patches' irradiance, (patches * 3,) float32, what comes along these links."""
    links, sources, lamps, out = borrow(links), borrow(sources), borrow(lamps), borrow(out)
    count = links.parts[0] * links.parts[1]
    chunk = next_tile(work)
    while chunk >= 0:
        for m in range(chunk * CHUNK, min((chunk + 1) * CHUNK, links.rows.size)):
            total = NO_LIGHT
            for at in range(m * count, (m + 1) * count):
                total = add(total, _radiance(links, at, sources, lamps))
            total = scale(total, math.pi / count * links.share[m])
            patch = 3 * i64(links.rows[m])
            for c in range(3):
                out[patch + c] += f32(total[c])
        chunk = next_tile(work)
    return 0


@kernel
def reflect(
    work: Array, arriving: tuple[Array, Array], surface: tuple[Array, Array], sources: Array, changes: Array
) -> int:
    """The radiance that patches send out, into `sources`.

    arriving : irradiance from the lights and along the links; surface : albedo and radiance that is emitted; all of
    them (patches * 3,) float32
    changes : (chunks * 2,) float64, of each chunk by how much its radiance has changed, and the radiance, summed up
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
    return 0


@inline
def _add_moments(light: Vec3, basis: Array, out: Array, at: int) -> None:
    """Add light times the 8 harmonics of its direction to what is known of a patch."""
    gray = luminance(light)
    for b in range(8):
        out[at + GRAY + b] += f32(gray * basis[b])
    for b in range(3):
        out[at + RED + b] += f32(light[0] * basis[b])
        out[at + BLUE + b] += f32(light[2] * basis[b])


@kernel
def add_facts(work: Array, links: Links, patches: Patches, sources: Array, lamps: Array, out: Array) -> int:
    """Add to what is known of the patches, (patches * FACTS,) float32, what these links tell.

    The moments of even light are those that the links would see of it: so even light has no noise.
    """
    links, patches = borrow(links), borrow(patches)
    sources, lamps, out = borrow(sources), borrow(lamps), borrow(out)
    count = links.parts[0] * links.parts[1]
    basis, seen_evenly = np.zeros(8), np.zeros(8)
    chunk = next_tile(work)
    while chunk >= 0:
        for m in range(chunk * CHUNK, min((chunk + 1) * CHUNK, links.rows.size)):
            patch = i64(links.rows[m])
            normal, at = normal_of(patches, patch), FACTS * patch
            square = before = 0.0
            total, part = NO_LIGHT, math.pi / count * links.share[m]
            seen_evenly[:] = 0.0
            for k in range(count):
                link = i64(links.links[m * count + k])
                seen = _radiance(links, m * count + k, sources, lamps)
                first, second = harmonics(link_direction(normal, patch, k, links.parts, links.seed))
                for b in range(8):
                    basis[b] = first[b] if b < 3 else second[b - 3]
                    seen_evenly[b] += basis[b]
                total = add(total, seen)
                _add_moments(scale(seen, part), basis, out, at)
                light, share = luminance(seen), links.share[m] / count
                out[at + SEES_SKY] += f32(share if SKY <= link < PATCHES else 0.0)
                out[at + SEES_INSIDE] += f32(share if link == INSIDE else 0.0)
                # Neighbouring strata see nearly the same: their differences tell the noise that is left.
                if k % links.parts[1] > 0:
                    square += (light - before) ** 2
                before = light
            _add_moments(scale(total, -part / count), seen_evenly, out, at)
            pairs = count - links.parts[0]
            if pairs > 0:
                variance = 0.5 * square / pairs * math.pi**2 / count
                out[at + VARIANCE] += f32(variance * links.share[m] ** 2)
        chunk = next_tile(work)
    return 0
