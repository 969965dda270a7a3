"""Files -> a model in parts, whatever their size: an interrupted run goes on where it stopped."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..memory import available_memory
from ..model_folder import INDEX, UNFINISHED
from ..points.files import headers, open_files, stamp
from ..points.formats._source import Request
from ..points.ready import PEAK
from ..points.replacing import check_writable
from ..points.selection import Selection
from ..progress import Progress, part_of
from ..tree.settings import TreeSettings
from .columns import Columns
from .large import Large, Wanted
from .spool import spool
from .spooled import spooled_in

if sys.platform != "win32":
    import fcntl

TASK = "task"  # what is known of the files and settings, there
SPOOLED = 0.25  # share of the time
# Bytes at the peak: of a point of a part, with its share of a margin; of all else, the sample of the cloud included.
EACH, REST, LEAST = 600, 3 << 28, 3 << 29


def part_points_within(memory: int) -> int:
    """How many points a part may have so that preparing takes no more than so many bytes, a power of two."""
    if memory < LEAST:
        raise ValueError(
            f"parts cannot be made in {memory / 2**30:.2f} GiB of memory: {LEAST / 2**30:.1f} GiB are needed"
        )
    return 1 << (((memory - REST) // EACH).bit_length() - 1)


def fits(files: Sequence[Path], request: Request, memory: int | None) -> bool:
    """Whether a model of all points of files can be made in memory, or in so much of it."""
    need = sum(listing.rows * (listing.row + PEAK) for _, _, listing in headers(files, request))
    free = available_memory() if memory is None else memory
    return free is None or need <= free


def prepare(
    files: Sequence[Path],
    reading: tuple[Request, Selection],
    path: Path,
    settings: tuple[TreeSettings, str | float],
    part_points: int,
    progress: Progress | None = None,
    levels: bool = True,
) -> int:
    """Write a model in parts, see `Model`; returns how many points it has.

    Parameters
    ----------
    reading : Request and Selection
        Which points are read, and how.
    path : path
        A folder, which must be empty, not exist, or hold what an interrupted run has left.
    settings : TreeSettings, and the noise's deviation or "auto"
    part_points : int
        Of a part, at most.
    levels : bool
        Whether parts get levels of detail.

    Raises
    ------
    OSError
        If a file cannot be read or written.
    ValueError
        If a file is damaged, the folder holds something else, or another process works there.
    """
    there = path.exists()
    columns = Columns(check_unfinished(path))
    size = 1 << (part_points.bit_length() - 1)
    wanted = Wanted(settings[0], settings[1], size, levels)
    with _alone(columns.folder):
        _check_task(columns, {**_task_of(files, reading, settings, size), "levels": levels})
        try:
            spooled = spooled_in(columns)
            if spooled is None:
                with open_files(files, reading[0]) as openers:
                    spooled = spool(openers, reading[1], columns, part_of(progress, 0.0, SPOOLED))
            Large(path, columns, spooled, wanted, part_of(progress, SPOOLED, 1.0)).build()
        except BaseException:  # Ctrl-C too
            if spooled_in(columns) is None:  # nothing is worth to be kept
                _remove(columns.folder, None if there else path)
            raise
        shutil.rmtree(columns.folder)
    return spooled.rows


def check_unfinished(path: Path) -> Path:
    """Where work in a folder is kept until it is done; an error if the folder holds something else."""
    unfinished = path / UNFINISHED
    others = path.exists() and (not path.is_dir() or any(path.iterdir()))
    if others and not unfinished.is_dir():
        raise ValueError(f"{path}: there is something already: name a new or an empty folder")
    check_writable(path / INDEX if path.exists() else path)
    return unfinished


def _task_of(
    files: Sequence[Path], reading: tuple[Request, Selection], settings: tuple[TreeSettings, str | float], size: int
) -> Mapping[str, Any]:
    """What must be the same for a run to go on with what another has left."""
    return {
        "files": [[str(file.resolve()), *stamp(file)] for file in files],
        "reading": [repr(one) for one in reading],
        "settings": [repr(one) for one in settings],
        "size": size,
    }


def _check_task(columns: Columns, task: Mapping[str, Any]) -> None:
    known = columns.get(TASK)
    if known is None:
        columns.put(TASK, task)
    elif known != task:
        what = next(name for name in task if known.get(name) != task[name])
        raise ValueError(
            f"{columns.folder.parent}: holds unfinished work of other {what}: "
            "go on with those, or remove the folder to begin anew"
        )


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other processes from working in a folder; ValueError if one does."""
    if sys.platform == "win32":
        yield
        return
    lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT, 0o666)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"{folder.parent}: another process prepares a model there just now") from None
        except OSError:  # a file system without locks
            pass
        yield
    finally:
        os.close(lock)


def _remove(unfinished: Path, folder: Path | None) -> None:
    """Remove what is unfinished, and the folder around it, if that was made for it."""
    with suppress(OSError):
        shutil.rmtree(unfinished)
        if folder is not None:
            folder.rmdir()
