"""Writer for binary PLY."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.progress import Progress, report_progress
from ....cloud.geographic import in_file
from ....cloud.points import Points
from .._source import CHUNK
from ._header import NAMES
from ._names import COLORS, NORMALS

Columns = dict[str, NDArray[Any]]


def write(file: Any, points: Points, progress: Progress | None = None) -> list[str]:
    """Write all data of the points to a stream as binary little-endian PLY; return what PLY cannot store, in words."""
    columns: Columns = {}
    _add(columns, "xyz", points.positions)
    if points.normals is not None:
        _add(columns, NORMALS[0], points.normals)
    if points.colors is not None:
        _add(columns, COLORS[0], points.colors)
    losses: list[str] = []
    for name, values in points.attributes.items():
        flat = _fitting(values, name, losses).reshape(len(points), -1)
        _add(columns, [name] if values.ndim == 1 else [f"{name}_{i}" for i in range(flat.shape[1])], flat)
    dtype = np.dtype([(name, column.dtype) for name, column in columns.items()])
    moved = bool(points.origin.any()) or points.georeference.projection is not None
    if moved:
        dtype = np.dtype([(n, np.float64 if n in ("x", "y", "z") else dtype[n]) for n in columns])
    comments = [f"comment crs {' '.join(points.crs.split())}"] if points.crs else []
    if not all(map(str.isascii, comments)):
        raise ValueError("a PLY file cannot store a coordinate system whose description is not ASCII")
    if points.georeference.stations and len(points.georeference.stations) > 0:
        losses.append("cannot store the scanner positions")
    properties = [f"property {NAMES[dtype[name].str[1:]]} {name}" for name in columns]
    header = ["ply", "format binary_little_endian 1.0", *comments, f"element vertex {len(points)}", *properties]
    file.write("\n".join([*header, "end_header", ""]).encode("ascii"))
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        rows = np.empty(len(points.positions[part]), dtype.newbyteorder("<"))
        world = (
            in_file(points.georeference, points.positions[part] + points.origin) if moved else points.positions[part]
        )
        for k, (name, column) in enumerate(columns.items()):
            rows[name] = world[:, k] if k < 3 else column[part]
        file.write(rows.data)
        report_progress(progress, min(part.stop / len(points), 1.0))
    return losses


def _fitting(values: NDArray[Any], name: str, losses: list[str]) -> NDArray[Any]:
    """Convert values of an attribute to a type of PLY, which has neither bool nor 64-bit integers.

    name : of the attribute; losses : receives a note if numbers are rounded
    """
    if values.dtype == np.bool_:
        return values.astype(np.uint8)
    if values.dtype not in (np.int64, np.uint64):
        if values.dtype.str[1:] not in NAMES:
            raise ValueError(f"a PLY file cannot store an attribute of type {values.dtype}: {name!r}")
        return values
    for dtype in (np.int32, np.uint32):
        if len(values) and values.min() >= np.iinfo(dtype).min and values.max() <= np.iinfo(dtype).max:
            return values.astype(dtype)
    floats = values.astype(np.float64)
    if len(values) and (values.max() > 2**53 or values.min() < -(2**53)):
        losses.append(f"stores {name} as 64-bit floats, which round its largest numbers")
    return floats


def _add(columns: Columns, names: Sequence[str], values: NDArray[Any]) -> None:
    for name, column in zip(names, values.T, strict=True):
        if name in columns or not re.fullmatch(r"[!-~]+", name):
            reason = "the name is reserved" if name in columns else "only ASCII without spaces is allowed"
            raise ValueError(f"a PLY file cannot store an attribute named {name!r}: {reason}")
        columns[name] = column
