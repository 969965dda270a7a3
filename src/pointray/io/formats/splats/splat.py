"""3D Gaussian splatting, .splat files of web viewers: 32 bytes per splat, without a header."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.progress import Progress, part_of
from ....cloud.points import Points
from .._source import MAYBE, NO, Chunk, Faults, Format, Request, Source
from ._common import KEEPS, ROWS, Floats, Splats, listing_of, opaque_chunks
from ._flat import FlatSplats

ROW = np.dtype([("place", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("turn", "u1", 4)])
UNEVEN = 0.1  # tolerance of the length of quaternions rounded to bytes
PLAUSIBLE = 0.9  # minimum fraction of the first rows that must be plausible


def recognise(head: bytes, path: Path) -> int:
    """Detect .splat files: return `MAYBE` or `NO`.

    Files named .ksplat are `MAYBE` too, so that opening them raises an error with advice.

    head : first bytes of the file
    """
    if path.suffix.lower() == ".ksplat":
        return MAYBE
    return MAYBE if path.suffix.lower() == ".splat" and _is_plausible(head) else NO


def _is_plausible(head: bytes) -> bool:
    """Whether most of the first rows have finite numbers, nonnegative scales and unit quaternions.

    head : first bytes of the file
    """
    rows = np.frombuffer(head[: len(head) // ROW.itemsize * ROW.itemsize], ROW)
    if not len(rows):
        return False
    with np.errstate(invalid="ignore", over="ignore"):
        good = np.isfinite(rows["place"]).all(axis=1)
        good &= ((rows["scale"] >= 0) & (rows["scale"] < np.inf)).all(axis=1)
        good &= np.abs(np.linalg.norm(_quaternions(rows["turn"]), axis=1) - 1) < UNEVEN
    return bool(good.mean() >= PLAUSIBLE)


def _quaternions(turn: NDArray[np.uint8]) -> Floats:
    return (turn.astype(np.float32) - 128) / 128


class SplatSource(Source):
    """Reader of Gaussian splats in .splat files of web viewers."""

    def __init__(self, path: Path, request: Request) -> None:
        if path.suffix.lower() == ".ksplat":
            raise ValueError(
                ".ksplat files are unsupported: convert it to .ply, .spz or .splat, for example with SuperSplat"
            )
        self._path, self._opacity, self.faults = path, request.opacity, Faults(request.strict)
        size = path.stat().st_size
        if size % ROW.itemsize:
            message = f"is cut off or not a splat file: its {size:,} bytes are not a multiple of {ROW.itemsize}"
            if size < ROW.itemsize:
                raise ValueError(message)
            self.faults.add(message)
        self._count = size // ROW.itemsize
        self._facts = {"splats": self._count}
        self.listing = listing_of(self._count, self._opacity, self._facts)

    def chunks(self) -> Iterator[Chunk]:
        return opaque_chunks(self._splats(), self._opacity, self._facts)

    def _splats(self) -> Iterator[tuple[Splats, float]]:
        with self._path.open("rb") as file:
            for first in range(0, self._count, ROWS):
                rows = np.fromfile(file, ROW, min(ROWS, self._count - first))
                end = first + len(rows)
                if end < min(first + ROWS, self._count):
                    raise ValueError(f"is cut off at splat {end:,} of {self._count:,}")
                shades = rows["color"] / np.float32(255)
                turns = _quaternions(rows["turn"])
                yield Splats(rows["place"], shades[:, :3], shades[:, 3], rows["scale"], turns), end / self._count


def write(file: Any, points: Points, progress: Progress | None = None) -> list[str]:
    """Write points to a stream as flat Gaussian splats of 32 bytes; return what the format cannot store, in words."""
    splats = FlatSplats(points, part_of(progress, 0.0, 0.5))
    for part in splats.parts(part_of(progress, 0.5, 1.0)):
        rows = np.empty(part.stop - part.start, ROW)
        scales, turns = splats.shapes(part)
        rows["place"], rows["scale"] = splats.positions[part], scales
        rows["color"][:, :3] = splats.colors(part)
        rows["color"][:, 3] = np.rint(255 * splats.opacity(part))
        rows["turn"] = np.clip(np.rint(128 * turns + 128), 0, 255)
        file.write(rows.data)
    return splats.lost


FORMAT = Format("splat", (".splat",), recognise, SplatSource, KEEPS, write=write)
