"""Noise removed from a picture: Intel's Open Image Denoise, with what the surfaces look like as a help."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.extras import require

Floats = NDArray[np.float32]


def check_denoise() -> None:
    """Raise what `denoise` would raise if its package is absent."""
    require("pyoidn", "denoise", "denoising")


def denoise(image: Floats, albedo: Floats, normal: Floats) -> None:
    """Take the noise out of a picture; alpha, which has none of its own, stays.

    All are worked on where they are, without copies: a large picture has no room for these.

    Parameters
    ----------
    image : (h, w, 4) float32, C-contiguous
        Linear, premultiplied; brightness without limit. Becomes the result.
    albedo : (h, w, 4) float32, C-contiguous
        Colour of the surfaces, 0 to 1; clipped. The fourth number does not matter, nor that of the normals.
    normal : (h, w, 4) float32, C-contiguous
        Their normals, at most unit length; clipped.

    Raises
    ------
    MemoryError
        If there is too little for what Open Image Denoise needs beside them.
    RuntimeError
        If it fails otherwise.
    """
    oidn = require("pyoidn", "denoise", "denoising")
    for row in image:  # whole pictures of what is not a number would be held
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
