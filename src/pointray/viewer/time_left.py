"""Estimates of the time left from the fraction of the work that is done."""

from __future__ import annotations

import time

MIN_SECONDS = 1.0  # seconds of work before the first estimate


class TimeLeft:
    """Callable that estimates the time left of successive stages of work from their fractions done."""

    def __init__(self) -> None:
        self._stage, self._since, self._first = "", 0.0, 0.0

    def __call__(self, stage: str, share: float | None) -> float | None:
        """Return the seconds left of a stage at its average speed so far; None if not known yet.

        stage : its name; share : fraction done, None if unknown
        """
        now = time.perf_counter()
        if stage != self._stage or share is None or share < self._first:
            self._stage, self._since, self._first = stage, now, share or 0.0
        spent, done = now - self._since, (share or 0.0) - self._first
        if share is None or spent < MIN_SECONDS or done <= 0.0:
            return None
        return spent * (1.0 - share) / done
