"""Which kernels are still to be compiled, in this process and in a second one, and how long that will take."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from typing import NamedTuple

UNKNOWN = 1.0  # seconds assumed for a kernel whose compile time is not known
ENOUGH = 2.0  # seconds of expected compiling after which this machine's speed is known


class Compiling(NamedTuple):
    """The progress of compiling.

    Attributes
    ----------
    number, total : int
        The kernel that is being compiled, from 1, and how many there will be.
    share : float
        Share of the time that is spent.
    seconds : float
        About how many seconds are left.
    """

    number: int
    total: int
    share: float
    seconds: float


class Backlog:
    """Kernels by name, in two queues: of this process and of the second one. Each compiles its queue one by one."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._rows: dict[bool, dict[str, float]] = {False: {}, True: {}}  # beside? -> kernel -> seconds it should take
        self._begun: dict[str, float] = {}  # kernel -> when its compiling began
        self._done, self._should, self._took = 0, 0.0, 0.0  # compiled kernels; their expected and actual seconds
        self._since: float | None = None

    def expect(self, kernels: dict[str, float], beside: bool = False) -> None:
        """Add kernels that will be compiled, with the seconds that each should take on a usual machine."""
        with self._lock:
            self._rows[beside].update(kernels)

    def begin(self, name: str, beside: bool = False) -> None:
        """Note that a kernel is being compiled."""
        with self._lock:
            self._rows[beside].setdefault(name, UNKNOWN)
            self._begun[name] = time.perf_counter()
            if self._since is None:
                self._since = self._begun[name]

    def end(self, name: str, beside: bool = False) -> None:
        """Note that a kernel is compiled."""
        with self._lock:
            should, begun = self._rows[beside].pop(name, None), self._begun.pop(name, None)
            if should is not None and begun is not None:
                self._done, self._should = self._done + 1, self._should + should
                self._took += time.perf_counter() - begun

    def drop(self, kernels: Iterable[str], beside: bool = False) -> None:
        """Remove kernels that will not be compiled there after all."""
        with self._lock:
            for name in kernels:
                self._rows[beside].pop(name, None)
                self._begun.pop(name, None)

    @property
    def state(self) -> Compiling | None:
        """The progress; None if no kernel is being compiled at this moment."""
        now = time.perf_counter()
        with self._lock:
            if not self._begun or self._since is None:
                return None
            pace = self._took / self._should if self._should > ENOUGH else 1.0
            rows = [{k: self._left(k, pace * cost, now) for k, cost in row.items()} for row in self._rows.values()]
            left = max(sum(row.values()) for row in rows)
            spent = now - self._since
            total = self._done + sum(map(len, self._rows.values()))
            return Compiling(self._done + 1, total, spent / (spent + left), left)

    def _left(self, name: str, cost: float, now: float) -> float:
        """Seconds that a kernel still takes."""
        begun = self._begun.get(name)
        return cost if begun is None else max(cost - (now - begun), 0.1 * cost)


class Counts:
    """What was compiled so far.

    kernels : how many, by this process or by a second one for it; loaded ones do not count
    seconds : spent with compiling them, or with waiting for the second process
    times : of each kernel compiled in this process, in seconds of processor time
    """

    def __init__(self) -> None:
        self.kernels, self.seconds = 0, 0.0
        self.times: dict[str, float] = {}


BACKLOG, COUNTS = Backlog(), Counts()


def compilations() -> int:
    """Number of kernels that this process compiled, or had compiled by a second process; loaded ones do not count."""
    return COUNTS.kernels


def compile_seconds() -> float:
    """How long this process has compiled kernels, or waited for kernels compiled by a second process."""
    return COUNTS.seconds


def compile_times() -> dict[str, float]:
    """Return the processor time that compiling each kernel took in this process, in seconds."""
    return dict(COUNTS.times)
