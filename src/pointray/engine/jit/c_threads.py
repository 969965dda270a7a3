"""A thread of which others know when it has ended, also where there was no memory for it to say so."""

from __future__ import annotations

import _thread
import weakref
from collections.abc import Callable


class _Life:
    """What lives as long as the thread that it was given to."""


def start(work: Callable[[], None]) -> Callable[[], bool]:
    """Start a thread, all of it in C; returns a function that tells whether the thread is still there.

    A Ctrl-C within the Python code of Thread.start, Thread.join or Event.wait may leave their locks held for ever, or
    release them twice (Python 3.11).

    Raises
    ------
    RuntimeError
        If there is no memory for the thread's stack.
    """
    life = _Life()
    _thread.start_new_thread(lambda _life: work(), (life,))
    told = weakref.ref(life)
    return lambda: told() is not None
