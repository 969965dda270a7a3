"""Medians of a value over the nearest points on each point's own sheet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats
from ...engine.jit import Array, borrow, f32, i64, inline, keep_alive, kernel, next_tile, run
from ...engine.kernels.vec import dot, load3_flat
from ...engine.simd import F16, gather16, load16, store, vmax, vmin
from .closed import NEAREST
from .voronoi import CHUNK, OTHER_SHEET, Neighborhood


@inline
def _gather_sorted(values: Array, normals: Array, i: int, near: Array, limit: float, found: Array) -> int:
    """Write, sorted, the values of the first neighbours of point i with a similar normal; return their number.

    values : (n,); normals : flat
    near : rows of neighbours, nearest first
    limit : least cosine of a neighbour's normal with that of point i
    found : output; its length is the maximum number
    """
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


@inline
def _median(values: Array, normals: Array, i: int, near: Array, own: int, found: Array) -> float:
    """Return the median of the values of the 8 nearest points on the sheet of point i, one neighbour at a time.

    normals : flat; near : row i, then its neighbours, nearest first; own : 1 to include the value of point i, else 0
    found : memory for 9 numbers
    """
    count = _gather_sorted(values, normals, i, near[1 - own :], OTHER_SHEET, found[: NEAREST + own])
    if count < NEAREST // 2:  # too few neighbours on its sheet: any neighbour counts
        count = _gather_sorted(values, normals, i, near[1 - own :], -2.0, found[: NEAREST + own])
    return f32(0.5) * (found[(count - 1) // 2] + found[count // 2])


@inline
def _in_order(a: F16, b: F16) -> tuple[F16, F16]:
    return vmin(a, b), vmax(a, b)


@inline
def _sorted4(a: F16, b: F16, c: F16, d: F16) -> tuple[F16, F16, F16, F16]:
    """Sort four numbers in each lane, ascending."""
    (a, b), (c, d) = _in_order(a, b), _in_order(c, d)
    (a, c), (b, d) = _in_order(a, c), _in_order(b, d)
    b, c = _in_order(b, c)
    return a, b, c, d


@inline
def _middle_of8(values: Array, near: Array, start: int, width: int, memory: Array) -> tuple[F16, F16]:
    """Return the fourth and fifth smallest value over the first 8 neighbours of each of 16 points.

    near : flat, `width` rows for each point: the point, then its neighbours; start : where the 16 points begin in it
    memory : for 128 numbers
    """
    for k in range(8):
        store(memory, 16 * k, gather16(values, near, start + k + 1, width))
    a = _sorted4(load16(memory, 0), load16(memory, 16), load16(memory, 32), load16(memory, 48))
    b = _sorted4(load16(memory, 64), load16(memory, 80), load16(memory, 96), load16(memory, 112))
    # The four smallest of two sorted fours are the minima of a[k] and b[3 - k].
    lesser = vmax(vmax(vmin(a[0], b[3]), vmin(a[1], b[2])), vmax(vmin(a[2], b[1]), vmin(a[3], b[0])))
    greater = vmin(vmin(vmax(a[0], b[3]), vmax(a[1], b[2])), vmin(vmax(a[2], b[1]), vmax(a[3], b[0])))
    return lesser, greater


@kernel
def _medians(work: Array, values: Array, near: Array, width: int, own: int, out: Array) -> None:
    """Write the median of the values of each point's 8 nearest neighbours.

    near : flat, `width` rows for each point: the point, then its neighbours
    own : 1 to include the point's own value, else 0
    """
    values, near, out = borrow(values), borrow(near), borrow(out)
    memory = np.empty(8 * 16, np.float32)
    found = borrow(memory)
    tile = next_tile(work)
    while tile >= 0:
        for begin in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out)), 16):
            first = min(begin, len(out) - 16)
            lesser, greater = _middle_of8(values, near, first * width, width, found)
            if own == 1:
                lesser = greater = vmax(lesser, vmin(load16(values, first), greater))
            store(out, first, f32(0.5) * (lesser + greater))
        tile = next_tile(work)
    keep_alive(memory)


@kernel
def _medians_of(
    work: Array, values: Array, normals: Array, neighborhood: tuple[Array, Array], own: int, out: Array
) -> None:
    """Write the medians for points whose 8 nearest neighbours are not all on their own sheet, one neighbour at a time.

    normals : flat; neighborhood : rows of these points (m,), and each with its neighbours (m, k)
    own : 1 to include the point's own value, else 0; out : (n,), written at these points only
    """
    values, normals, (rows, near), out = borrow(values), borrow(normals), borrow(neighborhood), borrow(out)
    found = np.empty(NEAREST + 1, np.float32)
    tile = next_tile(work)
    while tile >= 0:
        for at in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            i = i64(rows[at])
            out[i] = _median(values, normals, i, near[at], own, found)
        tile = next_tile(work)


def medians_around(values: Floats, normals: Floats, near: NDArray[np.int32], odd: Neighborhood, own: bool) -> Floats:
    """Compute the median of a value over the 8 nearest points on each point's own sheet, (n,).

    Parameters
    ----------
    values : (n,) float32
    normals : (n, 3) float32
        Unit normals.
    near : (n, 9) int32
        Rows of each point and its 8 nearest neighbours.
    odd : Neighborhood
        Points whose 8 nearest neighbours are not all on their own sheet, with more neighbours. All points, if there
        are fewer than 16 points or 8 neighbours.
    own : bool
        Whether to include the point's own value.
    """
    out = np.empty(len(values), np.float32)
    values = np.ascontiguousarray(values)
    if len(odd.rows) < len(out):
        first = np.ascontiguousarray(near).reshape(-1)
        run(_medians, -(-len(out) // CHUNK), values, first, near.shape[1], int(own), out)
    neighborhood = np.ascontiguousarray(odd.rows, np.int64), np.ascontiguousarray(odd.near)
    normals = np.ascontiguousarray(normals).reshape(-1)
    run(_medians_of, -(-len(odd.rows) // CHUNK), values, normals, neighborhood, int(own), out)
    return out
