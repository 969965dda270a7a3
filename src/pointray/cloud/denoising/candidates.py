"""Candidate planes near a point, fitted around some of its neighbours; sixteen neighbours, then all planes, at once."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...engine.jit import Array, f32, f64, inline, routine
from ...engine.simd import (
    F16,
    INF,
    ONE,
    ZERO,
    bits,
    broadcast16,
    broadcast_from,
    count_trailing_zeros,
    lane,
    load16,
    reduce_max,
    select,
    store,
    sum_over_lanes,
    vmax,
    vmin,
)
from ..normals.axes import principal_axes
from ..normals.fit_batch import LANES, TINIEST, Triple, distance_weight, zeros

CANDIDATES = 9
NARROW = 0.52  # radius of a candidate's neighbourhood, relative to that of all neighbours
SAMPLES = 31  # neighbours by which candidates are scored: with 21, edges of a cube are 0.41 spacings off; with 64, 0.38
MOST_SAMPLES = 2 * SAMPLES
SUMS = 10  # sums of a plane: weights, places and their products


class Neighbors(NamedTuple):
    """One thread's memory for the neighbours of one point; all flat float32.

    Attributes
    ----------
    places : (3 * width,)
        x of all neighbours as offsets, then y, then z; the farthest at distance 1. The width is a multiple of `LANES`.
    weights : (width,)
        By distance; 0 beyond the last neighbour.
    away : (width,)
        Squared distances to the nearest place around which a candidate has been fitted.
    owner : (width,)
        Plane that each neighbour belongs to, or -1.
    sums : (SUMS * LANES,)
        Sums over the neighbours of each plane, one lane per plane.
    found, chosen, again : (4 * LANES,)
        Planes, one lane each: x, y and z of the normals, and offsets. The third of two planes lies below all others.
    heights : (MOST_JUDGES * LANES,)
        Heights of each scoring neighbour above all candidates.
    """

    places: Array
    weights: Array
    away: Array
    owner: Array
    sums: Array
    found: Array
    chosen: Array
    again: Array
    heights: Array


@inline
def new_neighbors(most: int) -> Neighbors:
    """Return memory for at most `most` neighbours."""
    width = -(-most // LANES) * LANES
    return Neighbors(
        np.zeros(3 * width, np.float32),
        np.zeros(width, np.float32),
        np.zeros(width, np.float32),
        np.zeros(width, np.float32),
        np.zeros(SUMS * LANES, np.float32),
        np.zeros(4 * LANES, np.float32),
        np.zeros(4 * LANES, np.float32),
        np.zeros(4 * LANES, np.float32),
        np.zeros(MOST_SAMPLES * LANES, np.float32),
    )


@inline
def load_neighbors(positions: Array, row: int, near: Array, i: int, memory: Neighbors) -> float:
    """Write the places of the neighbours near[i] relative to positions[row], and their weights; return the unit."""
    k, width = near.shape[1], len(memory.weights)
    square = f64(0.0)
    for c in range(3):
        square += (f64(positions[near[i, k - 1], c]) - f64(positions[row, c])) ** 2
    unit = max(math.sqrt(square), TINIEST)
    for j in range(k):
        for c in range(3):
            memory.places[width * c + j] = f32((f64(positions[near[i, j], c]) - f64(positions[row, c])) / unit)
        memory.weights[j] = ONE
    for at in range(0, width, LANES):
        x, y, z = load_places(memory, at)
        weight = load16(memory.weights, at) * distance_weight(x * x + y * y + z * z)
        store(memory.weights, at, weight)
    return unit


@inline
def load_places(memory: Neighbors, at: int) -> Triple:
    """Return x, y and z of sixteen neighbours."""
    width = len(memory.weights)
    return load16(memory.places, at), load16(memory.places, width + at), load16(memory.places, 2 * width + at)


@inline
def store_sums(sums: Array, a: int, w: Triple, p: Triple, others: tuple[Triple, F16]) -> None:
    """Write to lane a the summed lanes of weighted places and their products: x y z, xx xy xz, yy yz zz, weights."""
    for c in range(3):
        sums[LANES * c + a] = lane(sum_over_lanes(w[c]), 0)
        sums[LANES * (3 + c) + a] = lane(sum_over_lanes(p[c]), 0)
        sums[LANES * (6 + c) + a] = lane(sum_over_lanes(others[0][c]), 0)
    sums[LANES * 9 + a] = lane(sum_over_lanes(others[1]), 0)


@routine
def fit_lanes(sums: Array, out: Array) -> None:
    """Write the planes fitted to the sums of each lane."""
    share = ONE / vmax(load16(sums, LANES * 9), broadcast16(f32(TINIEST)))
    x, y, z = load16(sums, 0) * share, load16(sums, LANES) * share, load16(sums, 2 * LANES) * share
    upper = (
        *(load16(sums, 3 * LANES) * share - x * x, load16(sums, 4 * LANES) * share - x * y),
        *(load16(sums, 5 * LANES) * share - x * z, load16(sums, 6 * LANES) * share - y * y),
        *(load16(sums, 7 * LANES) * share - y * z, load16(sums, 8 * LANES) * share - z * z),
    )
    n, _, _, _ = principal_axes(upper)
    store(out, 0, n[0])
    store(out, LANES, n[1])
    store(out, 2 * LANES, n[2])
    store(out, 3 * LANES, ZERO - (n[0] * x + n[1] * y + n[2] * z))


@inline
def height(planes: Array, a: int, p: Triple) -> F16:
    """Return the heights of sixteen places above plane a."""
    n = broadcast_from(planes, a), broadcast_from(planes, LANES + a), broadcast_from(planes, 2 * LANES + a)
    return n[0] * p[0] + n[1] * p[1] + n[2] * p[2] + broadcast_from(planes, 3 * LANES + a)


@routine
def find_candidates(k: int, memory: Neighbors) -> None:
    """Fit planes around the point, and around neighbours that are far from all previous ones."""
    width, place = f32(NARROW * NARROW), 0
    for at in range(0, len(memory.weights), LANES):
        store(memory.away, at, select(load16(memory.weights, at) > ZERO, broadcast16(INF), broadcast16(f32(-1.0))))
    for a in range(CANDIDATES):
        place = _around(a, place, width, memory)
    fit_lanes(memory.sums, memory.found)


@inline
def _around(a: int, place: int, width: float, memory: Neighbors) -> int:
    """Sum up candidate a around a neighbour; return the neighbour that is farthest from all used so far."""
    rows = len(memory.weights)
    mx, my = broadcast_from(memory.places, place), broadcast_from(memory.places, rows + place)
    mz = broadcast_from(memory.places, 2 * rows + place)
    total = x = y = z = xx = xy = xz = yy = yz = zz = zeros()
    farthest, following = f32(-1.0), 0
    for at in range(0, rows, LANES):
        p, q, r = load_places(memory, at)
        dx, dy, dz = p - mx, q - my, r - mz
        square = dx * dx + dy * dy + dz * dz
        w = vmax(ONE - square * (ONE / width), zeros())
        w = select(load16(memory.weights, at) > ZERO, w * w, zeros())
        wp, wq, wr = w * p, w * q, w * r
        total, x, y, z = total + w, x + wp, y + wq, z + wr
        xx, xy, xz = xx + wp * p, xy + wp * q, xz + wp * r
        yy, yz, zz = yy + wq * q, yz + wq * r, zz + wr * r
        away = vmin(load16(memory.away, at), square)
        store(memory.away, at, away)
        most = reduce_max(away)
        if most > farthest:
            farthest, following = most, at + count_trailing_zeros(bits(away >= most))
    store_sums(memory.sums, a, (x, y, z), (xx, xy, xz), ((yy, yz, zz), total))
    return following
