"""How bright a picture is shown: so that what is seen of the surface is of medium brightness, and little burns out."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..choices import AUTO
from ..kernels.vec import LUMINANCE
from .tone import tone

MIDDLE = 0.24  # what the log average becomes, linear: sRGB 0.53
BURNT, WHITE = 0.995, 0.92  # so many of the pixels stay below this, linear: level 246
COVERED = 0.5  # alpha from which a pixel counts
DARKEST = 1e-4  # of the brightest: what is darker counts as this
LEAST, MOST = -20.0, 20.0  # stops
DARKENED = 1.0  # stops that highlights may cost before they are shown by the soft curve
STEP = 1 << 18  # pixels that are looked at


def auto_exposure(image: NDArray[np.floating], curve: str = "srgb") -> float:
    """The exposure, in stops, that shows a picture well.

    Parameters
    ----------
    image : (h, w, 3) or (h, w, 4) float
        Linear; with alpha premultiplied: where it is below a half nothing counts.
    curve : {"srgb", "filmic", "soft"}
        By which it will be shown, see `tone`.

    Returns
    -------
    float
        Stops, a multiple of 1/16; 0 where there is nothing to be seen.

    References
    ----------
    Reinhard, Stark, Shirley and Ferwerda: Photographic Tone Reproduction for Digital Images (2002), the log average.
    """
    flat = image.reshape(-1, image.shape[-1])
    flat = flat[:: max(len(flat) // STEP, 1)].astype(np.float64)
    if flat.shape[1] == 4:
        flat = flat[flat[:, 3] >= COVERED]
        with np.errstate(invalid="ignore"):
            flat = flat[:, :3] / flat[:, 3:]
    flat = flat[np.isfinite(flat).all(axis=1)]
    light = flat @ np.array(LUMINANCE)
    brightest = float(np.quantile(flat.max(axis=1), BURNT)) if len(flat) else 0.0
    if brightest <= 0.0:
        return 0.0
    average = float(np.exp(np.log(np.maximum(light, DARKEST * brightest)).mean()))
    stops = min(np.log2(MIDDLE / average), np.log2(_brightest(curve) / brightest))
    return float(np.clip(np.floor(16.0 * stops) / 16.0, LEAST, MOST))


def auto_tone(image: NDArray[np.floating]) -> tuple[float, str]:
    """Exposure and curve that show a picture well: the soft one where a few bright spots would leave the rest dark."""
    plain, soft = auto_exposure(image), auto_exposure(image, "soft")
    return (soft, "soft") if soft - plain > DARKENED else (plain, "srgb")


def tone_of(image: NDArray[np.floating], exposure: float | str, curve: str) -> tuple[float, str]:
    """Exposure and curve, of which either may be "auto"; a curve alone that is auto is "srgb"."""
    if exposure != AUTO:
        return float(exposure), "srgb" if curve == AUTO else curve
    return auto_tone(image) if curve == AUTO else (auto_exposure(image, curve), curve)


@cache
def _brightest(curve: str) -> float:
    """What a curve shows as WHITE."""
    low, high = 0.0, 100.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        below = float(tone(np.array([middle], np.float32), 0.0, curve)[0]) < WHITE
        low, high = (middle, high) if below else (low, middle)
    return low
