"""Dask clients: their validation, and those of the command line."""

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

PATIENCE = 4  # timeout in seconds for a scheduler's answer
_FIT: WeakKeyDictionary[Any, set[str]] = WeakKeyDictionary()  # by client: workers with this version of pointray
_SPREAD: WeakKeyDictionary[Any, bool] = WeakKeyDictionary()  # by client: whether models are spread by default
# Dask's profiler calls sys._current_frames, which can deadlock while other threads start or end in Python 3.11:
# https://github.com/python/cpython/issues/106883.
UNPROFILED = {"distributed.worker.profile.enabled": False}
WANTED = "a dask.distributed.Client, not asynchronous, or None"


def check_client(client: Any, name: str = "client") -> Any:
    """Return a Dask client if it has workers, all with this version of pointray. None is returned as it is.

    name : of the parameter or option, for messages

    Raises
    ------
    ValueError
        If it is not a client, Dask is not installed, there are no workers, or one has another version of pointray.
    """
    if client is None:
        return None
    distributed = dask_for(name)
    if not isinstance(client, distributed.Client) or client.asynchronous:
        raise wrong(name, WANTED, client)
    if client.status != "running":
        raise ValueError(f"{name} must be a connected client, got {client!r}")
    workers = list(client.nthreads())
    if not workers:
        start = f"dask worker {client.scheduler.address}"
        raise ValueError(f"{name}: the scheduler has no workers; start some with `{start}`")
    others = unfit(client, workers)
    if others:
        raise ValueError(f"{name}: {next(iter(others.values()))}")
    return client


def dask_for(what: str) -> Any:
    """Return the package `distributed`; raise ValueError if it is not installed.

    what : parameter or option that needs it, the start of the message
    """
    return require("distributed", "cluster", what)


def unfit(client: Any, workers: list[str]) -> dict[str, str]:
    """Return the reason for each worker, by address, that cannot be used: pointray has another version or is missing.

    A worker with the same version is not asked again, as a stopped one would not answer. A worker lost while it is
    asked is not in the result, and `is_fit` returns False for it.

    workers : addresses
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
            wrongs[worker] = f"worker {worker} has pointray {version}, expected {here}"
        else:
            fit.add(worker)
    return wrongs


def is_fit(client: Any, worker: str) -> bool:
    """Return whether a worker has reported the same version of pointray as this process. worker : address"""
    return worker in _FIT.get(client, ())


def prefer_spread(client: Any) -> None:
    """Let the workers of a client share models in parts by default: each opens only some of the parts."""
    _SPREAD[client] = True


def is_spread_preferred(client: Any) -> bool:
    """Return whether the workers of a client share models in parts by default: each opens only some of the parts."""
    return check_client(client) is not None and _SPREAD.get(client, False)


def memory_of(client: Any) -> float:
    """Return the bytes of memory available to the worker with the least; infinite if unknown.

    Workers of a machine are assumed to share its free memory evenly.
    """
    return min((free / sharing for free, sharing in machines_of(client) if free is not None), default=inf)


def machines_of(client: Any) -> list[tuple[int | None, int]]:
    """Return for each worker the free bytes of memory of its machine (None: unknown) and how many workers run there."""
    found = client.run(available_memory, on_error="ignore")
    hosts = Counter(map(_host, found))
    return [(free, hosts[_host(worker)]) for worker, free in found.items()]


def _host(worker: str) -> str:
    """Return the host in the address of a worker: "10.0.0.1" in "tcp://10.0.0.1:4321"."""
    return worker.rpartition("://")[2].rpartition(":")[0]


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """Yield a client connected to the scheduler at an address (--cluster); raise ValueError if none answers."""
    distributed = dask_for("--cluster")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # failures are raised as errors
    clients: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def connect() -> None:
        try:
            clients.put(distributed.Client(address, timeout=PATIENCE, set_as_default=False))
        except Exception:  # the server is not a Dask scheduler
            clients.put(None)

    # In a thread: the client waits forever for a server that does not answer.
    threading.Thread(target=connect, daemon=True).start()
    client = None
    with suppress(queue.Empty):
        client = clients.get(timeout=PATIENCE + 1)
    if client is None:
        raise ValueError(f"--cluster {address}: no Dask scheduler found there")
    with client:
        yield check_client(client, f"--cluster {address}")


@contextmanager
def local_workers(count: int) -> Iterator[Any]:
    """Start `count` worker processes on this machine, which share its cores evenly, and yield a client for them."""
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
