"""Conversion of linear images to 8-bit sRGB by a table, fast enough for each frame of the viewer."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arrays import Floats
from ..engine.jit import Array, borrow, f32, kernel, next_tile, run
from ..engine.simd import float_bits
from .tone import linear_to_srgb, tone

Rgb8 = NDArray[np.uint8]

ROWS = 16  # rows a thread takes at a time
# The table is indexed by the exponent and the first 9 bits of the mantissa, from 2^-14, which is level 0, to 2^8, which
# is white on any curve. The error is at most 0.1 levels before rounding, and one level after.
DARKEST, BRIGHTEST = f32(2.0**-14), f32(2.0**8)
WHITEST = BRIGHTEST * f32(0.999)  # within the table
BRIGHT = 0.95  # limit of backdrops on curves that compress highlights
SHIFT = 14
_FIRST, _LAST = (int(np.array(x).view(np.int32)) >> SHIFT for x in (DARKEST, BRIGHTEST))


@cache
def _table(curve: str) -> Rgb8:
    """Return the table that `to_8bit` looks up: 8-bit sRGB values of a tone curve for inputs from DARKEST to BRIGHTEST.

    The index is made of exponent and leading mantissa bits of the input.
    """
    middles = ((np.arange(_FIRST, _LAST, dtype=np.int32) << SHIFT) + (1 << (SHIFT - 1))).view(np.float32)
    return np.rint(linear_to_srgb(tone(middles, 0.0, curve)) * 255).astype(np.uint8)


@kernel
def _to_8bit(work: Array, image: Array, backdrop: Array, gain: float, table: Array, out: Array) -> None:
    """Composite an image over a backdrop and convert it to 8-bit sRGB, in blocks of rows.

    image : (h, w, 4) float32, linear, premultiplied, with alpha; backdrop : (h, 3) float32, linear, one colour a row
    gain : factor of the exposure; table : 8-bit values of the tone curve, from `_table`; out : (h, w, 3) uint8
    """
    image, backdrop, table, out = borrow(image), borrow(backdrop), borrow(table), borrow(out)
    height, width = image.shape[:2]
    block = next_tile(work)
    while block >= 0:
        for y in range(block * ROWS, min((block + 1) * ROWS, height)):
            for x in range(width):
                rest = f32(1.0) - image[y, x, 3]
                for c in range(3):
                    value = (image[y, x, c] * gain) + backdrop[y, c] * rest
                    value = value if value > DARKEST else DARKEST  # also for NaN, which `max` may keep
                    value = value if value < WHITEST else WHITEST
                    out[y, x, c] = table[(float_bits(value) >> SHIFT) - _FIRST]
        block = next_tile(work)


@cache
def _inverse(curve: str) -> tuple[Floats, Floats]:
    """Return samples of a tone curve for interpolating its inverse: its values, ascending, and their inputs."""
    x = np.geomspace(DARKEST, BRIGHTEST, 4096, dtype=np.float32)
    return tone(x, 0.0, curve), x


def _before(curve: str, shown: Floats) -> Floats:
    """Return the linear values that a tone curve maps to `shown`, so that the curve leaves a backdrop unchanged.

    `shown` is limited to BRIGHT: curves that compress highlights reach white only from very large inputs, which would
    make the edges of surfaces in front of the backdrop jagged.

    shown : values after the curve, any shape; not limited for "srgb"
    """
    if curve == "srgb":
        return shown.copy()
    return np.interp(np.minimum(shown, BRIGHT), *_inverse(curve)).astype(np.float32)


def to_8bit(image: Floats, backdrop: ArrayLike = (0.0, 0.0, 0.0), exposure: float = 0.0, curve: str = "srgb") -> Rgb8:
    """Convert a rendered image to 8-bit sRGB by a table, fast enough for each frame of the viewer.

    Parameters
    ----------
    image : (h, w, 4) float32
        Linear, premultiplied, with alpha.
    backdrop : (3,) or (h, 3) float
        Linear colour behind the image, or behind each row; not changed by the curve.
    exposure : float
        In stops; each doubles the light.
    curve : {"srgb", "neutral", "filmic", "soft"}
        Tone curve, which sets the treatment of highlights.

    Returns
    -------
    (h, w, 3) uint8
        sRGB; at most one level off the result of `write_image`.
    """
    out = np.empty((*image.shape[:2], 3), np.uint8)
    behind = _before(curve, np.broadcast_to(np.asarray(backdrop, np.float32), (len(image), 3)))
    gain = f32(2.0**exposure)
    run(_to_8bit, -(-len(image) // ROWS), image, behind, gain, _table(curve), out)
    return out
