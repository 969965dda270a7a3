"""PCD files of the Point Cloud Library and Open3D, versions 0.5 to 0.7: ascii, binary, binary_compressed.

VIEWPOINT does not transform the points: PCL's readers return it separately and orient normals towards it, as if it were
in the coordinates of the points; Open3D ignores it. Here it becomes a station.
"""

from __future__ import annotations

import io
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ....cloud.georeference import Georeference
from .._counts import count_lines, count_mismatch, readable_rows, rows_after, whole_lines
from .._named_columns import Columns, Roles, roles_of
from .._odd_numbers import plain_lines
from .._packed_colors import PackedColors, find_packed
from .._source import CHUNK, NO, SURE, Chunk, Faults, Format, Listing, Request, Source
from ._header import PADDING, Field, Header, read_header
from ._write import write, write_compressed

CHUNK_BYTES = 1 << 25  # maximum bytes of rows read at a time
SPARE = 1 << 13  # maximum number of zeros after the data, as left by old versions of PCL
FIRST = re.compile(rb"(\s*#[^\n]*\n)*\s*(VERSION|FIELDS|COLUMNS)[ \t]")


def recognise(head: bytes, path: Path) -> int:
    """Detect PCD files: return `SURE` or `NO`. head : first bytes of the file"""
    return SURE if re.match(rb"#\s*\.PCD\b", head) or (FIRST.match(head) and b"FIELDS" in head) else NO


class PcdSource(Source):
    """Reader of PCD files."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path, self.faults = path, Faults(request.strict)
        with path.open("rb") as file:
            header = read_header(file, self.faults)
            file.seek(header.size)
            points, self._announced = _most(file, header, self.faults), header.points
            self._packed = find_packed((f.name, f.dtype) for f in header.kept if f.width == 1)
            self._roles = _roles(header, self._packed)
            points += _count_extra(file, header, self.faults)
        self._header = header = header._replace(points=points)
        georeference = Georeference(stations=() if header.station is None else (header.station,))
        facts: dict[str, Any] = {"version": header.version, "encoding": header.encoding}
        if header.shape[1] > 1:
            facts["organised"] = f"{header.shape[0]} x {header.shape[1]}"
        self.listing = Listing(header.points, 36 + header.row, georeference=georeference, facts=facts)

    def chunks(self) -> Iterator[Chunk]:
        header = self._header
        read = {"ascii": _read_ascii, "binary": _read_binary, "binary_compressed": _read_packed}[header.encoding]
        done, colors = 0, PackedColors()
        with self._path.open("rb") as file:
            file.seek(header.size)
            for columns in read(file, header, self._packed, self.faults):
                if self._packed:
                    columns[self._packed] = colors.unpack(columns[self._packed])
                done += len(next(iter(columns.values())))
                yield self._roles.chunk(columns, done / header.points)
        self.note = colors.note
        if header.encoding == "ascii" and done != self._announced:
            what = "" if done > self._announced else "is cut off: "
            self.faults.add(f"{what}{count_mismatch(self._announced, done, 'points')}")


def _roles(header: Header, packed: str) -> Roles:
    types = {f.name: (f.dtype, 0 if f.width == 1 else f.width) for f in header.kept}
    return roles_of({name: (np.dtype("u1"), 3) if name == packed else type for name, type in types.items()})


def _most(file: BinaryIO, header: Header, faults: Faults) -> int:
    """Return the maximum number of points in the file; fewer than announced are recorded in `faults`."""
    left, points, row = os.fstat(file.fileno()).st_size - header.size, header.points, header.row
    if row == 0:
        return points
    if header.encoding == "binary_compressed":
        return _packed_points(file, header, faults)
    if header.encoding == "ascii":
        row = 2 * sum(field.width for field in header.fields)  # digit and separator; the last line may lack a newline
        return readable_rows(points, row, left + 1, "points", faults) if faults.strict else max(count_lines(file), 1)
    return readable_rows(points, row, left, "points", faults)


def _count_extra(file: BinaryIO, header: Header, faults: Faults) -> int:
    """Return the number of points after the announced ones of a binary file, which are recorded in `faults`."""
    at = header.size + header.points * header.row
    if header.encoding != "binary" or not _check_end(file, at, "its last point", faults):
        return 0
    return rows_after(file, at, os.fstat(file.fileno()).st_size, header.row)


def _packed_points(file: BinaryIO, header: Header, faults: Faults) -> int:
    """Return the number of points in compressed data, from their size.

    A number other than announced is recorded in `faults`. Raise ValueError if the size is not that of whole points.
    """
    sizes = np.fromfile(file, "<u4", 2)
    size = int(sizes[-1]) if len(sizes) == 2 else 0
    if size in (header.points * header.row, header.points * sum(field.size for field in header.kept)):
        return header.points
    message = (
        f"is damaged at byte {header.size + 4:,}: {size:,} decompressed bytes announced, but "
        f"{header.points:,} points of {header.row} bytes need {header.points * header.row:,}"
    )
    if len(sizes) < 2:
        message = f"is cut off at byte {header.size:,}, in the sizes of the compressed data"
    if size == 0 or size % header.row:
        raise ValueError(message)
    faults.add(f"{message}: {size // header.row:,} points found")
    return size // header.row


def _check_end(file: BinaryIO, at: int, what: str, faults: Faults) -> bool:
    """Whether the file continues after byte `at`, where it should end. Zeros are ignored; other bytes are a fault.

    what : what should end there, for the message; faults : records it
    """
    left = os.fstat(file.fileno()).st_size - at
    if left <= 0:
        return False
    file.seek(at)
    more = left > SPARE or file.read(SPARE).strip(b"\0\r\n") != b""
    if more:
        faults.add(f"has {left:,} more bytes at byte {at:,}, where {what} should end: the count is wrong")
    return more


def _steps(header: Header) -> Iterator[int]:
    """Yield the number of rows of each chunk: at most 2^18 rows and 32 MiB."""
    step = max(min(CHUNK, CHUNK_BYTES // header.row), 1)
    for start in range(0, header.points, step):
        yield min(step, header.points - start)


# ----------------------------------------------------------------------------------------------------- binary


def _layout(fields: Sequence[Field], wide: str = "") -> np.dtype[Any]:
    """Return the structured dtype of a row, with unique names for padding.

    wide : name of a float field to read as float64, or ""
    """
    names = [f"{PADDING}{k}{PADDING}" if field.name == PADDING else field.name for k, field in enumerate(fields)]
    types = [np.dtype(np.float64) if f.name == wide and f.dtype.kind == "f" else f.dtype for f in fields]
    counts: list[Any] = [() if field.width == 1 else (field.width,) for field in fields]
    return np.dtype(list(zip(names, types, counts, strict=True)))


def _kept(rows: NDArray[Any], header: Header) -> Columns:
    return {field.name: rows[field.name] for field in header.kept}


def _read_binary(file: BinaryIO, header: Header, packed: str, faults: Faults) -> Iterator[Columns]:
    dtype, done = _layout(header.fields), 0
    for count in _steps(header):
        rows = np.fromfile(file, dtype, count)
        done += len(rows)
        if len(rows) < count:
            raise ValueError(f"is cut off at point {done:,} of {header.points:,}")
        yield _kept(rows, header)


def _read_packed(file: BinaryIO, header: Header, packed: str, faults: Faults) -> Iterator[Columns]:
    """Yield the fields other than padding by name, in chunks of rows, after decompressing the whole file.

    The decompressed data are stored field by field. `packed` is not used: all encodings have the same signature.
    """
    from ._lzf import unpack

    left = os.fstat(file.fileno()).st_size - header.size - 8
    stored, size = (int(number) for number in np.fromfile(file, "<u4", 2))
    if stored > left:
        raise ValueError(f"is cut off: {stored:,} bytes of compressed data expected, {left:,} bytes found")
    # PCL omits padding from the data, although the header may list it.
    fields = header.fields if size == header.points * header.row else header.kept
    data = unpack(np.fromfile(file, np.uint8, stored), size, header.size + 8)
    _check_end(file, header.size + 8 + stored, "its compressed data", faults)
    columns: Columns = {}
    start = 0
    for field in fields:
        end = start + header.points * field.size
        column = data[start:end].view(field.dtype)
        columns[field.name] = column if field.width == 1 else column.reshape(-1, field.width)
        start = end
    columns.pop(PADDING, None)
    start = 0
    for count in _steps(header):
        yield {name: column[start : start + count] for name, column in columns.items()}
        start += count


# ------------------------------------------------------------------------------------------------------- ascii


def _read_ascii(file: BinaryIO, header: Header, packed: str, faults: Faults) -> Iterator[Columns]:
    dtype = _layout(header.fields, packed)  # float32 would round packed colours written as integers
    text = io.TextIOWrapper(file, "latin-1", newline="\n")
    lines = Lines(whole_lines(text, sum(field.width for field in header.fields), faults), header.lines)
    try:
        for count in _steps(header):
            rows = _read_lines(lines, dtype, count)
            if len(rows):
                yield _kept(rows, header)
            if len(rows) < count:
                break
        if any(line.strip() for line in lines):
            raise ValueError(f"line {lines.number:,}: more points follow than the {header.points:,} announced")
    finally:
        text.detach()


class Lines:
    """Iterator over the lines of a text, which counts them. number : line read last, from 1"""

    def __init__(self, lines: Iterator[str], number: int) -> None:
        self._lines, self.number = lines, number

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        line = next(self._lines)
        self.number += 1
        return line


def _read_lines(lines: Lines, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
    """Read the next `count` nonblank lines, or fewer at the end, as (n,) of a structured dtype."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # loadtxt warns of missing rows, and of floats converted to integers
        try:
            return np.loadtxt(plain_lines(lines), dtype, comments=None, max_rows=count, ndmin=1)
        except (ValueError, DeprecationWarning, OverflowError) as error:
            what = re.sub(r";? (at row|use `usecols`).*", "", str(error))
            raise ValueError(f"line {lines.number:,}: {what}") from error


FORMAT = Format(
    "PCD",
    (".pcd",),
    recognise,
    PcdSource,
    {
        "positions": "x, y, z",
        "normals": "normal_x, normal_y, normal_z or nx, ny, nz",
        "colors": "rgb or rgba, packed in one number; r, g, b or red, green, blue",
        "attributes": "all other fields except padding, with their types",
        "survey": "the viewpoint, as the scanner position",
        "note": "rows without a return (NaN) are kept; written as binary; with --compressed, or compressed=True, as "
        "binary_compressed (pip install 'pointray[pcd]'); x, y, z are float64 if the coordinates are large, which "
        "PCL cannot read",
    },
    write=write,
    write_compressed=write_compressed,
)
