"""Executors do the jobs of a call: in this process, or on the workers of a cluster.

Rendering, baking and the preparation of models in parts make jobs; they know the protocols of this file, and nothing of
Dask. `cluster/`, which stands above them, has executors over Dask's workers, and is loaded when a client is given.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeVar

Client: TypeAlias = Any  # a dask.distributed.Client, or None: this process does the work

T = TypeVar("T")


@dataclass(eq=False)
class SharedValue:
    """A value that many jobs need. Each worker gets it once. name : what the dashboard shows"""

    name: str
    value: Any


@dataclass(frozen=True, eq=False)
class Job:
    """Work on a scene that any worker can do.

    Attributes
    ----------
    name : str
        What the dashboard shows.
    work : callable
        A function of a module. It takes the snapshot of the scene, `args`, the values of `shared`, a number of threads
        and a progress callback.
    args : tuple
    shared : tuple of SharedValue
    home : str
        The worker that does it, as long as it is there and not very slow; empty: any.
    """

    name: str
    work: Callable[..., Any]
    args: tuple[Any, ...]
    shared: tuple[SharedValue, ...] = ()
    home: str = ""


class Executor(Protocol):
    """Workers that do jobs on one scene, as it was when the executor was made.

    Attributes
    ----------
    workers : dict of str to int
        The threads of each worker, by its address.
    spread : bool
        Whether each worker opens only some parts of models in parts: whoever makes jobs sees to that.
    """

    workers: dict[str, int]
    spread: bool

    def run(self, jobs: deque[Job], tick: Callable[[], None]) -> Iterator[tuple[Job, Any]]:
        """Do jobs; yield each with its result, in the order in which they are ready.

        jobs : the caller may add others between two results
        tick : called ten times a second; an error in it ends all
        """


class TaskExecutor(Protocol):
    """Workers that call a function with numbers, such as those of parts, without a scene."""

    def share(
        self, name: str, do: Callable[[int], T], numbers: Sequence[int], tick: Callable[[], None]
    ) -> Iterator[tuple[int, T]]:
        """Call a function with each of some numbers; yield each with its result, in the order in which it is ready.

        The function may be called twice with the same number, at the same time too.

        name : what the dashboard shows
        tick : called ten times a second; an error in it ends all
        """

    def refresh(self, folder: Path) -> None:
        """See what workers have written into a folder."""


class LocalTasks:
    """Tasks of this process, one after the other."""

    def share(
        self, name: str, do: Callable[[int], T], numbers: Sequence[int], tick: Callable[[], None]
    ) -> Iterator[tuple[int, T]]:
        """See `TaskExecutor`."""
        return ((number, do(number)) for number in numbers)

    def refresh(self, folder: Path) -> None:
        """See `TaskExecutor`: this process sees what it has written."""


class Backend(Protocol):
    """What a package for clusters provides, see `cluster/backend.py`."""

    def is_spread_preferred(self, client: Client) -> bool:
        """Whether models in parts are spread over the workers of a client unless a call says otherwise."""

    def snapshot_and_executor(self, scene: Any, client: Client, spread: bool | None) -> tuple[Any, Executor]:
        """See the function of that name."""

    def tasks_beside(self, client: Client, file: Path) -> TaskExecutor:
        """Workers who see a file, and may write beside it; ValueError if one does not."""

    def machines_of(self, client: Client) -> list[tuple[int | None, int]]:
        """For each worker the bytes of memory that its machine has left, None if unknown, and how many share it."""

    def intersect_chunks(self, scene: Any, given: Any, attributes: Sequence[str], spread: bool) -> Any:
        """The hits of rays in chunked arrays, see `Scene.intersect`."""

    def occluded_chunks(self, scene: Any, given: Any, spread: bool) -> Any:
        """Whether rays in chunked arrays meet anything, see `Scene.occluded`."""


def is_chunked(*values: Any) -> bool:
    """Whether any of some values is an array of Dask, whose chunks are made when they are computed."""
    kind = getattr(sys.modules.get("dask.array"), "Array", None)
    return kind is not None and any(isinstance(value, kind) for value in values)


_LOADERS: list[Callable[[], Backend]] = []


def register_backend(load: Callable[[], Backend]) -> None:
    """Provide executors for clients. load : called when the first client is given"""
    _LOADERS[:] = [load]


def backend() -> Backend:
    """Return what knows clients."""
    return _LOADERS[0]()


def snapshot_and_executor(scene: Any, client: Client, spread: bool | None = False) -> tuple[Any, Executor | None]:
    """Return a scene as it is now, and who works for it.

    Parameters
    ----------
    scene : Scene
    client : dask.distributed.Client or None
    spread : bool or None
        Whether models in parts are spread over the workers. None: if one does not fit into a worker's memory.

    Returns
    -------
    snapshot : Snapshot
    executor : Executor or None
        None: this process, which needs no jobs.
    """
    return (scene.snapshot(), None) if client is None else backend().snapshot_and_executor(scene, client, spread)


def tasks_beside(client: Client, file: Path) -> TaskExecutor:
    """Return workers who see a file and may write beside it; this process, if there is no client."""
    return LocalTasks() if client is None else backend().tasks_beside(client, file)
