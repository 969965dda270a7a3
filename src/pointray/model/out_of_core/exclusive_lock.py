"""Lock on a folder: one process at a time works in it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path


@contextmanager
def exclusive_lock(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes for a `with` block.

    The lock is omitted on a file system without locks, and on Windows, where the owner could not remove its open file.

    Raises
    ------
    ValueError
        If another process holds the lock or has just removed the folder.
    """
    from filelock import FileLock, Timeout  # takes 50 ms, so only here

    with ExitStack() as stack:
        try:
            if sys.platform != "win32":
                stack.enter_context(FileLock(folder / "lock", blocking=False, fallback_to_soft=False))
        except Timeout:
            message = f"{folder.parent}: another process is preparing a model in this folder"
            raise ValueError(message) from None
        except OSError:  # file system without locks
            pass
        yield
