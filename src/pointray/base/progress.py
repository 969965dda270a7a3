"""Progress callbacks."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

Progress = Callable[[float], None]  # called with the completed fraction, 0 to 1, from any thread
StageProgress = Callable[[str, float], None]  # called with the name of the stage and its completed fraction


def in_stage(progress: StageProgress | None, stage: str) -> Progress | None:
    """Return a callback for the completed fraction, which calls `progress` with the name `stage` and the fraction.

    Functions with a single stage of work take such a callback. None becomes None.
    """
    return None if progress is None else partial(progress, stage)


def part_of(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """Return a progress callback for a part of the work; None if `progress` is None.

    It converts the completed fraction of the part to that of the whole, of which the part covers `begin` to `end`.
    """
    if progress is None:
        return None
    whole = progress
    return lambda share: whole(begin + share * (end - begin))


def report_progress(progress: Progress | None, share: float) -> None:
    """Call `progress` with the completed fraction, 0 to 1, unless it is None."""
    if progress is not None:
        progress(share)
