"""Writing of images and layers to files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from ..base.arguments import check_mapping, check_path
from ..base.arrays import Floats
from ..base.atomic_write import check_writable, replacing, unsupported_extension
from ..base.choices import AUTO
from ..base.memory import check_memory
from ..shade.attributes import Attribute
from .exposure import tone_of
from .exr import channels_of, check_exr, write_exr
from .legend import check_legend, draw_legend
from .tone import Backdrop, backdrop_rows, check_backdrop, check_tone, linear_to_srgb, srgb_to_linear, tone

SHOWN = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}
FORMATS = {**SHOWN, ".exr": "EXR"}
LAYERED = {".exr": "EXR", ".npz": "NPZ"}
QUALITY = 92  # JPEG quality
BAND = 1 << 19  # pixels converted together, to save memory
SHOWN_BYTES = 8  # bytes of a pixel in 8-bit channels, with Pillow's copy
EXR_BYTES = 64  # bytes of a pixel in separate channels, for all layers of `render_layers`


def write_image(
    path: str | os.PathLike[str],
    image: ArrayLike,
    exposure: float | str = 0,
    curve: str = "srgb",
    legend: Attribute | None = None,
    backdrop: Backdrop | None = None,
) -> None:
    """Write a rendered image to a PNG, JPEG or EXR file.

    Parameters
    ----------
    path : str or path
        Extension .png, .jpg, .jpeg or .exr. An existing file is replaced when the new one is complete.
    image : (h, w, 4) or (h, w, 3) float32
        Linear, premultiplied. NaN becomes 0.
    exposure : float or "auto"
        In stops, -100 to 100; each doubles the light. "auto": medium brightness without clipped highlights, see
        `auto_exposure`.
    curve : {"srgb", "neutral", "filmic", "soft", "auto"}
        Treatment of highlights: "srgb" clips at 1, "neutral" compresses from 0.8, "filmic" as film does, "soft" from
        the mid-tones. "auto" with automatic exposure: "soft" if a few bright spots would darken the rest, else
        "neutral"; with a given exposure: "srgb".
    legend : Attribute, optional
        Attribute with a range or categories, whose legend is drawn in a strip that widens the image, see `draw_legend`.
        Not for EXR.
    backdrop : ((3,), (3,)) float, optional
        sRGB colours, 0 to 1, at the top and the bottom of a gradient behind transparent pixels; not changed by the
        exposure. Not for EXR.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    OSError
        If the file cannot be written.
    ValueError
        If the extension, shape, dtype, exposure or curve is unsupported.
    ImportError
        If OpenEXR is not installed, for EXR.

    Notes
    -----
    A PNG has alpha if any pixel is transparent and no backdrop is given. A JPEG shows the image on white.

    An EXR stores the values as float32, linear and premultiplied, with alpha if the image has it, including NaN and
    values above 1. Exposure and curve do not change them. It needs OpenEXR: `pip install 'pointray[files]'`.

    Examples
    --------
    >>> image = np.full((24, 32, 3), 0.5, np.float32)
    >>> pr.write_image("grey.png", image, exposure=1)
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
                raise ValueError(f"{file}: an EXR stores only radiance; {name} is supported for {', '.join(SHOWN)}")
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
    """Write layers of an image (radiance, depth, normals and others, see `render_layers`) to one EXR or NPZ file.

    Parameters
    ----------
    path : str or path
        Extension .npz: compressed arrays for `numpy.load`. Extension .exr: a multi-channel file for other programs,
        which needs OpenEXR: `pip install 'pointray[files]'`. An existing file is replaced when the new one is complete.
    layers : dict of str to (h, w) or (h, w, k) array_like
        For an EXR, names must be those of `render_layers`.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    OSError
        If the file cannot be written.
    ValueError
        If the extension, a name, a shape or a dtype is unsupported.
    ImportError
        If OpenEXR is not installed, for EXR.

    Notes
    -----
    Channels of an EXR: R, G, B, A (radiance), Z (depth), normal.X to .Z, position.X to .Z, albedo.R to .B, instance,
    point. Colours, depth, normals and positions are float32: coordinates of millions of metres have a precision of half
    a metre, while an NPZ stores float64. Indices are uint32, exact up to 4,294,967,294; -1 (a miss) becomes
    4,294,967,295.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
    >>> pr.write_layers("ball.npz", pr.render_layers(scene, pr.frame(scene, size=(32, 24))))
    >>> np.load("ball.npz")["normal"].shape
    (24, 32, 3)
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
    """Raise the error that `write_image` would raise for this path, before an image is rendered for it.

    Errors are an unsupported extension, a missing package and a folder that is not writable.
    """
    _check_path(Path(path), FORMATS)


def check_layers_path(path: str | os.PathLike[str]) -> None:
    """Raise the error that `write_layers` would raise for this path, before layers are rendered for it.

    Errors are an unsupported extension, a missing package and a folder that is not writable.
    """
    _check_path(Path(path), LAYERED)


def _check_path(file: Path, formats: Mapping[str, str]) -> None:
    if _format_of(file, formats) == "EXR":
        check_exr(file)
    check_writable(file)


def _format_of(file: Path, formats: Mapping[str, str]) -> str:
    format = formats.get(file.suffix.lower())
    if format is None:
        raise unsupported_extension(file, formats)
    return format


def _check_layers(layers: Mapping[str, ArrayLike]) -> dict[str, NDArray[Any]]:
    arrays = {name: _as_array(values, f"layers: {name!r}") for name, values in check_mapping(layers, "layers").items()}
    if not arrays:
        raise ValueError("layers is empty")
    if not all(isinstance(name, str) for name in arrays):
        raise ValueError(f"layers must have strings as names, not {list(arrays)}")
    size = next(iter(arrays.values())).shape[:2]
    for name, array in arrays.items():
        if array.dtype.kind not in "iuf":
            raise ValueError(f"layers: {name!r} must hold real numbers, not {array.dtype}")
        if array.ndim not in (2, 3) or array.size == 0 or array.shape[:2] != size:
            raise ValueError(
                f"layers must have the shape (h, w) or (h, w, k), all of one size; {name!r} has {array.shape}"
            )
    return arrays


def _as_array(values: ArrayLike, name: str) -> NDArray[Any]:
    try:
        return np.asarray(values)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise ValueError(f"{name} must be a regular array of numbers: {error}") from None


def _check_image(image: ArrayLike) -> NDArray[Any]:
    array = _as_array(image, "image")
    if array.dtype.kind != "f":
        raise ValueError(f"image must be linear, of a float dtype, not {array.dtype}")
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.size == 0:
        raise ValueError(f"image must have the shape (h, w, 3) or (h, w, 4), not {array.shape}")
    return array


def _split(image: NDArray[Any]) -> tuple[Floats, Floats]:
    """Return the colours of a linear image divided by alpha, (h, w, 3), and its alpha, (h, w, 1), float32.

    image : (h, w, 4), premultiplied, or (h, w, 3) with alpha 1
    """
    with np.errstate(over="ignore"):
        linear = image.astype(np.float32, copy=False)
    if linear.shape[2] == 3:
        return linear, np.ones((*linear.shape[:2], 1), np.float32)
    alpha = np.clip(np.nan_to_num(linear[..., 3:]), 0, 1)
    with np.errstate(over="ignore", invalid="ignore"):  # colours at alpha 0 are not shown
        colors = np.divide(linear[..., :3], np.where(alpha > 0, alpha, np.inf), dtype=np.float32)
    return colors, alpha


def _to_bytes(
    image: NDArray[Any], look: tuple[Any, str], transparent: bool, backdrop: Floats | None
) -> NDArray[np.uint8]:
    """Convert a linear image to sRGB over a backdrop, (h, w, 3) uint8.

    The result is (h, w, 4) without a backdrop if `transparent` and any alpha is below 1. Bands of rows are converted
    one by one, as temporary arrays take several times the memory of the image.

    image : premultiplied; look : (exposure in stops, tone curve); backdrop : (h, 1, 3), linear; None for white
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


def displayed(image: ArrayLike, exposure: float, curve: str, backdrop: Backdrop | None = None) -> Floats:
    """Return the pixels that `write_image` would write, as a linear image with alpha 1, (h, w, 4) float32.

    Written without exposure and curve, it has the same pixels.

    image, exposure, curve, backdrop : as for `write_image`, but no value is chosen automatically
    """
    array = _check_image(image)
    behind = None if backdrop is None else backdrop_rows(backdrop, len(array))
    out = np.ones((*array.shape[:2], 4), np.float32)
    out[..., :3] = srgb_to_linear(_to_bytes(array, (exposure, curve), False, behind))
    return out


def bands(shape: tuple[int, ...]) -> list[slice]:
    """Return slices of rows that divide an image of this shape, (h, w, ...), into bands of about BAND pixels."""
    rows = max(BAND // shape[1], 1)
    return [slice(top, top + rows) for top in range(0, shape[0], rows)]
