"""Local planes of a scan: undirected normals of a few points, estimated in milliseconds without kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.arrays import Doubles, Flags, Rows

PLACES = 600  # planes at most
SUBSET = 5000  # points to which they are fitted
NEIGHBORS = 12
FLAT = 0.03  # largest variance across a flat plane, as a share of the largest variance
SCATTERED = 0.12  # smallest such share of foliage
BLOCK = 300  # positions whose neighbours are searched together: 14 MB


class Planes(NamedTuple):
    """Planes fitted to the neighbourhoods of positions spread evenly over a scan's surface.

    Attributes
    ----------
    positions, normals : (m, 3) float64
        The sign of a normal has no meaning.
    flat, scattered : (m,) bool
        Whether the points of a neighbourhood lie in a plane or along a line; whether they fill a volume.
    """

    positions: Doubles
    normals: Doubles
    flat: Flags
    scattered: Flags


def fit_planes(positions: Doubles) -> Planes:
    """Fit a plane to the 12 points nearest to each of up to 600 places spread over a scan; none if points are too few.

    positions : (n, 3), the scan's points
    """
    subset = positions[:: max(len(positions) // SUBSET, 1)]
    if len(subset) <= NEIGHBORS:
        none = np.zeros((0, 3))
        return Planes(none, none, np.zeros(0, bool), np.zeros(0, bool))
    subset = subset - subset.mean(axis=0)
    size = float(np.ptp(subset, axis=0).max()) or 1.0
    places = _spread_places(subset, size)
    moments = np.empty((len(places), 3, 3))
    for start in range(0, len(places), BLOCK):
        rows = places[start : start + BLOCK]
        near = subset[_nearest(subset[rows] / size, subset / size)]
        near -= near.mean(axis=1, keepdims=True)
        moments[start : start + BLOCK] = np.einsum("nki,nkj->nij", near, near)
    values, axes = np.linalg.eigh(moments)
    across = values[:, 0] / np.maximum(values[:, 2], 1e-300)
    shift = positions[:: max(len(positions) // SUBSET, 1)][places]
    return Planes(shift, axes[:, :, 0], across < FLAT, across > SCATTERED)


def _spread_places(subset: Doubles, size: float) -> Rows:
    """Return rows of up to `PLACES` points spread evenly: one in each occupied cell of the finest grid that allows it.

    subset : (n, 3), centred; size : largest extent
    """
    cells = 64
    while True:
        keys = np.floor((subset - subset.min(axis=0)) / size * cells).astype(np.int64) @ (1, 128, 128 * 128)
        rows = np.unique(keys, return_index=True)[1]
        if len(rows) <= PLACES or cells == 1:
            return rows
        cells = max(int(cells * 0.8), 1)


def _nearest(places: Doubles, subset: Doubles) -> Rows:
    """Return the rows in `subset` of the points nearest to each place, including itself, (m, NEIGHBORS).

    places : (m, 3); subset : (n, 3)
    """
    a, b = places.astype(np.float32), subset.astype(np.float32)
    squared = np.square(b).sum(axis=1) - 2.0 * (a @ b.T)
    return np.argpartition(squared, NEIGHBORS, axis=1)[:, :NEIGHBORS]
