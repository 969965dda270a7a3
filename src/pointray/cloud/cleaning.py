"""Cleaning: exact duplicates and far outliers are found, reported and dropped.

An outlier belongs to a group, single or small, that lies far from everything else: farther than FAR times the usual
spacing around the nearest of the rest and of the whole cloud, and farther than the group is wide. Sparse parts of an
uneven scan stay, as they have many points that are close together for their own spacing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_callback, check_flag, check_kind
from ..base.progress import Progress, part_of
from .neighbors import distinct, neighbors
from .neighbors.components import connected_components
from .points import Points

AROUND = 8  # neighbours that give the spacing
FAR = 12.0  # spacings: how far a group must lie from the rest
FEW = 1e-3  # greatest share of the positions in a group of outliers
PLACED, NEAR = 0.1, 0.6  # share of the time until positions are distinct; share of the rest until neighbours are found
GROUP = 30  # or this many positions, if that is less than a tenth of all


class Flaws(NamedTuple):
    """The flawed rows of a cloud."""

    duplicates: NDArray[np.bool_]  # (n,), whether an earlier row has the same position, bit for bit
    outliers: NDArray[np.bool_]  # (n,), whether the row is far from everything else


def find_flaws(points: Points, progress: Progress | None = None) -> Flaws:
    """Duplicates and far outliers; rows that are not finite are neither.

    Parameters
    ----------
    points : Points
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    Flaws
        `duplicates` and `outliers`, (n,) bool each.
    """
    check_kind(points, "points", Points, "Points")
    check_callback(progress)
    finite = np.flatnonzero(points.finite)
    rows, ids = distinct(points.positions[finite])
    duplicates = np.zeros(len(points), np.bool_)
    duplicates[finite] = True
    duplicates[finite[rows]] = False
    outliers = np.zeros(len(points), np.bool_)
    outliers[finite] = _far(points.positions[finite][rows], part_of(progress, PLACED, 1.0))[ids]
    return Flaws(duplicates, outliers)


def clean(points: Points, duplicates: bool = True, outliers: bool = True) -> Points:
    """The points without exact duplicates (the first of equal positions stays) and without far outliers.

    Parameters
    ----------
    points : Points
    duplicates, outliers : bool
        What to drop. `find_flaws` tells which rows these are.

    Returns
    -------
    Points
        The other rows in their order; rows that are not finite stay.
    """
    duplicates, outliers = check_flag(duplicates, "duplicates"), check_flag(outliers, "outliers")
    flaws = find_flaws(points)
    drop = (flaws.duplicates & duplicates) | (flaws.outliers & outliers)
    return points.select(~drop) if drop.any() else points


def _far(positions: NDArray[np.float32], progress: Progress | None) -> NDArray[np.bool_]:
    """Which of the positions, all distinct, are outliers."""
    n = len(positions)
    far = np.zeros(n, np.bool_)
    if n <= 2 * AROUND:  # too few to tell what is usual
        return far
    distances, near = neighbors(positions, AROUND + 1, progress=part_of(progress, 0.0, NEAR))
    usual = float(np.median(distances[:, AROUND]))
    # Points closer than FAR spacings are linked; the spacing is the neighbour's or the usual one, whichever is greater.
    local = np.maximum(np.median(distances[:, AROUND][near[:, 1:]], axis=1), usual)
    most = min(max(FEW * n, GROUP), 0.1 * n)
    near = near[:, 1:]
    part = connected_components(near, distances[:, 1:] < FAR * local[near])
    sizes = np.bincount(part)
    suspects = np.flatnonzero(sizes[part] <= most)
    if len(suspects) in (0, n):
        return far
    rest = np.flatnonzero(sizes[part] > most)
    if len(rest) == 0:
        return far
    gaps, nearest = neighbors(positions[rest], 1, positions[suspects])
    gap = np.full(len(sizes), np.inf)
    np.minimum.at(gap, part[suspects], gaps[:, 0] / local[rest[nearest[:, 0]]])
    far[suspects] = (gap > FAR)[part[suspects]]
    return far
