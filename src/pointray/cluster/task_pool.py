"""Chores: functions that workers call with numbers, such as those of parts, without a scene.

A task does not ask whether anybody still wants it. So it runs in a thread of its own, which is ended from outside
while it waits for a kernel: elsewhere it may hold a lock, which would stay locked.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from ..base.disk_columns import look_again
from ..base.executor import Job, SharedValue
from ..base.progress import Progress
from ..engine.jit import run
from .recipe import Stage, pack, unpack
from .worker import DroppedError
from .worker_pool import Ask, WorkerPool

POLL = 0.1  # seconds between two looks whether a task is still wanted
AGAIN = 2.0  # seconds that a task which was told to end has for it
THREADS = "POINTRAY_THREADS"

T = TypeVar("T")


class _Nothing:
    """A scene without anything."""

    def __init__(self) -> None:
        self.baked, self.models = None, list[Any]()

    def copy(self) -> Stage:
        return self

    def snapshot(self) -> None:
        return None


class TaskPool:
    """The workers of a client, for tasks.

    Parameters
    ----------
    client : distributed.Client
        As `check_client` takes it.
    ask : callable, optional
        What is wrong with workers, see `WorkerPool`.
    """

    def __init__(self, client: Any, ask: Ask | None = None) -> None:
        self._pool = WorkerPool(client, _Nothing(), ask)

    def share(
        self, name: str, do: Callable[[int], T], numbers: Sequence[int], tick: Callable[[], None]
    ) -> Iterator[tuple[int, T]]:
        """Call a function with each of some numbers; yields each with what it gives, in the order in which it is ready.

        The function goes to each worker once, so that what is bound to it may be large. It may be called twice with
        the same number, at the same time too.

        name : what the dashboard shows; tick : called ten times a second, an error in it ends all
        """
        todo = SharedValue(name, pack(do))
        jobs = deque(Job(f"{name} {k}/{len(numbers)}", do_task, (n,), (todo,)) for k, n in enumerate(numbers, 1))
        for job, result in self._pool.run(jobs, tick):
            yield job.args[0], unpack(result)

    def refresh(self, folder: Path) -> None:
        """See what workers have written into a folder."""
        look_again(folder)


def do_task(scene: None, number: int, todo: bytes, threads: int | None, check: Progress | None) -> bytes:
    """Call a function on a worker; returns what it gives."""
    do = unpack(todo)
    with _on(threads):
        return pack(do(number) if check is None else stoppable(lambda: do(number), check))


def stoppable(work: Callable[[], T], check: Progress) -> T:
    """Do work in a thread. When `check` raises DroppedError it ends, as by `sys.exit`, while it waits for a kernel."""
    task, is_dropped, told = _Task(work), False, -AGAIN
    task.start()
    while task.is_alive():
        task.join(POLL)
        try:
            check(0.0)
        except DroppedError:
            is_dropped = True
            if time.monotonic() - told > AGAIN and task.end():
                told = time.monotonic()
    if is_dropped:
        raise DroppedError
    if isinstance(task.error, Exception):
        raise task.error
    if task.error is not None:  # it would end the worker
        raise RuntimeError("a task was ended") from task.error
    result: T = task.result
    return result


class _Task(threading.Thread):
    """Work in a thread. result, error : what came of it"""

    def __init__(self, work: Callable[[], Any]) -> None:
        super().__init__(daemon=True)
        self._work = work
        self.result: Any = None
        self.error: BaseException | None = None
        self._ending = threading.Lock()

    def run(self) -> None:
        """See `Thread`."""
        try:
            self.result = self._work()
        except BaseException as error:
            self.error = error
        self._ending.acquire()  # when this thread has ended another one may get its number, which `end` uses

    def end(self) -> bool:
        """Raise SystemExit in this thread, if it waits for kernels; whether it does."""
        if not self._ending.acquire(blocking=False):
            return False
        try:
            found = self._waits_for_kernels()
            if found:
                exception = ctypes.py_object(SystemExit)
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self.ident or 0), exception)
            return found
        finally:
            self._ending.release()

    def _waits_for_kernels(self) -> bool:
        """Whether this thread does nothing but wait for the kernels that it runs."""
        frame = sys._current_frames().get(self.ident or 0)
        while frame is not None and frame.f_code.co_filename == threading.__file__:
            frame = frame.f_back
        if frame is None or frame.f_code is not run.__code__:
            return False
        while frame is not None and frame.f_code is not _Task.run.__code__:
            frame = frame.f_back
        return frame is not None and frame.f_locals["self"] is self


_LOCK, _BEFORE = threading.Lock(), list[str | None]()  # of the tasks in this process


@contextmanager
def _on(threads: int | None) -> Iterator[None]:
    """Have kernels use so many threads. Workers in one process have as many each, which the last of them sets back."""
    if threads is None:
        yield
        return
    with _LOCK:
        _BEFORE.append(os.environ.get(THREADS))
        os.environ[THREADS] = str(threads)
    try:
        yield
    finally:
        with _LOCK:
            before = _BEFORE.pop()
            if not _BEFORE:
                os.environ.pop(THREADS)
                if before is not None:
                    os.environ[THREADS] = before
