"""Rays of a bake on the workers of a cluster: ranges of tiles, which workers process independently.

A ray's direction and random numbers depend on its row among all rows. Workers therefore allocate arrays for all rows;
the operating system provides only the pages that are touched.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.executor import Executor, Job, SharedValue
from ..base.progress import Progress, report_progress
from ..engine.jit import Array, run
from ..scene.world import Snapshot
from .gather import ONE_TILE, Found, Patches, Rays, Targets, send_rays

RANGES_PER_WORKER = 8  # tile ranges per worker, so that workers end at about the same time
FEWEST_TILES = 4  # in a range, per thread of a worker
MOST_BYTES = 1 << 23  # result of a range, which is returned in one message


class SharedPatches(NamedTuple):
    """Data that all jobs of a bake need, sent once to each worker: all patches, and tables from hits to patches.

    positions : (n * 3,) float64, world; normals : (n * 3,) float32, pointing to the side that receives light
    """

    positions: Array
    normals: Array
    targets: Targets


class TileRange(NamedTuple):
    """Part of the rays of a bake that one job on a worker sends: a range of tiles, each of up to 64 patches.

    rays : kind and parameters of the rays
    tiles : (k * ONE_TILE,) int64, first index, number of patches and side of each tile, see `gather.Patches`
    rows : (m,) int32, the patches of these tiles
    begin : position of the first of these patches in the list of patches of all ranges
    sizes : length of each array of results (`gather.Found`) of all ranges together
    row_count : number of patches of all ranges together
    """

    rays: Rays
    tiles: NDArray[np.int64]
    rows: NDArray[np.int32]
    begin: int
    sizes: tuple[int, ...]
    row_count: int

    @property
    def spans(self) -> list[slice]:
        """Slices that belong to this range, one for each array of results (`gather.Found`) of all ranges."""
        widths = [size // self.row_count for size in self.sizes]
        return [slice(self.begin * width, (self.begin + len(self.rows)) * width) for width in widths]


def share_patches(patches: Patches, targets: Targets) -> SharedValue:
    """Wrap the patches and the tables that map a hit to a patch as a value that is sent once to each worker."""
    return SharedValue("patches of a bake", SharedPatches(patches.positions, patches.normals, targets))


def cut(patches: Patches, rays: Rays, found: Found, workers: dict[str, int]) -> list[TileRange]:
    """Divide the tiles of patches into ranges that are sent to workers as jobs.

    rays : kind and parameters of the rays
    found : arrays for the results, which give the size of the messages
    workers : number of threads of each worker, by name
    """
    tiles, row_count = patches.tiles.reshape(-1, ONE_TILE), len(patches.rows)
    least = FEWEST_TILES * max(workers.values(), default=1)
    bytes_of_all = sum(array.nbytes for array in found)
    wanted = max(min(RANGES_PER_WORKER * len(workers), len(tiles) // least), -(-bytes_of_all // MOST_BYTES), 1)
    ends = [len(tiles) * k // wanted for k in range(wanted + 1)]
    out = []
    for first, end in zip(ends, ends[1:], strict=False):
        if end > first:
            begin, last = int(tiles[first, 0]), int(tiles[end - 1, 0] + tiles[end - 1, 1])
            rows = patches.rows[begin:last]
            out.append(TileRange(rays, tiles[first:end].reshape(-1), rows, begin, _sizes(found), row_count))
    return out


def _sizes(found: Found) -> tuple[int, ...]:
    return tuple(array.size for array in found)


def send_ranges(
    executor: Executor, shared: SharedValue, ranges: Sequence[TileRange], found: Found, progress: Progress | None
) -> None:
    """Send the rays of all tile ranges through an executor, and write their results to `found`.

    shared : patches and tables that all ranges need
    """
    jobs = deque(
        Job(f"bake {k}/{len(ranges)}", send_tile_range, (tile_range,), (shared,))
        for k, tile_range in enumerate(ranges, 1)
    )
    done, total = 0, sum(len(tile_range.rows) for tile_range in ranges)

    def tick() -> None:
        report_progress(progress, done / total)

    for job, parts in executor.run(jobs, tick):
        tile_range: TileRange = job.args[0]
        done += len(tile_range.rows)
        for array, span, part in zip(found, tile_range.spans, parts, strict=True):
            array[span] = part


def send_tile_range(
    scene: Snapshot, tile_range: TileRange, shared: SharedPatches, threads: int, progress: Progress
) -> list[NDArray[np.generic]]:
    """Trace the rays of a range of patches on a worker; return the range's part of each array of results (`Found`).

    shared : all patches, and the tables that map a hit to a patch
    """
    positions, normals, (target_rows, patch_of, frames) = shared
    targets = Targets(_kernel_ready(target_rows), _kernel_ready(patch_of), _kernel_ready(frames))
    rows = np.zeros(tile_range.row_count, np.int32)
    rows[tile_range.begin : tile_range.begin + len(tile_range.rows)] = tile_range.rows
    patches = Patches(_kernel_ready(positions), _kernel_ready(normals), rows, _kernel_ready(tile_range.tiles))
    rays = tile_range.rays._replace(suns=_kernel_ready(tile_range.rays.suns))
    dtypes = np.int32, np.int32, np.float32, np.float32
    found = Found(*(np.zeros(size, dtype) for size, dtype in zip(tile_range.sizes, dtypes, strict=True)))
    args = scene.without_camera_lights().world, patches, targets, rays, found
    run(send_rays, len(tile_range.tiles) // ONE_TILE, *args, threads=threads, progress=progress)
    return [array[span].copy() for array, span in zip(found, tile_range.spans, strict=True)]


def _kernel_ready(array: Array) -> Array:
    """Return an aligned, contiguous and writable array, as kernels require; those from messages may not be."""
    return np.require(array, requirements=["A", "C", "W"])
