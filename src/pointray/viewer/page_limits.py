"""Limits for each page, so that one page cannot block the others."""

from __future__ import annotations

import time
from collections.abc import Callable

SHARE = 0.25  # fraction of a CPU core for the messages of one page; beyond it they wait
CREDIT = 0.1  # seconds of CPU time allowed in a burst
TRANSPORT = 2e-4  # seconds that transport of a message takes, before parsing


class CpuBudget:
    """Budget of CPU time for the messages of one page: a quarter of a core, so that others stay responsive.

    clock : returns seconds
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._at, self._owed = clock, clock(), 0.0

    def rest(self, spent: float) -> float:
        """Return the seconds to wait before the next message, after one that took `spent` seconds of CPU time."""
        now = self._clock()
        self._owed = max(0.0, self._owed - SHARE * (now - self._at)) + spent + TRANSPORT
        self._at = now
        return max(0.0, self._owed - CREDIT) / SHARE


class RateLimiter:
    """Token bucket: `rate` events a second, bursts of up to `most` events. clock : returns seconds"""

    def __init__(self, rate: float, most: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._most, self._clock = rate, most, clock
        self._left, self._at = most, clock()

    def take(self) -> bool:
        """Count an event; return whether it is allowed. An event that is not allowed does not count."""
        now = self._clock()
        self._left = min(self._most, self._left + self._rate * (now - self._at))
        self._at = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
