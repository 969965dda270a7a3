"""Writer for PCD: binary, as PCL and Open3D write it, or binary_compressed.

Positions are float32 unless the cloud has an origin; then they are float64, which Open3D and pypcd4 read as well. PCL
reads x, y, z only as float32.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.extras import require
from ....base.progress import Progress, report_progress
from ....cloud.geographic import in_file
from ....cloud.georeference import RESIDUAL
from ....cloud.points import Points
from .._losses import Losses, georeference_losses, separate_columns, unused_name
from .._named_columns import CHANNELS, NORMAL_AXES, names_with_roles
from .._source import CHUNK
from .._world import is_float64, world_rows

RESERVED = {"x", "y", "z", "_", "rgb", "rgba"}
NORMALS = ("normal_x", "normal_y", "normal_z")
KINDS = {"i": "I", "u": "U", "f": "F", "b": "U"}
MOST = 2**31 - 1  # numbers of a field for a point
LARGEST = 2**32 - 1  # bytes of compressed data: its size is a 32-bit number
BLOCK = 1 << 20  # bytes compressed at a time
LITERALS = 32  # largest run of bytes that are not compressed


class Column(NamedTuple):
    """A field of the file: its name, the dtype of its values, and their number per point."""

    name: str
    dtype: np.dtype[Any]
    width: int
    values: NDArray[Any] | None = None  # None: positions, of which it is one axis


def write(file: Any, points: Points, progress: Progress | None = None) -> Losses:
    """Write all data of the points to a stream as binary PCD; return what PCD cannot store, in words."""
    losses: Losses = []
    columns = _columns_of(points, losses)
    file.write(_header_of(columns, points, "binary", losses))
    types = [(c.name, c.dtype, () if c.width == 1 else (c.width,)) for c in columns]
    for start in range(0, len(points), CHUNK):
        part = slice(start, min(start + CHUNK, len(points)))
        rows = np.empty(part.stop - start, np.dtype(types))
        for column, values in zip(columns, _values_of(points, columns, part), strict=True):
            rows[column.name] = values
        file.write(rows.data)
        report_progress(progress, part.stop / len(points))
    return losses


def write_compressed(file: Any, points: Points, progress: Progress | None = None) -> Losses:
    """Write all data of the points as binary_compressed PCD, which stores field after field."""
    lzf, losses = require("lzf", "pcd", "compressed PCD"), Losses()
    columns = _columns_of(points, losses)
    size = len(points) * sum(c.dtype.itemsize * c.width for c in columns)
    _check_size(size)
    file.write(_header_of(columns, points, "binary_compressed", losses))
    start = file.tell()
    file.write(bytes(8))
    for k, column in enumerate(columns):
        for begin in range(0, len(points), CHUNK):
            part = slice(begin, min(begin + CHUNK, len(points)))
            (values,) = _values_of(points, [column], part, k)
            data = np.ascontiguousarray(values, column.dtype).tobytes()
            for at in range(0, len(data), BLOCK):
                file.write(_packed(lzf, data[at : at + BLOCK]))
            _check_size(file.tell() - start - 8)  # bytes that cannot be compressed grow by 1/32
            report_progress(progress, (k + part.stop / len(points)) / len(columns))
    end = file.tell()
    file.seek(start)
    file.write(np.array([end - start - 8, size], "<u4").tobytes())
    file.seek(end)
    return losses


def _check_size(size: int) -> None:
    if size > LARGEST:
        raise ValueError(
            f"cannot be compressed: {size:,} bytes of points, a compressed PCD file has at most {LARGEST:,}"
        )


def _packed(lzf: Any, data: bytes) -> bytes:
    """Compress bytes by LZF; those that do not become smaller are stored as runs of literals."""
    packed = lzf.compress(data) if len(data) > 4 else None
    if packed is not None:
        return bytes(packed)
    whole = len(data) // LITERALS * LITERALS
    rows = np.empty((whole // LITERALS, LITERALS + 1), np.uint8)
    rows[:, 0] = LITERALS - 1
    rows[:, 1:] = np.frombuffer(data, np.uint8, whole).reshape(-1, LITERALS)
    rest = data[whole:]
    return rows.tobytes() + (bytes([len(rest) - 1]) + rest if rest else b"")


def _columns_of(points: Points, losses: Losses) -> list[Column]:
    float64 = is_float64(points)
    real = np.dtype("<f8" if float64 else "<f4")
    columns = [Column(name, real, 1) for name in "xyz"]
    if points.normals is not None:  # in the type of the positions: Open3D reads others wrongly
        columns += [Column(name, real, 1, points.normals[:, k]) for k, name in enumerate(NORMALS)]
    if points.colors is not None:
        columns.append(Column("rgb", np.dtype("<f4"), 1, points.colors))
    kept = {name: values for name, values in points.attributes.items() if name != RESIDUAL or not float64}
    widths = {_plain(name): 1 if values.ndim == 1 else values.shape[1] for name, values in kept.items()}
    special = names_with_roles(widths, (*NORMAL_AXES, *CHANNELS))
    taken = RESERVED | set(NORMALS) | {name.lower() for name in special}
    for name, array in kept.items():
        for title, values in separate_columns(name, array, losses, MOST).items():
            width = 1 if values.ndim == 1 else values.shape[1]
            dtype = np.dtype("u1") if values.dtype == np.bool_ else values.dtype.newbyteorder("<")
            columns.append(Column(unused_name(_plain(title), taken, losses, "the field", title), dtype, width, values))
    return columns


def _plain(name: str) -> str:
    """Return the name of an attribute with the characters that a name of a field can have."""
    return re.sub(r"[^!-~]+", "_", name)


def _values_of(points: Points, columns: list[Column], part: slice, first: int = 0) -> Iterator[NDArray[Any]]:
    """Yield the values of some columns in a range of rows. first : index of the first of these columns"""
    world = world_rows(points, part) if columns[0].values is None else None
    for k, column in enumerate(columns, first):
        if world is not None and column.values is None:
            yield world[:, k]
        elif column.values is not None and column.name == "rgb":
            red, green, blue = column.values[part].T.astype(np.uint32)
            yield (red << 16 | green << 8 | blue).view(np.float32)
        elif column.values is not None:
            values = column.values[part]
            yield values[:, 0] if values.ndim > 1 and column.width == 1 else values


def _header_of(columns: list[Column], points: Points, encoding: str, losses: Losses) -> bytes:
    """Return the header; append to `losses` what the file cannot store of the georeference."""
    known = points.georeference
    is_single = len(known.stations) == 1
    losses += georeference_losses(points, ("stations",) if is_single else ())
    station = in_file(known, np.array(known.stations[:1] if is_single else [(0.0, 0.0, 0.0)]))[0].tolist()
    turn = "-1 0 0 0" if is_single and not any(station) else "1 0 0 0"  # 0 0 0 1 0 0 0: unknown, the default
    lines = {
        "VERSION": "0.7",
        "FIELDS": " ".join(c.name for c in columns),
        "SIZE": " ".join(str(c.dtype.itemsize) for c in columns),
        "TYPE": " ".join(KINDS[c.dtype.kind] for c in columns),
        "COUNT": " ".join(str(c.width) for c in columns),
        "WIDTH": str(len(points)),
        "HEIGHT": "1",
        "VIEWPOINT": f"{' '.join(map(repr, station))} {turn}",
        "POINTS": str(len(points)),
        "DATA": encoding,
    }
    text = "".join(f"{word} {value}\n" for word, value in lines.items())
    return f"# .PCD v0.7 - Point Cloud Data file format\n{text}".encode("ascii")
