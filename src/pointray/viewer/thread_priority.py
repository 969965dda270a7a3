"""Work that yields the processors to pictures: in threads of lower priority, where threads have one of their own."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

HAS_THREAD_NICENESS = sys.platform == "linux"  # elsewhere niceness is that of the whole process
# A thread of a picture gets 1.6, 3, 6 and 9 times as much of a processor as one of these.
ROUGH_LIGHT, PARTS, LEVELS, FINE_LIGHT = 2, 5, 8, 10
MAX_NICE = 19


def run_niced(nice: int, work: Callable[[], T]) -> T:
    """Do work in a thread that yields to others, as do those that it starts; a thread cannot take that back.

    nice : added to the niceness of the caller
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
        raise errors.pop()  # its traceback refers to this list: what work() had would wait for Python's collector
    return results[0]


def lower_priority(nice: int) -> None:
    """From now on this thread yields to others, which it cannot take back. nice : added to its niceness"""
    if HAS_THREAD_NICENESS:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), min(os.nice(0) + nice, MAX_NICE))
