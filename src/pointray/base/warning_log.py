"""Warnings of the package, which each thread can collect separately.

`warnings.catch_warnings` changes a setting of the whole process: if two threads use it at the same time, the setting of
one may remain.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_COLLECTED: ContextVar[list[str] | None] = ContextVar("collected", default=None)


def warn(message: str, category: type[Warning] = UserWarning, stacklevel: int = 1) -> None:
    """Issue a warning like `warnings.warn`; within `collect_warnings`, collect its message instead."""
    collected = _COLLECTED.get()
    if collected is None:
        warnings.warn(message, category, stacklevel=stacklevel + 1)
    else:
        collected.append(message)


@contextmanager
def collect_warnings() -> Iterator[list[str]]:
    """Yield a list that receives the messages of this thread's warnings, which are then not shown.

    Only warnings issued by `warning_log.warn` are collected.
    """
    found: list[str] = []
    token = _COLLECTED.set(found)
    try:
        yield found
    finally:
        _COLLECTED.reset(token)
