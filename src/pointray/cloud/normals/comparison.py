"""Comparison of a file's normals with planes fitted to the points' neighbours.

The mean normal of a neighbourhood is compared with the plane through its points. Both are smoothed alike, so detail
finer than the point spacing, which correct normals show and planes do not, does not count against a file. The
residuals of a plane give the standard deviation of its own tilt; planes with a large one are not used.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...base.arrays import Doubles, Floats
from ..conversion import PointsLike, check_points
from ..neighbors.few_queries import Neighborhoods, find_neighborhoods
from ..points import Points
from ..rounding import find_rounding

WRONG = 15.0  # degrees: eleven scans and meshes with correct normals have 0.4 to 3.8
SURE = 5.0  # degrees: largest standard deviation of the tilt of a plane that is used
ENOUGH = 0.1, 12  # share and number of planes that must be usable
SAMPLE = 2_000  # points whose normals are compared
SIZES = (12, 16, 32, 64)  # neighbourhood sizes to choose from
LOCAL = 16  # least number of points, over a neighbourhood's: planes through a whole torus are off by 24 degrees
STEPS = 2.0  # rounding steps that a plane must span: otherwise its points may all lie on one step
SLIM = 0.05  # ratio of the plane's variances below which its points lie on a line


class NormalsCheck(NamedTuple):
    """Result of `check_normals`: how far the normals of points deviate from their surface.

    Attributes
    ----------
    angle : float or None
        Median angle in degrees between the normals and the surface's, regardless of sign. None if there are no normals,
        or too few neighbourhoods are flat enough to compare.
    wrong : bool
        Whether the angle exceeds 15 degrees.

    Examples
    --------
    >>> pr.check_normals(pr.Points(np.zeros((3, 3))))
    NormalsCheck(angle=None, wrong=False)
    """

    angle: float | None
    wrong: bool


def check_normals(points: PointsLike) -> NormalsCheck:
    """Compare the normals of points with planes fitted to their neighbours.

    Neighbourhoods of 12 to 64 points around a sample of 2,000 points are examined, which takes a fraction of a second
    for any number of points. `Model` uses the normals that points have;
    ``pr.Model(pr.estimate_normals(points) if pr.check_normals(points).wrong else points)`` does the same as the command
    line, except for signs.

    Parameters
    ----------
    points : Points, or what `as_points` accepts

    Returns
    -------
    NormalsCheck
        `angle` and `wrong`.

    Raises
    ------
    TypeError
        If an argument has the wrong type.

    Examples
    --------
    >>> points = pr.procedural("sphere", 1000)
    >>> check = pr.check_normals(points)
    >>> check.wrong, check.angle < 5
    (False, True)
    """
    points = check_points(points)
    return compare_normals(points, 0.0 if points.normals is None else max(find_rounding(points)[0]))


def compare_normals(points: Points, step: float) -> NormalsCheck:
    """Compare the normals of points with planes fitted to their neighbours, like `check_normals`.

    step : coarsest step that coordinates were rounded to, or 0; planes that span few steps are not used
    """
    if points.normals is None:
        return NormalsCheck(None, False)
    squares = np.einsum("ij,ij->i", points.normals, points.normals, dtype=np.float64)
    used = points.finite & (squares > 0) & np.isfinite(squares)
    if used.sum() < SIZES[0]:
        return NormalsCheck(None, False)
    whole = bool(used.all())
    positions, normals = (array if whole else array[used] for array in (points.positions, points.normals))
    most = max(k for k in SIZES if k in (SIZES[0], min(k, len(positions) // LOCAL)))
    angle = _median_angle(positions, normals, find_neighborhoods(positions, SAMPLE, most), STEPS * step)
    return NormalsCheck(angle, angle is not None and angle > WRONG)


def _median_angle(positions: Floats, normals: Floats, near: Neighborhoods, least: float) -> float | None:
    """Return the median angle in degrees between normals and the planes fitted there; None if too few are reliable.

    positions, normals : (n, 3)
    near : neighbourhoods of a sample of these points; the normals of each are averaged
    least : radius that a plane's neighbours must reach
    """
    rows = near.rows
    offsets = positions[rows].astype(np.float64) - positions[rows[:, :1]]
    wide = normals[rows].astype(np.float64)
    unit = wide / np.linalg.norm(wide, axis=2, keepdims=True)
    sizes = [k for k in SIZES if k <= rows.shape[1]]
    if not sizes:
        return None
    angles, tilts = map(np.array, zip(*(_compare(offsets[:, :k], unit[:, :k], least) for k in sizes), strict=True))
    best, columns = tilts.argmin(axis=0), np.arange(len(rows))
    angle, sure = angles[best, columns], tilts[best, columns] < SURE
    return float(np.median(angle[sure])) if sure.mean() >= ENOUGH[0] and sure.sum() >= ENOUGH[1] else None


def _compare(offsets: Doubles, unit: Doubles, least: float) -> tuple[Doubles, Doubles]:
    """Fit planes to neighbourhoods; return how far mean normals deviate from them, and how uncertain the planes are.

    Parameters
    ----------
    offsets, unit : (m, k, 3) float64
        Offsets of the neighbours from the point, which comes first, and their unit normals.
    least : float
        Radius that the neighbours must reach.

    Returns
    -------
    angles : (m,) float64
        Between the mean normal and the plane's, in degrees, 0 to 90.
    tilts : (m,) float64
        Standard deviation of the plane's tilt, in degrees; infinite where the points lie on a line or within `least`.
    """
    squares = (offsets**2).sum(axis=2)
    weights = np.exp(-squares / squares[:, -1:])
    weights /= weights.sum(axis=1, keepdims=True)
    about = offsets - np.einsum("mk,mki->mi", weights, offsets)[:, None]
    variances, axes = np.linalg.eigh(np.einsum("mk,mki,mkj->mij", weights, about, about))
    thick, narrow, long = np.maximum(variances, 1e-300).T
    effective = 1 / (weights**2).sum(axis=1)  # number of points of full weight that would be as certain
    tilts = np.degrees(np.arctan(np.sqrt(thick * (1 / narrow + 1 / long) / np.maximum(effective - 3, 1))))
    tilts[(narrow < SLIM * long) | (squares[:, -1] < least * least)] = np.inf
    # Normals are flipped to the side of the point's own: signs differ across thin plates and in files without signs.
    signs = np.where(np.einsum("mki,mi->mk", unit, unit[:, 0]) < 0, -1, 1)
    mean = np.einsum("mk,mki->mi", weights * signs, unit)
    cosines = np.abs(np.einsum("mi,mi->m", mean, axes[:, :, 0])) / np.maximum(np.linalg.norm(mean, axis=1), 1e-300)
    return np.degrees(np.arccos(np.minimum(cosines, 1))), tilts
