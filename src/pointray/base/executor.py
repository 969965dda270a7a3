"""Protocols of executors, which run jobs in this process or on the workers of a cluster.

Rendering, baking and the preparation of out-of-core models create jobs. They depend on these protocols only, not on
Dask: `cluster/` implements executors for Dask workers, and is loaded when a client is given.
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
    """A value that many jobs need, sent to each worker once. name : label in the dashboard"""

    name: str
    value: Any


@dataclass(frozen=True, eq=False)
class Job:
    """A unit of work on a scene, which any worker can do.

    Attributes
    ----------
    name : str
        Label in the dashboard.
    work : callable
        Module-level function. Its arguments are the snapshot of the scene, `args`, the values of `shared`, a number of
        threads and a progress callback.
    args : tuple
    shared : tuple of SharedValue
    home : str
        Preferred worker, as long as it is connected and not very slow; empty: any.
    """

    name: str
    work: Callable[..., Any]
    args: tuple[Any, ...]
    shared: tuple[SharedValue, ...] = ()
    home: str = ""


class Executor(Protocol):
    """Workers that run jobs on one scene, in its state when the executor was created.

    Attributes
    ----------
    workers : dict of str to int
        Number of threads of each worker, by address.
    spread : bool
        Whether each worker opens only some parts of out-of-core models; jobs must be created accordingly.
    """

    workers: dict[str, int]
    spread: bool

    def run(self, jobs: deque[Job], tick: Callable[[], None]) -> Iterator[tuple[Job, Any]]:
        """Run jobs; yield each with its result in order of completion.

        jobs : the caller may append jobs between two results
        tick : called ten times a second; an exception in it ends the run
        """


class TaskExecutor(Protocol):
    """Workers that call a function with numbers, such as part numbers, without a scene."""

    def share(
        self, name: str, do: Callable[[int], T], numbers: Sequence[int], tick: Callable[[], None]
    ) -> Iterator[tuple[int, T]]:
        """Call a function with each number; yield each number with its result in order of completion.

        The function may be called twice with the same number, even at the same time.

        name : label in the dashboard
        tick : called ten times a second; an exception in it ends the run
        """

    def refresh(self, folder: Path) -> None:
        """Make files visible that workers have written into a folder."""


class LocalTasks:
    """Task executor that runs tasks in this process, one after the other."""

    def share(
        self, name: str, do: Callable[[int], T], numbers: Sequence[int], tick: Callable[[], None]
    ) -> Iterator[tuple[int, T]]:
        """See `TaskExecutor`."""
        return ((number, do(number)) for number in numbers)

    def refresh(self, folder: Path) -> None:
        """Do nothing: files written by this process are visible."""


class Backend(Protocol):
    """Interface of a cluster package, see `cluster/backend.py`."""

    def check_client(self, client: Any) -> Any:
        """Raise an error if a client is none, or its workers cannot be used."""

    def is_spread_preferred(self, client: Client) -> bool:
        """Whether out-of-core models are spread over the workers of a client by default."""

    def snapshot_and_executor(self, scene: Any, client: Client, spread: bool | None) -> tuple[Any, Executor]:
        """See the function with this name."""

    def tasks_beside(self, client: Client, file: Path) -> TaskExecutor:
        """Return workers that can read a file and write to its folder; raise ValueError if one cannot."""

    def machines_of(self, client: Client) -> list[tuple[int | None, int]]:
        """Return the available memory of each worker's machine (bytes; None: unknown), and its number of workers."""

    def intersect_chunks(self, scene: Any, given: Any, attributes: Sequence[str], spread: bool) -> Any:
        """Return the hits of rays in chunked arrays, see `Scene.intersect`."""

    def occluded_chunks(self, scene: Any, given: Any, spread: bool) -> Any:
        """Return whether rays in chunked arrays are occluded, see `Scene.occluded`."""


def is_chunked(*values: Any) -> bool:
    """Whether any of the values is a Dask array, whose chunks are computed on demand."""
    kind = getattr(sys.modules.get("dask.array"), "Array", None)
    return kind is not None and any(isinstance(value, kind) for value in values)


_LOADERS: list[Callable[[], Backend]] = []


def register_backend(load: Callable[[], Backend]) -> None:
    """Register the backend for clients. load : imports it; called when a client is first given"""
    _LOADERS[:] = [load]


def backend() -> Backend:
    """Return the registered backend."""
    return _LOADERS[0]()


def snapshot_and_executor(scene: Any, client: Client, spread: bool | None = False) -> tuple[Any, Executor | None]:
    """Return a snapshot of a scene, and the executor for it.

    Parameters
    ----------
    scene : Scene
    client : dask.distributed.Client or None
    spread : bool or None
        Whether out-of-core models are spread over the workers. None: if one does not fit into a worker's memory.

    Returns
    -------
    snapshot : Snapshot
    executor : Executor or None
        None: this process does the work, without jobs.
    """
    return (scene.snapshot(), None) if client is None else backend().snapshot_and_executor(scene, client, spread)


def tasks_beside(client: Client, file: Path) -> TaskExecutor:
    """Return workers that can read a file and write to its folder; this process if `client` is None."""
    return LocalTasks() if client is None else backend().tasks_beside(client, file)
