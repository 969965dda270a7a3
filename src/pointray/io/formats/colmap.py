"""Sparse points of COLMAP, `points3D.txt` and `points3D.bin`, triangulated from images, each with its track.

The formats are documented by COLMAP ("Output Format"). The track of a point, the images that show it, has variable
length, so rows of both files must be parsed one after the other.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ...cloud.georeference import Georeference
from ._counts import missing
from ._odd_numbers import plain_lines
from ._source import CHUNK, HEAD, NO, SURE, Chunk, Faults, Format, Listing, Request, Source

BINARY = "points3d.bin"  # file name in lower case
TITLE = re.compile(rb"(#[^\n]*\n)*#\s*POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK", re.IGNORECASE)
# Row of the binary file without its track, whose entries take 8 bytes each.
ROW = np.dtype([("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")])
ENTRY = 8
MOST = (1 << 64) - 1, 255, 255, 255  # the largest point id, red, green and blue
FIELDS, SHOWN = 8, 60  # numbers of a line before its track; maximum length of a line quoted in a message


def recognise(head: bytes, path: Path) -> int:
    """Detect COLMAP's points: return `SURE` or `NO`.

    A text is recognised by the comment that lists the columns, points3D.bin by its name and plausible first values.

    head : first bytes of the file
    """
    if TITLE.match(head):
        return SURE
    return SURE if path.name.lower() == BINARY and _is_plausible(head) else NO


def _is_plausible(head: bytes) -> bool:
    if len(head) < 8 + ROW.itemsize:
        return len(head) == 8 and not any(head)
    first = np.frombuffer(head, ROW, 1, offset=8)[0]
    return bool(np.isfinite(first["xyz"]).all() and first["error"] >= -1 and first["track"] < 1 << 32)


class ColmapSource(Source):
    """Reader of COLMAP's files of sparse points, text or binary."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path, self.faults = path, Faults(request.strict)
        self._size = path.stat().st_size
        with path.open("rb") as file:
            self._is_text = TITLE.match(file.read(HEAD)) is not None
            file.seek(0)
            count = None if self._is_text else _most(_announced(file, self._size, self.faults), self._size)
        facts = {"encoding": "text" if self._is_text else "binary"}
        self.listing = Listing(count, 36 + 16 + 8, max(self._size // 100, 1), Georeference(format="COLMAP"), facts)

    def chunks(self) -> Iterator[Chunk]:
        with self._path.open("rb") as file:
            if self._is_text:
                yield from _read_text(file, self._size, self.faults)
            else:
                yield from _read_binary(file, self._size, self.faults)


def _chunk(rows: NDArray[Any], share: float) -> Chunk:
    attributes = {
        "error": np.ascontiguousarray(rows["error"]),
        "track_length": rows["track"].astype(np.int32),
        "point_id": np.ascontiguousarray(rows["id"]),
    }
    return Chunk(np.ascontiguousarray(rows["xyz"]), None, np.ascontiguousarray(rows["rgb"]), attributes, share)


# ------------------------------------------------------------------------------------------------------ binary


def _announced(file: BinaryIO, size: int, faults: Faults) -> int:
    """Read the number of points at the start of a binary file; raise ValueError if it is 0 or no point fits.

    If `faults.strict`, all points must fit into the `size` bytes of the file.
    """
    if size < 8:
        raise ValueError("is cut off within the number of points")
    count = int(struct.unpack("<Q", file.read(8))[0])
    if count == 0:
        raise ValueError("contains no points: the header announces 0")
    if count * ROW.itemsize > size - 8 and (faults.strict or _most(count, size) == 0):
        raise ValueError(
            f"is cut off: {count:,} points of {ROW.itemsize} bytes or more expected, {size - 8:,} bytes found"
        )
    return count


def _most(count: int, size: int) -> int:
    """Return how many of the `count` announced points fit at most into a binary file of `size` bytes."""
    return min(count, max(size - 8, 0) // ROW.itemsize)


def _read_binary(file: BinaryIO, size: int, faults: Faults) -> Iterator[Chunk]:
    count = _announced(file, size, faults)
    at, done, cut = file.tell(), 0, False
    while done < count and not cut:
        heads = []
        for _ in range(done, min(done + CHUNK, count)):
            head = file.read(ROW.itemsize)
            at += ROW.itemsize + ENTRY * int.from_bytes(head[-8:], "little")
            cut = len(head) < ROW.itemsize or at > size
            if cut:
                break
            file.seek(at)
            heads.append(head)
        done += len(heads)
        if cut:
            message = f"is cut off at point {done:,} of {count:,}"
            faults.add(f"{message}: {missing(count, done)}")
            if not done:
                raise ValueError(message)
        if heads:
            yield _chunk(np.frombuffer(b"".join(heads), ROW), done / count)
    if at < size:
        faults.add(f"has {size - at:,} more bytes after {count:,} points: the number of points is wrong")


# -------------------------------------------------------------------------------------------------------- text


def _read_text(file: BinaryIO, size: int, faults: Faults) -> Iterator[Chunk]:
    lines = _Rows(file, faults)
    found = 0
    while rows := list(islice(lines, CHUNK)):
        array = np.empty(len(rows), ROW)
        for name, column in zip(("id", "error", "track"), (0, 7, 8), strict=True):
            array[name] = [row[column] for row in rows]
        array["xyz"] = [row[1:4] for row in rows]
        array["rgb"] = [row[4:7] for row in rows]
        found += len(rows)
        yield _chunk(array, min(file.tell() / size, 1.0))
    if found == 0:
        raise ValueError("contains no points")


class _Rows:
    """Iterator over the points of a text file: (id, x, y, z, r, g, b, error, number of images that show the point)."""

    def __init__(self, file: BinaryIO, faults: Faults) -> None:
        self._faults = faults
        self._lines = enumerate(plain_lines(line.decode("latin-1") for line in file), 1)

    def __iter__(self) -> Iterator[tuple[float, ...]]:
        return self

    def __next__(self) -> tuple[float, ...]:
        for number, line in self._lines:
            if (text := line.strip()) and not text.startswith("#"):
                try:
                    return self._row(number, text)
                except ValueError:
                    if self._faults.strict or line.endswith("\n"):
                        raise
                    self._faults.add("its last line is cut off")
        raise StopIteration

    def _row(self, number: int, text: str) -> tuple[float, ...]:
        fields = text.split()
        whole, track = (*fields[:1], *fields[4:7]), len(fields) - FIELDS
        if track < 0 or track % 2:
            raise ValueError(
                f"line {number:,} is invalid, expected id x y z r g b error and pairs of its track: {text[:SHOWN]!r}"
            )
        try:
            point, *color = (_whole(field, most) for field, most in zip(whole, MOST, strict=True))
            return (point, *map(float, fields[1:4]), *color, float(fields[7]), track // 2)
        except ValueError as error:
            raise ValueError(f"line {number:,}: {error}") from None


def _whole(text: str, most: int) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) <= 20 and int(text) <= most):
        raise ValueError(f"{text[:SHOWN]!r} is not an integer from 0 to {most}")
    return int(text)


FORMAT = Format(
    "COLMAP",
    (".txt", ".bin"),
    recognise,
    ColmapSource,
    {
        "positions": "X, Y, Z",
        "normals": "",
        "colors": "R, G, B",
        "attributes": "error (pixels), track_length (number of images that show the point), point_id",
        "survey": "",
        "note": "points3D.txt is detected by its title, points3D.bin by its name and first row",
    },
)
