"""Who works in a folder: one process, which shares the work with workers who see the same folder."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from ...base.disk_columns import look_again
from ...cluster.client import check_client
from ...cluster.task_pool import Team
from ..model_file import Place, place_of

if sys.platform != "win32":
    import fcntl

LOCK = "lock"


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Keep other processes from working in a folder; ValueError if one does."""
    if sys.platform == "win32":
        yield
        return
    lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _busy(folder) from None
        except OSError:  # a file system without locks
            pass
        if not _is_same(lock, folder / LOCK):  # who worked here has ended, and has removed the folder
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
    return ValueError(f"{folder.parent}: another process prepares a model there just now")


def team_for(client: Any, file: Path) -> Team | None:
    """The workers of a client who see a file, and write beside it; None if there is no client.

    Raises
    ------
    ValueError
        If the client is none, or a worker does not see the file; the message names the worker. Those that come later
        and do not see it are left out, with a warning.
    """
    if check_client(client) is None:
        return None
    ask = partial(_unseen, place_of(file))
    for reason in ask(client, list(client.nthreads())).values():
        raise ValueError(reason)
    return Team(client, ask)


def _unseen(place: Place, client: Any, workers: list[str]) -> dict[str, str]:
    """What is wrong with workers who do not see a file."""
    folder = Path(place.path).parent.parent
    share = "all must share its file system"
    answers = client.run(_is_seen, place, workers=workers, on_error="return") if workers else {}
    return {
        worker: f"worker {worker} does not see the folder {folder}, or must not write there: {share}"
        for worker, answer in answers.items()
        if answer is not True
    }


def _is_seen(place: Place) -> bool:
    """Whether this process sees a file, and may write beside it, and in the folder above."""
    folder = Path(place.path).parent
    try:
        for one in (folder.parent, folder):
            look_again(one)
    except OSError:
        return False
    return place.is_there
