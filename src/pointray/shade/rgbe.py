"""HDR colours in 32 bits: three 9-bit mantissas with a shared 5-bit exponent (RGB9E5 of OpenGL).

The largest component has a precision of 1 part in 512, the others the same absolute precision. The range is 6e-8 to
65,408.
"""

from __future__ import annotations

import math

import numpy as np

from ..engine.jit import f32, i64, inline
from ..engine.kernels.vec import Vec3
from ..engine.simd import F16, I16, bit_fields, last_quarter, power_of_two

LARGEST = 65408.0  # 511 / 512 * 2^16
BIAS, MANTISSA = 15, 9
STEPS = np.ldexp(np.float32(1.0), np.arange(32) - BIAS - MANTISSA)  # value of one mantissa step, by exponent


@inline
def _limited(x: float) -> float:
    return min(x, LARGEST) if x > 0.0 else 0.0


@inline
def pack_rgbe(rgb: Vec3) -> int:
    """Encode a linear RGB colour as 32 bits (RGB9E5: three 9-bit mantissas, a shared exponent), 0 to 2^32 - 1.

    Negative components and NaN become 0; larger ones than 65,408 are clamped.
    """
    r, g, b = _limited(rgb[0]), _limited(rgb[1]), _limited(rgb[2])
    most = max(r, g, b)
    exponent = max(-BIAS - 1, math.frexp(most)[1] - 1) + 1 + BIAS if most > 0.0 else 0
    step = math.ldexp(1.0, exponent - BIAS - MANTISSA)
    if int(most / step + 0.5) == 1 << MANTISSA:  # rounds up to the next power of two
        exponent, step = exponent + 1, 2.0 * step
    return int(r / step + 0.5) | int(g / step + 0.5) << 9 | int(b / step + 0.5) << 18 | exponent << 27


@inline
def unpack_rgbe(word: int) -> Vec3:
    """Decode a colour from 32 bits (RGB9E5) to float32; the word may be signed."""
    step = STEPS[(word >> 27) & 31]
    return f32(word & 511) * step, f32((word >> 9) & 511) * step, f32((word >> 18) & 511) * step


@inline
def unpack_four(words: I16) -> F16:
    """Decode four colours (RGB9E5) at once: red, green and blue in a quarter of the vector each; the last is unused.

    words : the four 32-bit words, repeated in all quarters
    """
    fields = bit_fields(words, 0, MANTISSA, 2 * MANTISSA, 27, 511)
    return fields * power_of_two(last_quarter(fields) - f32(BIAS + MANTISSA))


@inline
def signed(word: int) -> int:
    """Return the same 32 bits as a signed integer, which fits into int32. word : 0 to 2^32 - 1"""
    return i64(word - (1 << 32) if word >= 1 << 31 else word)
