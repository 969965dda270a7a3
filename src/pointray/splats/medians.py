"""Medians of a value over the nearest points of each point's own sheet: what is usual around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import Array, borrow, f32, i64, inline, keep_alive, kernel, next_tile, run
from ..kernels.vec import dot, load3_flat
from .voronoi import CHUNK, OTHER_SHEET

USUAL = 8  # neighbours that tell what is usual


@inline
def _gather_sorted(values: Array, normals: Array, i: int, near: Array, limit: float, found: Array) -> int:
    """Ascending values of the first of `near` whose normals have a cosine of `limit` or more to that of point i."""
    n, count = load3_flat(normals, 3 * i), 0
    for j in near:
        if count < len(found) and dot(n, load3_flat(normals, 3 * i64(j))) >= limit:
            k, value = count, values[j]
            while k > 0 and found[k - 1] > value:
                found[k] = found[k - 1]
                k -= 1
            found[k] = value
            count += 1
    return count


@kernel
def _medians(work: Array, values: Array, normals: Array, near: Array, own: int, out: Array) -> int:
    """See `medians_around`; own : 1 or 0."""
    values, normals, near, out = borrow(values), borrow(normals), borrow(near), borrow(out)
    memory = np.empty(USUAL + own, np.float32)
    found = borrow(memory)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            count = _gather_sorted(values, normals, i, near[i, 1 - own :], OTHER_SHEET, found)
            if count < USUAL // 2:  # too few neighbours on its sheet: any neighbour counts
                count = _gather_sorted(values, normals, i, near[i, 1 - own :], -2.0, found)
            out[i] = f32(0.5) * (found[(count - 1) // 2] + found[count // 2])
        tile = next_tile(work)
    keep_alive(memory)
    return 0


def medians_around(
    values: NDArray[np.float32], normals: NDArray[np.float32], near: NDArray[np.int32], own: bool
) -> NDArray[np.float32]:
    """Median of a value over the USUAL nearest points of each point's own sheet.

    Parameters
    ----------
    values : (n,) float32
    normals : (n, 3) float32, unit
    near : (n, k) int32
        Rows of each point's neighbours, itself first.
    own : bool
        Whether the point's own value counts too.
    """
    out = np.empty(len(values), np.float32)
    flat = np.ascontiguousarray(normals).reshape(-1)
    run(_medians, -(-len(out) // CHUNK), np.ascontiguousarray(values), flat, np.ascontiguousarray(near), int(own), out)
    return out
