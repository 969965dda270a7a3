"""Solution of light transport: from links and lights to the light that arrives at every patch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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

Floats = NDArray[np.float32]


class ArrivingLight(NamedTuple):
    """Light that arrives at the patches.

    direct, indirect : (n, 3) float32, irradiance from lights; from surfaces and the sky
    facts : (n, FACTS) float32, see `bounces.FACTS`
    """

    direct: Floats
    indirect: Floats
    facts: Floats


def lamp_radiances(world: World) -> NDArray[np.float64]:
    """Return the radiance of each light that rays can hit, (lights, 3); black for other lights."""
    records = world.lights.reshape(-1, rec.LIGHT)
    seen = np.isin(records[:, rec.LIGHT_KIND], (rec.RECT_LIGHT, rec.DISK_LIGHT, rec.SPHERE_LIGHT))
    return np.where(seen[:, None], records[:, rec.LIGHT_POWER : rec.LIGHT_POWER + 3], 0.0)


class Lights(NamedTuple):
    """Light that arrives at the patches before any bounce.

    direct : (n, 3) float32, irradiance from lights other than sky and emissive surfaces
    sky : texels and bright spots; cosines : (n, suns) float32, of patches to bright spots, 0 if occluded
    """

    direct: Floats
    sky: Sky
    cosines: Floats


def find_lights(world: World, sky: Sky, transport: Transport) -> Lights:
    """Find the light that patches receive from the lights of this world, and the links that lamps block."""
    transport.find_hidden_links(world)
    return Lights(transport.find_direct(world), sky, transport.find_suns(world, sky.suns))


def solve(world: World, transport: Transport, settings: BakeSettings, seen: Lights) -> ArrivingLight:
    """Return the light of this world's lights after all bounces."""
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
    """Return the moments of the bright spots of the sky, see `bounces.FACTS`. even : (n, 8), harmonics of normals"""
    out = np.zeros((len(cosines), SEES_SKY), np.float32)
    even = even * np.repeat(np.array([2 / 3, 1 / 4], np.float32), [3, 5])  # moments of uniform light times the cosine
    for k, (light, suns) in enumerate(zip(sky.irradiances, _bands(sky.suns), strict=True)):
        more = cosines[:, k, None] * (suns - even)
        out[:, :RED] += more * float(light @ np.array(LUMINANCE))
        out[:, RED:BLUE] += more[:, :3] * light[0]
        out[:, BLUE:] += more[:, :3] * light[2]
    return out


def _bands(directions: NDArray[Any]) -> Floats:
    """Return the spherical harmonics of bands 1 and 2 for unit directions, (n, 8)."""
    return np.asarray(harmonics(directions.astype(np.float32))[1:].T)


def _gather_light(
    transport: Transport, light: Floats, lamps: NDArray[np.float64], every: int, indirect: Floats, threads: int | None
) -> None:
    """Compute the irradiance of all patches from their links, or from one link in `every`."""
    indirect[:] = 0.0
    for part in transport.links:
        few = every if part.parts[1] % every == 0 else 1
        args = part, light, lamps, few, indirect.reshape(-1)
        run(add_irradiance, -(-len(part.rows) // CHUNK), *args, threads=threads)


def _is_settled(change: float, before: float, total: float) -> bool:
    """Return whether the omitted bounces, a geometric series, hold less than EXACT of the light."""
    if change == 0.0:
        return True
    ratio = change / before if before > 0.0 else 1.0
    return ratio < 1.0 and change * ratio / (1.0 - ratio) < EXACT * total


def smoothed(transport: Transport, arrived: ArrivingLight, threads: int | None) -> tuple[ArrivingLight, Floats]:
    """Return the light with less noise, and the effective number of patches averaged for each patch."""
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
