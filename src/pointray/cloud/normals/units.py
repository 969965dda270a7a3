"""Normalisation of vectors."""

from __future__ import annotations

import math

import numpy as np

from ...base.arrays import Doubles, Floats
from ...engine.jit import Array, borrow, f64, kernel, next_tile, run

CHUNK = 1 << 14  # vectors of a tile


@kernel
def _to_units(work: Array, vectors: Array, units: Array, lengths: Array) -> None:
    """Write unit vectors and the lengths before, both 0 where a vector is zero or not finite.

    work : gives each thread its next tile, 2^14 vectors
    vectors, units : (n, 3) float32; lengths : (n,) float64, which holds the square of every float32
    """
    vectors, units, lengths = borrow(vectors), borrow(units), borrow(lengths)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(vectors))):
            x, y, z = f64(vectors[i, 0]), f64(vectors[i, 1]), f64(vectors[i, 2])
            length = math.sqrt(x * x + y * y + z * z)
            good = 0.0 < length < math.inf  # false for NaN
            lengths[i] = length if good else 0.0
            units[i, 0], units[i, 1], units[i, 2] = (x / length, y / length, z / length) if good else (0.0, 0.0, 0.0)
        tile = next_tile(work)


def to_units(vectors: Floats) -> tuple[Floats, Doubles]:
    """Return unit vectors, (n, 3), and their lengths before, (n,); both are 0 where a vector is zero or not finite."""
    units, lengths = np.empty_like(vectors, order="C"), np.empty(len(vectors))
    run(_to_units, -(-len(vectors) // CHUNK), np.ascontiguousarray(vectors), units, lengths)
    return units, lengths
