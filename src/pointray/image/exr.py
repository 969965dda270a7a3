"""OpenEXR: linear numbers as they are, in named channels."""

from __future__ import annotations

import errno
import struct
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ..base.extras import require

# The names other programs look for: colour and Z of the file itself, the rest as layer.component.
CHANNELS = {
    "radiance": ("R", "G", "B", "A"),
    "depth": ("Z",),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "position": ("position.X", "position.Y", "position.Z"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "instance": ("instance",),
    "point": ("point",),
}
NO_INDEX = 2**32 - 1  # what -1 is as uint32
LINES = 16  # that ZIP compresses together


def check_exr(path: Path) -> None:
    """Raise what `write_exr` would raise if its package is absent."""
    require("OpenEXR", "files", str(path))


def channels_of(layers: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Layers, (h, w) or (h, w, k), as channels, (h, w) float32 or uint32, under the names of CHANNELS."""
    channels = {}
    for name, values in layers.items():
        names = CHANNELS.get(name)
        if names is None:
            raise ValueError(f"an EXR has no place for a layer {name!r}; it has for {', '.join(CHANNELS)}")
        planes = values.reshape(*values.shape[:2], -1)
        if planes.shape[2] not in {len(names), len(names[:3])}:  # radiance may be without alpha
            raise ValueError(f"layer {name!r} must have {len(names)} channels in an EXR, not {planes.shape[2]}")
        for k in range(planes.shape[2]):
            channels[names[k]] = _number(planes[..., k], name)
    return channels


def _number(plane: NDArray[Any], name: str) -> NDArray[Any]:
    """One channel as EXR knows it. Whole numbers do not become float32, which has gaps from 2^24: points have more."""
    if plane.dtype.kind == "f":
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(plane, np.float32)
    if plane.min() < -1 or plane.max() >= NO_INDEX:
        raise ValueError(f"layer {name!r}: an EXR holds whole numbers from -1 to {NO_INDEX - 1}, see an NPZ for others")
    out = np.empty(plane.shape, np.uint32)
    for row, numbers in zip(out, plane, strict=True):  # a row at a time: no second copy of all that is wider
        row[:] = numbers.astype(np.int64) & NO_INDEX
    return out


def write_exr(path: Path, channels: dict[str, NDArray[Any]]) -> None:
    """Write channels, (h, w) float32 or uint32, into one part of an EXR, losslessly compressed (ZIP)."""
    exr = require("OpenEXR", "files", str(path))
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    try:
        with exr.File(header, channels) as file:
            file.write(str(path))
    except RuntimeError as error:  # the library's only kind: the disk is full, say
        raise OSError(errno.EIO, str(error), str(path)) from error
    _check_whole(path)


def _check_whole(path: Path) -> None:
    """OSError if an EXR was cut off: the library does not tell what went wrong when it closed the file.

    Behind the header is a table of where chunks of lines begin; each begins with its first line and its size.
    """
    end = path.stat().st_size
    with path.open("rb") as file:
        file.seek(8)  # magic number, version
        height = 0
        while name := _text(file):
            _text(file)  # the attribute's type
            value = file.read(int.from_bytes(file.read(4), "little"))
            if name == b"dataWindow":
                _, low, _, high = struct.unpack("<4i", value.ljust(16, b"\0"))
                height = high - low + 1
        count = -(-height // LINES)
        starts = np.frombuffer(file.read(8 * count).ljust(8 * count, b"\0"), "<u8")
        reached = file.tell()
        for start in starts.tolist():
            if not reached <= start < end:
                break
            file.seek(start + 4)
            reached = start + 8 + int.from_bytes(file.read(4), "little")
        else:
            if count > 0 and reached == end:
                return
    raise OSError(errno.EIO, "the EXR was cut off: is the disk full?", str(path))


def _text(file: IO[bytes]) -> bytes:
    """What stands before the next zero."""
    return b"".join(iter(lambda: file.read(1).rstrip(b"\0"), b""))
