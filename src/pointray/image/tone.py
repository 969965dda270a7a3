"""From linear radiance to what a screen shows, and back from a file's colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_choice, check_number, check_numbers, wrong
from ..base.choices import CURVES

Floats = NDArray[np.float32]

# The neutral curve: what is taken off all but the darkest light, where highlights begin to be compressed.
BLACK_POINT, SHOULDER = 0.01, 0.79
SOFT_WHITE = 16.0  # what the soft curve makes white: four stops more than 1
MOST_STOPS = 100  # that float32 can hold
# sRGB, above and below, behind a scan: cool beside clay, and darker than its lit side; a shadow on the ground is seen.
GRADIENT = ((0.15, 0.18, 0.22), (0.50, 0.53, 0.57))
Backdrop = tuple[tuple[float, float, float], tuple[float, float, float]]


def linear_to_srgb(linear: NDArray[np.floating[Any]]) -> Floats:
    """The sRGB curve (IEC 61966-2-1), values clipped to 0..1; any shape, float32."""
    x = np.clip(linear, 0, 1).astype(np.float32)
    curve: Floats = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return curve


def srgb_to_linear(colors: NDArray[np.uint8] | NDArray[np.floating[Any]]) -> Floats:
    """Linear float32 of sRGB colours, uint8 or float from 0 to 1; any shape."""
    return _TABLE[colors] if colors.dtype == np.uint8 else _decode(colors.astype(np.float64))


def _decode(x: NDArray[np.float64]) -> Floats:
    curve = np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4)
    return curve.astype(np.float32)


_TABLE = _decode(np.arange(256) / 255)


def check_backdrop(backdrop: Any) -> Backdrop:
    """Two sRGB colours."""
    colors = check_numbers(backdrop, "backdrop", "two sRGB colours, above and below").astype(np.float64)
    if colors.shape != (2, 3) or not ((colors >= 0) & (colors <= 1)).all():
        raise wrong("backdrop", "two sRGB colours, above and below, from 0 to 1", backdrop)
    above, below = ((r, g, b) for r, g, b in colors.tolist())
    return above, below


def backdrop_rows(backdrop: Backdrop, height: int) -> Floats:
    """Linear colours of a gradient from sRGB above to sRGB below, (height, 1, 3)."""
    above, below = (np.array(color, np.float64) for color in backdrop)
    share = ((np.arange(height) + 0.5) / height)[:, None, None]
    return srgb_to_linear(above + share * (below - above))


def filmic(linear: Floats) -> Floats:
    """A curve that rolls highlights off as film does: linear 0..inf to linear 0..1, 1 to 0.80.

    References
    ----------
    Narkowicz: ACES Filmic Tone Mapping Curve (2016), the fit without its optional 0.6 of exposure.
    """
    x = np.clip(linear, 0, 1e4)  # beyond, the square may overflow; the curve has long reached 1
    curve: Floats = np.minimum(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 1)
    return curve


def neutral(linear: Floats) -> Floats:
    """A curve with a toe and a shoulder that keeps what is between: 0.02 to 0.01, 0.2 to 0.19, 1 to 0.90, inf to 1.

    References
    ----------
    Khronos: PBR Neutral Tone Mapper (2024), sections "Fresnel compensation" and "Highlight compression", each channel
    by itself, so that highlights fade to white without its desaturation. It takes off 0.04, what a glossy dielectric
    reflects of a white sky; scans are matt, and 0.01 is the glare of a good lens (ISO 9358: 1% to 3%).
    """
    x = np.clip(linear, 0, 1e30).astype(np.float32)
    dark = np.minimum(x, np.float32(2 * BLACK_POINT))
    toe = x - dark + dark * dark * np.float32(0.25 / BLACK_POINT)
    room = np.float32(1 - SHOULDER)
    above = np.maximum(toe - np.float32(SHOULDER), 0)
    return np.asarray(np.minimum(toe, np.float32(SHOULDER) + room * above / (above + room)), np.float32)


def soft(linear: Floats) -> Floats:
    """A curve that leaves shadows, and gives what is brighter the less room the brighter it is: 1 to 0.5, 16 to 1.

    References
    ----------
    Reinhard, Stark, Shirley and Ferwerda: Photographic Tone Reproduction for Digital Images (2002), equation 4.
    """
    x = np.clip(linear, 0, SOFT_WHITE).astype(np.float32)
    return np.asarray(x * (1 + x * np.float32(SOFT_WHITE**-2)) / (1 + x), np.float32)


def check_tone(exposure: float, curve: str) -> None:
    """Raise ValueError for what `tone` does not know."""
    check_choice(curve, "curve", CURVES)
    limits = f"between -{MOST_STOPS} and {MOST_STOPS} stops"
    check_number(exposure, "exposure", limits, lambda x: -MOST_STOPS <= x <= MOST_STOPS)


def tone(linear: Floats, exposure: float = 0, curve: str = "srgb") -> Floats:
    """What of linear colours can be shown.

    Parameters
    ----------
    linear : (..., 3) float32
    exposure : float
        In stops: each doubles the light.
    curve : {"srgb", "neutral", "filmic", "soft"}
        How brightness above 1 is treated: cut off, or rolled off: from 0.8 on, as by film, from the middle on.

    Returns
    -------
    (..., 3) float32
        Linear, 0 to 1; NaN becomes 0.
    """
    check_tone(exposure, curve)
    with np.errstate(over="ignore"):  # infinite is as bright as 1
        exposed = np.nan_to_num(linear) * np.float32(2.0 ** np.clip(exposure, -100, 100))
    if curve == "srgb":
        return np.asarray(np.clip(exposed, 0, 1))
    return _CURVES[curve](exposed)


_CURVES = {"neutral": neutral, "filmic": filmic, "soft": soft}
