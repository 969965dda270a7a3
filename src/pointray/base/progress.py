"""Reports of how much of the work is done."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], None]  # receives the share that is done, 0 to 1, from any thread
StageProgress = Callable[[str, float], None]  # receives the name of the stage and its share, 0 to 1


def part_of(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """The progress of a part that lies between two shares of the whole."""
    if progress is None:
        return None
    tell = progress
    return lambda share: tell(begin + share * (end - begin))


def tell(progress: Progress | None, share: float) -> None:
    """Report the share that is done."""
    if progress is not None:
        progress(share)
