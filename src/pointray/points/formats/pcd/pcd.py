"""PCD files of the Point Cloud Library and of Open3D, versions 0.5 to 0.7: ascii, binary, packed.

VIEWPOINT does not move the points: PCL's readers hand it on beside them, and its normals are turned to it, as if it lay
in the points' coordinates; Open3D does not look at it. It becomes a station.
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

from ....survey import Survey
from .._named_columns import Columns, Roles, roles_of
from .._source import CHUNK, NO, SURE, Chunk, Format, Listing, Request, Source
from ._header import PADDING, Field, Header, read_header

CHUNK_BYTES = 1 << 25  # of rows that are read together, if they are long
PACKED_COLORS = ("rgb", "rgba")
SPARE = 1 << 13  # zeros that old versions of PCL leave behind the data, at most
FIRST = re.compile(rb"(\s*#[^\n]*\n)*\s*(VERSION|FIELDS|COLUMNS)[ \t]")


def recognise(head: bytes, path: Path) -> int:
    """Whether a file is a PCD file."""
    return SURE if re.match(rb"#\s*\.PCD\b", head) or (FIRST.match(head) and b"FIELDS" in head) else NO


class PcdSource(Source):
    """A PCD file; ValueError says what is wrong with its contents."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path = path
        with path.open("rb") as file:
            self._header = header = read_header(file)
            file.seek(header.size)
            _check_size(file, header)
        self._packed = next((name for name in PACKED_COLORS if _is_packed(header, name)), "")
        self._roles = _roles(header, self._packed)
        survey = Survey(stations=() if header.station is None else (header.station,))
        facts: dict[str, Any] = {"version": header.version, "encoding": header.encoding}
        if header.shape[1] > 1:
            facts["organised"] = f"{header.shape[0]} x {header.shape[1]}"
        self.listing = Listing(header.points, 36 + header.row, survey=survey, facts=facts)

    def chunks(self) -> Iterator[Chunk]:
        header = self._header
        read = {"ascii": _read_ascii, "binary": _read_binary, "binary_compressed": _read_packed}[header.encoding]
        done = 0
        with self._path.open("rb") as file:
            file.seek(header.size)
            for columns in read(file, header, self._packed):
                if self._packed:
                    columns[self._packed] = _unpacked_colors(columns[self._packed])
                done += len(next(iter(columns.values())))
                yield self._roles.chunk(columns, done / header.points)


def _is_packed(header: Header, name: str) -> bool:
    return any(f.name == name and f.width == 1 and f.dtype.itemsize == 4 for f in header.fields)


def _roles(header: Header, packed: str) -> Roles:
    types = {f.name: (f.dtype, 0 if f.width == 1 else f.width) for f in header.kept}
    return roles_of({name: (np.dtype("u1"), 3) if name == packed else type for name, type in types.items()})


def _check_size(file: BinaryIO, header: Header) -> None:
    """Check the header's count against the file's size, as a header may state anything."""
    left = os.fstat(file.fileno()).st_size - header.size
    row = header.row
    if header.encoding == "ascii":
        row = 2 * sum(field.width for field in header.fields)  # a digit and a space, but for the file's last
        left += 1
    if header.encoding != "binary_compressed" and header.points * row > left:
        raise ValueError(
            f"is cut off: {header.points:,} points of {row} bytes or more are announced, {left:,} bytes are there"
        )


def _check_end(file: BinaryIO, what: str) -> None:
    """ValueError if there are more data than announced; zeros are none."""
    at = file.tell()
    left = os.fstat(file.fileno()).st_size - at
    rest = file.read(SPARE)
    if left > SPARE or rest.strip(b"\0\r\n"):
        raise ValueError(f"goes on for {left:,} bytes at byte {at:,}, where {what} should end: its count is wrong")


def _steps(header: Header) -> Iterator[int]:
    """The number of rows of each chunk."""
    step = max(min(CHUNK, CHUNK_BYTES // header.row), 1)
    for start in range(0, header.points, step):
        yield min(step, header.points - start)


# ----------------------------------------------------------------------------------------------------- binary


def _layout(fields: Sequence[Field], wide: str = "") -> np.dtype[Any]:
    """A row's type; padding gets names of its own. wide : a field to read as float64 if it is of floats"""
    names = [f"{PADDING}{k}{PADDING}" if field.name == PADDING else field.name for k, field in enumerate(fields)]
    types = [np.dtype(np.float64) if f.name == wide and f.dtype.kind == "f" else f.dtype for f in fields]
    counts: list[Any] = [() if field.width == 1 else (field.width,) for field in fields]
    return np.dtype(list(zip(names, types, counts, strict=True)))


def _kept(rows: NDArray[Any], header: Header) -> Columns:
    return {field.name: rows[field.name] for field in header.kept}


def _read_binary(file: BinaryIO, header: Header, packed: str) -> Iterator[Columns]:
    dtype, done = _layout(header.fields), 0
    for count in _steps(header):
        rows = np.fromfile(file, dtype, count)
        done += len(rows)
        if len(rows) < count:
            raise ValueError(f"is cut off at point {done:,} of {header.points:,}")
        yield _kept(rows, header)
    _check_end(file, "its last point")


def _read_packed(file: BinaryIO, header: Header, packed: str) -> Iterator[Columns]:
    """Columns lie one after the other in the unpacked data."""
    from ._lzf import unpack

    left = os.fstat(file.fileno()).st_size - header.size - 8
    if left < 0:
        raise ValueError(f"is cut off at byte {header.size:,}, in the sizes of the packed data")
    stored, size = (int(number) for number in np.fromfile(file, "<u4", 2))
    if stored > left:
        raise ValueError(f"is cut off: {stored:,} bytes of packed data are announced, {left:,} bytes are there")
    # PCL leaves padding out, though the header may list it.
    fields = header.fields if size == header.points * header.row else header.kept
    if size != header.points * sum(field.size for field in fields):
        raise ValueError(
            f"is damaged at byte {header.size + 4:,}: {size:,} unpacked bytes are announced, "
            f"{header.points:,} points of {header.row} bytes need {header.points * header.row:,}"
        )
    data = unpack(np.fromfile(file, np.uint8, stored), size, header.size + 8)
    _check_end(file, "its packed data")
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


def _read_ascii(file: BinaryIO, header: Header, packed: str) -> Iterator[Columns]:
    dtype = _layout(header.fields, packed)  # a packed colour may be written as a whole number: float32 would round it
    lines = Lines(io.TextIOWrapper(file, "latin-1", newline="\n"), header.lines)
    try:
        done = 0
        for count in _steps(header):
            rows = _read_lines(lines, dtype, count)
            done += len(rows)
            if len(rows) < count:
                raise ValueError(f"is cut off: {header.points:,} points are announced, {done:,} are there")
            yield _kept(rows, header)
        if any(line.strip() for line in lines):
            raise ValueError(f"line {lines.number:,}: there are more points than the {header.points:,} announced")
    finally:
        lines.stream.detach()


class Lines:
    """The lines of a text, counted. number : that of the line that was read last"""

    def __init__(self, stream: io.TextIOWrapper, number: int) -> None:
        self.stream, self.number = stream, number

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        line = next(self.stream)
        self.number += 1
        return line


def _read_lines(lines: Lines, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
    """The next `count` lines that are not blank, (count or fewer,) of a structured dtype."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # loadtxt warns of no rows, and of floats that it takes for whole numbers
        try:
            return np.loadtxt(lines, dtype, comments=None, max_rows=count, ndmin=1)
        except (ValueError, DeprecationWarning, OverflowError) as error:
            what = re.sub(r";? (at row|use `usecols`).*", "", str(error))
            raise ValueError(f"line {lines.number:,}: {what}") from error


def _unpacked_colors(packed: NDArray[Any]) -> NDArray[np.uint8]:
    """(m, 3) uint8 of packed colours: bits 0xAARRGGBB, as a whole number or as the bits of a float32.

    Some programs write the whole number as a float: as bits these would be colours with alphas of 63 to 79.
    """
    if packed.dtype.kind == "f":
        numbers = (packed >= 1) & (packed < 2**32)
        with np.errstate(over="ignore"):
            bits = packed.astype(np.float32).view(np.uint32)
        bits[numbers] = packed[numbers].astype(np.uint32)
    else:
        bits = packed.astype(np.uint32)
    return np.stack([(bits >> shift) & 255 for shift in (16, 8, 0)], axis=1).astype(np.uint8)


FORMAT = Format(
    "PCD",
    (".pcd",),
    recognise,
    PcdSource,
    {
        "positions": "x, y, z",
        "normals": "normal_x, normal_y, normal_z or nx, ny, nz",
        "colors": "rgb or rgba, packed in a number; r, g, b or red, green, blue",
        "attributes": "all other fields but padding, with their types",
        "survey": "the viewpoint, as where the scanner stood",
        "note": "rows without a return (NaN) are kept",
    },
)
