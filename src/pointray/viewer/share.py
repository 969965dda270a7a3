"""How much one page may ask for, so that it does not stop the others."""

from __future__ import annotations

import time
from collections.abc import Callable

SHARE = 0.25  # of a processor, for the messages of one page: those that come faster wait
CREDIT = 0.1  # seconds of it that may be taken at once
TRANSPORT = 2e-4  # seconds that a message takes before it is looked at


class Share:
    """Of a processor's time. clock : seconds"""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._at, self._owed = clock, clock(), 0.0

    def rest(self, spent: float) -> float:
        """Seconds to wait, after so many were spent on a message."""
        now = self._clock()
        self._owed = max(0.0, self._owed - SHARE * (now - self._at)) + spent + TRANSPORT
        self._at = now
        return max(0.0, self._owed - CREDIT) / SHARE


class Allowance:
    """So many events a second, and as many at once as would come in some seconds. clock : seconds"""

    def __init__(self, rate: float, most: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._most, self._clock = rate, most, clock
        self._left, self._at = most, clock()

    def take(self) -> bool:
        """Whether one more is allowed."""
        now = self._clock()
        self._left = min(self._most, self._left + self._rate * (now - self._at))
        self._at = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
