"""The rays of a bake that the workers of a cluster send: stretches of tiles, each of which finds what it finds alone.

A ray's direction and its chances depend on the number of its row among all rows, so a worker fills arrays of all rows,
of which the system gives it only the pages that it touches.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.executor import Executor, Job, SharedValue
from ..base.progress import Progress, tell
from ..engine.jit import Array, run
from ..scene.world import Snapshot
from .gather import ONE_TILE, Found, Patches, Rays, Targets, send_rays

STRETCHES = 8  # for each worker, so that all end at about the same time
FEWEST_TILES = 4  # of a stretch, for each thread of a worker
MOST_BYTES = 1 << 23  # that a stretch finds: it comes back in one message


class Ground(NamedTuple):
    """What all stretches need, and workers get once. positions, normals : see `Patches`"""

    positions: Array
    normals: Array
    targets: Targets


class Stretch(NamedTuple):
    """Some tiles of those that are asked for.

    rays : see `gather.Rays`
    tiles : (k * ONE_TILE,) int64, as they stand among all
    rows : (m,) int32, theirs; begin : the number of the first of them among all
    sizes : of the arrays of `Found`, of all rows
    whole : how many rows there are
    """

    rays: Rays
    tiles: NDArray[np.int64]
    rows: NDArray[np.int32]
    begin: int
    sizes: tuple[int, ...]
    whole: int

    @property
    def spans(self) -> list[slice]:
        """Where its rows stand in the arrays of `Found`."""
        widths = [size // self.whole for size in self.sizes]
        return [slice(self.begin * width, (self.begin + len(self.rows)) * width) for width in widths]


def ground_of(patches: Patches, targets: Targets) -> SharedValue:
    """What workers get once."""
    return SharedValue("patches of a bake", Ground(patches.positions, patches.normals, targets))


def cut(patches: Patches, rays: Rays, found: Found, workers: dict[str, int]) -> list[Stretch]:
    """Cut the tiles into stretches, for workers of whom the numbers of threads are given."""
    tiles, whole = patches.tiles.reshape(-1, ONE_TILE), len(patches.rows)
    least = FEWEST_TILES * max(workers.values(), default=1)
    bytes_of_all = sum(array.nbytes for array in found)
    wanted = max(min(STRETCHES * len(workers), len(tiles) // least), -(-bytes_of_all // MOST_BYTES), 1)
    ends = [len(tiles) * k // wanted for k in range(wanted + 1)]
    out = []
    for first, end in zip(ends, ends[1:], strict=False):
        if end > first:
            begin, last = int(tiles[first, 0]), int(tiles[end - 1, 0] + tiles[end - 1, 1])
            rows = patches.rows[begin:last]
            out.append(Stretch(rays, tiles[first:end].reshape(-1), rows, begin, _sizes(found), whole))
    return out


def _sizes(found: Found) -> tuple[int, ...]:
    return tuple(array.size for array in found)


def send_on(
    executor: Executor, ground: SharedValue, stretches: Sequence[Stretch], found: Found, progress: Progress | None
) -> None:
    """Send the rays of all stretches by an executor, and fill `found`."""
    jobs = deque(
        Job(f"bake {k}/{len(stretches)}", send_stretch, (stretch,), (ground,)) for k, stretch in enumerate(stretches, 1)
    )
    done, total = 0, sum(len(stretch.rows) for stretch in stretches)

    def tick() -> None:
        tell(progress, done / total)

    for job, parts in executor.run(jobs, tick):
        stretch: Stretch = job.args[0]
        done += len(stretch.rows)
        for array, span, part in zip(found, stretch.spans, parts, strict=True):
            array[span] = part


def send_stretch(
    scene: Snapshot, stretch: Stretch, ground: Ground, threads: int, progress: Progress
) -> list[NDArray[np.generic]]:
    """Send the rays of a stretch on a worker; returns its part of each array of `Found`."""
    positions, normals, (target_rows, patch_of, frames) = ground
    targets = Targets(_whole(target_rows), _whole(patch_of), _whole(frames))
    rows = np.zeros(stretch.whole, np.int32)
    rows[stretch.begin : stretch.begin + len(stretch.rows)] = stretch.rows
    patches = Patches(_whole(positions), _whole(normals), rows, _whole(stretch.tiles))
    rays = stretch.rays._replace(suns=_whole(stretch.rays.suns))
    dtypes = np.int32, np.int32, np.float32, np.float32
    found = Found(*(np.zeros(size, dtype) for size, dtype in zip(stretch.sizes, dtypes, strict=True)))
    args = scene.without_camera_lights().world, patches, targets, rays, found
    run(send_rays, len(stretch.tiles) // ONE_TILE, *args, threads=threads, progress=progress)
    return [array[span].copy() for array, span in zip(found, stretch.spans, strict=True)]


def _whole(array: Array) -> Array:
    """An array as kernels take it: parts of messages may lie at odd addresses, or be read-only."""
    return np.require(array, requirements=["A", "C", "W"])
