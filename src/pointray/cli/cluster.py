"""The Dask workers of --cluster and --workers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from .waiting import in_background


@contextmanager
def working_on(cluster: str | None, workers: int | None, spread: bool = False) -> Iterator[Any]:
    """Yield a Dask client for the options --cluster and --workers, or None if neither is given: this process works.

    Raise ValueError if the options are invalid or no scheduler is found.

    cluster : address of a Dask scheduler; workers : number of processes to start on this computer
    spread : whether each worker opens only some parts of models in parts
    """
    if cluster is None and workers is None:
        if spread:
            raise ValueError("--spread requires --cluster or --workers")
        yield None
        return
    if cluster is not None and workers is not None:
        raise ValueError("--cluster and --workers exclude each other")
    from ..cluster.client import connected, local_workers, prefer_spread

    with connected(cluster) if cluster is not None else local_workers(workers or 1) as client:
        if spread:
            prefer_spread(client)
        yield client


def wait_for_kernels(client: Any, settings: Any = None) -> None:
    """Wait until a kernel is compiled in the background, so that workers load it from the cache on disk.

    Do so only with --workers, whose processes share that cache, and not with --spread.

    settings : of the images that the kernel renders; None: the kernel traces the rays of a bake
    """
    from ..cluster.client import is_spread_preferred
    from ..rendering.warmup import wait_until_warm

    if client is not None and client.cluster is not None and not is_spread_preferred(client):
        in_background(lambda: wait_until_warm(settings))
