"""Reading of environment images, Radiance .hdr and .exr, with OpenImageIO."""

from __future__ import annotations

import os

import numpy as np

from ..base.arrays import Floats
from ..base.extras import require


def read_picture(path: str | os.PathLike[str]) -> Floats:
    """Read the linear pixels of an environment image, such as a Radiance .hdr or an OpenEXR file.

    Returns
    -------
    (h, w, channels) float32

    Raises
    ------
    OSError
        If the file does not exist or cannot be opened.
    ValueError
        If the file is not a valid image.
    ImportError
        If OpenImageIO is not installed.
    """
    with open(path, "rb"):  # raises OSError
        pass
    name = os.fspath(path)
    oiio = require("OpenImageIO", "files", name)
    source = oiio.ImageInput.open(name)
    if source is None:
        raise ValueError(f"{name}: {_reason(oiio.geterror())}")
    pixels = source.read_image("float")
    if pixels is None:
        raise ValueError(f"{name}: {_reason(source.geterror())}")
    source.close()
    return np.atleast_3d(np.asarray(pixels, np.float32))


def _reason(text: str) -> str:
    """Return the first line of OpenImageIO's error message, or a general one if it is empty."""
    return text.strip().splitlines()[0] if text.strip() else "unsupported or damaged image"
