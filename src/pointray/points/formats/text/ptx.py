"""PTX: grids of points, one after the other, each as a scanner saw them, with the matrix that places them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....survey import SCAN, Survey
from .._source import MAYBE, NO, SURE, Chunk, Format, Listing, Request, Source
from ._lines import is_binary, is_ptx, lines_of, shortened

HEADER, SHORT = 1 << 14, 1 << 10  # bytes that the ten lines of a header may have, and usually have
LINES = 1 << 22  # bytes in which lines are counted at a time
MOST_SCANS = 10_000
GREY = 128  # of scans without colours, beside others
FAR = 10  # diagonals of all points: a scanner so far from them did not stand there


class Scan(NamedTuple):
    """What the header of a scan says.

    Attributes
    ----------
    shape : (2,) tuple of int
        Columns and rows of its grid.
    matrix : (4, 4) tuple of tuple of float
        For row vectors: world = (x, y, z, 1) @ matrix.
    start : int
        The offset of its first row.
    line : int
        The number of that line.
    fields : int
        Numbers in its first row: 4, or 7 with colours; 0 if it has no rows.
    """

    shape: tuple[int, int]
    matrix: tuple[tuple[float, ...], ...]
    start: int
    line: int
    fields: int

    @property
    def total(self) -> int:
        """Rows, those without a return too."""
        return self.shape[0] * self.shape[1]


def recognise(head: bytes, path: Path) -> int:
    """Whether a file is a PTX file."""
    if is_binary(head):
        return NO
    return SURE if is_ptx(head) else MAYBE if path.suffix.lower() == ".ptx" else NO


class PtxSource(Source):
    """The rows with a return of all scans."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path = path
        facts = path.stat()
        self._size = facts.st_size
        self._scans = scans = _scans(path, facts.st_size, facts.st_mtime_ns)
        self._has_colors = any(scan.fields == 7 for scan in scans)
        row = 40 + 6 * self._has_colors + 4 * (len(scans) > 1)
        told = [{"columns": scan.shape[0], "rows": scan.shape[1]} for scan in scans]
        survey = Survey(stations=tuple(scan.matrix[3][:3] for scan in scans))  # type: ignore[misc]  # three numbers
        self.listing = Listing(None, row, sum(scan.total for scan in scans), survey, {"scans": told})

    def chunks(self) -> Iterator[Chunk]:
        grey = sum(scan.fields == 4 for scan in self._scans) if self._has_colors else 0
        if grey:
            warnings.warn(f"{grey} of {len(self._scans)} scans have no colours: they are grey", stacklevel=2)
        low, high, seen = np.full(3, np.inf), np.full(3, -np.inf), 0
        with self._path.open("rb") as file:
            newline = _newline(file)
            for k, scan in enumerate(self._scans):
                for chunk in self._rows(file, newline, scan, k):
                    seen += len(chunk.positions)
                    if len(chunk.positions):
                        low = np.fmin(low, chunk.positions.min(axis=0))
                        high = np.fmax(high, chunk.positions.max(axis=0))
                    yield chunk
        facts = {**self.listing.facts, "without_return": self.listing.expected - seen}
        self.listing = replace(self.listing, facts=facts)
        if len(self._scans) == 1 and _is_unplaced(self._scans[0], low, high):
            self.listing = replace(self.listing, survey=Survey())

    def _rows(self, file: BinaryIO, newline: bytes, scan: Scan, number: int) -> Iterator[Chunk]:
        from ._numbers import FLOAT, INT, Dialect, Reader, line_at

        if not scan.total:
            return
        dialect = Dialect(comments=False, newline=newline)
        reader = Reader(file, dialect, [FLOAT] * 4 + [INT] * (scan.fields - 4), scan.start, scan.total)
        done = 0
        for block in reader.blocks():
            done += len(block)
            if done > scan.total or not len(block):
                break
            colors = block.take(range(4, 7), np.int64) if scan.fields == 7 else None
            rows = block.take(range(4), np.float64)
            yield self._chunk(rows, colors, scan, number, block.end / self._size)
        if done != scan.total:
            line, text, _ = line_at(file, min(reader.at, self._size - 1))
            raise ValueError(
                f"scan {number + 1} ends at line {line:,}, {shortened(text)}: {scan.total:,} rows are announced, "
                f"{done:,} are there"
            )

    def _chunk(
        self, rows: NDArray[np.float64], colors: NDArray[np.int64] | None, scan: Scan, number: int, share: float
    ) -> Chunk:
        seen = (rows[:, :3] != 0).any(axis=1)
        rows, colors = rows[seen], None if colors is None else colors[seen]
        with np.errstate(over="ignore"):
            attributes: dict[str, NDArray[Any]] = {"intensity": rows[:, 3].astype(np.float32)}
        if len(self._scans) > 1:
            attributes[SCAN] = np.full(len(rows), number, np.int32)
        if colors is None and self._has_colors:
            colors = np.full((len(rows), 3), GREY)
        if colors is not None and colors.size and not (colors.min() >= 0 and colors.max() <= 255):
            low, high = colors.min(), colors.max()
            raise ValueError(f"the colours of scan {number + 1} reach from {low} to {high}, not 0 to 255")
        world = _placed(rows[:, :3], np.array(scan.matrix))
        return Chunk(world, None, None if colors is None else colors.astype(np.uint8), attributes, share)


def _placed(points: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points of a scan in the world."""
    if (matrix == np.eye(4)).all():
        return points
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(points @ matrix[:3, :3] + matrix[3, :3])


def _is_unplaced(scan: Scan, low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    """Whether a scan's header says nothing of its scanner: other programs write such ones, with world coordinates."""
    if not (np.array(scan.matrix) == np.eye(4)).all() or not np.isfinite(low).all():
        return False
    apart = np.linalg.norm(np.maximum(np.maximum(low, -high), 0))
    return bool(apart > FAR * np.linalg.norm(high - low))


# ------------------------------------------------------------------------------------------------------ headers


@lru_cache(maxsize=8)  # a file is opened twice: for its listing and to be read
def _scans(path: Path, size: int, time: int) -> list[Scan]:
    """The headers of all scans. Only ends of lines are counted between them: 1 GB takes half a second."""
    scans: list[Scan] = []
    with path.open("rb") as file:
        newline, offset, line = _newline(file), 0, 1
        while header := _header(file, offset, line, len(scans) + 1):
            if len(scans) == MOST_SCANS:
                raise ValueError(f"has more than {MOST_SCANS:,} scans")
            scans.append(header)
            offset = _skip_lines(file, header, size, newline, len(scans))
            line = header.line + header.total
    if not scans:
        raise ValueError("is no PTX file: it has no header of ten lines")
    return scans


def _newline(file: BinaryIO) -> bytes:
    file.seek(0)
    return b"\n" if b"\n" in file.read(HEADER) else b"\r"


def _header(file: BinaryIO, offset: int, line: int, number: int) -> Scan | None:
    """The header at an offset; None at the file's end."""
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
            raise ValueError(f"line {row:,} is in the header of scan {number}, where {what} must be: {found}")
    if len(rows) < 10:
        raise ValueError(f"is cut off in the header of scan {number}, after line {line + _ends(text):,}")
    begin = lines[9][0]
    end = begin + len(lines[9][1])
    end += 2 if text[end : end + 2] == b"\r\n" else 1
    columns, count = (_whole(rows[k][1][0], line, number) for k in range(2))
    fields = len(lines[10][1].split()) if len(lines) > 10 and columns * count else 0
    start = line + _ends(text[:end])
    if columns * count and len(lines) > 10 and fields not in (4, 7):
        raise ValueError(f"line {start:,} has {fields} columns, not 4 or 7: {shortened(lines[10][1])}")
    return Scan((columns, count), _matrix([row for _, row in rows[6:]], number), offset + end, start, fields)


def _numbers_of(line: str) -> list[float]:
    try:
        return [float(word) for word in line.split()]
    except ValueError:
        return []


def _ends(text: bytes) -> int:
    """How many lines end in a text."""
    return text.count(b"\n") + text.count(b"\r") - text.count(b"\r\n")


def _whole(value: float, line: int, number: int) -> int:
    if not (0 <= value < 2**31 and value.is_integer()):
        raise ValueError(f"the header of scan {number}, line {line:,}: a size must be a whole number, not {value:g}")
    return int(value)


def _matrix(rows: Sequence[Sequence[float]], number: int) -> tuple[tuple[float, ...], ...]:
    """A scan's matrix for row vectors; some programs write the one for column vectors."""
    matrix = np.array(rows)
    if (matrix[:, 3] != [0, 0, 0, 1]).any() and (matrix[3] == [0, 0, 0, 1]).all():
        matrix = matrix.T
    if (matrix[:, 3] != [0, 0, 0, 1]).any():
        raise ValueError(f"the matrix of scan {number} has the last column {matrix[:, 3].tolist()}, not 0, 0, 0, 1")
    return tuple(tuple(row) for row in matrix.tolist())


def _skip_lines(file: BinaryIO, scan: Scan, size: int, newline: bytes, number: int) -> int:
    """The offset behind a scan's rows."""
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
        if offset + len(text) >= size and text[-1:] != newline:  # the last line has no end
            ends = np.append(ends, len(text) - 1)
        if len(ends) >= left:
            return offset + int(ends[left - 1]) + 1
        left, offset = left - len(ends), offset + len(text)
    return offset


FORMAT = Format(
    "PTX",
    (".ptx",),
    recognise,
    PtxSource,
    {
        "positions": "x, y, z in the world; rows of 0 0 0 are without a return and left out",
        "colors": "8 bits",
        "attributes": "intensity; scan, if there are several",
        "survey": "where each scan's scanner stood",
    },
)
