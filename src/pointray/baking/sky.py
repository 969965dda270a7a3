"""The sky as links see it: texels of an octahedral map, each with the mean radiance of its part of the sky."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import Array, borrow, f32, kernel, next_tile, run
from ..kernels.records import NO_SKY, SKY_KIND, SKY_WIDTH, World
from ..kernels.vec import add, scale
from ..shade.sky import sky_radiance
from .directions import SKY_EDGE, SKY_TEXELS, in_texel

LEAST_SAMPLES, MOST_SAMPLES = 4, 32  # a side of a texel


@kernel
def _average(work: Array, world: World, samples: int, out: Array) -> int:
    """The mean radiance of each texel, (texels * 3,) float32, from samples x samples points of it."""
    world = borrow(world)
    texel = next_tile(work)
    while texel >= 0:
        total = (0.0, 0.0, 0.0)
        for k in range(samples * samples):
            d = in_texel(texel, (k // samples + 0.5) / samples, (k % samples + 0.5) / samples)
            total = add(total, sky_radiance(world, d))
        total = scale(total, 1.0 / (samples * samples))
        for c in range(3):
            out[3 * texel + c] = f32(total[c])
        texel = next_tile(work)
    return 0


def sky_texels(world: World) -> NDArray[np.float32]:
    """The radiance of all texels, (texels, 3)."""
    out = np.zeros((SKY_TEXELS, 3), np.float32)
    if world.sky[SKY_KIND] != NO_SKY:
        fine = int(np.ceil(world.sky[SKY_WIDTH] / SKY_EDGE))  # a texel is as wide as so many pixels of a picture
        samples = min(max(fine, LEAST_SAMPLES), MOST_SAMPLES)
        run(_average, SKY_TEXELS, world, samples, out.reshape(-1))
    return out
