"""Estimates of the time left from the fraction of the work that is done."""

from __future__ import annotations

import time

MIN_SECONDS = 1.0  # seconds of work before the first estimate


class TimeLeft:
    """Time left of successive stages."""

    def __init__(self) -> None:
        self._stage, self._since, self._first = "", 0.0, 0.0

    def __call__(self, stage: str, share: float | None) -> float | None:
        """Return the seconds left of a stage, given the fraction done; None if not known yet."""
        now = time.perf_counter()
        if stage != self._stage or share is None or share < self._first:
            self._stage, self._since, self._first = stage, now, share or 0.0
        spent, done = now - self._since, (share or 0.0) - self._first
        if share is None or spent < MIN_SECONDS or done <= 0.0:
            return None
        return spent * (1.0 - share) / done
