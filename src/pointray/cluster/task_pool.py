"""Tasks: calls of a function with numbers, such as those of parts, on workers. They use no scene.

Tasks do not poll for cancellation. A task runs in a thread of its own, which is ended from outside while it waits for a
kernel. Elsewhere it may hold a lock, which would stay locked.
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

from ..base.disk_columns import refresh_listing
from ..base.executor import Job, SharedValue
from ..base.progress import Progress
from ..engine.jit import run
from .recipe import SceneLike, pack, unpack
from .worker import DroppedError
from .worker_pool import WorkerCheck, WorkerPool

POLL = 0.1  # seconds between two checks for cancellation
INTERRUPT_AGAIN = 2.0  # seconds until a cancelled task is interrupted again
THREADS = "POINTRAY_THREADS"

T = TypeVar("T")


class _EmptyScene:
    """A scene without contents, for workers whose tasks need none."""

    def __init__(self) -> None:
        self.baked, self.models = None, list[Any]()

    def copy(self) -> SceneLike:
        return self

    def snapshot(self) -> None:
        return None


class TaskPool:
    """Workers of a client that do tasks: calls of a function with numbers, such as part numbers, without a scene.

    Parameters
    ----------
    client : distributed.Client
        One with workers, as checked by `check_client`.
    ask : callable, optional
        Called with the client and addresses of workers, returns the reason for each one that must not be used.
    """

    def __init__(self, client: Any, ask: WorkerCheck | None = None) -> None:
        self._pool = WorkerPool(client, _EmptyScene(), ask)

    def share(
        self, name: str, do: Callable[[int], T], numbers: Sequence[int], tick: Callable[[], None]
    ) -> Iterator[tuple[int, T]]:
        """Call a function with each number on any worker; yield numbers and results in the order of completion.

        The function is sent to each worker once, so data bound to it may be large. It may be called twice with the same
        number, even at the same time.

        name : shown on the dashboard; tick : called ten times a second; an exception in it stops all tasks
        """
        todo = SharedValue(name, pack(do))
        jobs = deque(Job(f"{name} {k}/{len(numbers)}", do_task, (n,), (todo,)) for k, n in enumerate(numbers, 1))
        for job, result in self._pool.run(jobs, tick):
            yield job.args[0], unpack(result)

    def refresh(self, folder: Path) -> None:
        """Make files that workers have written into a shared folder visible here, despite an outdated listing."""
        refresh_listing(folder)


def do_task(scene: None, number: int, todo: bytes, threads: int | None, check: Progress | None) -> bytes:
    """Call a function with a number on a worker and return the pickled result. Each job of a `TaskPool` runs this.

    scene : not used; todo : the function to call, pickled; threads : limit of the threads of kernels
    check : raises DroppedError if the result is no longer needed; None: not called
    """
    do = unpack(todo)
    with _thread_limit(threads):
        return pack(do(number) if check is None else stoppable(lambda: do(number), check))


def stoppable(work: Callable[[], T], check: Progress) -> T:
    """Return the result of `work`, called in another thread, which is ended if the result is no longer needed.

    check : called ten times a second. If it raises DroppedError, the thread is ended by SystemExit as soon as it waits
        for a kernel, and DroppedError is raised here.
    """
    task, is_dropped, interrupted_at = _Task(work), False, -INTERRUPT_AGAIN
    task.start()
    while task.is_alive():
        task.join(POLL)
        try:
            check(0.0)
        except DroppedError:
            is_dropped = True
            if time.monotonic() - interrupted_at > INTERRUPT_AGAIN and task.end():
                interrupted_at = time.monotonic()
    if is_dropped:
        raise DroppedError
    if isinstance(task.error, Exception):
        raise task.error
    if task.error is not None:  # SystemExit would end the worker
        raise RuntimeError("a task was ended") from task.error
    result: T = task.result
    return result


class _Task(threading.Thread):
    """Thread that keeps the result or the exception of its work, and can be ended from outside."""

    def __init__(self, work: Callable[[], Any]) -> None:
        super().__init__(daemon=True)
        self._work = work
        self.result: Any = None
        self.error: BaseException | None = None
        self._ending = threading.Lock()

    def run(self) -> None:
        """Do the work and keep its result or exception; overrides the method of `Thread`."""
        try:
            self.result = self._work()
        except BaseException as error:
            self.error = error
        self._ending.acquire()  # never released: `end` must not use the ident of this thread after it was reused

    def end(self) -> bool:
        """End this thread by SystemExit if it waits for a kernel; return whether it does.

        Elsewhere it may hold a lock, which would stay locked.
        """
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
        """Return whether this thread is inside `engine.jit.run`, waiting for the threads of a kernel to end."""
        frame = sys._current_frames().get(self.ident or 0)
        while frame is not None and frame.f_code.co_filename == threading.__file__:
            frame = frame.f_back
        if frame is None or frame.f_code is not run.__code__:
            return False
        while frame is not None and frame.f_code is not _Task.run.__code__:
            frame = frame.f_back
        return frame is not None and frame.f_locals["self"] is self


_LOCK, _SAVED_LIMITS = threading.Lock(), list[str | None]()  # settings before each task in this process


@contextmanager
def _thread_limit(threads: int | None) -> Iterator[None]:
    """Limit the threads of kernels by the environment variable POINTRAY_THREADS in this context; None: no limit.

    Workers in one process use the same limit; the last one restores the setting.
    """
    if threads is None:
        yield
        return
    with _LOCK:
        _SAVED_LIMITS.append(os.environ.get(THREADS))
        os.environ[THREADS] = str(threads)
    try:
        yield
    finally:
        with _LOCK:
            before = _SAVED_LIMITS.pop()
            if not _SAVED_LIMITS:
                os.environ.pop(THREADS)
                if before is not None:
                    os.environ[THREADS] = before
