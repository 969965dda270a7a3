"""Smoothing: noisy points are moved onto the surface fitted to their neighbours; clean points are unchanged."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arguments import check_callback, check_number
from ...base.arrays import Flags, Floats, Rows
from ...base.progress import Progress, StageProgress, in_stage, part_of, report_progress
from ..conversion import PointsLike, check_points
from ..kd_ordering import KdOrdering, compute_kd_ordering
from ..neighbors import neighbor_chunks, take
from ..normals.estimate import repair_normals, with_fits
from ..normals.fit_batch import LANES
from ..normals.jets import Fits, Planes, faces, fit_normals, measure_noise
from ..points import Points
from ..statistics import CloudStatistics
from .edges import Edges
from .fit import SIZES, fit_surface
from .noise import LITTLE, NoiseRanges, measure_ranges, raise_to_typical

MOVES = 0.09  # noise in spacings from which points move all the way
FEWER, MUCH = 64, 0.6  # neighbours; noise in spacings above which 128 are used, in twice the time, and no edges
SPACING = math.sqrt(math.pi / SIZES[0])  # times the distance of the 16th neighbour: root of the area per point
FAR = 5.0  # greatest move of a point to an edge, in standard deviations
SURVEYED = 0.1  # progress after the noise is measured


def smooth(points: PointsLike, sigma: str | float = "auto", progress: StageProgress | None = None) -> Points:
    """Smooth noisy points: move them onto the surface fitted to their neighbours, and replace their normals.

    A quadric is fitted to the 16 to 128 nearest neighbours of each noisy point, depending on local noise and detail,
    and the point moves along its normal. Edges of points without normals are rounded. Clean points are unchanged, to
    the bit.

    Parameters
    ----------
    points : Points, or what `as_points` accepts
        If they have normals, neighbours that face the opposite side are not used.
    sigma : "auto" or float
        Standard deviation of the noise, in the points' unit. "auto": measured locally; points stay where it is below
        about a tenth of the spacing. 0: all points stay.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Returns
    -------
    Points
        The same rows with other positions and normals; colours and attributes are shared. If no point is noisy,
        `points` itself.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If sigma is neither "auto" nor a finite number from 0, or there are fewer than three distinct positions.

    References
    ----------
    Cazals, Pouget: Estimating differential quantities using polynomial fitting of osculating jets (2003).
    Mitra, Nguyen: Estimating surface normals in noisy point cloud data (2003).

    Examples
    --------
    >>> points = pr.procedural("sphere", 1000)
    >>> pr.smooth(points) is points  # no noise
    True
    >>> noisy = points.changed(positions=points.positions + np.float32(0.02) * np.sin(np.arange(3000)).reshape(-1, 3))
    >>> pr.smooth(noisy) is noisy
    False
    """
    points = check_points(points)
    check_callback(progress)
    sigma = check_sigma(sigma, "sigma")
    if sigma == 0.0:
        return points
    placed, _ = place(points, sigma, in_stage(progress, "smoothing"))
    return points if placed.noise is None else placed.points


class Placed(NamedTuple):
    """Points that a surface can be built of: with unit normals, and moved onto their surface where they were noisy.

    noise : (n,) float32, standard deviation of the removed noise, in the points' unit; None if none was removed
    order : (n,) int, rows in the kd order of the positions, or nearly; None if unknown
    apart : whether all positions are known to be distinct
    """

    points: Points
    noise: Floats | None
    order: NDArray[np.integer[Any]] | None = None
    apart: bool = False

    def select(self, mask: Flags) -> Placed:
        """Return the points where the mask, (n,) bool, is true, with their noise and kd order."""
        order = self.order
        if order is not None:
            order = (np.cumsum(mask) - 1)[order[mask[order]]]
        noise = None if self.noise is None else self.noise[mask]
        return Placed(self.points.select(mask), noise, order, self.apart)


def place(
    points: Points, sigma: str | float, progress: Progress | None = None, ordering: KdOrdering | None = None
) -> tuple[Placed, str | None]:
    """Return points with unit normals, moved onto their surface where noisy, and a message on repairs, or None.

    sigma : standard deviation of the noise, or "auto"
    ordering : kd ordering of the points, if known
    """
    if points.normals is None:
        return Placed(*with_fits(points, Fitting(sigma).fit, progress=progress, ordering=ordering)), None
    repaired, message = repair_normals(points, progress, ordering)
    return smooth_known(repaired, sigma, progress, ordering), message


def check_sigma(value: object, name: str) -> str | float:
    """Validate the standard deviation of the noise, "auto" or a number from 0, and return it."""
    if isinstance(value, str) and value == "auto":
        return value
    return check_number(value, name, "'auto' or a finite number from 0", lambda x: 0 <= x < math.inf)


class Fitting:
    """Fit of normals that also moves noisy points onto their surface; `with_fits` calls its `fit`.

    Parameters
    ----------
    sigma : "auto" or float
        Standard deviation of the noise, in the points' unit. "auto": measured locally.
    noise : Noise, optional
        Noise of each point, if measured before.
    statistics : CloudStatistics, optional
        Of the cloud that the points are a part of. None: they are the whole cloud.
    """

    def __init__(
        self, sigma: str | float, noise: Noise | None = None, statistics: CloudStatistics | None = None
    ) -> None:
        self._sigma, self._noise, self._statistics = sigma, noise, statistics

    def fit(
        self,
        ordered: Floats,
        kept: int,
        eye: Floats | None = None,
        progress: Progress | None = None,
        planes: Planes | None = None,
    ) -> Fits:
        """Fit quadrics for unit normals, as `fit_normals` does, and move noisy points onto them.

        Returns the moved positions, normals, neighbours, residuals, and the noise removed (None if no point is noisy).

        ordered : (n, 3) distinct positions in kd order
        kept : number of neighbours to return for each point, itself included
        eye : (3,) or (n, 3) position of the scanner, which normals face; None, or NaN for a point: either side
        planes : receives the neighbours of each point, for further fits
        """
        noise, most = self._noise or noise_of(ordered, self._sigma)
        report_progress(progress, SURVEYED)
        left = part_of(progress, SURVEYED, 1.0)
        if noise is None:
            return fit_normals(ordered, kept, eye, left, planes, statistics=self._statistics)
        n = len(ordered)
        moved, normals = ordered.copy(), np.zeros_like(ordered)
        near, residuals = np.empty((n, min(kept, n)), np.int32), np.empty(n, np.float32)
        shares = np.empty((n, 1), np.float32)
        needed = 0 if planes is None else planes.needed(measure_noise(ordered, self._statistics)[0])
        edges = Edges(ordered)
        for part, found in neighbor_chunks(ordered, max(most, kept, needed), left):
            rows = np.arange(part.start, part.start + len(found))
            table = np.ascontiguousarray(found[:, :most])
            if planes is not None and needed:
                planes.add_neighbors(part, found)
            shifts, normals[part], flat, errors = fit_surface(ordered, rows, table, None, noise[part])
            shares[part], spacing = _shares(ordered, rows, table, noise[part], self._sigma)
            moved[part] += shares[part] * shifts
            residuals[part] = noise[part] / spacing
            if most == FEWER:
                edges.add(rows, table, noise[part], errors, spacing)
            if eye is not None:
                to_eye = (eye if eye.ndim == 1 else eye[part]) - moved[part]
                normals[part][~faces(normals[part], flat, to_eye)] *= -1
            near[part] = found[:, : near.shape[1]]
        rows, shifts, turned = edges.find_moves(normals)
        likely = np.linalg.norm(shifts, axis=1) < FAR * noise[rows]
        if eye is not None:  # the scanner cannot see a side that faces away
            to_eye = (eye if eye.ndim == 1 else eye[rows]) - ordered[rows]
            likely &= ~(np.einsum("ij,ij->i", turned, to_eye) < 0)
        rows, shifts, turned = rows[likely], shifts[likely], turned[likely]
        moved[rows] = ordered[rows] + shares[rows] * shifts
        normals[rows] = turned
        return Fits(moved, normals, near, residuals, noise * shares[:, 0])


def smooth_known(
    points: Points,
    sigma: str | float,
    progress: Progress | None = None,
    ordering: KdOrdering | None = None,
    known_noise: Noise | None = None,
) -> Placed:
    """Move points with unit normals onto their surface where they are noisy; their new normals face the same sides.

    sigma : standard deviation of the noise, in the points' unit, or "auto"
    ordering : kd ordering of the points, if known
    known_noise : noise of each point in kd order, if measured before
    """
    if sigma == 0.0:
        return Placed(points, None)
    ordering = ordering or compute_kd_ordering(points)
    ordered = ordering.positions
    assert points.normals is not None
    known = take(points.normals, ordering.rows)
    noise, most = known_noise or noise_of(ordered, sigma, known)
    if noise is None:
        return Placed(points, None)
    noise = noise.copy()
    moved, turned = ordered.copy(), known.copy()
    for part, found in neighbor_chunks(ordered, most, part_of(progress, SURVEYED, 1.0)):
        rows = np.arange(part.start, part.start + len(found))
        share, _ = _shares(ordered, rows, found, noise[part], sigma)
        fitted, some = _whole_vectors(share[:, 0] > 0)
        shifts, normals, _, _ = fit_surface(ordered, rows[fitted], found[fitted], known, noise[part][fitted])
        moved[part][fitted[some]] += share[fitted[some]] * shifts[some]
        turned[part][fitted[some]] = _blended(known[part][fitted[some]], normals[some], share[fitted[some]])
        noise[part] *= share[:, 0]
    positions, out = ordering.spread(moved, points), ordering.spread(turned, points)
    positions[~points.finite] = points.positions[~points.finite]
    return Placed(points.changed(positions=positions, normals=out), ordering.spread(noise, points))


class Noise(NamedTuple):
    """Noise of a cloud, which decides how many neighbours are fitted.

    values : (n,) standard deviation of each point from its surface, in the points' unit; None if negligible everywhere
    most : largest number of neighbours to fit a quadric to
    """

    values: Floats | None
    most: int


def noise_of(ordered: Floats, sigma: str | float, normals: Floats | None = None) -> Noise:
    """Return the noise of each point: `sigma`, or measured if that is "auto".

    ordered : (n, 3) distinct positions in kd order
    normals : (n, 3) known unit normals, which also show the noise
    """
    if len(ordered) < SIZES[0] or sigma == 0.0:
        return Noise(None, FEWER)
    if not isinstance(sigma, str):
        return Noise(np.full(len(ordered), sigma, np.float32), FEWER)
    return noise_by(raise_to_typical(measure_ranges(ordered, normals)), np.arange(len(ordered)))


def noise_by(ranges: NoiseRanges, rows: Rows) -> Noise:
    """Return the noise of some rows of a cloud's kd order, interpolated between the ranges it was measured in.

    ranges : all ranges of the cloud
    rows : (n,) numbers in the kd order of the whole cloud
    """
    shares = ranges.noise / np.maximum(ranges.spacing, 1e-30)
    if not (shares > LITTLE).any():
        return Noise(None, FEWER)
    return Noise(ranges.interpolate(rows)[0], SIZES[-1] if np.median(shares) > MUCH else FEWER)


def _shares(
    ordered: Floats, rows: Rows, near: NDArray[np.int32], noise: Floats, sigma: str | float
) -> tuple[Floats, Floats]:
    """Return the fraction of its move onto the fitted surface that each point makes, (m, 1), and the spacing, (m,).

    The fraction is 1 for a given `sigma`; for "auto" it is 0 where noise is negligible, so that clean points stay.

    ordered : (n, 3) positions
    rows, near : (m,) some rows, and (m, k) their nearest neighbours
    noise : (m,) standard deviation of these points from their surface
    """
    k = min(SIZES[0], near.shape[1]) - 1
    spacing = SPACING * np.linalg.norm(ordered[near[:, k]] - ordered[rows], axis=1)
    if not isinstance(sigma, str):
        return np.ones((len(rows), 1), np.float32), spacing
    share = (noise / np.maximum(spacing, 1e-30) - LITTLE) / (MOVES - LITTLE)
    return np.clip(share, 0.0, 1.0).astype(np.float32)[:, None], spacing


def _whole_vectors(needed: Flags) -> tuple[Rows, Flags]:
    """Return the rows of all groups of 16 that contain wanted ones, (r,) int64, and which are wanted, (r,) bool.

    Points fitted in the same vector of 16 affect each other's last bits. Whole vectors are fitted, so that they are the
    same wherever a part of a cloud begins.

    needed : (m,) bool, the wanted rows
    """
    groups = np.add.reduceat(needed, np.arange(0, len(needed), LANES)) > 0
    rows = np.flatnonzero(np.repeat(groups, LANES)[: len(needed)])
    return rows, needed[rows]


def _blended(known: Floats, fitted: Floats, share: Floats) -> Floats:
    """Interpolate unit normals between known and fitted ones, on the side of the known ones, (m, 3).

    share : (m, 1) weight of the fitted normal, 0 to 1
    """
    same = np.sign(np.einsum("ij,ij->i", known, fitted))[:, None]
    mixed = (1 - share) * known + share * same * fitted
    length = np.linalg.norm(mixed, axis=1, keepdims=True)
    return np.where(length > 0, mixed / np.maximum(length, 1e-30), known)
