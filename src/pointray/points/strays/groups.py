"""Sparse points between dense ones, and small groups that float by themselves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...neighbors import neighbors
from .floors import CORE, Floors

Floats = NDArray[np.float32]

THIN = 3.0  # times as far apart as the dense points within some steps: 27 times fewer to a volume
STEPS, LOW = 3, 2  # steps from neighbour to neighbour, to the third least of their distances
GAP = 4.0  # distances to the `CORE`-th neighbour, some 6 spacings: a group farther from the rest floats
FEW, SHARE = 20, 5e-4  # the most points of a floating group: so many, or this share of all


def thin(floors: Floors) -> NDArray[np.bool_]:
    """Which points are far sparser than those around and lie on no smooth sheet of such points."""
    least = floors.core
    for _ in range(STEPS):
        least = np.partition(least[floors.near], LOW, axis=1)[:, LOW]
    return np.asarray((floors.core > THIN * least) & ~floors.is_on)


def adrift(positions: Floats, floors: Floors, strays: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which points are in small groups, far from the rest; strays link nothing."""
    n = len(positions)
    floating = np.zeros(n, np.bool_)
    core = np.maximum(floors.core, np.float32(np.median(floors.core)))
    near = floors.near[:, 1 : CORE + 1]
    away = np.linalg.norm(positions[near] - positions[:, None], axis=2)
    link = (away < GAP * core[near]) & ~strays[near] & ~strays[:, None]
    one, other = np.repeat(np.arange(n), near.shape[1]).reshape(near.shape)[link], near[link]
    edges = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(n, n))
    part = connected_components(edges, directed=False)[1]
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
