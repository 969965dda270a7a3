"""Clusters of a sample: the points to frame, without distant clusters, small islands and duplicate positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Flags, Rows

STRAY = 0.0005  # share of the points at either end of an axis that counts as outliers
CELLS = 32  # along the longest side without outliers: points in neighbouring cells are connected
ISLAND = 0.0025  # share of the points: a smaller connected group is not framed, even if it is near
APART = 0.02  # share of the points: if more are separate, the scan consists of several objects
SHRUNK = 8  # a cluster this many times smaller than its surroundings is an object of its own
ROUNDS = 12  # each finds clusters at the scale of the previous round's main cluster


FACTORS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)  # hash multipliers
# Offsets to half of a cell's 26 neighbours; symmetry covers the other half.
ASIDE = np.array([o for o in np.ndindex(3, 3, 3) if o > (1, 1, 1)]) - 1


def places(positions: Doubles) -> Rows:
    """Return the first row of each distinct position, sorted, (m,), so that each position counts once.

    Scanners repeat a position for rows without a return.

    positions : (n, 3)
    """
    bits = np.ascontiguousarray(positions + 0.0).view(np.uint64).reshape(-1, 3)  # -0 is 0
    _, first = np.unique(_hash(bits), return_index=True)
    return np.sort(first)


def find_main(positions: Doubles) -> tuple[Flags, Flags]:
    """Find the points that the camera frames, and the distant points among the others.

    A cluster is distant if its distance from the main (largest) cluster exceeds the size of the main cluster. At most
    2% of the points may be distant. Clusters are connected cells of a grid, which is refined to the main cluster until
    no cluster is distant. Clusters of less than 0.25% of the points are not framed either if all of these have at most
    2% of the points.

    Parameters
    ----------
    positions : (n, 3) float64
        Distinct positions.

    Returns
    -------
    framed, distant : (n,) bool
        Whether each point is framed; whether it is distant.
    """
    n = len(positions)
    distant = np.zeros(n, bool)
    low, high = np.quantile(positions, [STRAY, 1.0 - STRAY], axis=0)
    for _ in range(ROUNDS):
        rows = np.flatnonzero(~distant)
        size = float((high - low).max())
        if not size > 0:
            break
        group = clusters(positions[rows], low, size / CELLS)
        counts = np.bincount(group)
        main = positions[rows[group == counts.argmax()]]
        low, high = main.min(axis=0), main.max(axis=0)
        far = _gaps(positions[rows], group, low, high) > (high - low).max()
        few = np.count_nonzero(distant) + counts[far].sum() <= APART * n
        if not far.any() or not few:
            small = counts < ISLAND * n
            small[counts.argmax()] = False
            framed = ~distant
            if counts[small].sum() <= APART * n:
                framed[rows[small[group]]] = False
            return framed, distant
        distant[rows[far[group]]] = True
    return ~distant, distant


def largest_cluster(positions: Doubles) -> Rows:
    """Return the rows of the largest cluster of positions, (n, 3).

    If it is at most 1/8 as wide as all points and has enough of them, the search is repeated inside it, and so on.
    """
    rows = np.arange(len(positions))
    size = float(np.ptp(positions, axis=0).max())
    while size > 0:
        group = clusters(positions[rows], positions[rows].min(axis=0), size / CELLS)
        largest = rows[group == np.bincount(group).argmax()]
        smaller = float(np.ptp(positions[largest], axis=0).max())
        if SHRUNK * smaller > size or len(largest) < ISLAND * len(rows):
            break
        rows, size = largest, smaller
    return rows


def clusters(positions: Doubles, low: Doubles, cell: float) -> Rows:
    """Return the cluster number of each point, (n,). Clusters are cells of a grid connected by faces, edges or corners.

    Parameters
    ----------
    positions : (n, 3) float64
    low : (3,) float64
        Minimum corner of a cell.
    cell : float
        Side length of a cell.
    """
    at = np.clip(np.floor((positions - low) / cell), -(2.0**60), 2.0**60).astype(np.int64)
    keys, of = np.unique(_hash(at.view(np.uint64)), return_inverse=True)
    pairs = []
    for offset in ASIDE:
        neighbor_keys = keys + _hash(offset.astype(np.int64).view(np.uint64)[None])
        place = np.searchsorted(keys, neighbor_keys).clip(max=len(keys) - 1)
        found = keys[place] == neighbor_keys
        pairs.append((np.flatnonzero(found), place[found]))
    one, other = (np.concatenate(side) for side in zip(*pairs, strict=True))
    label: Rows = np.arange(len(keys))
    before = label[:0]
    while not np.array_equal(label, before):
        before = label
        label = before.copy()
        np.minimum.at(label, one, before[other])
        np.minimum.at(label, other, before[one])
        label = label[label]
    return np.asarray(np.unique(label, return_inverse=True)[1][of], np.int64)


def _hash(rows: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return a hash of each row, (n,). rows : (n, 3)

    It is linear, so the hashes of neighbouring cells differ by constants.
    """
    return np.asarray((rows * FACTORS).sum(axis=1, dtype=np.uint64), np.uint64)


def _gaps(positions: Doubles, group: Rows, low: Doubles, high: Doubles) -> Doubles:
    """Return the distance from a box to the nearest point of each group, (groups,); 0 or less if a point is inside.

    The distance of a point is the largest of the distances along x, y and z.

    positions : (n, 3); group : (n,), group number of each point; low, high : (3,), corners of the box
    """
    gap = np.maximum(low - positions, positions - high).max(axis=1)
    out = np.full(int(group.max()) + 1, np.inf)
    np.minimum.at(out, group, gap)
    return out
