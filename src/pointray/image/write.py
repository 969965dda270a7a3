"""Pictures as files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from ..points.files import check_writable, replacing
from .tone import linear_to_srgb, tone

FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}
QUALITY = 92  # of JPEG

Floats = NDArray[np.float32]


def write_image(path: str | os.PathLike[str], image: ArrayLike, exposure: float = 0, curve: str = "srgb") -> None:
    """Write a rendered image.

    Parameters
    ----------
    path : str or path
        Ends in .png, .jpg or .jpeg; replaced when all is written.
    image : (h, w, 4) or (h, w, 3) float32
        Linear; with alpha premultiplied. NaN becomes 0.
    exposure : float
        In stops: each doubles the light.
    curve : {"srgb", "filmic"}
        Brightness above 1 is cut off, or rolled off as by film.

    Raises
    ------
    OSError
        If the file cannot be written.
    ValueError
        If the extension, the shape, the dtype or the curve is another.

    Notes
    -----
    A PNG keeps alpha where any is below 1. A JPEG has none: it shows the image on white.
    """
    file = Path(path)
    format = _format_of(file)
    linear, alpha = _split(image)
    shown = tone(linear, exposure, curve)
    if format == "JPEG":
        shown = shown * alpha + (1 - alpha)
    picture = _to_bytes(linear_to_srgb(shown))
    if format == "PNG" and (alpha < 1).any():
        picture = np.concatenate([picture, _to_bytes(alpha)], axis=2)
    with replacing(file) as beside:
        Image.fromarray(picture).save(beside, format, quality=QUALITY, subsampling=0, compress_level=4)


def check_image_path(path: str | os.PathLike[str]) -> None:
    """Raise what `write_image` would raise for this path, before the work is done."""
    _format_of(Path(path))
    check_writable(path)


def _format_of(file: Path) -> str:
    format = FORMATS.get(file.suffix.lower())
    if format is None:
        extension = file.suffix or "a file without extension"
        raise ValueError(f"{file}: cannot write {extension}; can write {', '.join(FORMATS)}")
    return format


def _split(image: ArrayLike) -> tuple[Floats, Floats]:
    """Colour as if everything were opaque, (h, w, 3), and alpha, (h, w, 1)."""
    array = np.asarray(image)
    if array.dtype.kind != "f":
        raise ValueError(f"an image must be float, linear, not {array.dtype}")
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.size == 0:
        raise ValueError(f"an image must have the shape (h, w, 3) or (h, w, 4), not {array.shape}")
    with np.errstate(over="ignore"):
        linear: Floats = array.astype(np.float32, copy=False)
    if linear.shape[2] == 3:
        return linear, np.ones((*linear.shape[:2], 1), np.float32)
    alpha = np.clip(np.nan_to_num(linear[..., 3:]), 0, 1)
    with np.errstate(over="ignore", invalid="ignore"):  # where nothing is, no colour shows
        colors = np.divide(linear[..., :3], np.where(alpha > 0, alpha, np.inf), dtype=np.float32)
    return colors, alpha


def _to_bytes(values: Floats) -> NDArray[np.uint8]:
    return np.rint(values * 255).astype(np.uint8)
