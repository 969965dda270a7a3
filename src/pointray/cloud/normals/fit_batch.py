"""Fit memory: the neighbourhoods of sixteen points side by side, one point per vector lane.

Places are float32 offsets from the point, divided by the distance of its farthest neighbour, so that sums of their
powers are of order 1. In a cloud a thousand spacings wide, float32 coordinates are hundreds of times coarser.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from ...engine.jit import Array, f32, f64, inline, u64
from ...engine.simd import F16, broadcast16, load16

LANES = 16
ROW = 3 * LANES  # floats of one neighbour of all sixteen points: x, y and z
TINIEST = 1e-37  # lower limit of the farthest neighbour's distance, near the end of float32
RESULTS = 10

Triple: TypeAlias = tuple[F16, F16, F16]
Sextuple: TypeAlias = tuple[F16, F16, F16, F16, F16, F16]


class FitBatch16(NamedTuple):
    """One thread's memory for fits to the neighbours of sixteen points, one point in each lane; flat float32 arrays.

    Attributes
    ----------
    places : (most * 48,)
        x, then y, then z of the nearest neighbour in all lanes, then of the next one: offsets from the point, scaled so
        that the farthest neighbour is at distance 1. A lane with fewer neighbours repeats its last one.
    local : (most * 48,)
        The same in the axes of a fitted plane: two coordinates in it, and the height above it; the farthest fitted
        neighbour is at distance 1.
    weights, residuals : (most * 16,)
        Weight of each neighbour by distance alone, and its residual from the first of two fits.
    counts : (16,)
        Number of neighbours.
    units : (16,)
        Distance of the farthest neighbour: the unit of the scaled offsets.
    results : (10 * 16,)
        Results of a fit, 16 floats for each number: x, y, z of the quadric's normal at the point and of the plane's
        normal; RMS residual; variance of the slope for unit noise; height of the quadric at the point; variance of that
        height for unit noise.
    """

    places: Array
    local: Array
    weights: Array
    residuals: Array
    counts: Array
    units: Array
    results: Array


@inline
def new_fit_batch(most: int) -> FitBatch16:
    """Return memory for fits to at most `most` neighbours of each of sixteen points."""
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
    """Load the neighbours of the point positions[row] into a lane: offsets from it, scaled by a neighbour's distance.

    near : (m, k) rows of neighbours, nearest first; near[i] are those of the point
    farthest : index in near[i] of the neighbour that gets distance 1
    """
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
    """Return x, y and z of the j-th neighbour in all sixteen lanes: scaled offsets from its point, see `FitBatch16`."""
    return load16(places, ROW * j), load16(places, ROW * j + LANES), load16(places, ROW * j + 2 * LANES)


@inline
def distance_weight(square: F16) -> F16:
    """Return weights of neighbours by squared distance, exp(-square), within 5e-7 for squares from 0 to 1.

    They still decrease slightly beyond 1.
    """
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
    """Return the scalar products of the vectors in sixteen lanes."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
