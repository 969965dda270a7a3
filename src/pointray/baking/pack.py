"""Records of baked light, 16 bytes, see `shade/baked.py`: blended from the light of patches."""

from __future__ import annotations

import numpy as np

from ..jit import Array, borrow, f32, i32, inline, kernel, next_tile
from ..kernels.records import BANDS, DIRECT, INDIRECT, RECORD
from ..kernels.vec import luminance
from ..shade.baked import BAND_UNITS
from ..shade.harmonics import BAND_0
from ..shade.rgbe import pack_rgbe, signed
from .patches import AROUND, BLOCK_SPLATS

PER_PATCH = 14  # numbers that are blended: irradiance (3), that of lights (3), and bands 1 and 2 of the light (8)
CHUNK = 4096


@inline
def _word(bands: Array, first: int, base: float) -> int:
    """Four bands as shares of the band 0, a byte each. bands : PER_PATCH numbers; first : which of the 8"""
    word = 0
    for k in range(4):
        limit = BAND_UNITS[0] if first + k < 3 else BAND_UNITS[1]
        share = bands[6 + first + k] / base / limit if base > 0.0 else 0.0
        byte = int(round(min(max(share, -127.0), 127.0)))
        word |= (byte & 255) << (8 * k)
    return signed(word)


@inline
def blend(around: Array, weights: Array, values: Array, size: int, i: int, out: Array) -> None:
    """Blend the values, `size` numbers each, of the patches around splat i."""
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
def pack(work: Array, around: Array, weights: Array, values: Array, scale: float, out: Array) -> int:
    """Blend the values of patches and write records.

    around, weights : see `patches.Blend`; or length 0: each record is that of its own patch
    values : (patches * PER_PATCH,) float32; scale : what light is multiplied by; out : (n * RECORD,) int32
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
            light = blended[0] * scale, blended[1] * scale, blended[2] * scale
            direct = blended[3] * scale, blended[4] * scale, blended[5] * scale
            base = luminance((blended[0], blended[1], blended[2])) * BAND_0
            at = i * RECORD
            out[at + INDIRECT], out[at + DIRECT] = i32(signed(pack_rgbe(light))), i32(signed(pack_rgbe(direct)))
            out[at + BANDS], out[at + BANDS + 1] = i32(_word(blended, 0, base)), i32(_word(blended, 4, base))
        chunk = next_tile(work)
    return 0
