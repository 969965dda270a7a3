"""Tone curves, and conversion between linear and sRGB colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_choice, check_number, check_numbers, wrong
from ..base.arrays import Doubles, Floats
from ..base.choices import CURVES

# Neutral curve: offset subtracted from all but the darkest values; start of highlight compression.
BLACK_POINT, SHOULDER = 0.01, 0.79
SOFT_WHITE = 16.0  # input that the soft curve maps to 1: four stops above 1
MOST_STOPS = 100  # within the range of float32
# Default backdrop, sRGB, top and bottom: cooler than clay, darker than its lit side, and shadows on the ground show.
GRADIENT = ((0.15, 0.18, 0.22), (0.50, 0.53, 0.57))
Backdrop = tuple[tuple[float, float, float], tuple[float, float, float]]


def linear_to_srgb(linear: NDArray[np.floating[Any]]) -> Floats:
    """Convert linear values, clipped to 0..1, to sRGB from 0 to 1 (IEC 61966-2-1), float32; any shape."""
    x = np.clip(linear, 0, 1).astype(np.float32)
    curve: Floats = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return curve


def srgb_to_linear(colors: NDArray[np.uint8] | NDArray[np.floating[Any]]) -> Floats:
    """Convert sRGB colours, uint8 or float from 0 to 1, to linear float32; any shape."""
    return _TABLE[colors] if colors.dtype == np.uint8 else _decode(colors.astype(np.float64))


def _decode(x: Doubles) -> Floats:
    curve = np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4)
    return curve.astype(np.float32)


_TABLE = _decode(np.arange(256) / 255)


def check_backdrop(backdrop: Any) -> Backdrop:
    """Validate a backdrop from the caller: return two sRGB colours, 0 to 1, at the top and the bottom of a gradient."""
    colors = check_numbers(backdrop, "backdrop", "two sRGB colours, above and below").astype(np.float64)
    if colors.shape != (2, 3) or not ((colors >= 0) & (colors <= 1)).all():
        raise wrong("backdrop", "two sRGB colours, above and below, from 0 to 1", backdrop)
    above, below = ((r, g, b) for r, g, b in colors.tolist())
    return above, below


def backdrop_rows(backdrop: Backdrop, height: int) -> Floats:
    """Return the linear colour of each row of a vertical gradient between two sRGB colours, (height, 1, 3)."""
    above, below = (np.array(color, np.float64) for color in backdrop)
    share = ((np.arange(height) + 0.5) / height)[:, None, None]
    return srgb_to_linear(above + share * (below - above))


def filmic(linear: Floats) -> Floats:
    """Apply a filmic tone curve, linear 0..inf to linear 0..1, which maps 1 to 0.80; any shape.

    References
    ----------
    Narkowicz: ACES Filmic Tone Mapping Curve (2016), the fit without its optional 0.6 of exposure.
    """
    x = np.clip(linear, 0, 1e4)  # avoids overflow; the curve is 1 there
    curve: Floats = np.minimum(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 1)
    return curve


def neutral(linear: Floats) -> Floats:
    """Apply a tone curve with toe and shoulder to linear values; any shape.

    In between it is linear. It maps 0.02 to 0.01, 0.2 to 0.19, 1 to 0.90, and infinity to 1.

    References
    ----------
    Khronos: PBR Neutral Tone Mapper (2024), sections "Fresnel compensation" and "Highlight compression", applied per
    channel, so that highlights fade to white without its desaturation. The original subtracts 0.04, the reflection of a
    white sky by a glossy dielectric; scans are diffuse, and 0.01 is the glare of a good lens (ISO 9358: 1% to 3%).
    """
    x = np.clip(linear, 0, 1e30).astype(np.float32)
    dark = np.minimum(x, np.float32(2 * BLACK_POINT))
    toe = x - dark + dark * dark * np.float32(0.25 / BLACK_POINT)
    room = np.float32(1 - SHOULDER)
    above = np.maximum(toe - np.float32(SHOULDER), 0)
    return np.asarray(np.minimum(toe, np.float32(SHOULDER) + room * above / (above + room)), np.float32)


def soft(linear: Floats) -> Floats:
    """Apply a tone curve that preserves shadows and compresses highlights increasingly to linear values; any shape.

    It maps 1 to 0.5, and 16 to 1.

    References
    ----------
    Reinhard, Stark, Shirley and Ferwerda: Photographic Tone Reproduction for Digital Images (2002), equation 4.
    """
    x = np.clip(linear, 0, SOFT_WHITE).astype(np.float32)
    return np.asarray(x * (1 + x * np.float32(SOFT_WHITE**-2)) / (1 + x), np.float32)


def check_tone(exposure: float, curve: str) -> None:
    """Raise ValueError unless the exposure is from -100 to 100 stops and the tone curve is known."""
    check_choice(curve, "curve", CURVES)
    limits = f"between -{MOST_STOPS} and {MOST_STOPS} stops"
    check_number(exposure, "exposure", limits, lambda x: -MOST_STOPS <= x <= MOST_STOPS)


def tone(linear: Floats, exposure: float = 0, curve: str = "srgb") -> Floats:
    """Apply exposure and a tone curve to linear colours.

    Parameters
    ----------
    linear : (..., 3) float32
    exposure : float
        In stops; each doubles the light.
    curve : {"srgb", "neutral", "filmic", "soft"}
        Treatment of highlights: "srgb" clips at 1, "neutral" compresses from 0.8, "filmic" as film does, "soft" from
        the mid-tones.

    Returns
    -------
    (..., 3) float32
        Linear, 0 to 1; NaN becomes 0.
    """
    check_tone(exposure, curve)
    with np.errstate(over="ignore"):  # infinity is shown as 1
        exposed = np.nan_to_num(linear) * np.float32(2.0 ** np.clip(exposure, -100, 100))
    if curve == "srgb":
        return np.asarray(np.clip(exposed, 0, 1))
    return _CURVES[curve](exposed)


_CURVES = {"neutral": neutral, "filmic": filmic, "soft": soft}
