"""Workers that share a folder with this machine and can write there."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from ..base.disk_columns import refresh_listing
from ..model.model_file import Place, place_of
from .client import check_client
from .task_pool import TaskPool


def tasks_beside(client: Any, file: Path) -> TaskPool:
    """Return the workers of a client as a pool; all must see a file and be able to write beside it.

    Raises
    ------
    ValueError
        If the client is invalid, or a worker does not see the file; the message names the worker. Workers that join
        later and do not see it are ignored, with a warning.
    """
    check_client(client)
    ask = partial(_unseen, place_of(file))
    for reason in ask(client, list(client.nthreads())).values():
        raise ValueError(reason)
    return TaskPool(client, ask)


def _unseen(place: Place, client: Any, workers: list[str]) -> dict[str, str]:
    """Return a message for each worker, by address, that does not see a file or cannot write beside it."""
    folder = Path(place.path).parent.parent
    share = "all workers must share its file system"
    answers = client.run(_is_seen, place, workers=workers, on_error="return") if workers else {}
    return {
        worker: f"worker {worker} cannot read and write the folder {folder}: {share}"
        for worker, answer in answers.items()
        if answer is not True
    }


def _is_seen(place: Place) -> bool:
    """Return whether this process sees a file and can write into its folder and the parent folder."""
    folder = Path(place.path).parent
    try:
        for one in (folder.parent, folder):
            refresh_listing(one)
    except OSError:
        return False
    return place.is_there
