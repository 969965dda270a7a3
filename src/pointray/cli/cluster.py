"""The options --cluster and --workers: who renders, or bakes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer

from .waiting import in_background

ClusterOption = Annotated[
    str | None,
    typer.Option(
        help="Let the workers of a Dask scheduler do the work, tcp://host:8786: see docs/scale.md. Trust them."
    ),
]
WorkersOption = Annotated[
    int | None, typer.Option(min=1, help="Let so many processes do the work, by Dask, which share the cores evenly.")
]
SpreadOption = Annotated[
    bool,
    typer.Option(
        "--spread",
        help="Each worker opens only some parts of a model in parts, and rays travel: where no worker could hold all.",
    ),
]


@contextmanager
def working_on(cluster: str | None, workers: int | None, spread: bool = False) -> Iterator[Any]:
    """A client of Dask whose workers do the work; None: this process does. What is wrong raises ValueError at once.

    spread : whether models in parts are spread over the workers
    """
    if cluster is None and workers is None:
        if spread:
            raise ValueError("--spread is for --cluster and --workers")
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
    """Wait until the kernel of pictures is compiled, if workers of this machine take it from the same cache.

    settings : of the pictures; None: the kernel is that of the rays of a bake
    """
    from ..rendering.warmup import wait_until_warm

    if client is not None and client.cluster is not None:
        in_background(lambda: wait_until_warm(settings))
