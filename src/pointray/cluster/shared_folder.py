"""Workers who see a folder of this machine, and may write there."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from ..base.disk_columns import look_again
from ..model.model_file import Place, place_of
from .client import check_client
from .task_pool import TaskPool


def tasks_beside(client: Any, file: Path) -> TaskPool:
    """Return the workers of a client, who must see a file and may write beside it.

    Raises
    ------
    ValueError
        If the client is unfit, or a worker does not see the file; the message names the worker. Those that come later
        and do not see it are left out, with a warning.
    """
    check_client(client)
    ask = partial(_unseen, place_of(file))
    for reason in ask(client, list(client.nthreads())).values():
        raise ValueError(reason)
    return TaskPool(client, ask)


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
