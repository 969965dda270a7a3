"""Depth images: 16-bit PNG, or NPY. Each pixel becomes the point that the camera saw there.

The camera looks along z, with x to the right and y down, as in OpenCV. The centre of the first pixel is (0, 0).
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...cloud.georeference import Georeference
from ._source import CHUNK, NO, SURE, Chunk, Format, Listing, Request, Source

PNG, NPY = b"\x89PNG\r\n\x1a\n", b"\x93NUMPY"
IHDR = slice(16, 26)  # width, height, bits per channel, colour type
GREY = 0
DEFLATE_RATIO = 1032  # maximum compression ratio of deflate
SMALLEST = 17  # minimum rows and columns of an array read as an image; fewer may be the columns of a point array
MILLIMETRES = 1000.0


def recognise(head: bytes, path: Path) -> int:
    """Detect depth images: return `SURE` for PNG, `SURE` + 1 for an NPY file with an image, to outrank NPY, or `NO`.

    head : first bytes of the file
    """
    if head.startswith(PNG) and head[12:16] == b"IHDR":
        return SURE
    return SURE + 1 if head.startswith(NPY) and _is_image(head) else NO


def _is_image(head: bytes) -> bool:
    try:
        file = io.BytesIO(head)
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
    except Exception:  # NumPy evaluates the header as Python literals, which can raise anything
        return False
    return len(shape) == 2 and min(shape) >= SMALLEST and dtype.kind in "uif"


class DepthSource(Source):
    """Reader of depth images: each pixel becomes the point that the camera saw there."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path = path
        with path.open("rb") as file:
            head = file.read(32)
        self._png = head.startswith(PNG)
        if self._png:
            _check_png(head, path.stat().st_size)
        if request.intrinsics is None:
            raise ValueError("is a depth image: pass the camera as --intrinsics fx,fy,cx,cy, in pixels")
        self._fx, self._fy, self._cx, self._cy, *steps = request.intrinsics
        height, width, dtype = _size_of(head, path) if self._png else _array(path)
        self._whole = dtype.kind != "f"
        self._steps = steps[0] if steps else MILLIMETRES if self._whole else 1.0
        self._dtype = np.dtype("f4" if dtype.itemsize <= (2 if self._whole else 4) else "f8")
        self._facts: dict[str, Any] = {"width": width, "height": height, "type": str(dtype), "steps": self._steps}
        georeference = Georeference(stations=((0.0, 0.0, 0.0),), format="depth image")
        self.listing = Listing(None, 12 + 3 * self._dtype.itemsize, height * width, georeference, self._facts)

    def chunks(self) -> Iterator[Chunk]:
        pixels = _read_png(self._path) if self._png else np.load(self._path, mmap_mode="r", allow_pickle=False)
        height, width = pixels.shape
        rows, left_out = max(CHUNK // width, 1), 0
        for start in range(0, height, rows):
            depth = np.asarray(pixels[start : start + rows], np.float64) / self._steps
            seen = (depth > 0) & (depth < np.inf)
            left_out += int(seen.size - np.count_nonzero(seen))
            v, u = np.nonzero(seen)
            z = depth[seen]
            x, y = (u - self._cx) * z / self._fx, (v + start - self._cy) * z / self._fy
            yield Chunk(np.stack([x, y, z], axis=1).astype(self._dtype), share=min((start + rows) / height, 1.0))
        if left_out:
            self._facts["left_out"] = left_out


def _check_png(head: bytes, size: int) -> None:
    """Raise ValueError if a PNG file is not 16-bit grey, or its `size` is too small for its number of pixels.

    head : first bytes of the file
    """
    if len(head) < IHDR.stop:
        raise ValueError(f"is cut off: it has only {size} bytes")
    width, height = (int.from_bytes(head[IHDR][k : k + 4], "big") for k in (0, 4))
    bits, color = head[IHDR][8:]
    if color != GREY or bits != 16:
        what = f"a grey image of {bits} bits" if color == GREY else "a colour image"
        raise ValueError(f"is {what}, expected a 16-bit grey depth image")
    if not 0 < width * height * 2 <= size * DEFLATE_RATIO:
        raise ValueError(f"is damaged or cut off: {width:,} x {height:,} pixels expected, {size:,} bytes found")


def _size_of(head: bytes, path: Path) -> tuple[int, int, np.dtype[Any]]:
    width, height = (int.from_bytes(head[IHDR][k : k + 4], "big") for k in (0, 4))
    return height, width, np.dtype(np.uint16)


def _array(path: Path) -> tuple[int, int, np.dtype[Any]]:
    try:
        pixels = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # NumPy evaluates the header as Python literals, which can raise anything
        raise ValueError(f"is damaged or cut off: {error}") from error
    height, width = pixels.shape
    return height, width, pixels.dtype


def _read_png(path: Path) -> NDArray[Any]:
    from PIL import Image

    try:
        with warnings.catch_warnings(), Image.open(path, formats=["PNG"]) as image:
            warnings.simplefilter("ignore")  # about images with many pixels; _check_png has compared them with the size
            pixels = np.asarray(image)
    except Exception as error:
        raise ValueError(f"is damaged or cut off: {error}") from error
    if pixels.ndim != 2:
        raise ValueError(f"must have one channel: its shape is {pixels.shape}")
    return pixels


FORMAT = Format(
    "Depth image",
    (".png", ".npy"),
    recognise,
    DepthSource,
    {
        "positions": "one point per pixel, with --intrinsics fx,fy,cx,cy and optionally the depth steps per unit "
        "(default 1000 for integers, 1 for floats): x right, y down, z forward; 0, NaN and infinity are skipped",
        "normals": "none",
        "colors": "none",
        "attributes": "none",
        "survey": "the camera position, 0, 0, 0, as the scanner",
        "note": "16-bit grey PNG, or an array with more than 16 rows and columns",
    },
)
