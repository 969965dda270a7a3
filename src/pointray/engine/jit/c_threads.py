"""Threads whose end other threads can detect, even if they end for lack of memory."""

from __future__ import annotations

import _thread
import weakref
from collections.abc import Callable


class _AliveToken:
    """Object that only a running thread references: a weak reference to it shows whether the thread is alive."""


def start(work: Callable[[], None]) -> Callable[[], bool]:
    """Start a thread with C code only, and return a function that says whether the thread is alive.

    Thread.start, Thread.join and Event.wait are avoided: a Ctrl-C within their Python code may leave their locks held
    forever, or release them twice (Python 3.11).

    work : the function that the thread calls

    Raises
    ------
    RuntimeError
        If there is no memory for the thread's stack.
    """
    token = _AliveToken()
    _thread.start_new_thread(lambda _token: work(), (token,))
    token_ref = weakref.ref(token)
    return lambda: token_ref() is not None
