"""Light and noise of an image, from its film."""

from __future__ import annotations

import numpy as np

from ..base.arrays import Floats
from ..engine.kernels.vec import LUMINANCE

ROUNDING = 4e-6  # variance of equal samples by rounding of their sums, relative to the squared mean
BAND = 1 << 17  # pixels processed together, to save memory


def light_of(film: Floats, done: int) -> tuple[Floats, Floats]:
    """Return RGB (no background) and alpha, (h, w, 4), and a mask of noisy pixels, (h, w): 1 where samples differ.

    The denoiser changes only noisy pixels. With one sample, or only black samples, pixels with a hit count as noisy.

    film : (h, w, k) float32, sums over samples: RGB, number of hits, squared luminance; done : number of samples
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
    """Return the standard error of the pixels, root mean square, relative to the image's mean.

    film : (h, w, k) float32, sums over samples: RGB, number of hits, squared luminance; done : number of samples, at
        least 2
    """
    light, variance = 0.0, 0.0
    rows = max(BAND // film.shape[1], 1)
    for top in range(0, len(film), rows):
        band = film[top : top + rows].astype(np.float64)
        mean = band[..., :3] @ np.array(LUMINANCE) / done
        variance += float(np.maximum(band[..., 4] / done - mean * mean, 0.0).sum()) / (done - 1)
        light += float(mean.sum())
    pixels = film.shape[0] * film.shape[1]
    return float(np.sqrt(variance / pixels)) * pixels / light if light > 0 else 0.0
