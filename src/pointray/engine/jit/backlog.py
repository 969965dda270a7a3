"""Kernels waiting to be compiled, in this process and in a second one, and the time that will take."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from typing import NamedTuple

UNKNOWN = 1.0  # seconds assumed for a kernel of unknown compile time
ENOUGH = 2.0  # seconds of expected compile time after which the speed of this machine is taken into account


class Compiling(NamedTuple):
    """Progress of compilation.

    Attributes
    ----------
    number, total : int
        Number of the kernel being compiled, from 1, and the number of all.
    share : float
        Share of the time already spent, 0 to 1.
    seconds : float
        Estimated remaining time.
    """

    number: int
    total: int
    share: float
    seconds: float


class Backlog:
    """Two queues of kernels by name, one for each process. Each process compiles its queue one by one."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._rows: dict[bool, dict[str, float]] = {False: {}, True: {}}  # second process? -> kernel -> seconds
        self._begun: dict[str, float] = {}  # kernel -> start of its compilation
        self._done, self._should, self._took = 0, 0.0, 0.0  # compiled kernels; their expected and actual seconds
        self._since: float | None = None

    def expect(self, kernels: dict[str, float], beside: bool = False) -> None:
        """Add kernels to a queue, with their compile times in seconds on a typical machine."""
        with self._lock:
            self._rows[beside].update(kernels)

    def begin(self, name: str, beside: bool = False) -> None:
        """Mark a kernel as being compiled."""
        with self._lock:
            self._rows[beside].setdefault(name, UNKNOWN)
            self._begun[name] = time.perf_counter()
            if self._since is None:
                self._since = self._begun[name]

    def end(self, name: str, beside: bool = False) -> None:
        """Mark a kernel as compiled."""
        with self._lock:
            should, begun = self._rows[beside].pop(name, None), self._begun.pop(name, None)
            if should is not None and begun is not None:
                self._done, self._should = self._done + 1, self._should + should
                self._took += time.perf_counter() - begun

    def drop(self, kernels: Iterable[str], beside: bool = False) -> None:
        """Remove kernels that will not be compiled in that process."""
        with self._lock:
            for name in kernels:
                self._rows[beside].pop(name, None)
                self._begun.pop(name, None)

    @property
    def state(self) -> Compiling | None:
        """The progress, or None if no kernel is being compiled."""
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
        """Return the remaining compile time of a kernel, in seconds."""
        begun = self._begun.get(name)
        return cost if begun is None else max(cost - (now - begun), 0.1 * cost)


class Counts:
    """Statistics of compilation so far.

    kernels : number of kernels compiled by this process or for it by the second one, without loaded ones
    seconds : time spent compiling or waiting for the second process
    times : processor time of each kernel compiled in this process, in seconds
    """

    def __init__(self) -> None:
        self.kernels, self.seconds = 0, 0.0
        self.times: dict[str, float] = {}


BACKLOG, COUNTS = Backlog(), Counts()


def compilations() -> int:
    """Return the number of kernels compiled by this process or for it by the second one, without loaded ones."""
    return COUNTS.kernels


def compile_seconds() -> float:
    """Return the seconds that this process spent compiling or waiting for the second process."""
    return COUNTS.seconds


def compile_times() -> dict[str, float]:
    """Return the processor time of each kernel compiled in this process, in seconds."""
    return dict(COUNTS.times)
