"""Selection of the holders to which rays are sent, by the boxes of their parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles, Flags
from ...engine.jit import Array, borrow, kernel, next_tile, run
from ...engine.kernels.vec import load3_flat

BATCH = 4096  # rays that a thread takes at a time
PAD = 1e-5  # padding of boxes relative to the size of their union, more than in `surface/tree/instance_bvh.py`


@kernel
def _route(work: Array, rays: Array, boxes: Array, owners: Array, out: Array) -> None:
    """Set out[ray, owner] = 1 where a ray enters a box of an owner (a worker) before the ray's largest t.

    work : counter from which threads take rays; rays : (n, 8) float64: origin, direction, largest t, side (not used)
    boxes : (m, 6) float64, min x y z, max x y z; owners : (m,) int64, owner of each box, an index of a worker
    out : (n, workers) uint8, 0 at first
    """
    rays, boxes, owners, out = borrow(rays), borrow(boxes), borrow(owners), borrow(out)
    batch = next_tile(work)
    while batch >= 0:
        for i in range(batch * BATCH, min((batch + 1) * BATCH, len(rays))):
            ray = rays[i]
            o = load3_flat(ray, 0)
            # No component is 0, as 0 times inf is NaN.
            inverse = (
                1.0 / (ray[3] if abs(ray[3]) > 1e-300 else 1e-300),
                1.0 / (ray[4] if abs(ray[4]) > 1e-300 else 1e-300),
                1.0 / (ray[5] if abs(ray[5]) > 1e-300 else 1e-300),
            )
            for b in range(len(boxes)):
                owner = owners[b]
                if out[i, owner] != 0:
                    continue
                near, far = 0.0, ray[6]
                for c in range(3):
                    low, high = (boxes[b, c] - o[c]) * inverse[c], (boxes[b, 3 + c] - o[c]) * inverse[c]
                    near, far = max(near, min(low, high)), min(far, max(low, high))
                if near <= far:
                    out[i, owner] = 1
        batch = next_tile(work)


def route(rays: Doubles, boxes: Doubles, owners: NDArray[np.int64], count: int, threads: int | None) -> Flags:
    """Return for each ray the owners (workers) with a box that the ray enters, (n, count) bool: it is sent to these.

    Parameters
    ----------
    rays : (n, 8) float64
        Origin, direction, largest t, side (not used).
    boxes : (m, 6) float64
        Minimum x y z, maximum x y z, world.
    owners : (m,) int64
        Owner of each box (index of a worker), less than `count`.
    count : int
        Number of workers.
    """
    out = np.zeros((len(rays), count), np.uint8)
    if len(boxes) and len(rays):
        low, high = boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)
        pad = PAD * float(np.abs(high - low).max() + np.abs(low + high).max() * 1e-6)
        grown = np.concatenate([boxes[:, :3] - pad, boxes[:, 3:] + pad], axis=1)
        run(_route, -(-len(rays) // BATCH), rays, grown, owners, out, threads=threads)
    return out.view(np.bool_)
