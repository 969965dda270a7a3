"""How long something will still take, by how much of it is done."""

from __future__ import annotations

import time

SURE = 1.0  # seconds after which it can be told


class TimeLeft:
    """Of one stage after the other."""

    def __init__(self) -> None:
        self._stage, self._since, self._first = "", 0.0, 0.0

    def __call__(self, stage: str, share: float | None) -> float | None:
        """Seconds that a stage of which this share is done will take; None: it is not known yet."""
        now = time.perf_counter()
        if stage != self._stage or share is None or share < self._first:
            self._stage, self._since, self._first = stage, now, share or 0.0
        spent, done = now - self._since, (share or 0.0) - self._first
        if share is None or spent < SURE or done <= 0.0:
            return None
        return spent * (1.0 - share) / done
