"""Progress callbacks."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

Progress = Callable[[float], None]  # called with the completed fraction, 0 to 1, from any thread
StageProgress = Callable[[str, float], None]  # called with the name of the stage and its completed fraction


def in_stage(progress: StageProgress | None, stage: str) -> Progress | None:
    """Return the progress of one stage, which a function with a single stage reports."""
    return None if progress is None else partial(progress, stage)


def part_of(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """Return a callback for a part of the work, which covers the fractions `begin` to `end` of the whole."""
    if progress is None:
        return None
    whole = progress
    return lambda share: whole(begin + share * (end - begin))


def report_progress(progress: Progress | None, share: float) -> None:
    """Report the completed fraction to a callback, if there is one."""
    if progress is not None:
        progress(share)
