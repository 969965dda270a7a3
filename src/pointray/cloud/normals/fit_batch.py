"""Neighbourhoods of sixteen points side by side: each lane of a vector holds those of one point.

Places are float32 about their point, in the distance of its farthest neighbour, so that sums of their powers are of
order 1. In a cloud a thousand spacings wide float32 coordinates themselves are hundreds of times coarser than places.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from ...engine.jit import Array, f32, f64, inline, u64
from ...engine.simd import F16, broadcast16, load16

LANES = 16
ROW = 3 * LANES  # numbers of one neighbour of all sixteen points: x, y and z
TINIEST = 1e-37  # the least distance of the farthest neighbour, far below which float32 ends
RESULTS = 10

Triple: TypeAlias = tuple[F16, F16, F16]
Sextuple: TypeAlias = tuple[F16, F16, F16, F16, F16, F16]


class FitBatch16(NamedTuple):
    """One thread's memory for fits to at most `most` neighbours of each of sixteen points, all flat float32.

    Attributes
    ----------
    places : (most * ROW,)
        x of the sixteen points' nearest neighbours, then y and z, then those of the next ones: about the point, the
        farthest at distance 1. A lane with fewer neighbours repeats its last one.
    local : (most * ROW,)
        Two coordinates on the plane of a fit, and the height over it; the farthest that is fitted at distance 1.
    weights, residuals : (most * LANES,)
        Of a fit: weights by distance alone, and what its first round leaves.
    counts : (LANES,)
        How many neighbours there are.
    units : (LANES,)
        The distance of the farthest neighbour.
    results : (RESULTS * LANES,)
        What a fit finds, see `jet`.
    """

    places: Array
    local: Array
    weights: Array
    residuals: Array
    counts: Array
    units: Array
    results: Array


@inline
def new_sixteen(most: int) -> FitBatch16:
    """Memory for fits to at most so many neighbours."""
    return FitBatch16(
        np.zeros(most * ROW, np.float32),
        np.zeros(most * ROW, np.float32),
        np.zeros(most * LANES, np.float32),
        np.zeros(most * LANES, np.float32),
        np.zeros(LANES, np.float32),
        np.zeros(LANES, np.float32),
        np.zeros(RESULTS * LANES, np.float32),
    )


@inline
def load_point(positions: Array, row: int, near: Array, i: int, farthest: int, lane: int, memory: FitBatch16) -> None:
    """Fill a lane with the neighbours near[i] of positions[row]; the one at `farthest` is at distance 1."""
    x, y, z = positions[row, 0], positions[row, 1], positions[row, 2]
    far = near[i, farthest]
    dx, dy, dz = f64(positions[far, 0]) - x, f64(positions[far, 1]) - y, f64(positions[far, 2]) - z
    unit = max(math.sqrt(dx * dx + dy * dy + dz * dz), TINIEST)
    inverse, places, most = f32(1.0 / unit), memory.places, len(memory.places) // ROW
    for j in range(most):
        other, at = u64(near[i, j]), ROW * j + lane
        places[at] = (positions[other, 0] - x) * inverse
        places[at + LANES] = (positions[other, 1] - y) * inverse
        places[at + 2 * LANES] = (positions[other, 2] - z) * inverse
    memory.counts[lane], memory.units[lane] = f32(most), f32(unit)


@inline
def load_place(places: Array, j: int) -> Triple:
    """x, y and z of neighbour j of the sixteen points."""
    return load16(places, ROW * j), load16(places, ROW * j + LANES), load16(places, ROW * j + 2 * LANES)


@inline
def distance_weight(square: F16) -> F16:
    """exp(-square), from 0 to 1 within 5e-7; a little beyond 1 it still falls."""
    y = 0.03833892 - 0.00509973 * square
    y = y * square - 0.16501272
    y = y * square + 0.49962087
    y = y * square - 0.99996785
    return y * square + 0.99999955


@inline
def zeros() -> F16:
    return broadcast16(f32(0.0))


@inline
def inner(a: Triple, b: Triple) -> F16:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
