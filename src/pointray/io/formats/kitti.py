"""Lidar sweeps of KITTI (.bin) and nuScenes (.pcd.bin): rows of float32 without a header.

The number of columns is found from the file size and the values after x, y, z. With a wrong number of columns,
coordinates appear among these values, and some of them are negative.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...base.arrays import Floats
from ...cloud.georeference import Georeference
from ._named_columns import roles_of
from ._source import CHUNK, MAYBE, NO, Chunk, Faults, Format, Listing, Request, Source

# Columns after x, y, z, by the number of columns; the most specific layout comes first.
LAYOUTS = {5: ("intensity", "ring"), 6: ("red", "green", "blue"), 4: ("reflectance",)}
NAMES = {4: "KITTI", 5: "nuScenes", 6: "with colours"}
LEFT_OUT = "-"
FARTHEST = 1e4  # metres: beyond the range of any such scanner
NEAREST = 1e-2  # the largest coordinate at the beginning of a sweep exceeds this: zeros are not points
TINY = 1e-20  # smaller values are bytes of other types
MOST_RINGS = 256
HEAD_ROWS = 200
ADVICE = "; name each float32 of a row with --columns x,y,z,intensity (- ignores one)"


def recognise(head: bytes, path: Path) -> int:
    """Detect lidar sweeps: return `MAYBE` for a file named .bin with plausible coordinates, `NO` for others.

    head : first bytes of the file
    """
    if path.suffix.lower() != ".bin":
        return NO
    return MAYBE if any(_is_plausible(_rows(head, width)) for width in _widths(path)) else NO


def _widths(path: Path) -> tuple[int, ...]:
    """Return the possible numbers of columns of a file by its name, the most specific layout first."""
    return (5,) if path.name.lower().endswith(".pcd.bin") else tuple(LAYOUTS)


def _rows(head: bytes, width: int) -> Floats:
    count = min(len(head) // (4 * width), HEAD_ROWS)
    return np.frombuffer(head, "<f4", count * width).reshape(count, width)


def _is_plausible(rows: Floats) -> bool:
    size = np.abs(rows)
    if not len(rows) or not (size < FARTHEST).all() or size[:, :3].max() < NEAREST:  # also excludes NaN
        return False
    return bool(((size == 0) | (size > TINY)).all())


def _fits(rows: Floats) -> bool:
    """Whether the values of (n, k) rows after x, y, z are plausible for the lidar layout with k columns."""
    more = rows[:, 3:]
    if not _is_plausible(rows) or (more < 0).any():
        return False
    if rows.shape[1] == 5:
        return bool((more[:, 1] == np.rint(more[:, 1])).all() and (more[:, 1] < MOST_RINGS).all())
    if rows.shape[1] == 6:
        whole = (more == np.rint(more)).all() and more.max() <= 255
        return bool(more.any() and (whole or more.max() <= 1))
    return True


class KittiSource(Source):
    """Reader of lidar sweeps: rows of float32 without a header."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path, self.faults = path, Faults(request.strict)
        with path.open("rb") as file:
            size, head = os.fstat(file.fileno()).st_size, file.read(24 * HEAD_ROWS)
        self._columns = request.columns or _columns(path, size, head, self.faults)
        self._width = width = len(self._columns)
        twice = next((n for n in self._columns if n != LEFT_OUT and self._columns.count(n) > 1), None)
        if twice is not None:
            raise ValueError(f"duplicate column name {twice!r}: {','.join(self._columns)}")
        if size == 0 or (size % (4 * width) and request.columns):
            raise ValueError(f"its {size:,} bytes are not a multiple of {width} float32: {','.join(self._columns)}")
        if size % (4 * width):
            self.faults.add(f"is cut off: its {size:,} bytes are not a multiple of {4 * width}")
        self._roles = roles_of({name: (np.dtype("<f4"), 0) for name in self._columns if name != LEFT_OUT})
        scanner = 0.0, 0.0, 0.0  # coordinates are relative to it
        georeference = Georeference(stations=(scanner,), format="KITTI")
        facts = {"layout": ",".join(self._columns) if request.columns else NAMES[width]}
        self.listing = Listing(size // (4 * width), 36 + 4 * width, georeference=georeference, facts=facts)

    def chunks(self) -> Iterator[Chunk]:
        done, total = 0, self.listing.rows
        with self._path.open("rb") as file:
            while done < total:
                rows = np.fromfile(file, "<f4", min(CHUNK, total - done) * self._width)
                if len(rows) < min(CHUNK, total - done) * self._width:
                    raise ValueError(f"is cut off at point {done + len(rows) // self._width:,} of {total:,}")
                rows = rows.reshape(-1, self._width)
                done += len(rows)
                columns = {name: rows[:, k] for k, name in enumerate(self._columns) if name != LEFT_OUT}
                yield self._roles.chunk(columns, done / total)


def _columns(path: Path, size: int, head: bytes, faults: Faults) -> tuple[str, ...]:
    """Return the names of the columns that fit the size and the values of a file; ValueError if no layout does.

    If the size is not a multiple of any row, the file is cut off, and only the values decide.

    size : of the file in bytes; head : its first rows
    """
    widths = [width for width in _widths(path) if size >= 4 * width]
    fitting = [width for width in widths if size % (4 * width) == 0]
    if not fitting and (faults.strict or not widths):
        sizes = " or ".join(str(4 * width) for width in sorted(_widths(path)))
        raise ValueError(
            f"is cut off, or not a lidar sweep: its {size:,} bytes are not a multiple of {sizes} bytes{ADVICE}"
        )
    others = [] if faults.strict else [width for width in widths if width not in fitting]
    found = next((width for width in (*fitting, *others) if _fits(_rows(head, width))), None)
    if found is None:
        raise ValueError(f"unsupported layout: the values of its rows fit no known lidar sweep{ADVICE}")
    return ("x", "y", "z", *LAYOUTS[found])


FORMAT = Format(
    "KITTI, nuScenes",
    (".bin",),
    recognise,
    KittiSource,
    {
        "positions": "x, y, z",
        "normals": "",
        "colors": "the last three of six columns, 0 to 1 or to 255",
        "attributes": "reflectance (KITTI); intensity and ring (nuScenes, .pcd.bin); or as named with --columns",
        "survey": "the scanner position, 0, 0, 0",
        "note": "detected by the extension, the size and plausible values; other layouts need --columns",
    },
)
