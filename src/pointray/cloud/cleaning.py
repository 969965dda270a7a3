"""Cleaning: find, report and drop exact duplicates and distant outliers.

An outlier belongs to a group of few points, or stands alone, far from everything else: farther than FAR times the
larger of the local and the median spacing. Sparse regions of an uneven scan are kept, since many of their points are
close together relative to their own spacing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_callback, check_flag
from ..base.progress import Progress, StageProgress, in_stage, part_of
from .conversion import PointsLike, check_points
from .neighbors import distinct, neighbors
from .neighbors.components import connected_components
from .points import Points

AROUND = 8  # neighbours that define the spacing
FAR = 12.0  # spacings between a group of outliers and the rest, at least
FEW = 1e-3  # greatest share of the positions in a group of outliers
PLACED, NEAR = 0.1, 0.6  # progress when duplicates are found; share of the rest when neighbours are found
GROUP = 30  # positions that a group may have in any case, if less than a tenth of all


class Flaws(NamedTuple):
    """Result of `find_flaws`: flaws of a cloud, row by row.

    Attributes
    ----------
    duplicates : (n,) bool
        Rows with exactly the same position as an earlier row.
    outliers : (n,) bool
        Rows far from everything else, alone or in a small group: more than 12 times as far as a point there is from its
        eighth neighbour.

    Examples
    --------
    >>> flaws = pr.find_flaws(pr.Points([[0, 0, 0], [1, 0, 0], [0, 0, 0]]))
    >>> int(flaws.duplicates.sum()), int(flaws.outliers.sum())
    (1, 0)
    """

    duplicates: NDArray[np.bool_]
    outliers: NDArray[np.bool_]


def find_flaws(points: PointsLike, progress: StageProgress | None = None) -> Flaws:
    """Find exact duplicates, and distant outliers: points far from everything else, alone or in a small group.

    Rows that are not finite are neither.

    Parameters
    ----------
    points : Points, or what `as_points` accepts
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Returns
    -------
    Flaws
        `duplicates` and `outliers`, (n,) bool each.

    Raises
    ------
    TypeError
        If an argument has the wrong type.

    Examples
    --------
    >>> points = pr.Points([[0, 0, 0], [1, 0, 0], [0, 0, 0]])
    >>> pr.find_flaws(points).duplicates.tolist()
    [False, False, True]
    """
    points = check_points(points)
    check_callback(progress)
    finite = np.flatnonzero(points.finite)
    rows, ids = distinct(points.positions[finite])
    duplicates = np.zeros(len(points), np.bool_)
    duplicates[finite] = True
    duplicates[finite[rows]] = False
    outliers = np.zeros(len(points), np.bool_)
    part = part_of(in_stage(progress, "finding duplicates and outliers"), PLACED, 1.0)
    outliers[finite] = _far(points.positions[finite][rows], part)[ids]
    return Flaws(duplicates, outliers)


def clean(points: PointsLike, duplicates: bool = True, outliers: bool = True) -> Points:
    """Remove exact duplicates, and distant outliers: points far from everything else, alone or in a small group.

    The first of several equal positions is kept, and so are rows that are not finite.

    Parameters
    ----------
    points : Points, or what `as_points` accepts
    duplicates, outliers : bool
        What to remove; `find_flaws` returns these rows.

    Returns
    -------
    Points
        The remaining rows in their order; `points` itself if nothing is removed.

    Raises
    ------
    TypeError
        If an argument has the wrong type.

    Examples
    --------
    >>> points = pr.Points([[0, 0, 0], [1, 0, 0], [0, 0, 0]])
    >>> len(pr.clean(points))
    2
    """
    duplicates, outliers = check_flag(duplicates, "duplicates"), check_flag(outliers, "outliers")
    points = check_points(points)
    flaws = find_flaws(points)
    drop = (flaws.duplicates & duplicates) | (flaws.outliers & outliers)
    return points.select(~drop) if drop.any() else points


def _far(positions: NDArray[np.float32], progress: Progress | None) -> NDArray[np.bool_]:
    """Return which of m distinct positions lie alone or in a small group, far from all others, (m,) bool.

    positions : (m, 3) float32
    """
    n = len(positions)
    far = np.zeros(n, np.bool_)
    if n <= 2 * AROUND:  # too few for statistics
        return far
    distances, near = neighbors(positions, AROUND + 1, progress=part_of(progress, 0.0, NEAR))
    typical = float(np.median(distances[:, AROUND]))
    # Points closer than FAR spacings are linked; the spacing is the larger of the neighbour's and the median one.
    local = np.maximum(np.median(distances[:, AROUND][near[:, 1:]], axis=1), typical)
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
