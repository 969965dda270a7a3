"""Sparse points between dense ones, and small floating groups."""

from __future__ import annotations

import numpy as np

from ...base.arrays import Flags, Floats
from ...engine.jit import run
from ..neighbors import neighbors
from ..neighbors.components import connected_components
from .floors import Floors
from .links import CHUNK, link, third_least
from .local_fits import CORE

THIN = 3.0  # times the distances of dense points within some steps: 27 times fewer per volume
STEPS = 3  # steps from neighbour to neighbour, each to the third least of the distances
GAP = 4.0  # gap around a floating group, in distances to the `CORE`-th neighbour, about 6 spacings
FEW, SHARE = 20, 5e-4  # greatest number of points of a floating group, or share of all points


def find_sparse(floors: Floors) -> Flags:
    """Return which points, (n,) bool, are much sparser than those around, and lie on no smooth surface of such points.

    floors : the surface near each point
    """
    least = np.ascontiguousarray(floors.core)
    for _ in range(STEPS):
        low = np.empty_like(least)
        run(third_least, -(-len(low) // CHUNK), least, floors.near, low)
        least = low
    return np.asarray((floors.core > THIN * least) & ~floors.is_on)


def find_floating(positions: Floats, floors: Floors, strays: Flags) -> Flags:
    """Return which points, (n,) bool, are in small groups far from all others, such as birds.

    positions : (n, 3)
    floors : the surface near each point
    strays : (n,) points found to be other strays, which do not connect groups
    """
    n = len(positions)
    floating = np.zeros(n, np.bool_)
    core = np.maximum(floors.core, np.float32(np.median(floors.core)))
    near, is_linked = floors.near[:, 1 : CORE + 1], np.empty((n, min(CORE, floors.near.shape[1] - 1)), np.bool_)
    run(link, -(-n // CHUNK), positions, near, GAP * core, strays, is_linked)
    part = connected_components(near, is_linked)
    sizes = np.bincount(part)
    small = (sizes[part] <= max(FEW, SHARE * n)) & ~strays
    rest = np.flatnonzero(~small & ~strays)
    suspects = np.flatnonzero(small)
    if len(rest) == 0 or len(suspects) == 0:
        return floating
    gaps, nearest = neighbors(positions[rest], 1, positions[suspects])
    gap = np.full(len(sizes), np.inf)
    np.minimum.at(gap, part[suspects], gaps[:, 0] / core[rest[nearest[:, 0]]])
    floating[suspects] = (gap > GAP)[part[suspects]]
    return floating
