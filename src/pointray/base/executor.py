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
    """A value that many jobs need, sent to each worker of a cluster once. name : label in Dask's dashboard"""

    name: str
    value: Any


@dataclass(frozen=True, eq=False)
class Job:
    """A unit of work on a scene, such as a part of an image, which any worker of a cluster can do.

    Attributes
    ----------
    name : str
        Label in Dask's dashboard.
    work : callable
        Module-level function, called with the snapshot of the scene, `args`, the values of `shared`, the number of
        threads to use (None: all) and a progress callback, which may raise an error to end the job, or None.
    args : tuple
        Arguments of `work` for this job only.
    shared : tuple of SharedValue
        Large values that many jobs need; each is sent to a worker once.
    home : str
        Address of the preferred worker, as long as it is connected and not very slow; empty: any.
    """

    name: str
    work: Callable[..., Any]
    args: tuple[Any, ...]
    shared: tuple[SharedValue, ...] = ()
    home: str = ""


class Executor(Protocol):
    """Interface of workers that run jobs on one scene, in its state when the executor was created.

    Attributes
    ----------
    workers : dict of str to int
        Number of threads of each worker, by address.
    spread : bool
        Whether each worker opens only some parts of models in parts. A job then prefers the worker with the parts that
        it needs.
    """

    workers: dict[str, int]
    spread: bool

    def run(self, jobs: deque[Job], tick: Callable[[], None]) -> Iterator[tuple[Job, Any]]:
        """Run jobs; yield each with its result in order of completion.

        jobs : the caller may append jobs between two results
        tick : called about ten times a second, for example to report progress; an exception in it ends the run
        """


class TaskExecutor(Protocol):
    """Interface of workers that call a function with numbers, such as those of a model's parts, without a scene."""

    def share(
        self, name: str, do: Callable[[int], T], numbers: Sequence[int], tick: Callable[[], None]
    ) -> Iterator[tuple[int, T]]:
        """Call `do` with each number; yield each number with its result in order of completion.

        The function may be called twice with the same number, even at the same time.

        name : label in Dask's dashboard
        tick : called about ten times a second, for example to report progress; an exception in it ends the run
        """

    def refresh(self, folder: Path) -> None:
        """Make files that workers on other machines have written into a folder visible to this process."""


class LocalTasks:
    """Task executor that runs tasks in this process, one after the other."""

    def share(
        self, name: str, do: Callable[[int], T], numbers: Sequence[int], tick: Callable[[], None]
    ) -> Iterator[tuple[int, T]]:
        """Call `do` with each number in this process, in order; yield each number with its result.

        name, tick : unused, because there is neither a dashboard nor waiting
        """
        return ((number, do(number)) for number in numbers)

    def refresh(self, folder: Path) -> None:
        """Do nothing: files written by this process are visible without it."""


class Backend(Protocol):
    """Interface of `cluster/backend.py`, through which scenes, models, rendering and baking use Dask."""

    def check_client(self, client: Any) -> Any:
        """Return a valid Dask client, or None if it is None.

        Raise ValueError if it is not a client, or its workers do not have this version of pointray.
        """

    def is_spread_preferred(self, client: Client) -> bool:
        """Return whether each worker of a client opens, by default, only some parts of models in parts."""

    def snapshot_and_executor(self, scene: Any, client: Client, spread: bool | None) -> tuple[Any, Executor]:
        """Return a snapshot of a scene, and an executor that runs jobs on it on a client's workers.

        spread : whether each worker opens only some parts of models in parts; None: if one exceeds a worker's memory
        """

    def tasks_beside(self, client: Client, file: Path) -> TaskExecutor:
        """Return an executor that calls functions on a client's workers, which share a file and its folder.

        Raise ValueError if a worker cannot read `file` or write to its folder.
        """

    def machines_of(self, client: Client) -> list[tuple[int | None, int]]:
        """Return two numbers for each worker: its machine's available memory and its machine's number of workers.

        The memory is in bytes, None if unknown.
        """

    def intersect_chunks(self, scene: Any, given: Any, attributes: Sequence[str], spread: bool) -> Any:
        """Return the hits of rays in Dask arrays as `Hits` of Dask arrays, which are computed on demand.

        given : origins, directions, t_min and t_max; attributes : names of point attributes to blend at the hits
        spread : whether each worker opens only some parts of models in parts
        """

    def occluded_chunks(self, scene: Any, given: Any, spread: bool) -> Any:
        """Return whether each ray, given in Dask arrays, hits anything: a Dask array of bools, computed on demand.

        given : origins, directions, t_min and t_max
        spread : whether each worker opens only some parts of models in parts
        """


def is_chunked(*values: Any) -> bool:
    """Return whether any of the values is a Dask array, whose chunks are computed on demand."""
    kind = getattr(sys.modules.get("dask.array"), "Array", None)
    return kind is not None and any(isinstance(value, kind) for value in values)


_LOADERS: list[Callable[[], Backend]] = []


def register_backend(load: Callable[[], Backend]) -> None:
    """Register the function that imports `cluster/backend.py`; it is called when Dask is needed.

    `base/` itself must not import from `cluster/`.
    """
    _LOADERS[:] = [load]


def backend() -> Backend:
    """Import and return `cluster/backend.py`, through which scenes, models, rendering and baking use Dask."""
    return _LOADERS[0]()


def snapshot_and_executor(scene: Any, client: Client, spread: bool | None = False) -> tuple[Any, Executor | None]:
    """Return a snapshot of a scene, and an executor that runs jobs on it on the workers of a Dask client.

    Parameters
    ----------
    scene : Scene
    client : dask.distributed.Client or None
    spread : bool or None
        Whether each worker opens only some parts of models in parts. None: if a model does not fit into a worker's
        memory.

    Returns
    -------
    snapshot : Snapshot
    executor : Executor or None
        None without a client: the caller does the work in this process, without jobs.
    """
    return (scene.snapshot(), None) if client is None else backend().snapshot_and_executor(scene, client, spread)


def tasks_beside(client: Client, file: Path) -> TaskExecutor:
    """Return an executor that calls functions on workers that can read a file and write to its folder.

    client : Dask client of these workers; None: the functions are called in this process
    """
    return LocalTasks() if client is None else backend().tasks_beside(client, file)
