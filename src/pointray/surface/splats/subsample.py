"""Subsampling that preserves the surface (Wu and Kobbelt 2004): within an error bound, or to a given size."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arguments import check_callback, check_positive, check_whole
from ...base.arrays import Floats
from ...base.progress import StageProgress
from ...base.warning_log import warn
from ...cloud.conversion import PointsLike, check_points
from ...cloud.denoising.smooth import check_sigma, place
from ...cloud.georeference import RESIDUAL
from ...cloud.neighbors import distinct, kd_order, neighbors
from ...cloud.points import Points
from .averages import attribute_averages
from .cells import NEIGHBORS
from .cover import relax
from .grow import Cloud, Splats, join
from .radii import choose_radii
from .subset import Subset, errors, fit, measure, select, select_greedily, shrink_splats, worst

AROUND = 12  # neighbours of a point to which a splat can grow
RANK = 8  # a radius is the distance to this neighbour where no point can be omitted
STRAY = 4.0  # upper limit of that radius, in medians of the radii around it
SHARE = 0.999  # share of the points that must be within the tolerance
NOISY = "the points are noisier, or the surface is sharper, than this tolerance allows"  # where fewer are
LEEWAY = 2.0  # error bound of the discs, in tolerances: the blended surface follows curves, the discs do not
REFINEMENTS = 8  # maximum number of refinement rounds
MARGIN = 0.8  # splats are refined above this share of the tolerance: rays find slightly larger errors than predicted
ENOUGH = 1e-4  # share of points beyond that at which refinement stops
RELAXED = 0.9  # expected share of the chosen splats after the relaxation
COUNT_REFINEMENTS = 16  # maximum number of refinement rounds for a count
REFINED_SHARE = 0.2  # share of the unused splats that are refined at once; refining one splat adds about three
RESERVE = 0.2  # share of a count kept for refinement. Statue, 8,000: 0.1% of errors exceed 1.6e-3; with 0.06, 1.9e-3
MOST_PASSES = 12  # maximum number of relaxation passes for a count
ATTEMPTS = 8  # maximum number of attempts to meet a count
MET = 0.96, 1.03  # accepted ratios of relaxed splats to wanted splats
SAMPLE = 50_000  # points at which sizes are measured to estimate the error bound for a count
DENSITY = 0.5  # chosen splats per squared size: between 0.45 and 0.6
FINEST = 1e-7  # least error bound that is tried for a count, in diagonals


class Subsample(NamedTuple):
    """Result of `subsample`, and the data for its warnings.

    points : the chosen points
    radii : (m,) float32, support radii of the chosen points
    within : share of the given cloud's points (smoothed, finite, distinct) that lie within the tolerance of the surface
        of the chosen points; 1 if a count was given
    message : warning about the normals, or None
    """

    points: Points
    radii: NDArray[np.float32]
    within: float
    message: str | None

    @property
    def met(self) -> bool:
        """Whether at least 99.9% of the given cloud's points are within the tolerance of the result's surface."""
        return self.within >= SHARE


def subsample(
    points: PointsLike,
    tolerance: float | None = None,
    count: int | None = None,
    *,
    smooth: str | float = "auto",
    progress: StageProgress | None = None,
) -> tuple[Points, NDArray[np.float32]]:
    """Reduce a cloud to fewer points, with support radii, that represent the same surface.

    Splats are grown under an error bound, chosen by newly covered area, relaxed to a smaller number, and fitted to the
    points that they cover. Flat regions get few large splats; fine detail keeps its points.

    Parameters
    ----------
    points : Points, or what `as_points` accepts
        Missing normals are estimated. Rows that are not finite are ignored; duplicates count once.
    tolerance : float, optional
        Maximum distance, in the points' unit, of 99.9% of the points from the surface of
        `pr.Model(*pr.subsample(...))`. A warning reports a smaller share: points with more noise than the tolerance
        have no such surface, even if all of them are kept.
    count : int, optional
        Exact number of points to return, with an error as small as possible. Give either this or the tolerance.
    smooth : "auto" or float
        Noise to smooth away first, see `pr.smooth`. The tolerance refers to the smoothed points.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Returns
    -------
    points : Points
        In no particular order. Each position is centred among the points that it represents; colours and attributes
        are their means, or the most common category.
    radii : (m,) float32
        Support radii, in the points' unit, for `pr.Model(points, radii)`.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If not exactly one of tolerance and count is given, the tolerance is not between 0 and the cloud's diagonal,
        `count` exceeds the number of distinct positions or is too small to cover the surface, or all positions are
        equal.

    References
    ----------
    J. Wu and L. Kobbelt, "Optimized Sub-Sampling of Point Sets for Surface Splatting", Eurographics 2004.

    Examples
    --------
    >>> points = pr.procedural("sphere", 1000)
    >>> few, radii = pr.subsample(points, count=200)
    >>> len(few), radii.shape
    (200, (200,))
    """
    found = find_subsample(points, tolerance, count, smooth, progress)
    if found.message:
        warn(found.message, stacklevel=2)
    if not found.met:
        warn(
            f"{found.within:.1%} of the points are within {tolerance:g} of the surface, not {SHARE:.1%}: {NOISY}",
            stacklevel=2,
        )
    return found.points, found.radii


def find_subsample(
    points: PointsLike,
    tolerance: float | None,
    count: int | None,
    smooth: str | float = "auto",
    progress: StageProgress | None = None,
) -> Subsample:
    """Reduce a cloud to fewer points that represent the same surface, like `subsample`, but without issuing warnings.

    Give either `tolerance` or `count`.

    tolerance : largest distance of 99.9% of the cloud's points from the surface of the result
    count : number of points of the result
    smooth : standard deviation of the noise to remove first, or "auto"
    """
    points = check_points(points)
    check_callback(progress)
    _check_target(tolerance, count)
    smooth = check_sigma(smooth, "smooth")
    report = progress or (lambda stage, share: None)
    report("normals", 0.0)
    finite = np.flatnonzero(points.finite)
    placed, message = place(points.select(finite) if len(finite) < len(points) else points, smooth)
    smoothed = placed.points
    rows = kd_order(smoothed.positions)
    rows = rows[distinct(smoothed.positions[rows])[0]]
    if len(rows) < 2:
        raise ValueError(f"all {len(points):,} points have the same position: cannot choose radii")
    smoothed = smoothed.select(rows)
    if count is not None and count > len(rows):
        raise ValueError(f"count is {count:,}, but the points have only {len(rows):,} different positions")
    diagonal = float(np.linalg.norm(np.subtract(*smoothed.bounds)))
    if tolerance is not None and tolerance > diagonal:
        raise ValueError(f"tolerance is {tolerance:g}, but must not exceed the cloud's diagonal ({diagonal:g})")
    report("neighbors", 0.0)
    cloud = describe_cloud(smoothed)
    within = 1.0
    if tolerance is not None:
        subset = _within(cloud, float(tolerance), report)
        within = float((errors(subset, float(tolerance)) <= 1).mean())
    else:
        assert count is not None
        subset = _as_many(cloud, int(count), diagonal, report)
    return Subsample(_averaged(smoothed, subset), subset.radii, within, message)


def _check_target(tolerance: Any, count: Any) -> None:
    if (tolerance is None) == (count is None):
        raise ValueError("give either tolerance or count" + ("" if count is None else ", not both"))
    if tolerance is not None:
        check_positive(tolerance, "tolerance", "a positive number in the points' unit")
    else:
        check_whole(count, "count", 1)


def describe_cloud(points: Points) -> Cloud:
    """Find neighbours, areas and borders of the points, for the growth of splats over them.

    points : with distinct positions, in kd order, with unit normals
    """
    positions, normals = points.positions, points.normals
    assert normals is not None
    distances, near = neighbors(positions, NEIGHBORS + 1)
    k = min(RANK, near.shape[1] - 1)
    radii = distances[:, k]
    radii = np.minimum(radii, np.float32(STRAY) * np.median(radii[near[:, 1 : k + 1]], axis=1))
    radii = np.minimum(radii, np.float32(STRAY * np.quantile(radii, 0.99)))
    border: NDArray[Any] = np.any(choose_radii(positions, normals).borders, axis=1)
    area = (np.pi / k * np.float64(radii) ** 2).astype(np.float32)
    around = np.ascontiguousarray(near[:, 1 : AROUND + 1])
    return Cloud(np.ascontiguousarray(positions), np.ascontiguousarray(normals), around, area, radii, border)


def _within(cloud: Cloud, tolerance: float, report: StageProgress) -> Subset:
    """Select splats whose surface lies within `tolerance` of the cloud's points; replace splats with larger errors."""
    error = LEEWAY * tolerance
    report("sizes", 0.0)
    sizes = measure(cloud, error)
    report("selection", 0.0)
    splats = select(cloud, sizes, error, report)
    report("fit", 0.0)
    subset = fit(cloud, splats, tolerance)
    for k in range(REFINEMENTS):
        if (errors(subset, MARGIN * tolerance) > 1).mean() <= ENOUGH:
            break
        splats, sizes = shrink_splats(cloud, subset, sizes, error, worst(subset, MARGIN * tolerance))
        report("fit", (k + 1) / (REFINEMENTS + 1))
        subset = fit(cloud, splats, tolerance)
    return subset


def _as_many(cloud: Cloud, count: int, diagonal: float, report: StageProgress) -> Subset:
    """Select exactly `count` splats, with distances between their surface and the cloud's points as small as possible.

    diagonal : length of the diagonal of the cloud's bounding box, the largest error bound that is tried
    """
    if count == len(cloud.positions):
        return fit(cloud, _single(np.arange(count), cloud.radii), diagonal * FINEST)
    splats, sizes, error = _meet(cloud, count, diagonal, report)
    report("fit", 0.0)
    subset, share = fit(cloud, splats, error), REFINED_SHARE
    for k in range(COUNT_REFINEMENTS):
        number = int(share * (count - len(subset.splats.seeds)))
        if number < 1:
            break
        splats, smaller = shrink_splats(cloud, subset, sizes, error, _first(worst(subset, error), number))
        if len(splats.seeds) > count:
            share /= 2
            continue
        report("fit", (k + 1) / (COUNT_REFINEMENTS + 1))
        subset, sizes = fit(cloud, splats, error), smaller
    spare = count - len(subset.splats.seeds)
    return fit(cloud, join([subset.splats, _more(cloud, subset, spare)]), error) if spare else subset


def _first(ratio: Floats, number: int) -> Floats:
    """Return errors of splats, the `number` largest over 1 and all others 0, so that only these are refined.

    ratio : (m,) error of each splat over the tolerance

    The result, (m,), is `ratio` divided by the least of the selected errors, but at least 1.001.
    """
    first = np.argsort(-ratio, kind="stable")[:number]
    out = np.zeros_like(ratio)
    out[first] = np.maximum(ratio[first] / np.maximum(ratio[first[-1]], np.float32(1e-12)), np.float32(1.001))
    return out


def _meet(cloud: Cloud, count: int, diagonal: float, report: StageProgress) -> tuple[Splats, Floats, float]:
    """Select at most `count` splats, and not many fewer, by trying error bounds.

    An error bound is half the largest range of heights of a splat's points over its plane.

    diagonal : length of the diagonal of the cloud's bounding box, the largest bound that is tried

    About a fifth of `count` is left unused, so that splats with large errors can be replaced by several smaller ones.

    Returns the splats, the largest radius of a splat at each point (n,), and the error bound.
    """
    goal = max(int((1 - RESERVE) * count), 1)
    report("sizes", 0.0)
    error = _guess(cloud, goal, diagonal)
    low, high = FINEST * diagonal, diagonal  # too many splats, too few
    for k in range(ATTEMPTS):
        report("selection", k / ATTEMPTS)
        sizes = measure(cloud, error)
        pool, rows = select_greedily(cloud, sizes, error)
        ratio = len(rows) * RELAXED / goal
        if MET[0] < ratio < MET[1] or (error == FINEST * diagonal and len(rows) <= count):
            rows = relax(pool, cloud, rows, goal, MOST_PASSES, report).astype(np.int32)
        if len(rows) <= count and (ratio > MET[0] or error == FINEST * diagonal or k == ATTEMPTS - 1):
            return pool.pick(rows), sizes, error
        low, high = (max(low, error), high) if ratio > 1 else (low, min(high, error))
        # On smooth surfaces the number falls with a power of the bound between -1/2 and -1, elsewhere slower.
        error *= ratio**1.4
        if not low < error < high:
            error = float(np.sqrt(low * high)) if low > FINEST * diagonal or k < ATTEMPTS // 2 else low
    raise ValueError(f"count is {count:,}, too few to cover the surface: it needs about {len(rows):,}")


def _guess(cloud: Cloud, goal: int, diagonal: float) -> float:
    """Estimate the error bound at which about `goal` splats cover the cloud, from a sample of its points.

    The error bound is half the largest range of heights of a splat's points over its plane.

    diagonal : length of the diagonal of the cloud's bounding box, the largest bound
    """
    n = len(cloud.positions)
    some = np.zeros(n, np.bool_)
    some[:: max(n // SAMPLE, 1)] = True
    low, high = np.log(FINEST * diagonal), np.log(diagonal)
    while high - low > 0.1:
        middle = 0.5 * (low + high)
        sizes = measure(cloud, float(np.exp(middle)), 1, some)
        number = DENSITY * RELAXED * float(np.sum(cloud.area / np.float64(sizes) ** 2))
        low, high = (middle, high) if number > goal else (low, middle)
    return float(np.exp(0.5 * (low + high)))


def _single(rows: NDArray[Any], widths: Floats) -> Splats:
    """Return splats that cover one point each.

    rows : (m,) these points; widths : (m,) radius of each splat
    """
    rows = rows.astype(np.int32)
    return Splats(rows, np.arange(len(rows) + 1), rows, widths.astype(np.float32))


def _more(cloud: Cloud, subset: Subset, number: int) -> Splats:
    """Return `number` more splats of one point each, to reach an exact count.

    subset : the splats so far

    The new splats lie at points that these cover: first at one point of each, then at others. Within both, points of
    splats with a small error come first, because new splats disturb the fit.
    """
    splats = subset.splats
    free = np.ones(len(cloud.positions), np.bool_)
    free[splats.seeds] = False
    owner = np.empty(len(free), np.int64)
    owner[splats.members] = splats.owners
    order = np.argsort(worst(subset, 1.0)[owner], kind="stable")
    order = order[free[order]]
    first = np.zeros(len(order), np.bool_)
    first[np.unique(owner[order], return_index=True)[1]] = True
    rows = np.concatenate([order[first], order[~first]])[:number]
    return _single(rows, splats.widths[owner[rows]])


def _averaged(points: Points, subset: Subset) -> Points:
    """Return the splats as points, with the mean colours and attributes of the points that each covers.

    points : the cloud that `subset` represents
    """
    splats, at = subset.splats, subset.splats.starts[:-1]

    colors = None
    if points.colors is not None:  # root mean square: nearly the mean of light, as sRGB is nearly a square root
        squares = {"": points.colors.astype(np.float32) ** 2}
        colors = np.rint(np.sqrt(attribute_averages(squares, splats.members, at)[""])).astype(np.uint8)
    kept = {name: values for name, values in points.attributes.items() if name != RESIDUAL}
    attributes = attribute_averages(kept, splats.members, at, 0.0)
    return Points.about(points.origin, subset.positions, subset.normals, colors, attributes, points.georeference)
