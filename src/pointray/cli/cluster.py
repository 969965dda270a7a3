"""The options --cluster and --workers: who renders."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer

from .waiting import in_background

ClusterOption = Annotated[
    str | None,
    typer.Option(help="Render on the workers of a Dask scheduler, tcp://host:8786: see docs/scale.md. Trust them."),
]
WorkersOption = Annotated[
    int | None, typer.Option(min=1, help="Render in so many processes, by Dask, which share the cores evenly.")
]


@contextmanager
def rendering_on(cluster: str | None, workers: int | None) -> Iterator[Any]:
    """A client of Dask whose workers render; None: this process does. What is wrong raises ValueError at once."""
    if cluster is None and workers is None:
        yield None
        return
    if cluster is not None and workers is not None:
        raise ValueError("--cluster and --workers exclude each other")
    from ..cluster.client import connected, local_workers

    with connected(cluster) if cluster is not None else local_workers(workers or 1) as client:
        yield client


def wait_for_kernels(client: Any, settings: Any) -> None:
    """Wait until the kernel of pictures is compiled, if workers of this machine take it from the same cache."""
    from ..rendering.warmup import wait_until_warm

    if client is not None and client.cluster is not None:
        in_background(lambda: wait_until_warm(settings))
