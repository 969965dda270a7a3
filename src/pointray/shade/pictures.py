"""Pictures of light, from files: Radiance .hdr and .exr, by OpenImageIO."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from ..base.extras import require


def read_picture(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """The pixels of a picture, unchanged and linear.

    Returns
    -------
    (h, w, channels) float32

    Raises
    ------
    OSError
        If there is no such file.
    ValueError
        If it is no picture, or is damaged, or OpenImageIO is not installed.
    """
    with open(path, "rb"):  # raises the system's own error
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
    """The first line of an error."""
    return text.strip().splitlines()[0] if text.strip() else "not a picture that can be read"
