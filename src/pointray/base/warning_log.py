"""Warnings of the package, which threads can silence or collect each for itself.

`warnings.catch_warnings` changes a setting of the whole process: two threads that use it at the same time leave each
other's setting behind.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_HEARD: ContextVar[list[str] | None] = ContextVar("heard", default=None)


def warn(message: str, category: type[Warning] = UserWarning, stacklevel: int = 1) -> None:
    """Give a warning, as `warnings.warn` does; in `heard` it is collected."""
    heard = _HEARD.get()
    if heard is None:
        warnings.warn(message, category, stacklevel=stacklevel + 1)
    else:
        heard.append(message)


@contextmanager
def heard() -> Iterator[list[str]]:
    """Collect the warnings that this thread gives within; they are shown to nobody."""
    found: list[str] = []
    token = _HEARD.set(found)
    try:
        yield found
    finally:
        _HEARD.reset(token)
