"""Locating: positions about an origin in float32, and what these lose of a file's whole numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cloud.geographic import LocalFrame, in_file, projected
from ..cloud.georeference import Survey, numbers_of
from ..cloud.points import SAMPLE, choose_origin

BLOCK = 1 << 15  # rows whose positions are moved at once: they stay in the processor's cache
SAFE = 2**22  # of whole numbers as large float32 loses nothing


def sample_step(total: int) -> int:
    """Of so many rows every so manieth tells where the origin is."""
    return -(-total // SAMPLE)


def surveyed(sample: Sequence[NDArray[Any]], survey: Survey) -> tuple[Survey, list[NDArray[Any]]]:
    """Return the survey and a sample of positions, in pieces, projected if the coordinates are geographic."""
    with np.errstate(invalid="ignore", over="ignore"):
        found = projected(survey, np.concatenate(sample))
        frame = LocalFrame.of(found)
        return found, list(sample) if frame is None else [frame.to_local(piece) for piece in sample]


def origin_of(sample: Sequence[NDArray[Any]], total: int) -> NDArray[np.float64]:
    """The origin that suits `total` rows, of which a sample (m, 3) is given, in pieces."""
    with np.errstate(invalid="ignore", over="ignore"):  # signalling NaNs of a damaged file
        return choose_origin(np.concatenate(sample), total)


def locate(
    world: NDArray[Any], origin: NDArray[np.float64], survey: Survey, local: NDArray[np.float32]
) -> Iterator[tuple[slice, NDArray[np.int64]]]:
    """Fill `local` with positions about the origin; yields what these lose of whole numbers, by rows that lose any.

    world : the file's coordinates, which are projected here if the survey has a projection
    """
    frame = LocalFrame.of(survey)
    origins = np.tile(origin, (min(BLOCK, len(world)), 1))  # rows of three would take three times as long
    for start in range(0, len(world), BLOCK):
        part, rows = world[start : start + BLOCK], slice(start, min(start + BLOCK, len(world)))
        with np.errstate(over="ignore", invalid="ignore"):  # signalling NaNs; a number that overflows becomes infinite
            moved = part if frame is None else frame.to_local(part)
            local[rows].reshape(-1)[:] = moved.reshape(-1) - origins[: len(part)].reshape(-1)
        lost = _lost(part, local[rows], origin, survey)
        if lost is not None:
            yield rows, lost


def _lost(
    rows: NDArray[Any], local: NDArray[np.float32], origin: NDArray[np.float64], survey: Survey
) -> NDArray[np.int64] | None:
    """What float32 loses of the whole numbers of some rows, (n, 3); None if nothing, or if the file has none."""
    if survey.scale is None:
        return None
    if max(-local.min(), local.max()) < SAFE * min(survey.scale):  # by axes it takes ten times as long
        return None
    lost = numbers_of(survey, rows) - numbers_of(survey, in_file(survey, local + origin))
    return lost if lost.any() else None
