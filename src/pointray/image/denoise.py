"""Noise removed from a picture: Intel's Open Image Denoise, with what the surfaces look like as a help."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..extras import require

Floats = NDArray[np.float32]


def check_denoise() -> None:
    """Raise what `denoise` would raise if its package is absent."""
    require("pyoidn", "denoise", "denoising")


def denoise(image: Floats, albedo: Floats, normal: Floats) -> Floats:
    """A picture without its noise; alpha, which has none of its own, stays.

    Parameters
    ----------
    image : (h, w, 4) float32
        Linear, premultiplied; brightness without limit.
    albedo : (h, w, 3) float32
        Colour of the surfaces, 0 to 1.
    normal : (h, w, 3) float32
        Their normals, at most unit length.
    """
    oidn = require("pyoidn", "denoise", "denoising")
    color = np.ascontiguousarray(np.nan_to_num(image[..., :3]))
    helpers = {
        "albedo": np.ascontiguousarray(np.clip(albedo, 0, 1)),
        "normal": np.ascontiguousarray(np.clip(normal, -1, 1)),
    }
    clean = oidn.denoise(color, **helpers, hdr=True)
    return np.concatenate([np.maximum(clean, 0.0), image[..., 3:]], axis=2)
