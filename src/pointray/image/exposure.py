"""How bright a picture is shown: so that what is seen of the surface is of medium brightness, and little burns out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..vec import LUMINANCE

EXPOSED = ("phong", "ao", "path")  # integrators whose pictures are light; others are shown as they are
MIDDLE = 0.24  # what the log average becomes, linear: sRGB 0.53
BURNT, WHITE = 0.995, 0.92  # so many of the pixels stay below this, linear: level 246
COVERED = 0.5  # alpha from which a pixel counts
DARKEST = 1e-4  # of the brightest: what is darker counts as this
LEAST, MOST = -20.0, 20.0  # stops
STEP = 1 << 18  # pixels that are looked at


def auto_exposure(image: NDArray[np.floating]) -> float:
    """The exposure, in stops, that shows a picture well.

    Parameters
    ----------
    image : (h, w, 3) or (h, w, 4) float
        Linear; with alpha premultiplied: where it is below a half nothing counts.

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
    stops = min(np.log2(MIDDLE / average), np.log2(WHITE / brightest))
    return float(np.clip(np.floor(16.0 * stops) / 16.0, LEAST, MOST))
