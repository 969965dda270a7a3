"""Estimation of normals for clouds without any, and repair of missing or inconsistent normals."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.arguments import check_callback, check_whole
from ...base.arrays import Doubles, Flags, Floats, Rows
from ...base.progress import Progress, StageProgress, in_stage, part_of, report_progress
from ..conversion import PointsLike, check_points
from ..kd_ordering import KdOrdering, compute_kd_ordering
from ..neighbors import distinct, neighbor_chunks, neighbors
from ..points import Points
from . import stations
from .consistency import disagreement_share
from .jets import Fits, Planes, fit_normals
from .layers import Layers, signs_facing
from .orientation import NEAR, orient
from .outward import looks_inward
from .sheets import orient_thin_sheets
from .units import to_units
from .visibility import ignored_stations

REPLACEMENTS = 8  # nearest valid normals that replace a missing one
UNIT = 0.01  # tolerated difference of lengths from each other, or of all from 1, without a message
DISAGREE = 0.05  # share of neighbours on opposite sides above which signs are recomputed: real scans have up to 0.006

FITTED, ORIENTED = 0.7, 0.8  # progress after fitting and after orienting

Fitting = Callable[[Floats, int, Floats | None, Progress | None, Planes | None], Fits]  # see `fit_normals`


def estimate_normals(
    points: PointsLike,
    neighbors: int | None = None,
    viewpoint: ArrayLike | None = None,
    progress: StageProgress | None = None,
) -> Points:
    """Estimate normals from quadrics fitted to the nearest neighbours, and orient them consistently.

    Parameters
    ----------
    points : Points, or what `as_points` accepts
    neighbors : int, optional
        Number of points that a quadric is fitted to, including the point itself (below 8: a plane). None: 10 to 64,
        chosen for each point by noise, detail and the distance of scan lines.
    viewpoint : (3,) or (n, 3) array_like, optional
        World position of the scanner, or of the scanner that saw each point, NaN where unknown (`eyes_along` computes
        it for a moving scanner). Each normal is turned towards the scanner; where it grazes the view, the plane through
        the neighbours decides. Of rows with equal positions the first one's scanner counts. None: the stations of
        `points.georeference`; the attribute "scan" holds each point's station, and a single station without that
        attribute saw all points. A station from which its points cannot have been seen, as in merged clouds, is ignored
        with a warning. Where the scanner is unknown, signs propagate from points where it is known; a connected group
        without any is turned outward, or up if it has no outside.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and its completed share, 0 to 1.

    Returns
    -------
    Points
        The same points with unit normals, (n, 3) float32; 0 for rows that are not finite.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If there are fewer than three distinct positions, `neighbors` is less than 3, or `viewpoint` has the wrong
        shape, is a single position that is not finite, or is a single position among the points.

    References
    ----------
    Cazals, Pouget: Estimating differential quantities using polynomial fitting of osculating jets (2003).
    Mitra, Nguyen: Estimating surface normals in noisy point cloud data (2003).
    Koenig, Gumhold: Consistent propagation of normal orientations in point clouds (2009).
    Barill, Dickson, Schmidt, Levin, Jacobson: Fast winding numbers for soups and clouds (2018).

    Examples
    --------
    >>> points = pr.procedural("sphere", 1000)
    >>> estimated = pr.estimate_normals(points.with_normals(None))
    >>> bool((np.einsum("ij,ij->i", estimated.normals, points.normals) > 0.9).all())
    True
    """
    points = check_points(points)
    check_callback(progress)
    if neighbors is not None:
        neighbors = min(check_whole(neighbors, "neighbors", 3, or_none=True), max(len(points), 3))
    return with_fits(points, partial(fit_normals, neighbors=neighbors), viewpoint, in_stage(progress, "normals"))[0]


def with_fits(
    points: Points,
    fit: Fitting,
    viewpoint: ArrayLike | None = None,
    progress: Progress | None = None,
    ordering: KdOrdering | None = None,
) -> tuple[Points, Floats | None]:
    """Fit normals, orient them consistently, and return the points with them; a fit may also move noisy points.

    Returns the points, and the noise removed at each row, (n,), or None if none was moved.

    fit : function with the parameters of `fit_normals` that returns normals, and perhaps other positions
    viewpoint : (3,) or (n, 3) position of the scanner, which normals face; None: the stations of the georeference
    ordering : kd ordering of the points, if known
    """
    eyes = _stations_of(points) if viewpoint is None else stations.check_eyes(viewpoint, len(points))
    ordering = ordering or compute_kd_ordering(points)
    ordered, rows = ordering.positions, ordering.rows
    if len(ordered) < 3:
        raise ValueError(
            f"normals need at least 3 distinct positions: {len(points):,} points have {len(ordered)} distinct positions"
        )
    if viewpoint is None:
        stations.warn_of_lost_scans(points)
    elif eyes is not None and eyes.ndim == 1:
        stations.check_outside(ordered, eyes - points.origin)
    eye = None if eyes is None else seen_from(points, eyes, rows)
    known = np.zeros(len(ordered), np.bool_) if eye is None else stations.is_known(eye) & (eye != ordered).any(axis=1)
    watch = progress if known.all() else part_of(progress, 0.0, FITTED)
    layers = None if known.any() else Layers(ordered)
    found = fit(ordered, 1 if known.all() else NEAR, eye, watch, layers)
    if layers is not None:
        if layers.noisy:
            layers.planes *= orient(layers.moved, layers.planes, layers.near)[:, None]
            found.normals[:] *= signs_facing(found.normals, layers.planes, layers.near)[:, None]
        else:
            found.normals[:] *= orient(found.positions, found.normals, found.near)[:, None]
        report_progress(progress, ORIENTED)
        orient_thin_sheets(found.positions, found.normals, found.near, found.residuals)
    elif not known.all():
        stations.orient_unknown(found.positions, found.normals, found.near, known)
    normals = ordering.spread(found.normals, points)
    if found.positions is ordered:
        return points.with_normals(normals), None
    positions = ordering.spread(found.positions, points)
    positions[~points.finite] = points.positions[~points.finite]
    assert found.noise is not None
    return points.changed(positions=positions, normals=normals), ordering.spread(found.noise, points)


def _stations_of(points: Points) -> Doubles | None:
    """Return the scanner position that saw each point, world, (n, 3) or (3,); None if unknown; warn of wrong positions.

    A position is ignored if its points cannot have been seen from it. Rows without a position are NaN.
    """
    ignored = ignored_stations(points)
    stations.warn_of_ignored(ignored, len(points.georeference.stations))
    return stations.eyes_of(points, ignored)


def seen_from(points: Points, eyes: Doubles, rows: NDArray[np.int32]) -> Floats:
    """Return the scanner positions of some rows of points, (m, 3) float32, relative to the points' origin.

    eyes : (3,) or (n, 3) world position of the scanner that saw each point, NaN where unknown
    rows : (m,)
    """
    chosen = eyes if eyes.ndim == 1 else eyes[rows]
    return np.broadcast_to((chosen - points.origin).astype(np.float32), (len(rows), 3))


def repair_normals(
    points: Points, progress: Progress | None = None, ordering: KdOrdering | None = None
) -> tuple[Points, str | None]:
    """Return the points with a unit normal at each finite position, and a message on what was repaired.

    Parameters
    ----------
    points : Points
    progress : callable, optional
    ordering : KdOrdering, optional
        The kd ordering of the points, if known.

    Returns
    -------
    points : Points
        A missing normal (zero, NaN or infinite) becomes the mean of the nearest valid ones; if none is valid, all are
        estimated. If many neighbours face opposite sides, directions are kept and signs are recomputed, with the
        stations of `points.georeference` as in `estimate_normals`. Normals that all point inward are kept. Rows that
        are not finite have the normal 0.
    message : str or None
        One line; None if all normals were valid.
    """
    if points.normals is None:
        why = "the points have no normals: estimated from their neighbours"
        return with_fits(points, partial(fit_normals, neighbors=None), progress=progress)[0], why
    repaired = normalize_normals(points)
    if repaired is None:
        why = "all normals are zero or not finite: estimated from the points' neighbours"
        return with_fits(points, partial(fit_normals, neighbors=None), progress=progress)[0], why
    unit, sound = repaired.unit, repaired.sound
    messages, whole = describe_repairs(repaired.lost, repaired.odd, len(points)), bool(sound.all())
    known, facing = (points.positions, unit) if whole else (points.positions[sound], unit[sound])
    share = disagreement_share(known, facing, ordering.rows if ordering and whole else None)
    if share > DISAGREE:
        eyes = _stations_of(points)
        advice = "" if eyes is not None else " (pass viewpoint= to estimate_normals if known)"
        turned = unit
        unit = _reorient(points, unit, eyes, ordering)
        if not np.array_equal(unit, turned):
            opposite = f"{100 * share:.0f}% of neighbouring normals face opposite sides"
            messages.append(f"{opposite}: directions kept, signs recomputed{advice}")
    elif looks_inward(known, facing):
        messages.append(
            "most normals point inward: used as they are; if this is not a room scanned from inside, flip them: "
            "points.with_normals(-points.normals)"
        )
    return points.with_normals(unit), "; ".join(messages) or None


class RepairedNormals(NamedTuple):
    """Unit normals of points, with what was repaired.

    unit : (n, 3) float32; 0 for rows that are not finite
    sound : (n,) bool, whether the row is finite and had a valid normal
    lost, odd : number of normals that were missing, and that were not of unit length
    """

    unit: Floats
    sound: Flags
    lost: int
    odd: int


def normalize_normals(points: Points, counted: Rows | None = None) -> RepairedNormals | None:
    """Return the normals of points at unit length, missing ones interpolated from the nearest; None if none is valid.

    counted : rows among which missing normals, and those not of unit length, are counted. None: all
    """
    assert points.normals is not None
    finite = points.finite
    unit, length = to_units(points.normals)
    good = length > 0
    sound = finite & good
    whole = bool(sound.all())  # then nothing is copied
    if not (whole or sound.any()):
        return None
    lost = finite & ~good
    if not whole:
        unit[~sound] = 0
    if lost.any():
        unit[lost] = _mean_of_nearest(points.positions, unit, np.flatnonzero(sound), lost)
    rows = slice(None) if counted is None else counted
    lengths = length[rows] if whole else length[rows][sound[rows]]
    return RepairedNormals(unit, sound, int(lost[rows].sum()), _odd_lengths(lengths))


def describe_repairs(lost: int, odd: int, total: int) -> list[str]:
    """Return messages on the repairs of `total` normals.

    lost, odd : number of normals that were missing, and that were not of unit length
    """
    messages = []
    if lost:
        messages.append(f"{lost:,} of {total:,} normals are zero or not finite: interpolated from neighbours")
    if odd:
        messages.append(f"{odd:,} of {total:,} normals are not of unit length: normalised")
    return messages


def _odd_lengths(length: Doubles) -> int:
    """Return how many lengths of normals differ from 1 by more than 1%; 0 if all are equal, as in a scaled model."""
    if not len(length) or length.max() - length.min() <= UNIT * length.min():  # the usual case
        return 0
    typical = np.median(length)
    if np.abs(length - typical).max() <= UNIT * typical:
        return 0
    return int((np.abs(length - 1) > UNIT).sum())


def _reorient(points: Points, unit: Floats, eyes: Doubles | None, ordering: KdOrdering | None) -> Floats:
    """Return normals with the same directions and recomputed signs, (n, 3).

    unit : (n, 3) unit normals
    eyes : (3,) or (n, 3) world position of the scanner that saw each point, NaN where unknown; None: signs follow from
        neighbours, and rows with equal positions get the same side
    ordering : kd ordering of the points, if known
    """
    if eyes is not None and np.isfinite(eyes).all():
        out = unit.copy()
        out[~stations.faced(points.positions, unit, np.broadcast_to(eyes - points.origin, unit.shape))] *= -1
        return out
    ordered, ids, first = ordering or compute_kd_ordering(points)
    finite = np.flatnonzero(points.finite)
    directions = unit[first]
    near = np.concatenate([found for _, found in neighbor_chunks(ordered, NEAR)])
    if eyes is None:
        directions *= orient(ordered, directions, near)[:, None]
    else:
        eye = seen_from(points, eyes, first)
        directions[~stations.faced(ordered, directions, eye)] *= -1
        stations.orient_unknown(ordered, directions, near, stations.is_known(eye))
    out = unit.copy()
    against = np.einsum("ij,ij->i", unit[finite], directions[ids]) < 0
    out[finite[against]] *= -1
    return out


def _mean_of_nearest(positions: Floats, unit: Floats, good: NDArray[Any], lost: Flags) -> Floats:
    good = good[distinct(positions[good])[0]]  # a thousand equal positions make the search very slow
    _, near = neighbors(positions[good], REPLACEMENTS, positions[lost])
    nearest = unit[good][near]
    mean, length = to_units(nearest.mean(axis=1))
    mean[length == 0] = nearest[length == 0, 0]  # the mean cancels out
    return mean
