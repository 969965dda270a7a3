"""Writing of OpenEXR files: linear values in named channels."""

from __future__ import annotations

import errno
import struct
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ..base.extras import require

# Channel names by convention: colour and Z of the file itself, others as layer.component.
CHANNELS = {
    "radiance": ("R", "G", "B", "A"),
    "depth": ("Z",),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "position": ("position.X", "position.Y", "position.Z"),
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "instance": ("instance",),
    "point": ("point",),
}
NO_INDEX = 2**32 - 1  # -1 as uint32
LINES = 16  # lines of a ZIP-compressed chunk


def check_exr(path: Path) -> None:
    """Raise ImportError, with instructions, if the package that `write_exr` needs is not installed."""
    require("OpenEXR", "files", str(path))


def channels_of(layers: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Convert the layers of an image to the channels of an EXR, (h, w) float32 or uint32, such as "normal.X".

    layers : (h, w) or (h, w, k), by the names in CHANNELS; ValueError for another name or number of channels
    """
    channels = {}
    for name, values in layers.items():
        names = CHANNELS.get(name)
        if names is None:
            raise ValueError(f"unsupported layer {name!r} for EXR: expected one of {', '.join(CHANNELS)}")
        planes = values.reshape(*values.shape[:2], -1)
        if planes.shape[2] not in {len(names), len(names[:3])}:  # radiance may lack alpha
            raise ValueError(f"layer {name!r} must have {len(names)} channels in an EXR, not {planes.shape[2]}")
        for k in range(planes.shape[2]):
            channels[names[k]] = _number(planes[..., k], name)
    return channels


def _number(plane: NDArray[Any], name: str) -> NDArray[Any]:
    """Convert a channel, (h, w), to float32, or integers to uint32, as float32 is inexact above 2^24.

    -1 becomes 2^32 - 1. name : of its layer, for the message if integers are out of range
    """
    if plane.dtype.kind == "f":
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(plane, np.float32)
    if plane.min() < -1 or plane.max() >= NO_INDEX:
        raise ValueError(f"layer {name!r}: EXR supports whole numbers from -1 to {NO_INDEX - 1}; write an NPZ instead")
    out = np.empty(plane.shape, np.uint32)
    for row, numbers in zip(out, plane, strict=True):  # a row at a time, to save memory
        row[:] = numbers.astype(np.int64) & NO_INDEX
    return out


def write_exr(path: Path, channels: dict[str, NDArray[Any]]) -> None:
    """Write channels, (h, w) float32 or uint32, to a single-part EXR with lossless ZIP compression."""
    exr = require("OpenEXR", "files", str(path))
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    try:
        with exr.File(header, channels) as file:
            file.write(str(path))
    except RuntimeError as error:  # the library's only error, such as for a full disk
        raise OSError(errno.EIO, str(error), str(path)) from error
    _check_whole(path)


def _check_whole(path: Path) -> None:
    """Raise OSError if an EXR is truncated, as the library does not report errors on closing.

    After the header a table lists the offsets of chunks of lines; a chunk begins with its first line and its size.
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
    raise OSError(errno.EIO, "the EXR is incomplete: is the disk full?", str(path))


def _text(file: IO[bytes]) -> bytes:
    """Read a zero-terminated string, and return it without the zero."""
    return b"".join(iter(lambda: file.read(1).rstrip(b"\0"), b""))
