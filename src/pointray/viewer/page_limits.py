"""Limits for one page, so that it does not stop the others."""

from __future__ import annotations

import time
from collections.abc import Callable

SHARE = 0.25  # of a processor, for one page's messages: faster ones wait
CREDIT = 0.1  # seconds of it that may be used at once
TRANSPORT = 2e-4  # seconds that a message takes before it is parsed


class CpuBudget:
    """A share of a processor's time. clock : seconds"""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._at, self._owed = clock, clock(), 0.0

    def rest(self, spent: float) -> float:
        """Seconds to wait after a message that took the given seconds."""
        now = self._clock()
        self._owed = max(0.0, self._owed - SHARE * (now - self._at)) + spent + TRANSPORT
        self._at = now
        return max(0.0, self._owed - CREDIT) / SHARE


class RateLimiter:
    """A limit of events a second, with a burst of as many as come in some seconds. clock : seconds"""

    def __init__(self, rate: float, most: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._most, self._clock = rate, most, clock
        self._left, self._at = most, clock()

    def take(self) -> bool:
        """Take one event; returns whether it is allowed."""
        now = self._clock()
        self._left = min(self._most, self._left + self._rate * (now - self._at))
        self._at = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
