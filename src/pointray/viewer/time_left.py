"""Estimates how long something will still take, from the share of it that is done."""

from __future__ import annotations

import time

MIN_SECONDS = 1.0  # seconds after which an estimate is given


class TimeLeft:
    """The time left of successive stages."""

    def __init__(self) -> None:
        self._stage, self._since, self._first = "", 0.0, 0.0

    def __call__(self, stage: str, share: float | None) -> float | None:
        """Seconds that a stage will still take, given the share done; None if not yet known."""
        now = time.perf_counter()
        if stage != self._stage or share is None or share < self._first:
            self._stage, self._since, self._first = stage, now, share or 0.0
        spent, done = now - self._since, (share or 0.0) - self._first
        if share is None or spent < MIN_SECONDS or done <= 0.0:
            return None
        return spent * (1.0 - share) / done
