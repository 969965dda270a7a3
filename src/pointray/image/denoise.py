"""Denoising by Intel's Open Image Denoise, guided by albedo and normals."""

from __future__ import annotations

import numpy as np

from ..base.arrays import Floats
from ..base.extras import require


def check_denoise() -> None:
    """Raise ImportError, with instructions, if the package that `denoise` needs is not installed."""
    require("pyoidn", "denoise", "denoising")


def denoise(image: Floats, albedo: Floats, normal: Floats) -> None:
    """Denoise a rendered image with Open Image Denoise; alpha is unchanged.

    All arrays are modified in place, to save memory.

    Parameters
    ----------
    image : (h, w, 4) float32, C-contiguous
        Linear, premultiplied HDR, and alpha. Replaced by the result.
    albedo : (h, w, 4) float32, C-contiguous
        Albedo of the surface seen in each pixel; clipped to 0 to 1. Alpha is ignored, as in normal.
    normal : (h, w, 4) float32, C-contiguous
        Normals of that surface; clipped to -1 to 1.

    Raises
    ------
    ImportError
        If its package is not installed.
    MemoryError
        If Open Image Denoise runs out of memory.
    RuntimeError
        If it fails otherwise.
    """
    oidn = require("pyoidn", "denoise", "denoising")
    for row in image:  # by rows, as masks of the whole image need memory
        np.nan_to_num(row[:, :3], copy=False)
    np.clip(albedo, 0, 1, out=albedo)
    np.clip(normal, -1, 1, out=normal)
    with oidn.Device() as device:
        device.commit()
        with oidn.Filter(device, oidn.OIDN_FILTER_TYPE_RT) as work:
            for name, array in (("color", image), ("albedo", albedo), ("normal", normal), ("output", image)):
                work.set_image(name, array, oidn.OIDN_FORMAT_FLOAT3, pixel_byte_stride=4 * array.itemsize)
            work.set_bool("hdr", True)
            work.set_quality(oidn.OIDN_QUALITY_HIGH)
            work.commit()
            work.execute()
            error = device.get_error()
    if error:
        raise (MemoryError if "memory" in str(error) else RuntimeError)(f"Open Image Denoise: {error}")
    np.maximum(image[..., :3], 0.0, out=image[..., :3])
