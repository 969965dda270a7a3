"""Encoding of the directional distribution of baked light in 8 bytes a record.

The distribution is F(w) = L(w) max(0, w.n), with arriving radiance L and splat normal n. Its moments are the real
spherical harmonics of bands 1 and 2 in luminance, and of band 1 in red and blue. Stored are their differences from
uniform light of the same irradiance E: for luminance Y the difference divided by Y; for red and blue the difference
divided by the channel's irradiance, minus the value of luminance. Green follows. Values are quantized; step sizes grow
linearly:

    word 0, from bit 0 : the first four of the 8 of luminance, 5 bits each; from bit 20 : three of red, 4 bits each
    word 1, likewise : the last four, and three of blue

Differences are blended with the weights of the splats times their irradiance. Uniform light is reproduced exactly.
"""

from __future__ import annotations

import math

from ..engine.jit import Array, f32, inline
from ..engine.kernels.vec import LUMINANCE, Vec3, luminance
from ..engine.simd import F16, I16, bit_fields, first_quarter, quarters, sum_over_quarters, third_quarter, vabs
from .harmonics import BAND_1, BAND_2

LEVELS, COLOR_LEVELS = 15, 7  # steps above and below zero
REACH, COLOR_REACH = 0.7, 1.0 / 3.0  # largest encoded value, relative to the largest value of the harmonics
LINEAR = 0.2  # size of the first step, relative to uniform steps
# Largest encoded values of the bands.
REACH_1, REACH_2, REACH_COLOR = REACH * BAND_1, REACH * 2.0 * BAND_2, COLOR_REACH * BAND_1
MOMENTS_OF_GRAY, COLORS = 8, 3  # moments of luminance; of red and of blue each


@inline
def _height(k: int, levels: int) -> float:
    """Return the value that k quantization steps stand for, relative to the largest encoded value; steps grow linearly.

    k : 0 to levels; levels : number of steps up to the largest value
    """
    x = k / levels
    return x * (LINEAR + (1.0 - LINEAR) * x)


@inline
def steps_of(x: float, reach: float, levels: int) -> int:
    """Quantize x to the nearest number of steps, -levels to levels, of a scale whose steps grow linearly.

    reach : largest encoded value, to which x is clamped; levels : number of steps up to it
    """
    share = min(abs(x) / reach, 1.0)
    exact = (math.sqrt(LINEAR * LINEAR + 4.0 * (1.0 - LINEAR) * share) - LINEAR) / (2.0 * (1.0 - LINEAR))
    k = min(int(exact * levels), levels - 1)
    if share - _height(k, levels) > _height(k + 1, levels) - share:
        k += 1
    return k if x >= 0.0 else -k


@inline
def _excess(moment: float, of: float, share: float) -> float:
    """Return a number to encode: a harmonic of one channel of light over the channel's irradiance, minus `share`.

    It is 0 without irradiance.

    moment : the spherical harmonic; of : irradiance of the channel
    share : the same quotient of luminance, for red and blue, which are encoded relative to it; 0 for luminance
    """
    return moment / of - share if of > 0.0 else 0.0


@inline
def pack_moments(moments: Array, at: int, light: Vec3) -> tuple[int, int]:
    """Encode the directional distribution of the light at a splat, given by spherical harmonics, as two 32-bit words.

    moments : flat, from index `at` 14 harmonics, 8 of luminance (bands 1 and 2), 3 of red and 3 of blue (band 1); they
        are those of radiance times cosine, minus those of uniform light of the same irradiance
    light : irradiance, RGB
    """
    gray = luminance(light)
    first = second = 0
    for k in range(4):
        steps = steps_of(_excess(moments[at + k], gray, 0.0), REACH_1 if k < 3 else REACH_2, LEVELS)
        first |= (LEVELS + steps) << (5 * k)
        steps = steps_of(_excess(moments[at + 4 + k], gray, 0.0), REACH_2, LEVELS)
        second |= (LEVELS + steps) << (5 * k)
    for k in range(COLORS):
        share, red = _excess(moments[at + k], gray, 0.0), at + MOMENTS_OF_GRAY + k
        steps = steps_of(_excess(moments[red], light[0], share), REACH_COLOR, COLOR_LEVELS)
        first |= (COLOR_LEVELS + steps) << (20 + 4 * k)
        steps = steps_of(_excess(moments[red + COLORS], light[2], share), REACH_COLOR, COLOR_LEVELS)
        second |= (COLOR_LEVELS + steps) << (20 + 4 * k)
    return first, second


@inline
def _heights(steps: F16, levels: int) -> F16:
    """Return the values that 16 signed numbers of quantization steps stand for, relative to the largest encoded value.

    levels : number of steps up to the largest value
    """
    return steps * (f32(LINEAR / levels) + vabs(steps) * f32((1.0 - LINEAR) / (levels * levels)))


@inline
def unpack_moments(light: F16, first: I16, second: I16) -> tuple[F16, F16, F16, F16]:
    """Decode the spherical harmonics of the light in four records, times their irradiance, for blending.

    Values are relative to the largest encoded one.

    light : irradiance of the four records, red, green and blue in a quarter of the vector each
    first, second : the records' two words of encoded harmonics, as from `pack_moments`, repeated in all quarters

    Returns
    -------
    tuple
        (harmonics 0 to 3 of luminance, 4 to 7 of luminance, three of red, three of blue). Each vector has a quarter for
        each harmonic, with a lane for each record.
    """
    weights = quarters(f32(LUMINANCE[0]), f32(LUMINANCE[1]), f32(LUMINANCE[2]), f32(0.0))
    gray = sum_over_quarters(light * weights)
    return (
        gray * _heights(bit_fields(first, 0, 5, 10, 15, 31) - f32(LEVELS), LEVELS),
        gray * _heights(bit_fields(second, 0, 5, 10, 15, 31) - f32(LEVELS), LEVELS),
        first_quarter(light) * _heights(bit_fields(first, 20, 24, 28, 28, 15) - f32(COLOR_LEVELS), COLOR_LEVELS),
        third_quarter(light) * _heights(bit_fields(second, 20, 24, 28, 28, 15) - f32(COLOR_LEVELS), COLOR_LEVELS),
    )
