"""What the sums of a picture's samples tell: its light, and how noisy it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..engine.kernels.vec import LUMINANCE

ROUNDING = 4e-6  # share of a squared mean: the variance that sums of equal samples may have by rounding
BAND = 1 << 17  # pixels that are processed together where noise is measured

Floats = NDArray[np.float32]


def light_of(film: Floats, done: int) -> tuple[Floats, Floats]:
    """Light along the rays without the background, (h, w, 4); and 1 where samples differ, else 0, (h, w).

    One sample a pixel cannot tell that, nor can samples that are all dark: what they met counts as noisy.

    film : (h, w, k) float32, see `integrate`; done : samples in it
    """
    light, noisy = np.zeros((*film.shape[:2], 4), np.float32), np.empty(film.shape[:2], np.float32)
    for row, differs, sums in zip(light, noisy, film, strict=True):
        row[:, :3] = sums[:, :3] / done
        mean = sums[:, :3].astype(np.float64) @ np.array(LUMINANCE) / done
        variance = sums[:, 4] / done - mean * mean
        same = (variance <= ROUNDING * mean * mean) & (mean > 0) & (done > 1)
        differs[:] = (sums[:, 3] > 0) & ~same
    return light, noisy


def noise_of(film: Floats, done: int) -> float:
    """Standard error of the pixels, root mean square, as a share of the picture's mean."""
    light, variance = 0.0, 0.0
    rows = max(BAND // film.shape[1], 1)
    for top in range(0, len(film), rows):
        band = film[top : top + rows].astype(np.float64)
        mean = band[..., :3] @ np.array(LUMINANCE) / done
        variance += float(np.maximum(band[..., 4] / done - mean * mean, 0.0).sum()) / (done - 1)
        light += float(mean.sum())
    pixels = film.shape[0] * film.shape[1]
    return float(np.sqrt(variance / pixels)) * pixels / light if light > 0 else 0.0
