"""Clients of Dask: whether one is fit, and how the command line gets one."""

from __future__ import annotations

import logging
import queue
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import inf
from typing import Any
from weakref import WeakKeyDictionary

from ..base.arguments import wrong
from ..base.extras import require
from ..base.memory import available_memory
from ..engine.jit import thread_count
from .worker import version_here

PATIENCE = 4  # seconds for a scheduler to answer
_FIT: WeakKeyDictionary[Any, set[str]] = WeakKeyDictionary()  # by client: workers of our version
_SPREAD: WeakKeyDictionary[Any, bool] = WeakKeyDictionary()  # by client: whether models are spread over its workers
# Dask's profiler calls sys._current_frames, which can deadlock while other threads start or end in Python 3.11:
# https://github.com/python/cpython/issues/106883.
UNPROFILED = {"distributed.worker.profile.enabled": False}
WANTED = "a dask.distributed.Client, not asynchronous, or None"


def check_client(client: Any, name: str = "client") -> Any:
    """A client of Dask with workers of our version, or None. Messages call it `name`.

    Raises
    ------
    ValueError
        If it is something else, Dask is not installed, there are no workers, or one has another version of pointray.
    """
    if client is None:
        return None
    distributed = dask_for(name)
    if not isinstance(client, distributed.Client) or client.asynchronous:
        raise wrong(name, WANTED, client)
    if client.status != "running":
        raise ValueError(f"{name} must be one that is connected, not {client!r}")
    workers = list(client.nthreads())
    if not workers:
        start = f"dask worker {client.scheduler.address}"
        raise ValueError(f"{name}: the scheduler has no workers: start some with `{start}`")
    others = unfit(client, workers)
    if others:
        raise ValueError(f"{name}: {next(iter(others.values()))}")
    return client


def dask_for(what: str) -> Any:
    """The package `distributed`; ValueError, which begins with `what`, if it is not installed."""
    return require("distributed", "cluster", what)


def unfit(client: Any, workers: list[str]) -> dict[str, str]:
    """Return why each of some workers cannot be used: it has another version of pointray than this process, or none.

    Each worker is asked once: one that has stopped would not answer. Workers that are lost meanwhile are not reported,
    and are not fit either, see `is_fit`.
    """
    fit = _FIT.setdefault(client, set())
    new = [worker for worker in workers if worker not in fit]
    here, found = version_here(), client.run(version_here, workers=new, on_error="return") if new else {}
    wrongs = {}
    for worker, version in found.items():
        if isinstance(version, OSError):  # its connection is closed
            continue
        if isinstance(version, BaseException):
            wrongs[worker] = f"worker {worker} has no pointray {here}: {type(version).__name__}: {version}"
        elif version != here:
            wrongs[worker] = f"worker {worker} has pointray {version}, here is {here}"
        else:
            fit.add(worker)
    return wrongs


def is_fit(client: Any, worker: str) -> bool:
    """Whether a worker has answered that it has the version of this process."""
    return worker in _FIT.get(client, ())


def prefer_spread(client: Any) -> None:
    """From now on models in parts are spread over the workers of a client, unless a call says something else."""
    _SPREAD[client] = True


def is_spread_preferred(client: Any) -> bool:
    """See `prefer_spread`."""
    return check_client(client) is not None and _SPREAD.get(client, False)


def memory_of(client: Any) -> float:
    """Bytes of memory that are available to the worker with the least of it, if those of a machine share it evenly."""
    return min((free / sharing for free, sharing in machines_of(client) if free is not None), default=inf)


def machines_of(client: Any) -> list[tuple[int | None, int]]:
    """For each worker the bytes of memory that its machine has left, None if unknown, and how many workers share it."""
    found = client.run(available_memory, on_error="ignore")
    hosts = Counter(map(_host, found))
    return [(free, hosts[_host(worker)]) for worker, free in found.items()]


def _host(worker: str) -> str:
    """The machine in the address of a worker."""
    return worker.rpartition("://")[2].rpartition(":")[0]


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """A client of a scheduler; ValueError if none answers there."""
    distributed = dask_for("--cluster")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what goes wrong is told by errors
    clients: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def connect() -> None:
        try:
            clients.put(distributed.Client(address, timeout=PATIENCE, set_as_default=False))
        except Exception:  # whatever another server answers
            clients.put(None)

    # In a thread: a server that says nothing is waited for without end.
    threading.Thread(target=connect, daemon=True).start()
    client = None
    with suppress(queue.Empty):
        client = clients.get(timeout=PATIENCE + 1)
    if client is None:
        raise ValueError(f"--cluster {address}: no scheduler of Dask answers there")
    with client:
        yield check_client(client, f"--cluster {address}")


@contextmanager
def local_workers(count: int) -> Iterator[Any]:
    """A client of so many processes of this machine, which share its cores evenly."""
    distributed = dask_for("--workers")
    import dask

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    options = {"n_workers": count, "threads_per_worker": max(thread_count() // count, 1), "memory_limit": 0}
    quiet = {"dashboard_address": "127.0.0.1:0", "silence_logs": logging.CRITICAL}
    with (
        dask.config.set(UNPROFILED),
        distributed.LocalCluster(**options, **quiet) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield check_client(client, "--workers")
