"""Compilation of kernels in a second process, while this process continues with other work."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from .backlog import BACKLOG, COUNTS
from .decorators import KERNELS

if TYPE_CHECKING:
    import subprocess

STEP = 0.02  # seconds between two checks for cancellation

_lock = threading.Lock()
_pending: dict[str, threading.Event] = {}  # kernels of the second process; the event is set when compiled


def compile_in_background(module: str, kernels: dict[str, float]) -> None:
    """Compile kernels in a second process, `python -m module NAME...`, unless they are compiled. Returns at once.

    The process prints the name of each kernel on a line when it is on disk, and ends when its input ends. `run` waits
    for a kernel that is being compiled. If the process fails, kernels are compiled where they are used.

    Parameters
    ----------
    module : str
        A module that compiles the kernels named by its arguments when it is run.
    kernels : dict
        Names in `KERNELS`, in the order of use, and their expected compile times in seconds.
    """
    with _lock:
        wanted = {k: cost for k, cost in kernels.items() if k not in _pending and not KERNELS[k].is_compiled}
        if not wanted or not _has_cache_folder():
            return
        import subprocess  # takes 10 ms, which are saved if kernels are compiled

        command, pipe = [sys.executable, "-m", module, *wanted], subprocess.PIPE
        try:
            process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True)
        except OSError:
            return
        _pending.update({name: threading.Event() for name in wanted})
    BACKLOG.expect(wanted, in_second_process=True)
    threading.Thread(target=_follow, args=(process, list(wanted)), name="pointray-compiling", daemon=True).start()


def _has_cache_folder() -> bool:
    """Return whether there is a folder on disk through which a second process can pass compiled kernels to this one."""
    from .disk_cache import cache_folder

    return cache_folder() is not None


def wait_for(kernel: Any, is_cancelled: Callable[[], bool]) -> bool:
    """Wait until the second process has compiled a kernel, if it is to compile it.

    Returns False if `is_cancelled` becomes true first.
    """
    event = next((event for name, event in list(_pending.items()) if KERNELS[name] is kernel), None)
    if event is None:
        return True
    started = time.perf_counter()
    # Event.wait is avoided: a Ctrl-C within it may leave its lock held, and the thread that sets the event would hang.
    while not event.is_set() and not is_cancelled():
        time.sleep(STEP)
    COUNTS.seconds += time.perf_counter() - started
    return event.is_set()


def _follow(process: subprocess.Popen[str], names: list[str]) -> None:
    """Read from the second process which kernels are compiled; wake the threads that wait for them.

    When the process ends, all waiting threads are woken.

    names : of the kernels that the process compiles, in order
    """
    left = list(names)
    BACKLOG.begin(left[0], in_second_process=True)
    with process, suppress(OSError, ValueError):
        for line in process.stdout or ():
            if line.strip() not in left:
                continue
            left.remove(line.strip())
            BACKLOG.end(line.strip(), in_second_process=True)
            COUNTS.kernels += 1
            if left:
                BACKLOG.begin(left[0], in_second_process=True)
            _mark_compiled([line.strip()])
    BACKLOG.drop(left, in_second_process=True)
    _mark_compiled(left)


def _mark_compiled(names: Iterable[str]) -> None:
    with _lock:
        for name in names:
            _pending.pop(name).set()
