"""Kernels waiting to be compiled, in this process and in a second one, and the time that will take."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from typing import NamedTuple

UNKNOWN = 1.0  # seconds assumed for a kernel of unknown compile time
ENOUGH = 2.0  # seconds of expected compile time after which the speed of this machine is taken into account


class Compiling(NamedTuple):
    """State of the compilation of kernels, for a progress display.

    Attributes
    ----------
    number, total : int
        Number of the kernel being compiled, from 1, and the number of all.
    share : float
        Time already spent, as a share of the estimated total, 0 to 1.
    seconds : float
        Estimated remaining time.
    """

    number: int
    total: int
    share: float
    seconds: float


class Backlog:
    """Kernels still to be compiled, by name, from which the remaining time is estimated.

    There are two queues: of this process, and of a second one that compiles in parallel. Each compiles one by one.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._queues: dict[bool, dict[str, float]] = {False: {}, True: {}}  # second process? -> kernel -> seconds
        self._started: dict[str, float] = {}  # kernel -> start of its compilation
        self._done, self._expected_seconds, self._actual_seconds = 0, 0.0, 0.0  # of compiled kernels
        self._since: float | None = None

    def expect(self, kernels: dict[str, float], in_second_process: bool = False) -> None:
        """Add kernels to a queue. kernels : compile time of each on a typical machine, in seconds, by name"""
        with self._lock:
            self._queues[in_second_process].update(kernels)

    def begin(self, name: str, in_second_process: bool = False) -> None:
        """Mark a kernel as being compiled from now on; its time is measured."""
        with self._lock:
            self._queues[in_second_process].setdefault(name, UNKNOWN)
            self._started[name] = time.perf_counter()
            if self._since is None:
                self._since = self._started[name]

    def end(self, name: str, in_second_process: bool = False) -> None:
        """Mark a kernel as compiled and remove it from its queue.

        Its compile time corrects the estimates for the speed of this machine.
        """
        with self._lock:
            expected, started = self._queues[in_second_process].pop(name, None), self._started.pop(name, None)
            if expected is not None and started is not None:
                self._done, self._expected_seconds = self._done + 1, self._expected_seconds + expected
                self._actual_seconds += time.perf_counter() - started

    def drop(self, kernels: Iterable[str], in_second_process: bool = False) -> None:
        """Remove kernels that this process, or the second one, will not compile after all. kernels : their names"""
        with self._lock:
            for name in kernels:
                self._queues[in_second_process].pop(name, None)
                self._started.pop(name, None)

    @property
    def state(self) -> Compiling | None:
        """The progress of compilation with the estimated remaining time; None if no kernel is being compiled."""
        now = time.perf_counter()
        with self._lock:
            if not self._started or self._since is None:
                return None
            pace = self._actual_seconds / self._expected_seconds if self._expected_seconds > ENOUGH else 1.0
            queues = [
                {k: self._left(k, pace * cost, now) for k, cost in queue.items()} for queue in self._queues.values()
            ]
            left = max(sum(queue.values()) for queue in queues)
            spent = now - self._since
            total = self._done + sum(map(len, self._queues.values()))
            return Compiling(self._done + 1, total, spent / (spent + left), left)

    def _left(self, name: str, cost: float, now: float) -> float:
        """Return the remaining compile time of a kernel, in seconds.

        cost : expected total time, in seconds; now : `time.perf_counter`
        """
        started = self._started.get(name)
        return cost if started is None else max(cost - (now - started), 0.1 * cost)


class Counts:
    """Statistics of the compilation of kernels by this process so far.

    kernels : number of kernels compiled by this process, or for it by a second one, without those loaded from disk
    seconds : time spent compiling or waiting for the second process
    times : processor time of each kernel compiled in this process, in seconds
    """

    def __init__(self) -> None:
        self.kernels, self.seconds = 0, 0.0
        self.times: dict[str, float] = {}


BACKLOG, COUNTS = Backlog(), Counts()


def compilations() -> int:
    """Return how many kernels were compiled so far by this process, or for it by a second one in parallel.

    Kernels loaded from disk do not count.
    """
    return COUNTS.kernels


def compile_seconds() -> float:
    """Return the seconds that this process spent compiling, or waiting for the second process that compiles for it."""
    return COUNTS.seconds


def compile_times() -> dict[str, float]:
    """Return the processor time of each kernel compiled in this process, in seconds, by the kernel's name."""
    return dict(COUNTS.times)
