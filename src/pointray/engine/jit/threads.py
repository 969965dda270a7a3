"""Execution of kernels on all cores: tiles from a shared counter, progress, Ctrl-C."""

from __future__ import annotations

import os
import queue
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from .arrays import fetch_add, peek
from .c_threads import start
from .decorators import inline
from .numbers import Array
from .second_process import wait_for

# Slots shared by a kernel and its caller: int64, a cache line apart.
NEXT, TOTAL, CANCEL, SLOTS = 0, 8, 16, 24


class Cancel:
    """Cancellation of a kernel's run: calling the object stops its threads between two tiles (units of work).

    A run that begins after the call is cancelled at once.
    """

    def __init__(self) -> None:
        self.wanted = False
        self._work: np.ndarray[Any, Any] | None = None

    def __call__(self) -> None:
        self.wanted = True
        if self._work is not None:
            self._work[CANCEL] = 1

    def watch(self, work: np.ndarray[Any, Any]) -> None:
        """Make a run the one to cancel. work : array that its threads share, with the flag that they poll"""
        self._work = work
        if self.wanted:  # called before the run began
            work[CANCEL] = 1


@inline
def next_tile(work: Array) -> int:
    """Take the next tile (unit of work) of a run and return its number, or -1 if none is left or the run is cancelled.

    work : array that the run's threads share, with the counter of tiles
    """
    # Loops fetch tiles at two places: Numba 0.68 cannot type `while (tile := next_tile(work)) >= 0`.
    if peek(work, CANCEL) != 0:
        return -1
    tile = fetch_add(work, NEXT, 1)
    return tile if tile < work[TOTAL] else -1


@inline
def cancelled(work: Array) -> bool:
    """Return whether a kernel's run is cancelled. work : array that the run's threads share, with the flag"""
    return peek(work, CANCEL) != 0


def thread_count(threads: int | None = None) -> int:
    """Return the number of threads: the argument, else `POINTRAY_THREADS`, else all CPUs that this process may use."""
    if threads is None:
        text = os.environ.get("POINTRAY_THREADS", "")
        if not text:
            return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        try:
            threads = int(text)
        except ValueError:
            raise ValueError(f"POINTRAY_THREADS must be an integer, got {text!r}") from None
    if threads < 1:
        raise ValueError(f"threads must be at least 1, got {threads}")
    return threads


def run(
    kernel: Callable[..., Any],
    tiles: int,
    *args: Any,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
    cancel: Cancel | None = None,
    first: int = 0,
) -> list[Any]:
    """Run `kernel(work, *args)` in worker threads that call `next_tile(work)` until no tile is left.

    A tile is any unit of work. The caller only waits, so that Ctrl-C gets through. Ctrl-C and `cancel` stop the kernels
    between two tiles. Returns a list of the threads' results; it is empty if cancelled while the kernel is compiled.

    tiles : number of tiles; first : number of the first one
    threads : number of threads; None for `POINTRAY_THREADS`, else all CPUs
    progress : called with the share of tiles taken, about ten times a second
    """
    if not wait_for(kernel, lambda: cancel is not None and cancel.wanted):
        return []
    work = np.zeros(SLOTS, np.int64)
    work[NEXT], work[TOTAL] = first, first + tiles
    if cancel is not None:
        cancel.watch(work)
    results: list[Any] = []
    errors: list[BaseException] = []
    # The caller waits in C, see `c_threads.start`.
    done: queue.SimpleQueue[None] = queue.SimpleQueue()

    def worker() -> None:
        try:
            results.append(kernel(work, *args))
        except BaseException as error:
            errors.append(error)
            work[CANCEL] = 1
        finally:
            done.put(None)

    started: list[Callable[[], bool]] = []
    try:
        for _ in range(min(thread_count(threads), max(tiles, 1))):
            started += _start(worker, needed=not started)
        while len(results) + len(errors) < len(started):
            try:
                done.get(timeout=0.1)
            except queue.Empty:
                # All threads have ended, one without a result: it ran out of memory.
                if not any(is_alive() for is_alive in started) and len(results) + len(errors) < len(started):
                    raise MemoryError("out of memory in a worker thread") from None
                if progress is not None:
                    progress(min((work[NEXT] - first) / max(tiles, 1), 1.0))
    except BaseException:
        # A worker may be inside the compiler, which cannot be interrupted: wait briefly, then abandon it.
        work[CANCEL] = 1
        end = time.monotonic() + 0.3
        with suppress(queue.Empty):
            while len(results) + len(errors) < len(started):
                done.get(timeout=max(0.0, end - time.monotonic()))
        raise
    if errors:
        raise errors[0]
    return results


def _start(worker: Callable[[], None], needed: bool) -> list[Callable[[], bool]]:
    """Start a worker thread if there is memory for its stack.

    needed : whether to raise RuntimeError without memory, as for the first thread

    Returns a list with one function, which says whether the thread is alive; an empty list if there is no memory.
    """
    try:
        return [start(worker)]
    except RuntimeError:
        if needed:
            raise
        return []
