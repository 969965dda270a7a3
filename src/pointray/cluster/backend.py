"""The functions of `base.executor.Backend`, for Dask clients."""

from .client import check_client, is_spread_preferred, machines_of
from .dask_casting import intersect_chunks, occluded_chunks
from .shared_folder import tasks_beside
from .worker_pool import snapshot_and_executor

__all__ = [
    "check_client",
    "intersect_chunks",
    "is_spread_preferred",
    "machines_of",
    "occluded_chunks",
    "snapshot_and_executor",
    "tasks_beside",
]
