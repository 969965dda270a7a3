"""PTX: gridded scans, one after the other, each with the matrix of its pose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Doubles
from ....base.warning_log import warn
from ....cloud.georeference import SCAN, Georeference
from ...colors import GREY
from .._counts import count_mismatch
from .._source import MAYBE, NO, SURE, Chunk, Faults, Format, Listing, Request, Source
from .._stations import scan_numbers
from ._lines import is_binary, is_ptx, shortened
from ._ptx_headers import Scan, newline_of, scans_of
from ._ptx_write import write

FAR = 10  # in diagonals of the point cloud: a scanner farther away than this cannot have been there


def recognise(head: bytes, path: Path) -> int:
    """Detect PTX files: return `SURE` by their first lines, `MAYBE` by the extension, or `NO`.

    head : first bytes of the file
    """
    if is_binary(head):
        return NO
    return SURE if is_ptx(head) else MAYBE if path.suffix.lower() == ".ptx" else NO


class PtxSource(Source):
    """Reader of PTX files: the rows with a return of all scans, in world coordinates."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path, self.faults = path, Faults(request.strict)
        facts = path.stat()
        self._size = facts.st_size
        self._scans, cut = scans_of(path, facts.st_size, facts.st_mtime_ns, request.strict)
        if cut:
            self.faults.add(cut)
        scans = self._scans
        self._has_colors = any(scan.fields == 7 for scan in scans)
        row = 40 + 6 * self._has_colors + 4 * (len(scans) > 1)
        grids = [{"columns": scan.shape[0], "rows": scan.shape[1]} for scan in scans]
        stations: Any = tuple(scan.matrix[3][:3] for scan in scans if scan.placed)
        self._numbers = scan_numbers([scan.placed for scan in scans])
        georeference = Georeference(stations=stations, format="PTX")
        self.listing = Listing(None, row, sum(scan.rows for scan in scans), georeference, {"scans": grids})

    def chunks(self) -> Iterator[Chunk]:
        grey = sum(scan.fields == 4 for scan in self._scans) if self._has_colors else 0
        if grey:
            warn(f"{grey} of {len(self._scans)} scans have no colours: they are set to grey", stacklevel=2)
        low, high, seen = np.full(3, np.inf), np.full(3, -np.inf), 0
        self._there = 0
        with self._path.open("rb") as file:
            newline = newline_of(file)
            for k, scan in enumerate(self._scans):
                for chunk in self._rows(file, newline, scan, k):
                    seen += len(chunk.positions)
                    if len(chunk.positions):
                        low = np.fmin(low, chunk.positions.min(axis=0))
                        high = np.fmax(high, chunk.positions.max(axis=0))
                    yield chunk
        total = sum(scan.total for scan in self._scans)
        if self._there != total:
            self.faults.add(count_mismatch(total, self._there, "rows"))
        facts = {**self.listing.facts, "without_return": self._there - seen}
        self.listing = replace(self.listing, facts=facts)
        if len(self._scans) == 1 and _is_unplaced(self._scans[0], low, high):
            self.listing = replace(self.listing, georeference=Georeference(format="PTX"))

    def _rows(self, file: BinaryIO, newline: bytes, scan: Scan, number: int) -> Iterator[Chunk]:
        from ._numbers import FLOAT, INT, Dialect, Reader, line_at

        if not scan.fields:
            return
        dialect = Dialect(comments=False, newline=newline)
        reader = Reader(file, dialect, [FLOAT] * 4 + [INT] * (scan.fields - 4), scan.start, scan.rows, self.faults)
        done = 0
        for block in reader.blocks():
            done += len(block)
            if (done > scan.total and self.faults.strict) or not len(block):
                break
            colors = block.take(range(4, 7), np.int64) if scan.fields == 7 else None
            rows = block.take(range(4), np.float64)
            yield self._chunk(rows, colors, scan, number, block.end / self._size)
        self._there += done
        if done != scan.total and self.faults.strict:
            line, text, _ = line_at(file, min(reader.at, self._size - 1))
            raise ValueError(
                f"scan {number + 1} ends at line {line:,}, {shortened(text)}: {scan.total:,} rows expected, "
                f"{done:,} found"
            )

    def _chunk(self, rows: Doubles, colors: NDArray[np.int64] | None, scan: Scan, number: int, share: float) -> Chunk:
        seen = (rows[:, :3] != 0).any(axis=1)
        rows, colors = rows[seen], None if colors is None else colors[seen]
        with np.errstate(over="ignore"):
            attributes: dict[str, NDArray[Any]] = {"intensity": rows[:, 3].astype(np.float32)}
        if len(self._scans) > 1:
            attributes[SCAN] = np.full(len(rows), self._numbers[number], np.int32)
        if colors is None and self._has_colors:
            colors = np.full((len(rows), 3), GREY)
        if colors is not None and colors.size and not (colors.min() >= 0 and colors.max() <= 255):
            low, high = colors.min(), colors.max()
            raise ValueError(f"invalid colours of scan {number + 1}: got {low} to {high}, expected 0 to 255")
        world = _placed(rows[:, :3], np.array(scan.matrix))
        return Chunk(world, None, None if colors is None else colors.astype(np.uint8), attributes, share)


def _placed(points: Doubles, matrix: Doubles) -> Doubles:
    """Transform the points of a scan, (n, 3), to world coordinates. matrix : (4, 4), for row vectors"""
    if (matrix == np.eye(4)).all():
        return points
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(points @ matrix[:3, :3] + matrix[3, :3])


def _is_unplaced(scan: Scan, low: Doubles, high: Doubles) -> bool:
    """Whether the pose in a header is a placeholder: some programs write it with points in world coordinates.

    It is the identity, and the points lie far from 0 compared with their extent.

    low, high : (3,), bounds of the points
    """
    if not (np.array(scan.matrix) == np.eye(4)).all() or not np.isfinite(low).all():
        return False
    apart = np.linalg.norm(np.maximum(np.maximum(low, -high), 0))
    return bool(apart > FAR * np.linalg.norm(high - low))


FORMAT = Format(
    "PTX",
    (".ptx",),
    recognise,
    PtxSource,
    {
        "positions": "x, y, z, transformed to world coordinates; rows of 0 0 0 (no return) are left out",
        "colors": "8 bits",
        "attributes": "intensity; scan, if the file has several",
        "survey": "the scanner position of each scan; unknown ones are written as -0 -0 -0",
        "note": "written with one scan for each scanner position (attribute scan): as its grid, if row_index and "
        "column_index give one, otherwise as a single column",
    },
    write=write,
)
