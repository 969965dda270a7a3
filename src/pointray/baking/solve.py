"""Solution of light transport: from links and lights to the light that arrives at every patch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Floats
from ..engine.jit import run
from ..engine.kernels import records as rec
from ..engine.kernels.records import World
from ..engine.kernels.vec import LUMINANCE
from ..shade.environment import harmonics
from .bounces import BLUE, CHUNK, FACTS, PER_SOURCE, RED, SEES_SKY, add_facts, add_irradiance, reflect
from .directions import cell_moments
from .gather import PATCHES, SKY
from .settings import BakeSettings
from .sky import Sky
from .smooth import CHUNK as SMOOTHED, smooth
from .transport import Transport

# All bounces but the last follow one link in FEW; the last follows all links and averages their noise.
FEW = 2
EXACT = 1e-3  # fraction of the light that omitted bounces may hold


class ArrivingLight(NamedTuple):
    """Light that arrives at n patches after all bounces.

    direct, indirect : (n, 3) float32, irradiance from lights; from surfaces and the sky
    facts : (n, FACTS) float32, about the indirect light: spherical harmonics that store its directional distribution,
        fraction of the sky that is visible, variance, see `bounces.FACTS`
    """

    direct: Floats
    indirect: Floats
    facts: Floats


def lamp_radiances(world: World) -> Doubles:
    """Return the radiance of each area light, (lights, 3) RGB; black for other lights."""
    records = world.lights.reshape(-1, rec.LIGHT)
    seen = np.isin(records[:, rec.LIGHT_KIND], (rec.RECT_LIGHT, rec.DISK_LIGHT, rec.SPHERE_LIGHT))
    return np.where(seen[:, None], records[:, rec.LIGHT_POWER : rec.LIGHT_POWER + 3], 0.0)


class Lights(NamedTuple):
    """Light that arrives at n patches before any bounce.

    direct : (n, 3) float32, irradiance from lights other than sky and emissive surfaces
    sky : radiance of the sky, and its bright spots, which are treated as directional lights
    cosines : (n, suns) float32, of the angles between normals and bright spots, 0 if occluded
    """

    direct: Floats
    sky: Sky
    cosines: Floats


def find_lights(world: World, sky: Sky, transport: Transport) -> Lights:
    """Compute the light that arrives at patches before any bounce.

    It also finds which links (rays from patches to sources of light) area lights block.

    sky : of this world; transport : the patches and their links
    """
    transport.find_hidden_links(world)
    return Lights(transport.find_direct(world), sky, transport.find_suns(world, sky.suns))


def solve(world: World, transport: Transport, settings: BakeSettings, seen: Lights) -> ArrivingLight:
    """Propagate light between patches until it converges: return the light that arrives at them after all bounces.

    transport : the patches and their links (rays to sources of light)
    seen : light that arrives at the patches before any bounce
    """
    n, threads, (lights, sky, cosines) = len(transport), settings.threads, seen
    suns = cosines @ sky.irradiances
    direct = transport.fill_untrusted(lights + suns)
    lamps = lamp_radiances(world).reshape(-1)
    sources = np.zeros((PATCHES + n, PER_SOURCE), np.float32)
    sources[SKY:PATCHES, :3] = sky.texels
    sources[PATCHES:, :3] = transport.emitted
    light = sources.reshape(-1)
    indirect, changes = np.zeros((n, 3), np.float32), np.zeros((-(-n // CHUNK), 2))
    surface = transport.albedo.reshape(-1), transport.emitted.reshape(-1)
    before = 0.0
    for depth in range(settings.depth):
        if depth > 0 or settings.max_depth is None:  # without a limit the first pass already includes direct light
            arriving = direct.reshape(-1), indirect.reshape(-1)
            run(reflect, len(changes), arriving, surface, light, changes.reshape(-1), threads=threads)
            change, total = changes.sum(axis=0).tolist()
            if depth > 0 and _is_settled(change, before, total):
                break
            before = change
        _gather_light(transport, light, lamps, FEW, indirect, threads)
        transport.fill_untrusted(indirect)
    if settings.depth > 0:
        _gather_light(transport, light, lamps, 1, indirect, threads)
    indirect += suns
    facts, patches = np.zeros((n, FACTS), np.float32), transport.patches()
    for part in transport.links:
        args = part, patches, light, lamps, cell_moments(part.parts).reshape(-1), facts.reshape(-1)
        run(add_facts, -(-len(part.rows) // CHUNK), *args, threads=threads)
    if len(sky.suns):
        facts[:, :SEES_SKY] += _moments_of(cosines, sky, _bands(transport.normals))
    return ArrivingLight(lights, indirect, facts)


def _moments_of(cosines: Floats, sky: Sky, even: Floats) -> Floats:
    """Return what the bright spots of the sky add to the patches' spherical harmonics of arriving light, (n, SEES_SKY).

    cosines : (n, suns), of patches to bright spots, 0 if occluded
    even : (n, 8), harmonics (bands 1 and 2) of the patches' normals, from which those of uniform light follow
    """
    out = np.zeros((len(cosines), SEES_SKY), np.float32)
    even = even * np.repeat(np.array([2 / 3, 1 / 4], np.float32), [3, 5])  # moments of uniform light times the cosine
    for k, (light, suns) in enumerate(zip(sky.irradiances, _bands(sky.suns), strict=True)):
        more = cosines[:, k, None] * (suns - even)
        out[:, :RED] += more * float(light @ np.array(LUMINANCE))
        out[:, RED:BLUE] += more[:, :3] * light[0]
        out[:, BLUE:] += more[:, :3] * light[2]
    return out


def _bands(directions: NDArray[Any]) -> Floats:
    """Return the eight spherical harmonics of bands 1 and 2 for unit directions, (n, 8) float32. directions : (n, 3)"""
    return np.asarray(harmonics(directions.astype(np.float32))[1:].T)


def _gather_light(
    transport: Transport, light: Floats, lamps: Doubles, every: int, indirect: Floats, threads: int | None
) -> None:
    """Compute the irradiance that arrives at all patches along their links, rays to sources of light.

    light : radiance of sky texels and patches, flat; lamps : radiance of lights, flat
    every : follow one link in `every`, which is faster and noisier; indirect : (n, 3), overwritten with the irradiance
    """
    indirect[:] = 0.0
    for part in transport.links:
        few = every if part.parts[1] % every == 0 else 1
        args = part, light, lamps, few, indirect.reshape(-1)
        run(add_irradiance, -(-len(part.rows) // CHUNK), *args, threads=threads)


def _is_settled(change: float, before: float, total: float) -> bool:
    """Return whether the bounces still to come, estimated as a geometric series, hold less than EXACT of the light.

    change, before : total change of radiance in this bounce and in the one before; total : radiance
    """
    if change == 0.0:
        return True
    ratio = change / before if before > 0.0 else 1.0
    return ratio < 1.0 and change * ratio / (1.0 - ratio) < EXACT * total


def smoothed(transport: Transport, arrived: ArrivingLight, threads: int | None) -> tuple[ArrivingLight, Floats]:
    """Reduce the noise of light at patches by averaging over similar neighbours.

    Returns
    -------
    ArrivingLight
        The light with less noise.
    (n,) float32
        Effective number of patches averaged for each patch.
    """
    values = np.concatenate([arrived.indirect, arrived.facts], axis=1)
    trust = transport.trusted.astype(np.float32)
    places = transport.positions.reshape(-1), transport.normals.reshape(-1), transport.nearness, trust
    out, count = np.empty_like(values), np.zeros(len(transport), np.float32)
    flat = values.reshape(-1), out.reshape(-1), count
    for side in transport.sides:
        near = side.near
        span = side.first, side.size, near.shape[1], values.shape[1]
        run(smooth, -(-side.size // SMOOTHED), places, near.reshape(-1), span, *flat, threads=threads)
    return ArrivingLight(arrived.direct, out[:, :3], out[:, 3:]), count
