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
    """One thread's memory for planes near one point and the neighbours that they are fitted to; flat float32 arrays.

    A plane is a unit normal n and an offset d: n.x + d = 0. Vectors of 16 lanes hold 16 neighbours, or one plane a
    lane.

    Attributes
    ----------
    places : (3 * width,)
        x of all neighbours, then y, then z: offsets from the point, scaled so that the farthest neighbour is at
        distance 1. The width is the number of neighbours rounded up to a multiple of 16.
    weights : (width,)
        Weight of each neighbour, decreasing with its distance; 0 beyond the last neighbour.
    away : (width,)
        Squared distance of each neighbour from the nearest place around which a candidate plane has been fitted.
    owner : (width,)
        Index of the chosen plane that each neighbour lies on, or -1.
    sums : (10 * 16,)
        Weighted sums over the neighbours of each plane: x y z, xx xy xz, yy yz zz, and the weights.
    found, chosen, again : (4 * 16,)
        Planes, one a lane: x of the normals, then y, z and the offsets. `found` holds nine candidates, `chosen` the two
        or three planes of the edge or corner, `again` new fits of these. If only two are chosen, the third has the
        normal 0 and an offset that makes it lower than both.
    heights : (62 * 16,)
        Heights of some neighbours above all candidates: 16 floats a neighbour.
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
    """Return memory for the planes near a point with at most `most` neighbours."""
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
    """Load the neighbours near[i] of the point positions[row]: scaled offsets from it, and weights by distance.

    Return the distance of the farthest neighbour, which is the unit of the offsets.

    near : (m, k) rows of `positions`, nearest first
    """
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
    """Return x, y and z of the sixteen neighbours from index `at` on: offsets from the point, see `Neighbors`."""
    width = len(memory.weights)
    return load16(memory.places, at), load16(memory.places, width + at), load16(memory.places, 2 * width + at)


@inline
def store_sums(sums: Array, a: int, w: Triple, p: Triple, others: tuple[Triple, F16]) -> None:
    """Write the sums over the neighbours of plane `a` to lane `a` of `sums`: x y z, xx xy xz, yy yz zz, weights.

    The lanes of each argument are partial sums, which are added up.

    w, p : weighted sums of x, y, z, and of xx, xy, xz
    others : weighted sums of yy, yz, zz, and the sum of the weights
    """
    for c in range(3):
        sums[LANES * c + a] = lane(sum_over_lanes(w[c]), 0)
        sums[LANES * (3 + c) + a] = lane(sum_over_lanes(p[c]), 0)
        sums[LANES * (6 + c) + a] = lane(sum_over_lanes(others[0][c]), 0)
    sums[LANES * 9 + a] = lane(sum_over_lanes(others[1]), 0)


@routine
def fit_lanes(sums: Array, out: Array) -> None:
    """Fit sixteen planes, one in each lane, to the sums over the neighbours of each.

    sums : (10 * 16,) weighted sums of x y z, xx xy xz, yy yz zz, and of the weights
    out : (4 * 16,) receives x, y and z of the unit normals n, and the offsets d: n.x + d = 0
    """
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
    """Return the heights of sixteen places above plane `a`: signed distances, positive in front of its normal.

    planes : (4 * 16,) x, y and z of the normals, and the offsets, one plane a lane
    p : x, y and z of the places
    """
    n = broadcast_from(planes, a), broadcast_from(planes, LANES + a), broadcast_from(planes, 2 * LANES + a)
    return n[0] * p[0] + n[1] * p[1] + n[2] * p[2] + broadcast_from(planes, 3 * LANES + a)


@routine
def find_candidates(k: int, memory: Neighbors) -> None:
    """Fit nine candidates for the planes of an edge: one around the point, the others around some of its neighbours.

    The centre of each is the neighbour that is farthest from all previous centres.

    k : number of neighbours; not used
    """
    width, place = f32(NARROW * NARROW), 0
    for at in range(0, len(memory.weights), LANES):
        store(memory.away, at, select(load16(memory.weights, at) > ZERO, broadcast16(INF), broadcast16(f32(-1.0))))
    for a in range(CANDIDATES):
        place = _around(a, place, width, memory)
    fit_lanes(memory.sums, memory.found)


@inline
def _around(a: int, place: int, width: float, memory: Neighbors) -> int:
    """Store in the memory the sums from which candidate plane `a` is fitted to the neighbours around one of them.

    Returns the index of the neighbour that is farthest from the centres of all candidates so far: the next centre.

    place : index of the neighbour around which plane `a` is fitted, its centre
    width : squared radius around the centre beyond which weights are 0; the farthest neighbour is at distance 1
    """
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
