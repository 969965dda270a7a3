"""Sky of a bake: texels that links refer to, and its brightest spots, to which shadow rays are sent.

Random links rarely hit a small sun in an environment map, which would leave speckles. Radiance far above the mean is
therefore removed from the texels and treated as directional light, one direction per texel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.arrays import Doubles, Floats
from ..engine.jit import Array, borrow, f32, kernel, next_tile, run
from ..engine.kernels.records import NO_SKY, SKY_KIND, SKY_WIDTH, World
from ..engine.kernels.vec import LUMINANCE, add, luminance, scale
from ..shade.sky import sky_radiance
from .directions import SKY_EDGE, SKY_TEXELS, in_texel, texel_size

LEAST_SAMPLES, MOST_SAMPLES = 4, 64  # along each side of a texel
BRIGHT = 16.0  # multiple of the sky's mean above which a texel's radiance becomes directional light
MOST_SUNS = 32
PER_TEXEL = 6  # float32: mean radiance (RGB), and mean of direction times luminance


class Sky(NamedTuple):
    """Sky light of a bake: an octahedral map, and the brightest spots, which are treated as directional lights.

    texels : (SKY_TEXELS, 3) float32, radiance without the bright spots
    suns : (n, 3) float64, unit directions to bright spots; irradiances : (n, 3) float32, of surfaces that face them
    """

    texels: Floats
    suns: Doubles
    irradiances: Floats


@kernel
def _average(work: Array, world: World, samples: int, out: Array) -> None:
    """Average the sky over each texel of the octahedral map, at samples x samples points.

    out : (texels * PER_TEXEL,) float32, written: mean radiance, and mean of direction times luminance
    """
    world = borrow(world)
    texel = next_tile(work)
    while texel >= 0:
        total = middle = (0.0, 0.0, 0.0)
        for k in range(samples * samples):
            d = in_texel(texel, (k // samples + 0.5) / samples, (k % samples + 0.5) / samples)
            light = sky_radiance(world, d)
            total, middle = add(total, light), add(middle, scale(d, luminance(light)))
        size = 1.0 / (samples * samples)
        for c in range(3):
            out[PER_TEXEL * texel + c] = f32(total[c] * size)
            out[PER_TEXEL * texel + 3 + c] = f32(middle[c] * size)
        texel = next_tile(work)


def sample_sky(world: World) -> Sky:
    """Return the sky of a scene: an octahedral map of radiance, and its brightest spots as directional lights."""
    numbers = np.zeros((SKY_TEXELS, PER_TEXEL), np.float32)
    if world.sky[SKY_KIND] != NO_SKY:
        fine = int(np.ceil(2.0 * world.sky[SKY_WIDTH] / SKY_EDGE))  # about two samples per pixel of an environment map
        run(_average, SKY_TEXELS, world, min(max(fine, LEAST_SAMPLES), MOST_SAMPLES), numbers.reshape(-1))
    texels, middles = numbers[:, :3].copy(), numbers[:, 3:].astype(np.float64)
    light, size = texels @ np.array(LUMINANCE, np.float32), texel_size()
    limit = BRIGHT * float(light @ size) / (4.0 * np.pi)
    bright = np.flatnonzero((light > limit) & (limit > 0.0))
    bright = bright[np.argsort(-light[bright] * size[bright], kind="stable")][:MOST_SUNS]
    share = 1.0 - limit / light[bright]
    irradiances = (texels[bright] * (share * size[bright])[:, None]).astype(np.float32)
    texels[bright] *= (1.0 - share)[:, None].astype(np.float32)
    suns = middles[bright] / np.linalg.norm(middles[bright], axis=1, keepdims=True)
    return Sky(texels, suns, irradiances)
