"""Positions in float32 relative to an origin, and the integer steps of the file's grid that are lost in rounding."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Floats
from ..cloud.geographic import LocalFrame, in_file, projected
from ..cloud.georeference import Georeference, numbers_of
from ..cloud.points import SAMPLE, choose_origin
from ..cloud.shifting import shift_rows

BLOCK = 1 << 15  # rows converted at a time: they stay in the processor's cache
SAFE = 2**22  # grid steps up to this number are exact in float32


def sample_step(total: int) -> int:
    """Return the step at which rows are sampled to find the origin of `total` rows: at most 20,000 rows are used."""
    return -(-total // SAMPLE)


def georeferenced(
    sample: Sequence[NDArray[Any]], georeference: Georeference
) -> tuple[Georeference, list[NDArray[Any]]]:
    """Return the georeference, and a sample of positions in the coordinates of `Points`.

    Both are unchanged unless coordinates are in degrees. Then a local projection is added to the georeference, and the
    sample is projected to metres.

    sample : rows of the file in (m, 3) pieces
    """
    with np.errstate(invalid="ignore", over="ignore"):
        found = projected(georeference, np.concatenate(sample))
        frame = LocalFrame.of(found)
        return found, list(sample) if frame is None else [frame.to_local(piece) for piece in sample]


def origin_of(sample: Sequence[NDArray[Any]], total: int) -> Doubles:
    """Return the origin, (3,), about which float32 can hold `total` positions.

    sample : some of the positions, in (m, 3) pieces
    """
    with np.errstate(invalid="ignore", over="ignore"):  # a damaged file may contain signalling NaNs
        return choose_origin(np.concatenate(sample), total)


def locate(
    world: NDArray[Any], origin: Doubles, georeference: Georeference, local: Floats
) -> Iterator[tuple[slice, NDArray[np.int64]]]:
    """Fill `local` with float32 positions relative to the origin; yield the ranges of rows where rounding loses digits.

    With each range come the rounding errors, (m, 3), in steps of the file's integer coordinates.

    world : (n, 3), the file's coordinates, projected here if the georeference has a projection
    """
    frame = LocalFrame.of(georeference)
    if frame is None:
        shift_rows(world, -origin, local)
    if frame is None and georeference.scale is None:
        return
    for start in range(0, len(world), BLOCK):
        part, rows = world[start : start + BLOCK], slice(start, min(start + BLOCK, len(world)))
        if frame is not None:
            with np.errstate(over="ignore", invalid="ignore"):  # signalling NaNs; overflow to infinity
                shift_rows(frame.to_local(part), -origin, local[rows])
        lost = _lost(part, local[rows], origin, georeference)
        if lost is not None:
            yield rows, lost


def _lost(rows: NDArray[Any], local: Floats, origin: Doubles, georeference: Georeference) -> NDArray[np.int64] | None:
    """Return what float32 loses of coordinates that a file stores as integers, in steps of these integers, (n, 3).

    Return None if nothing is lost or the file has no integer coordinates.

    rows : coordinates in the file; local : their float32 positions relative to the origin
    """
    if georeference.scale is None:
        return None
    if max(-local.min(), local.max()) < SAFE * min(georeference.scale):  # per axis it takes ten times as long
        return None
    lost = numbers_of(georeference, rows) - numbers_of(georeference, in_file(georeference, local + origin))
    return lost if lost.any() else None
