"""Kernels that link points with their neighbours."""

from __future__ import annotations

import math

from ...engine.jit import Array, borrow, f64, kernel, next_tile

CHUNK = 4096  # points of a tile


@kernel
def third_least(work: Array, values: Array, near: Array, out: Array) -> None:
    """Write to out[i] the third least of the values of the points near[i]: a minimum despite two exceptions.

    work : gives each thread its next tile, 4096 points
    values, near : (n,), and (n, k) rows
    """
    values, near, out = borrow(values), borrow(near), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            one, two, three = values[near[i, 0]], math.inf, math.inf
            for j in near[i, 1:]:
                value = values[j]
                if value < one:
                    one, two, three = value, one, two
                elif value < two:
                    two, three = value, two
                elif value < three:
                    three = value
            out[i] = three
        tile = next_tile(work)


@kernel
def link(work: Array, positions: Array, near: Array, reach: Array, strays: Array, out: Array) -> None:
    """Write to out[i, j] whether point i is within the reach of its neighbour near[i, j], and neither is a stray.

    work : gives each thread its next tile, 4096 points
    positions, near : (n, 3), and (n, k) rows of neighbours
    reach : (n,) distance within which each point is linked with others
    strays : (n,) bool
    """
    positions, near, reach, out = borrow(positions), borrow(near), borrow(reach), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            for j in range(near.shape[1]):
                other, square = near[i, j], 0.0
                for c in range(3):
                    square += (f64(positions[other, c]) - f64(positions[i, c])) ** 2
                limit = f64(reach[other])
                out[i, j] = square < limit * limit and not strays[i] and not strays[other]
        tile = next_tile(work)
