"""Pictures and layers as files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from ..base.arguments import check_mapping, check_path
from ..base.atomic_write import check_writable, replacing
from ..base.choices import AUTO
from ..base.memory import check_memory
from ..shade.attributes import Attribute
from .exposure import tone_of
from .exr import channels_of, check_exr, write_exr
from .legend import check_legend, draw_legend
from .tone import Backdrop, backdrop_rows, check_backdrop, check_tone, linear_to_srgb, tone

SHOWN = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}
FORMATS = {**SHOWN, ".exr": "EXR"}
LAYERED = {".exr": "EXR", ".npz": "NPZ"}
QUALITY = 92  # of JPEG
BAND = 1 << 19  # pixels that are converted together
SHOWN_BYTES = 8  # a pixel: 8 bits a channel, and as Pillow keeps them
EXR_BYTES = 64  # a pixel, of all that `render_layers` returns: its channels one by one

Floats = NDArray[np.float32]


def write_image(
    path: str | os.PathLike[str],
    image: ArrayLike,
    exposure: float | str = 0,
    curve: str = "srgb",
    legend: Attribute | None = None,
    backdrop: Backdrop | None = None,
) -> None:
    """Write a rendered image.

    Parameters
    ----------
    path : str or path
        Ends in .png, .jpg, .jpeg or .exr; replaced when all is written.
    image : (h, w, 4) or (h, w, 3) float32
        Linear; with alpha premultiplied. NaN becomes 0.
    exposure : float or "auto"
        In stops: each doubles the light. Auto: of medium brightness, with highlights kept, see `auto_exposure`.
    curve : {"srgb", "neutral", "filmic", "soft", "auto"}
        Brightness above 1 is cut off, or rolled off: from 0.8 on, as by film, or from the middle on. Auto: where the
        exposure is chosen, "neutral", or "soft" where a few bright spots would leave the rest dark; else "srgb".
    legend : Attribute, optional
        With a range or categories: in a strip beside what is shown, by which the file is wider, see `draw_legend`. Not
        for EXR.
    backdrop : ((3,), (3,)) float, optional
        sRGB, 0 to 1: a gradient from the first above to the second below, behind what is transparent; the exposure does
        not change it. Not for EXR.

    Raises
    ------
    OSError
        If the file cannot be written.
    ValueError
        If the extension, the shape, the dtype or the curve is another, or the package for EXR is absent.

    Notes
    -----
    A PNG keeps alpha where any is below 1. A JPEG has none: it shows the image on white.

    An EXR keeps the numbers themselves, float32: linear, premultiplied, alpha if the image has it, NaN and what is
    brighter than 1 too. Exposure and curve are for looking at pictures and do not change it. It needs OpenEXR:
    `pip install 'pointray[files]'`.
    """
    file = check_path(path)
    format = _format_of(file, FORMATS)
    array = _check_image(image)
    known = isinstance(exposure, str) and exposure == AUTO
    check_tone(0.0 if known else exposure, "srgb" if isinstance(curve, str) and curve == AUTO else curve)  # type: ignore[arg-type]
    stops, curve = tone_of(array, exposure, curve)
    behind = None if backdrop is None else backdrop_rows(check_backdrop(backdrop), len(array))
    if legend is not None:
        check_legend(legend, "legend")
    if format == "EXR":
        for name, given in (("a legend", legend), ("a backdrop", backdrop)):
            if given is not None:
                raise ValueError(f"{file}: an EXR keeps the light as it is; {name} is for {', '.join(SHOWN)}")
        write_layers(file, {"radiance": array})
        return
    check_memory(SHOWN_BYTES * array.shape[0] * array.shape[1], f"to write {file.name}")
    picture = _to_bytes(array, (stops, curve), format == "PNG", behind)
    if legend is not None:
        picture = draw_legend(picture, legend, beside=True)
    with replacing(file) as beside:
        stream = cast(IO[bytes], beside)
        Image.fromarray(picture).save(stream, format, quality=QUALITY, subsampling=0, compress_level=4)


def write_layers(path: str | os.PathLike[str], layers: Mapping[str, ArrayLike]) -> None:
    """Write layers of one picture, as `render_layers` returns them, all or some.

    Parameters
    ----------
    path : str or path
        Ends in .npz: arrays as they are, compressed, for `numpy.load`. Or in .exr: one file of many channels for
        other programs, which needs OpenEXR: `pip install 'pointray[files]'`. Replaced when all is written.
    layers : dict of str to (h, w) or (h, w, k) array_like
        An EXR takes the names of `render_layers` only.

    Raises
    ------
    OSError
        If the file cannot be written.
    ValueError
        If the extension, a name, a shape or a dtype is another, or the package for EXR is absent.

    Notes
    -----
    Channels of an EXR: R, G, B, A (radiance), Z (depth), normal.X to .Z, position.X to .Z, albedo.R to .B, instance,
    point. Colours, depth, normals and positions are float32 there: of coordinates in millions of metres half a metre
    is left, an NPZ keeps float64. Indices are uint32, exact up to 4,294,967,294 (float32 would be up to 2^24); -1,
    which means none, becomes 4,294,967,295.
    """
    file = check_path(path)
    format = _format_of(file, LAYERED)
    arrays = _check_layers(layers)
    channels = channels_of(arrays) if format == "EXR" else {}
    with replacing(file) as beside:
        if format == "EXR":
            write_exr(beside.path, channels)
        else:
            np.savez_compressed(beside, **arrays)  # type: ignore[arg-type]  # its stub takes names for an option


def check_image_path(path: str | os.PathLike[str]) -> None:
    """Raise what `write_image` would raise for this path, before the work is done."""
    _check_path(Path(path), FORMATS)


def check_layers_path(path: str | os.PathLike[str]) -> None:
    """Raise what `write_layers` would raise for this path, before the work is done."""
    _check_path(Path(path), LAYERED)


def _check_path(file: Path, formats: Mapping[str, str]) -> None:
    if _format_of(file, formats) == "EXR":
        check_exr(file)
    check_writable(file)


def _format_of(file: Path, formats: Mapping[str, str]) -> str:
    format = formats.get(file.suffix.lower())
    if format is None:
        extension = file.suffix or "a file without extension"
        raise ValueError(f"{file}: cannot write {extension}; can write {', '.join(formats)}")
    return format


def _check_layers(layers: Mapping[str, ArrayLike]) -> dict[str, NDArray[Any]]:
    arrays = {name: _as_array(values, f"layers: {name!r}") for name, values in check_mapping(layers, "layers").items()}
    if not arrays:
        raise ValueError("layers holds none to write")
    if not all(isinstance(name, str) for name in arrays):
        raise ValueError(f"layers must have strings for names, not {list(arrays)}")
    size = next(iter(arrays.values())).shape[:2]
    for name, array in arrays.items():
        if array.dtype.kind not in "iuf":
            raise ValueError(f"layers: {name!r} must hold real numbers, not {array.dtype}")
        if array.ndim not in (2, 3) or array.size == 0 or array.shape[:2] != size:
            raise ValueError(f"layers have the shape (h, w) or (h, w, k), all of one size; {name!r}: {array.shape}")
    return arrays


def _as_array(values: ArrayLike, name: str) -> NDArray[Any]:
    try:
        return np.asarray(values)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise ValueError(f"{name} is no regular array of numbers: {error}") from None


def _check_image(image: ArrayLike) -> NDArray[Any]:
    array = _as_array(image, "image")
    if array.dtype.kind != "f":
        raise ValueError(f"an image must be float, linear, not {array.dtype}")
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.size == 0:
        raise ValueError(f"an image must have the shape (h, w, 3) or (h, w, 4), not {array.shape}")
    return array


def _split(image: NDArray[Any]) -> tuple[Floats, Floats]:
    """Colour as if everything were opaque, (h, w, 3), and alpha, (h, w, 1)."""
    with np.errstate(over="ignore"):
        linear = image.astype(np.float32, copy=False)
    if linear.shape[2] == 3:
        return linear, np.ones((*linear.shape[:2], 1), np.float32)
    alpha = np.clip(np.nan_to_num(linear[..., 3:]), 0, 1)
    with np.errstate(over="ignore", invalid="ignore"):  # where nothing is, no colour shows
        colors = np.divide(linear[..., :3], np.where(alpha > 0, alpha, np.inf), dtype=np.float32)
    return colors, alpha


def _to_bytes(
    image: NDArray[Any], look: tuple[Any, str], transparent: bool, backdrop: Floats | None
) -> NDArray[np.uint8]:
    """What is shown of an image, (h, w, 3) uint8, or (h, w, 4) where alpha is kept and any is below 1; else on white.

    look : exposure, curve; backdrop : (h, 1, 3), linear, in the place of white

    Made by bands of rows: what is on the way to it takes several times the memory of the picture.
    """
    rows = bands(image.shape)
    transparent = transparent and backdrop is None and any((_split(image[band])[1] < 1).any() for band in rows)
    out = np.empty((*image.shape[:2], 4 if transparent else 3), np.uint8)
    for band in rows:
        linear, alpha = _split(image[band])
        shown = tone(linear, *look)
        if not transparent:
            shown = shown * alpha + (1 - alpha) * (1.0 if backdrop is None else backdrop[band])
        out[band, :, :3] = np.rint(linear_to_srgb(shown) * 255)
        if transparent:
            out[band, :, 3:] = np.rint(alpha * 255)
    return out


def bands(shape: tuple[int, ...]) -> list[slice]:
    """Rows of a picture (h, w, ...), some at a time."""
    rows = max(BAND // shape[1], 1)
    return [slice(top, top + rows) for top in range(0, shape[0], rows)]
