"""Headers of a PTX file: where each scan begins, the announced number of rows, and the number of rows in the file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from .._counts import count_lines
from ._lines import lines_of, shortened

HEADER, SHORT = 1 << 14, 1 << 10  # maximum and usual bytes of the ten lines of a header
LINES = 1 << 22  # bytes read at a time to count lines
MOST_SCANS = 10_000
NO_STATION = "-0 -0 -0"  # position of an unknown scanner, as pointray writes it; other programs read 0 0 0
BEGIN = re.compile(rb"(?<=[\r\n])([ \t]*\d+[ \t]*(\r\n|\r|\n)){2}[ \t]*[-+.\w]+([ \t]+[-+.\w]+){2}[ \t]*[\r\n]")


class Scan(NamedTuple):
    """Contents of the header of a scan.

    Attributes
    ----------
    shape : (2,) tuple of int
        Columns and rows of the grid.
    matrix : (4, 4) tuple of tuple of float
        For row vectors: world = (x, y, z, 1) @ matrix.
    start : int
        Offset of the first row.
    line : int
        Line number of the first row.
    fields : int
        Numbers in the first row: 4, or 7 with colours; 0 if there are no rows.
    rows : int
        Estimated number of rows in the file: `total` if it is complete.
    placed : bool
        Whether the scanner position is known.
    """

    shape: tuple[int, int]
    matrix: tuple[tuple[float, ...], ...]
    start: int
    line: int
    fields: int
    rows: int
    placed: bool = True

    @property
    def total(self) -> int:
        """Announced number of rows, including those without a return."""
        return self.shape[0] * self.shape[1]


@lru_cache(maxsize=8)  # a file is opened twice: for its listing and for reading
def scans_of(path: Path, size: int, time: int, strict: bool) -> tuple[list[Scan], str]:
    """Return the headers of all scans, and the error message of an incomplete last header, or "".

    The rows are skipped by counting newlines: 1 GB takes half a second. A header that is not at the expected place is
    searched for, unless `strict`.

    size, time : size and modification time of the file, as a cache key
    """
    scans: list[Scan] = []
    with path.open("rb") as file:
        newline, offset, line = newline_of(file), 0, 1
        while offset < size or not scans:
            try:
                header = _header(file, offset, line, len(scans) + 1)
            except ValueError as error:
                if strict or not scans:
                    raise
                begin, rows = _next_header(file, scans[-1])
                if begin == offset and _is_complete(file, offset):
                    raise
                if begin == size and _is_single(file, offset):
                    return scans, str(error)
                scans[-1] = scans[-1]._replace(rows=rows)
                if begin == offset:
                    return scans, str(error)
                offset, line = begin, scans[-1].line + rows
                continue
            if header is None:
                break
            if len(scans) == MOST_SCANS:
                raise ValueError(f"has more than {MOST_SCANS:,} scans")
            try:
                offset = _skip_lines(file, header, size, newline, len(scans) + 1)
            except ValueError:
                if strict:
                    raise
                offset, rows = _next_header(file, header)
                header = header._replace(rows=rows)
            scans.append(header)
            line = header.line + header.rows
    if not scans:
        raise ValueError("is not a valid PTX file: header of ten lines not found")
    return scans, ""


def _next_header(file: BinaryIO, scan: Scan) -> tuple[int, int]:
    """Search for the header that follows the rows of `scan`; return its offset and the number of lines of these rows.

    Without a further header the offset is the end of the file.
    """
    offset = end = scan.start - 1  # the newline of the header's last line, which the file may lack
    file.seek(offset)
    tail, found = b"", None
    while found is None and (block := file.read(LINES)):
        text = tail + block
        found = BEGIN.search(text)
        end = offset + (found.start() if found else len(text))
        tail = text[-SHORT:]
        offset += len(text) - len(tail)
    file.seek(scan.start)
    return end, count_lines(file, end)


def _is_single(file: BinaryIO, offset: int) -> bool:
    """Whether the first line after an offset has a single field, like the first line of a header."""
    file.seek(offset)
    lines = lines_of(file.read(HEADER))
    return bool(lines) and len(lines[0][1].split()) == 1


def _is_complete(file: BinaryIO, offset: int) -> bool:
    """Whether the file has enough lines after an offset for a header of ten lines and a row."""
    file.seek(offset)
    return len(lines_of(file.read(HEADER))) > 10


def newline_of(file: BinaryIO) -> bytes:
    file.seek(0)
    return b"\n" if b"\n" in file.read(HEADER) else b"\r"


def _header(file: BinaryIO, offset: int, line: int, number: int) -> Scan | None:
    """Parse the header of a scan at an offset; return None at the end of the file. Raise ValueError if it is invalid.

    line, number : number of its first line, and of the scan, for messages
    """
    file.seek(offset)
    text = file.read(HEADER)
    lines = lines_of(text[:SHORT])
    lines = lines if len(lines) > 11 else lines_of(text)
    if not lines and len(text) < HEADER:
        return None
    rows = [(at, _numbers_of(words)) for at, words in lines[:10]]
    for (at, numbers), wanted in zip(rows, (1, 1, 3, 3, 3, 3, 4, 4, 4, 4), strict=False):
        if len(numbers) != wanted or not np.isfinite(numbers).all():
            row = line + _ends(text[:at])
            found = shortened(text[at:].splitlines()[0].decode("latin-1"))
            what = "one number" if wanted == 1 else f"{wanted} numbers"
            raise ValueError(f"invalid line {row:,} in the header of scan {number}, expected {what}: {found}")
    if len(rows) < 10:
        raise ValueError(f"is cut off in the header of scan {number}, after line {line + _ends(text):,}")
    begin = lines[9][0]
    end = begin + len(lines[9][1])
    end += 2 if text[end : end + 2] == b"\r\n" else 1
    columns, count = (_whole(rows[k][1][0], line, number) for k in range(2))
    fields = len(lines[10][1].split()) if len(lines) > 10 and columns * count else 0
    start = line + _ends(text[:end])
    if columns * count and len(lines) > 10 and fields not in (4, 7):
        raise ValueError(f"line {start:,} has {fields} columns, expected 4 or 7: {shortened(lines[10][1])}")
    matrix = _matrix([row for _, row in rows[6:]], number)
    placed = lines[2][1].strip() != NO_STATION or any(matrix[3][:3])
    return Scan((columns, count), matrix, offset + end, start, fields, columns * count, placed)


def _numbers_of(line: str) -> list[float]:
    try:
        return [float(word) for word in line.split()]
    except ValueError:
        return []


def _ends(text: bytes) -> int:
    """Count the line ends in a text: LF, CR, or both as one."""
    return text.count(b"\n") + text.count(b"\r") - text.count(b"\r\n")


def _whole(value: float, line: int, number: int) -> int:
    if not (0 <= value < 2**31 and value.is_integer()):
        raise ValueError(f"the header of scan {number}, line {line:,}: expected an integer as size, got {value:g}")
    return int(value)


def _matrix(rows: Sequence[Sequence[float]], number: int) -> tuple[tuple[float, ...], ...]:
    """Return the pose of a scan as a (4, 4) matrix for row vectors; some programs write the one for column vectors.

    Raise ValueError if it is neither. number : of the scan, for the message
    """
    matrix = np.array(rows)
    if (matrix[:, 3] != [0, 0, 0, 1]).any() and (matrix[3] == [0, 0, 0, 1]).all():
        matrix = matrix.T
    if (matrix[:, 3] != [0, 0, 0, 1]).any():
        raise ValueError(f"the matrix of scan {number} has last column {matrix[:, 3].tolist()}, expected 0, 0, 0, 1")
    return tuple(tuple(row) for row in matrix.tolist())


def _skip_lines(file: BinaryIO, scan: Scan, size: int, newline: bytes, number: int) -> int:
    """Return the offset after the announced rows of a scan; raise ValueError if the file ends before.

    size : of the file in bytes; newline : byte that ends lines; number : of the scan, for the message
    """
    left, offset = scan.total, scan.start
    while left > 0:
        file.seek(offset)
        text = file.read(min(LINES, HEADER + left * 64))
        if not text:
            line = scan.line + scan.total - left
            raise ValueError(
                f"is cut off at line {line:,}: scan {number} of {scan.shape[0]:,} x {scan.shape[1]:,} has "
                f"{scan.total - left:,} of {scan.total:,} rows"
            )
        ends = np.flatnonzero(np.frombuffer(text, np.uint8) == newline[0])
        if offset + len(text) >= size and text[-1:] != newline:  # the last line may lack a newline
            ends = np.append(ends, len(text) - 1)
        if len(ends) >= left:
            return offset + int(ends[left - 1]) + 1
        left, offset = left - len(ends), offset + len(text)
    return offset
