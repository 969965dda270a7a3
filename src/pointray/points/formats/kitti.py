"""Sweeps of a spinning laser scanner as KITTI (.bin) and nuScenes (.pcd.bin) have them: rows of float32, no header."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...survey import Survey
from ._named_columns import own, stack
from ._source import CHUNK, MAYBE, NO, Chunk, Format, Listing, Request, Source

LAYOUTS = {4: ("KITTI", ("reflectance",)), 5: ("nuScenes", ("intensity", "ring"))}
FARTHEST = 1e4  # metres: no such scanner sees farther
NEAREST = 1e-2  # some coordinate of a sweep's beginning is larger: zeros are no points
TINY = 1e-20  # numbers below are bytes that mean something else
MOST_RINGS = 256
HEAD_ROWS = 200


def recognise(head: bytes, path: Path) -> int:
    """Whether a file may be a sweep: by the extension, and as its numbers are plausible."""
    if path.suffix.lower() != ".bin":
        return NO
    return MAYBE if any(_is_plausible(_rows(head, width)) for width in _widths(path)) else NO


def _widths(path: Path) -> tuple[int, ...]:
    """Numbers in a row, the likelier first."""
    return (5,) if path.name.lower().endswith(".pcd.bin") else (4, 5)


def _rows(head: bytes, width: int) -> NDArray[np.float32]:
    count = min(len(head) // (4 * width), HEAD_ROWS)
    return np.frombuffer(head, "<f4", count * width).reshape(count, width)


def _is_plausible(rows: NDArray[np.float32]) -> bool:
    size = np.abs(rows)
    if not len(rows) or not (size < FARTHEST).all() or size[:, :3].max() < NEAREST:  # NaN too
        return False
    return bool(((size == 0) | (size > TINY)).all())


def _has_rings(rows: NDArray[np.float32]) -> bool:
    ring = rows[:, 4]
    return bool((ring == np.rint(ring)).all() and (ring >= 0).all() and (ring < MOST_RINGS).all())


class KittiSource(Source):
    """A sweep; ValueError says what is wrong with it."""

    def __init__(self, path: Path, request: Request) -> None:
        self._path = path
        with path.open("rb") as file:
            size, head = os.fstat(file.fileno()).st_size, file.read(20 * HEAD_ROWS)
        self._width = _width(path, size, head)
        name, self._attributes = LAYOUTS[self._width]
        survey = Survey(stations=((0.0, 0.0, 0.0),))  # coordinates are the scanner's
        self.listing = Listing(size // (4 * self._width), 36 + 4 * self._width, survey=survey, facts={"layout": name})

    def chunks(self) -> Iterator[Chunk]:
        done, total = 0, self.listing.rows
        with self._path.open("rb") as file:
            while done < total:
                rows = np.fromfile(file, "<f4", min(CHUNK, total - done) * self._width)
                if len(rows) < min(CHUNK, total - done) * self._width:
                    raise ValueError(f"is cut off at point {done + len(rows) // self._width:,} of {total:,}")
                rows = rows.reshape(-1, self._width)
                done += len(rows)
                attributes = {name: own(rows[:, 3 + k]) for k, name in enumerate(self._attributes)}
                yield Chunk(stack(rows[:, :3].T), attributes=attributes, share=done / total)


def _width(path: Path, size: int, head: bytes) -> int:
    """Numbers in a row: as the file's size allows, and if it allows both, as a column of rings tells."""
    fitting = [width for width in _widths(path) if size % (4 * width) == 0]
    if not fitting or size == 0:
        sizes = " or ".join(str(4 * width) for width in _widths(path))
        raise ValueError(f"is cut off, or no sweep of a scanner: its {size:,} bytes are no rows of {sizes} bytes")
    if len(fitting) == 1:
        return fitting[0]
    rows = _rows(head, 5)
    return 5 if _is_plausible(rows) and _has_rings(rows) else 4


FORMAT = Format(
    "KITTI, nuScenes",
    (".bin",),
    recognise,
    KittiSource,
    {
        "positions": "x, y, z",
        "normals": "",
        "colors": "",
        "attributes": "reflectance (KITTI); intensity and ring (nuScenes, .pcd.bin)",
        "survey": "the scanner stands at 0, 0, 0",
        "note": "recognised by the extension, the size and plausible values",
    },
)
