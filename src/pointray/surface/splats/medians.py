"""Medians of a value over the nearest points of each point's own sheet: what is usual around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...engine.jit import Array, borrow, f32, i64, inline, keep_alive, kernel, next_tile, run
from ...engine.kernels.vec import dot, load3_flat
from ...engine.simd import F16, gather16, load16, store, vmax, vmin
from .closed import USUAL
from .voronoi import CHUNK, OTHER_SHEET, Neighborhood


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


@inline
def _median(values: Array, normals: Array, i: int, near: Array, own: int, found: Array) -> float:
    """The median around point i, neighbour by neighbour."""
    count = _gather_sorted(values, normals, i, near[1 - own :], OTHER_SHEET, found[: USUAL + own])
    if count < USUAL // 2:  # too few neighbours on its sheet: any neighbour counts
        count = _gather_sorted(values, normals, i, near[1 - own :], -2.0, found[: USUAL + own])
    return f32(0.5) * (found[(count - 1) // 2] + found[count // 2])


@inline
def _in_order(a: F16, b: F16) -> tuple[F16, F16]:
    return vmin(a, b), vmax(a, b)


@inline
def _sorted4(a: F16, b: F16, c: F16, d: F16) -> tuple[F16, F16, F16, F16]:
    """Each lane's four numbers, ascending."""
    (a, b), (c, d) = _in_order(a, b), _in_order(c, d)
    (a, c), (b, d) = _in_order(a, c), _in_order(b, d)
    b, c = _in_order(b, c)
    return a, b, c, d


@inline
def _middle_of8(values: Array, near: Array, start: int, width: int, memory: Array) -> tuple[F16, F16]:
    """The fourth and the fifth of the values at each of 16 points' first 8 neighbours."""
    for k in range(8):
        store(memory, 16 * k, gather16(values, near, start + k + 1, width))
    a = _sorted4(load16(memory, 0), load16(memory, 16), load16(memory, 32), load16(memory, 48))
    b = _sorted4(load16(memory, 64), load16(memory, 80), load16(memory, 96), load16(memory, 112))
    # The four lesser ones of two sorted fours are the lesser of each number and its opposite.
    lesser = vmax(vmax(vmin(a[0], b[3]), vmin(a[1], b[2])), vmax(vmin(a[2], b[1]), vmin(a[3], b[0])))
    greater = vmin(vmin(vmax(a[0], b[3]), vmax(a[1], b[2])), vmin(vmax(a[2], b[1]), vmax(a[3], b[0])))
    return lesser, greater


@kernel
def _medians(work: Array, values: Array, near: Array, width: int, own: int, out: Array) -> int:
    """Write the median of the values at each point's first neighbours; near : flat, so many columns; own : 1 or 0."""
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
    return 0


@kernel
def _medians_of(work: Array, values: Array, normals: Array, hood: tuple[Array, Array], own: int, out: Array) -> int:
    """Write the medians around a hood's rows, neighbour by neighbour."""
    values, normals, (rows, near), out = borrow(values), borrow(normals), borrow(hood), borrow(out)
    found = np.empty(USUAL + 1, np.float32)
    tile = next_tile(work)
    while tile >= 0:
        for at in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            i = i64(rows[at])
            out[i] = _median(values, normals, i, near[at], own, found)
        tile = next_tile(work)
    return 0


def medians_around(
    values: NDArray[np.float32],
    normals: NDArray[np.float32],
    near: NDArray[np.int32],
    odd: Neighborhood,
    own: bool,
) -> NDArray[np.float32]:
    """Median of a value over the USUAL nearest points of each point's own sheet.

    Parameters
    ----------
    values : (n,) float32
    normals : (n, 3) float32, unit
    near : (n, USUAL + 1) int32
        Rows of each point's neighbours, itself first.
    odd : Neighborhood
        The points whose first USUAL neighbours are not all of their own sheet, and more neighbours of theirs; all
        points, if there are fewer than 16, or fewer neighbours.
    own : bool
        Whether the point's own value counts too.
    """
    out = np.empty(len(values), np.float32)
    values = np.ascontiguousarray(values)
    if len(odd.rows) < len(out):
        first = np.ascontiguousarray(near).reshape(-1)
        run(_medians, -(-len(out) // CHUNK), values, first, near.shape[1], int(own), out)
    hood = np.ascontiguousarray(odd.rows, np.int64), np.ascontiguousarray(odd.near)
    normals = np.ascontiguousarray(normals).reshape(-1)
    run(_medians_of, -(-len(odd.rows) // CHUNK), values, normals, hood, int(own), out)
    return out
