"""NPY files: one NumPy array, with or without column names."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.progress import Progress, report_progress
from ....cloud.georeference import RESIDUAL
from ....cloud.points import Points
from .._counts import missing
from .._named_columns import CHANNELS, NORMAL_AXES, Columns, roles_of
from .._source import MAYBE, NO, SURE, Chunk, Faults, Format, Listing, Request, Source
from .._unnamed_columns import recognise_array_columns
from .._world import is_float64, world_rows
from . import _array
from ._array import Header


def recognise(head: bytes, path: Path) -> int:
    """Detect NPY files: return `SURE`, `MAYBE` if the array may be a depth image, or `NO`.

    head : first bytes of the file
    """
    if not head.startswith(_array.MAGIC):
        return NO
    try:
        header = _array.read_header(_Head(head))
    except ValueError:
        return SURE  # opening it raises the error
    return MAYBE if not header.dtype.fields and header.width > _array.MOST_COLUMNS else SURE


class _Head:
    """Stream over the first bytes of a file, from which a header is read."""

    def __init__(self, head: bytes) -> None:
        self._rest = head

    def read(self, size: int = -1, /) -> bytes:
        taken, self._rest = self._rest[:size], self._rest[size:]
        return taken


class NpySource(Source):
    """Reader of NPY files: each row of an array, or each item of a structured array, is a point."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path, self.faults = path, Faults(request.strict)
        with path.open("rb") as file:
            header = _array.read_header(file)
            left = os.fstat(file.fileno()).st_size - header.size
        if not header.dtype.hasobject and header.nbytes != left:
            header = _fitted(header, left, self.faults)
        self._header = header
        self._names = request.columns
        if header.dtype.fields:
            self._roles = roles_of(_array.fields_of(header))
        else:
            _array.check_table(header, request.columns)
        if not header.rows:
            raise ValueError("contains no points: its array has no rows")
        facts = {"type": str(header.dtype)} if not header.dtype.fields else {}
        self._step = _array.step_of(header.nbytes // header.rows)
        self.listing = Listing(header.rows, 36 + header.nbytes // header.rows, facts=facts)

    def chunks(self) -> Iterator[Chunk]:
        done = 0
        for block in self._blocks():
            done += len(block)
            yield self._to_chunk(block, done / self._header.rows)

    def _blocks(self) -> Iterator[NDArray[Any]]:
        with self._path.open("rb") as file:
            file.seek(self._header.size)
            yield from _array.blocks_of(file, self._header, self._step)

    def _to_chunk(self, block: NDArray[Any], share: float) -> Chunk:
        if self._header.dtype.fields:
            return self._roles.chunk({name: block[name] for name in block.dtype.names or ()}, share)
        if self._names is None:
            names, self.note = recognise_array_columns(self._blocks, self._header.width)
            self._names = tuple(names)
        return table_chunk(block, self._names, share)


def _fitted(header: Header, left: int, faults: Faults) -> Header:
    """Return the header with the number of rows that the file has; record the difference in `faults`.

    Raise ValueError if no row is complete, or an array in Fortran order is cut off.

    left : bytes of the file after the header
    """
    cut = header.nbytes > left
    message = f"{header.nbytes:,} bytes of {header.shape} expected, {left:,} found"
    if not cut:
        faults.add(f"has more bytes after its array: {message}")
        return header
    rows = left // (header.nbytes // header.rows)
    if header.fortran or not rows:
        raise ValueError(f"is cut off: {message}")
    faults.add(f"is cut off: {message}: {missing(header.rows, rows)}")
    return header._replace(shape=(rows, *header.shape[-1:]) if len(header.shape) > 1 else (rows,))


def table_chunk(block: NDArray[Any], names: tuple[str, ...], share: float) -> Chunk:
    """Return an (m, k) block as a chunk: its columns by `names`, without those named "-".

    share : fraction of the file read so far
    """
    columns: Columns = {name: block[:, k] for k, name in enumerate(names) if name != "-"}
    roles = roles_of(dict.fromkeys(columns, (block.dtype, 0)))
    return roles.chunk(columns, share)


# ----------------------------------------------------------------------------------------------------- writing


def write(file: Any, points: Points, progress: Progress | None = None) -> list[str]:
    """Write all data of the points to a stream as a structured array; return what it cannot store, in words."""
    float64 = is_float64(points)
    fields: list[tuple[Any, ...]] = [(name, "<f8" if float64 else "<f4") for name in "xyz"]
    if points.normals is not None:
        fields += [(name, "<f4") for name in NORMAL_AXES[0]]
    if points.colors is not None:
        fields += [(name, "u1") for name in CHANNELS[0]]
    attributes = {name: values for name, values in points.attributes.items() if name != RESIDUAL or not float64}
    _check_names(attributes, {field[0] for field in fields})
    fields += [(name, values.dtype.newbyteorder("<"), values.shape[1:]) for name, values in attributes.items()]
    dtype = np.dtype(fields)
    file.write(_header_of(dtype, len(points)))
    for start in range(0, len(points), _array.step_of(dtype.itemsize)):
        part = slice(start, start + _array.step_of(dtype.itemsize))
        file.write(_rows(points, attributes, dtype, part).data)
        report_progress(progress, min(part.stop / len(points), 1.0))
    return _lost(points)


def _rows(points: Points, attributes: Mapping[str, NDArray[Any]], dtype: np.dtype[Any], part: slice) -> NDArray[Any]:
    out = np.empty(len(points.positions[part]), dtype)
    normals, colors = (None if a is None else a[part] for a in (points.normals, points.colors))
    for names, values in (("xyz", world_rows(points, part)), (NORMAL_AXES[0], normals), (CHANNELS[0], colors)):
        for name, column in zip(names, () if values is None else values.T, strict=values is not None):
            out[name] = column
    for name, values in attributes.items():
        out[name] = values[part]
    return out


def _check_names(attributes: Mapping[str, NDArray[Any]], taken: set[str]) -> None:
    lower = {name.lower() for name in taken}
    for name in attributes:
        if name.lower() in lower:
            raise ValueError(f"an NPY file cannot store an attribute named {name!r}: the name is reserved")


def _header_of(dtype: np.dtype[Any], count: int) -> bytes:
    """Return the header of a structured array with `count` rows, version 3.0, which allows names in Unicode."""
    descr = np.lib.format.dtype_to_descr(dtype)
    text = repr({"descr": descr, "fortran_order": False, "shape": (count,)}).encode("utf-8", "strict")
    text += b" " * (-(12 + len(text) + 1) % 64) + b"\n"
    return _array.MAGIC + bytes((3, 0)) + len(text).to_bytes(4, "little") + text


def _lost(points: Points) -> list[str]:
    georeference = points.georeference
    held = {
        "the coordinate system": georeference.crs,
        "the unit": georeference.unit,
        "scale and offset": georeference.scale,
        "the scanner positions": georeference.stations,
    }
    return [f"cannot store {what}" for what, value in held.items() if value]


FORMAT = Format(
    "NPY",
    (".npy",),
    recognise,
    NpySource,
    {
        "positions": "the first three columns, or the fields x, y, z",
        "normals": "fields nx, ny, nz; columns 4 to 6 (or 7 to 9) of unit length",
        "colors": "fields r, g, b or red, green, blue; columns 4 to 6 (or 7 to 9) from 0 to 1, or integers to 255",
        "attributes": "all other columns, with their types; unnamed ones as column_4 and so on",
        "survey": "",
        "note": "name the columns with --columns",
    },
    write=write,
)
