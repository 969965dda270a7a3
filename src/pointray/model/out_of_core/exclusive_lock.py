"""Lock on a folder: one process at a time works in it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

if sys.platform != "win32":
    import fcntl

LOCK = "lock"


@contextmanager
def exclusive_lock(folder: Path) -> Iterator[None]:
    """Lock a folder; raise a ValueError if another process holds the lock."""
    if sys.platform == "win32":
        yield
        return
    lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _busy(folder) from None
        except OSError:  # file system without locks
            pass
        if not _is_same(lock, folder / LOCK):  # the previous owner has finished and removed the folder
            raise _busy(folder)
        yield
    finally:
        os.close(lock)


def _is_same(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def _busy(folder: Path) -> ValueError:
    return ValueError(f"{folder.parent}: another process is preparing a model in this folder")
