"""Threads of lower priority than those that draw, on systems where each thread has its own niceness."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

HAS_THREAD_NICENESS = sys.platform == "linux"  # elsewhere niceness applies to the whole process
# Niceness of background work. A drawing thread gets 1.6, 3, 6 and 9 times the CPU time of such a thread.
ROUGH_LIGHT, PARTS, LEVELS, FINE_LIGHT = 2, 5, 8, 10
MAX_NICE = 19


def run_niced(nice: int, work: Callable[[], T]) -> T:
    """Run `work` in a thread of lower priority, which threads started by it inherit; return its result.

    nice : added to the niceness of the caller; without effect on systems other than Linux
    """
    results: list[T] = []
    errors: list[BaseException] = []

    def body() -> None:
        try:
            lower_priority(nice)
            results.append(work())
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=body, name="pointray-baking", daemon=True)
    thread.start()
    thread.join()
    if errors:
        raise errors.pop()  # pop: its traceback refers to this list, and the cycle would keep what work() held alive
    return results[0]


def lower_priority(nice: int) -> None:
    """Lower the priority of this thread permanently, on Linux only. nice : added to its niceness"""
    if HAS_THREAD_NICENESS:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), min(os.nice(0) + nice, MAX_NICE))
