"""Records of baked light, 16 bytes each: irradiance, and the moments of `shade/baked_code.py`, blended from patches."""

from __future__ import annotations

import numpy as np

from ..engine.jit import Array, borrow, f32, i32, inline, kernel, next_tile
from ..engine.kernels.records import DIRECT, INDIRECT, MOMENTS, RECORD
from ..shade.baked_code import COLORS, MOMENTS_OF_GRAY, pack_moments
from ..shade.rgbe import pack_rgbe, signed
from .patches import AROUND, BLOCK_SPLATS

# Values of a patch that are blended: irradiance, irradiance from lights, and moments (`baked_code.pack_moments`).
LIGHT, LIGHT_OF_LAMPS, MOMENTS_AT, PER_PATCH = 0, 3, 6, 6 + MOMENTS_OF_GRAY + 2 * COLORS
CHUNK = 4096


@inline
def write_record(values: Array, scale: float, out: Array, at: int) -> None:
    """Encode light as a 16-byte record, out[at : at + RECORD]: irradiance as RGB9E5, and its directional distribution.

    values : PER_PATCH numbers, the irradiance from surfaces and the sky (RGB), the irradiance from lights (RGB), and
        spherical harmonics of the light from surfaces and the sky, see `pack_moments`
    scale : factor for both irradiances
    """
    light = values[LIGHT] * 1.0, values[LIGHT + 1] * 1.0, values[LIGHT + 2] * 1.0
    lamps = values[LIGHT_OF_LAMPS] * scale, values[LIGHT_OF_LAMPS + 1] * scale, values[LIGHT_OF_LAMPS + 2] * scale
    first, second = pack_moments(values, MOMENTS_AT, light)
    out[at + INDIRECT] = i32(signed(pack_rgbe((light[0] * scale, light[1] * scale, light[2] * scale))))
    out[at + DIRECT] = i32(signed(pack_rgbe(lamps)))
    out[at + MOMENTS], out[at + MOMENTS + 1] = i32(signed(first)), i32(signed(second))


@inline
def blend(around: Array, weights: Array, values: Array, size: int, i: int, out: Array) -> None:
    """Write the weighted mean of the values of the patches near splat i to out[:size].

    around : flat, for each block the indices of AROUND patches near it
    weights : flat, for each splat the AROUND weights of its block's patches; not normalized
    values : flat, `size` numbers for each patch
    """
    total = f32(0.0)
    for c in range(size):
        out[c] = f32(0.0)
    for k in range(AROUND):
        w = f32(weights[i * AROUND + k])
        if w > f32(0.0):
            total += w
            patch = around[i // BLOCK_SPLATS * AROUND + k]
            for c in range(size):
                out[c] += w * values[patch * size + c]
    for c in range(size):
        out[c] /= total


@kernel
def pack(work: Array, around: Array, weights: Array, values: Array, scale: float, out: Array) -> None:
    """Interpolate the light of patches to splats, and encode it as 16-byte records in `out`.

    around : flat, for each block the indices of AROUND patches near it; if empty, record i is that of patch i
    weights : flat, for each splat the AROUND weights of its block's patches; not normalized
    values : (patches * PER_PATCH,) float32, for each patch the irradiance from surfaces and the sky, the irradiance
        from lights, and spherical harmonics
    scale : factor for irradiance
    out : (n * RECORD,) int32
    """
    around, weights, values, out = borrow(around), borrow(weights), borrow(values), borrow(out)
    blended = np.zeros(PER_PATCH, np.float32)
    chunk = next_tile(work)
    while chunk >= 0:
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, out.size // RECORD)):
            if around.size > 0:
                blend(around, weights, values, PER_PATCH, i, blended)
            else:
                for c in range(PER_PATCH):
                    blended[c] = values[i * PER_PATCH + c]
            write_record(blended, scale, out, i * RECORD)
        chunk = next_tile(work)
