"""The 8 bytes of a record that tell from where its light comes.

Of F(w) = L(w) max(0, w.n), the light L that arrives at a splat with the normal n times the cosine, the moments are
the real spherical harmonics of the bands 1 and 2 in luminance, and of band 1 in red and in blue. Kept is by how much
they differ from those of even light of the same irradiance E: for luminance Y the difference over Y; for red and blue
by how much more than that it is, over their own irradiance. Green follows. These shares are whole numbers of steps,
which grow linearly:

    word 0, from bit 0 : the first four of the 8 of luminance, 5 bits each; from bit 20 : three of red, 4 bits each
    word 1, likewise : the last four, and three of blue

Differences are blended with the weights of the splats, each times its own irradiance. Even light stays exact.
"""

from __future__ import annotations

import math

from ..engine.jit import Array, f32, inline
from ..engine.kernels.vec import LUMINANCE, Vec3, luminance
from ..engine.simd import F16, I16, bit_fields, first_quarter, quarters, sum_over_quarters, third_quarter, vabs
from .harmonics import BAND_1, BAND_2

LEVELS, COLOR_LEVELS = 15, 7  # steps up and down
REACH, COLOR_REACH = 0.7, 1.0 / 3.0  # the last step, as a share of the largest value that harmonics have
LINEAR = 0.2  # the first step, as a share of an even one
# What the last steps of a band mean.
REACH_1, REACH_2, REACH_COLOR = REACH * BAND_1, REACH * 2.0 * BAND_2, COLOR_REACH * BAND_1
MOMENTS_OF_GRAY, COLORS = 8, 3  # of red and of blue each


@inline
def _height(k: int, levels: int) -> float:
    """The share of the last step that k steps reach."""
    x = k / levels
    return x * (LINEAR + (1.0 - LINEAR) * x)


@inline
def steps_of(x: float, reach: float, levels: int) -> int:
    """The number of steps next to x, from -levels to levels. reach : what the last step means"""
    share = min(abs(x) / reach, 1.0)
    exact = (math.sqrt(LINEAR * LINEAR + 4.0 * (1.0 - LINEAR) * share) - LINEAR) / (2.0 * (1.0 - LINEAR))
    k = min(int(exact * levels), levels - 1)
    if share - _height(k, levels) > _height(k + 1, levels) - share:
        k += 1
    return k if x >= 0.0 else -k


@inline
def _more(moment: float, of: float, share: float) -> float:
    """By how much the share that a moment is of an irradiance is more than another share."""
    return moment / of - share if of > 0.0 else 0.0


@inline
def pack_moments(moments: Array, at: int, light: Vec3) -> tuple[int, int]:
    """The two words, 0 to 2^32 - 1.

    moments : from [at] on 8 of luminance, 3 of red, 3 of blue, less those of even light of this irradiance
    """
    gray = luminance(light)
    first = second = 0
    for k in range(4):
        steps = steps_of(_more(moments[at + k], gray, 0.0), REACH_1 if k < 3 else REACH_2, LEVELS)
        first |= (LEVELS + steps) << (5 * k)
        steps = steps_of(_more(moments[at + 4 + k], gray, 0.0), REACH_2, LEVELS)
        second |= (LEVELS + steps) << (5 * k)
    for k in range(COLORS):
        share, red = _more(moments[at + k], gray, 0.0), at + MOMENTS_OF_GRAY + k
        steps = steps_of(_more(moments[red], light[0], share), REACH_COLOR, COLOR_LEVELS)
        first |= (COLOR_LEVELS + steps) << (20 + 4 * k)
        steps = steps_of(_more(moments[red + COLORS], light[2], share), REACH_COLOR, COLOR_LEVELS)
        second |= (COLOR_LEVELS + steps) << (20 + 4 * k)
    return first, second


@inline
def _heights(steps: F16, levels: int) -> F16:
    """The share of the last step that each number of steps reaches, with its sign."""
    return steps * (f32(LINEAR / levels) + vabs(steps) * f32((1.0 - LINEAR) / (levels * levels)))


@inline
def unpack_moments(light: F16, first: I16, second: I16) -> tuple[F16, F16, F16, F16]:
    """Moments of four records, each times its irradiance and over what its last step means.

    Each vector holds four of them, a quarter each: 0 to 3 of luminance, 4 to 7, three of red, three of blue.

    light : irradiance of the records, RGB a quarter each; first, second : their words
    """
    weights = quarters(f32(LUMINANCE[0]), f32(LUMINANCE[1]), f32(LUMINANCE[2]), f32(0.0))
    gray = sum_over_quarters(light * weights)
    return (
        gray * _heights(bit_fields(first, 0, 5, 10, 15, 31) - f32(LEVELS), LEVELS),
        gray * _heights(bit_fields(second, 0, 5, 10, 15, 31) - f32(LEVELS), LEVELS),
        first_quarter(light) * _heights(bit_fields(first, 20, 24, 28, 28, 15) - f32(COLOR_LEVELS), COLOR_LEVELS),
        third_quarter(light) * _heights(bit_fields(second, 20, 24, 28, 28, 15) - f32(COLOR_LEVELS), COLOR_LEVELS),
    )
