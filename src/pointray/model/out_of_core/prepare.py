"""Preparation of a model in parts from files of any size; an interrupted run can be resumed."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ...base.atomic_write import check_writable
from ...base.disk_columns import Columns
from ...base.executor import backend, tasks_beside
from ...base.memory import FULL_DISK, available_memory
from ...base.progress import Progress, part_of
from ...base.version import __version__
from ...cloud.preparation import PEAK
from ...io.files import headers, open_files
from ...io.formats._source import Request
from ...io.inputs import identity_of, stamp
from ...io.remote.remote_file import Location
from ...io.selection import Selection
from ...io.spooling.spool import spool
from ...io.spooling.spooled import spooled_in
from ...surface.splats.scattered.spheres import Drawing
from ...surface.tree.settings import TreeSettings
from ..model_folder import INDEX, UNFINISHED, VERSION
from .builder import BuildOptions, OutOfCoreBuilder
from .exclusive_lock import exclusive_lock
from .split import check_new, not_empty

TASK = "task"  # facts about the files and settings of the unfinished work
SPOOLED = 0.25  # progress after spooling
UNKNOWN = 1 << 32  # bytes, if the available memory is unknown
# Bytes at the peak: per point of a part, including its share of a margin; for everything else, including the sample.
EACH, REST, LEAST = 600, 3 << 28, 3 << 29
PROCESS, FEWEST = 1 << 28, 1 << 18  # bytes of a worker without points; points of a part that must fit, at least
ATTEMPTS, PAUSE = 20, 0.5  # attempts to remove the folder; seconds between them


def part_points_within(memory: int, workers: int = 0) -> int:
    """Return the largest part size in points, a power of two, with which preparation takes at most `memory` bytes.

    workers : processes that make parts at the same time, besides this one; 0: this one does

    Raises
    ------
    ValueError
        If the memory is not enough for the smallest parts.
    """
    rest, each = REST + workers * PROCESS, EACH * max(workers, 1)
    least = rest + each * FEWEST if workers else LEAST
    if memory < least:
        raise ValueError(
            f"not enough memory: {memory / 2**30:.2f} GiB, but {least / 2**30:.1f} GiB are needed"
            + (f" with {workers} workers on one machine" if workers else "")
        )
    return 1 << (((memory - rest) // each).bit_length() - 1)


def part_points_for(client: Any, memory: int | None) -> int:
    """Return the largest part size in points, a power of two, with which each machine has enough memory.

    client : Dask client of the workers, or None; memory : bytes per machine, None: what is available
    """
    if client is None:
        return part_points_within(memory or available_memory() or UNKNOWN)
    machines = backend().machines_of(client)
    most = max((sharing for _, sharing in machines), default=1)
    return part_points_within(memory or min((free or UNKNOWN for free, _ in machines), default=UNKNOWN), most)


def unfinished_part_points(path: Path) -> int | None:
    """Return the part size in points of an interrupted preparation in a folder; None if there is none."""
    known = Columns(path / UNFINISHED).get(TASK) if (path / UNFINISHED).is_dir() else None
    size = None if known is None else known.get("size")
    return size if isinstance(size, int) and size > 0 else None


def fits(files: Sequence[Location], request: Request, memory: int | None) -> bool:
    """Return whether a model of all points of the files can be made in the available memory, or in `memory` bytes.

    request : options of the formats, such as the columns of a text file
    """
    need = sum(listing.rows * (listing.row + PEAK) for _, _, listing in headers(files, request))
    free = available_memory() if memory is None else memory
    return free is None or need <= free


def prepare(
    files: Sequence[Location],
    reading: tuple[Request, Selection],
    path: Path,
    settings: tuple[TreeSettings, str | float] | tuple[TreeSettings, str | float, Drawing | None],
    part_points: int,
    progress: Progress | None = None,
    client: Any = None,
    levels: bool = True,
) -> int:
    """Write a model in parts from files of any size; return the number of points.

    An interrupted run is resumed. With a Dask client, its workers make the parts and write them. The files are the same
    as without.

    Parameters
    ----------
    files : sequence of Path
        Scans, read as one cloud.
    reading : Request and Selection
        Which points are read, and how.
    path : path
        A folder that is empty, does not exist, or holds the unfinished work of an interrupted run.
    settings : TreeSettings, noise ("auto" or its standard deviation), and optionally Drawing
        Drawing of points that lie on no surface; None or omitted: as spheres, but like the surface if there are radii.
    part_points : int
        Points of a part, at most; rounded down to a power of two.
    progress : callable, optional
        Called with the fraction done.
    client : distributed.Client, optional
        Its workers must see the folder at the same path and be able to write to it.
    levels : bool
        Whether parts get levels of detail.

    Raises
    ------
    OSError
        If a file cannot be read or written.
    ValueError
        If a file is damaged, the folder holds something else, another process works in it, or a worker does not see the
        folder or has another version of pointray.
    """
    there, path = path.exists(), path if client is None else path.absolute()
    columns = Columns(check_unfinished(path))
    size = 1 << (part_points.bit_length() - 1)
    options = BuildOptions(settings[0], settings[1], size, levels, settings[2] if len(settings) > 2 else None)
    with exclusive_lock(columns.folder), _explain_full_disk(path):
        if columns.get(TASK) is None and (path / INDEX).exists():
            _remove(columns.folder, None)
            raise not_empty(path)
        _check_task(columns, {**_task_of(files, reading, settings, size), "levels": levels})
        try:
            tasks = tasks_beside(client, columns.folder / f"{TASK}.json")
            spooled = spooled_in(columns)
            if spooled is None:
                with open_files(files, reading[0]) as openers:
                    spooled = spool(openers, reading[1], columns, part_of(progress, 0.0, SPOOLED))
            count = OutOfCoreBuilder(path, columns, spooled, options, part_of(progress, SPOOLED, 1.0), tasks).build()
        except BaseException:  # Ctrl-C too
            if spooled_in(columns) is None:  # nothing is worth keeping
                _remove(columns.folder, None if there else path)
            raise
        _remove(columns.folder, None)
    return count


@contextmanager
def _explain_full_disk(path: Path) -> Iterator[None]:
    """Add advice on how to resume to an error in the `with` block that reports a full disk.

    path : folder of the model
    """
    try:
        yield
    except OSError as error:
        if error.errno not in FULL_DISK:
            raise
        advice = f"{error.strerror}: free some space and run the same command again to resume"
        raise OSError(error.errno, advice, str(error.filename or path)) from error


def check_unfinished(path: Path) -> Path:
    """Return the subfolder for unfinished work in the folder of a model in parts.

    Raises
    ------
    ValueError
        If the folder holds something else, such as a finished model.
    """
    unfinished = path / UNFINISHED
    if unfinished.is_dir():
        check_writable(path / INDEX)
    else:
        check_new(path)
    return unfinished


def _task_of(
    files: Sequence[Location], reading: tuple[Request, Selection], settings: tuple[Any, ...], size: int
) -> Mapping[str, Any]:
    """Return the facts that must be the same to resume an interrupted preparation: files, options, part size, version.

    reading : which points are read, and how; settings : of the model; size : points of a part
    """
    return {
        "files": [[identity_of(file), *stamp(file)] for file in files],
        "reading": [repr(one) for one in reading],
        "settings": [repr(one) for one in settings],
        "size": size,
        "version": [__version__, VERSION],
    }


def _check_task(columns: Columns, task: Mapping[str, Any]) -> None:
    known = columns.get(TASK)
    if known is None:
        # The id is derived from the task: other points or settings give another id.
        columns.put("id", {"id": hashlib.sha256(json.dumps(task).encode()).hexdigest()[:16]})
        columns.put(TASK, task)
    elif known != task:
        what = next(name for name in task if known.get(name) != task[name])
        raise ValueError(
            f"{columns.folder.parent}: contains unfinished work with different {what}: "
            "use the same to resume, or remove the folder to start over"
        )


def _remove(unfinished: Path, folder: Path | None) -> None:
    """Remove unfinished work, and the folder around it if given and empty."""
    for _ in range(ATTEMPTS):
        shutil.rmtree(unfinished, ignore_errors=True)
        if not unfinished.exists():
            break
        time.sleep(PAUSE)  # a worker whose job another one has finished writes here until it notices
    if folder is not None:
        with suppress(OSError):
            folder.rmdir()
