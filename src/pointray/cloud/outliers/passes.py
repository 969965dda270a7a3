"""Passes: misaligned scans of one surface are moved onto their mean, if the scan and scanner of each point are known.

Around a point one quadric is fitted to all scans, with a separate height for each. Scans are passes of one surface if
their scanners face the same side and no scan has points at the height of another: of two sheets, one in front of the
other, one scanner would see both, or they would be seen from opposite sides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles, Floats
from ...base.progress import Progress, part_of, report_progress
from ..georeference import SCAN
from ..kd_ordering import KdOrdering, compute_kd_ordering
from ..neighbors import NeighborTree
from ..normals.stations import eyes_of
from ..points import Points
from ..statistics import CloudStatistics
from .heights import AROUND, even_out, heights

IDS = SCAN, "point_source_id"  # attributes that hold the scan, or flight line, of each point
SAMPLE, SHOWN = 20_000, 0.01  # sampled points; share of them that must show misaligned passes
KEPT = 24  # neighbours over which moves are averaged: makes the mean of two scans no rougher than each
ROWS = 1 << 16  # rows of a table at a time
SAMPLED, MOVED = 0.1, 0.9  # progress after the sample, and after all moves are known


def merge_passes(
    points: Points,
    eyes: Doubles | None = None,
    progress: Progress | None = None,
    ordering: KdOrdering | None = None,
    statistics: CloudStatistics | None = None,
    ignored: tuple[int, ...] | None = None,
) -> Points:
    """Move misaligned scans of one surface onto their mean, weighted by density and noise.

    Parameters
    ----------
    points : Points
        The attribute "scan" or "point_source_id" holds the scan of each point, an integer from 0. Without it nothing is
        moved, and points with other values stay.
    eyes : (3,) or (n, 3) float64, optional
        Scanner position that saw each point. None: the stations of the points; where they are unknown, normals, if any,
        show from which side the surface was seen.
    progress : callable, optional
    ordering : KdOrdering, optional
        The ordering of the points, if known.
    statistics : CloudStatistics, optional
        Of the cloud that the points are a part of. None: they are the whole cloud.
    ignored : tuple of int, optional
        Indices of stations to ignore; None: those from which their points cannot have been seen.

    Returns
    -------
    Points
        `points` itself if less than a hundredth of them would move.
    """
    scans = _scans_of(points)
    if scans is None:
        return points
    ordered, ids, rows = ordering or compute_kd_ordering(points)
    facing = _facing(points, eyes_of(points, ignored) if eyes is None else eyes)
    if facing is None or len(ordered) <= AROUND:
        return points
    scans, facing, tree = scans[rows], facing[rows], NeighborTree(ordered, in_order=True)
    statistics = statistics or CloudStatistics.of(len(ordered))

    def share() -> float:
        some = np.ascontiguousarray(statistics.spread(len(ordered), SAMPLE))
        seen = heights(ordered, some, tree.query(AROUND, ordered[some])[1], scans, facing)
        return float(seen[:, :3].any(axis=1).mean())

    misaligned = statistics.get_or_compute("share of passes", share)
    report_progress(progress, SAMPLED)
    if misaligned < SHOWN:
        return points
    shifts = _shifts(ordered, tree, scans, facing, part_of(progress, SAMPLED, 1.0))
    positions = points.positions.copy()
    positions[points.finite] += shifts[ids]
    return points.changed(positions=positions)


def _shifts(
    ordered: Floats, tree: NeighborTree, scans: NDArray[np.int32], facing: Floats, progress: Progress | None
) -> Floats:
    """Return how each point moves to the mean of the misaligned scans around it, (n, 3).

    ordered, tree : (n, 3) positions in kd order, and their search tree
    scans : (n,) scan of each point, negative where unknown
    facing : (n, 3) unit vectors to the scanner that saw each point, 0 where unknown
    """
    n = len(ordered)
    moves, near = np.zeros((n, 4), np.float32), np.empty((n, KEPT), np.int32)
    for start in range(0, n, ROWS):
        rows = np.arange(start, min(start + ROWS, n))
        found = tree.rows(AROUND, slice(start, start + ROWS))
        moves[rows], near[rows] = heights(ordered, rows, found, scans, facing), found[:, :KEPT]
        report_progress(progress, MOVED * rows[-1] / n)
    return even_out(moves, near, scans)


def _scans_of(points: Points) -> NDArray[np.int32] | None:
    """Return the scan of each point by its attributes, (n,), -1 where unknown; None with fewer than two scans."""
    for name in IDS:
        values = points.attributes.get(name)
        if values is None or values.ndim != 1 or values.dtype == np.bool_:
            continue
        with np.errstate(invalid="ignore"):
            known = (values >= 0) & (values < 2**31) & (values == np.rint(values))
        scans = np.where(known, values, -1).astype(np.int32)
        if len(np.unique(scans[known & points.finite])) > 1:
            return scans
    return None


def _facing(points: Points, eyes: Doubles | None) -> Floats | None:
    """Return unit vectors to the side from which each point was seen, (n, 3), 0 where unknown; None if all are unknown.

    eyes : (3,) or (n, 3) world position of the scanner; where it is unknown, normals show the side
    """
    facing = np.zeros((len(points), 3), np.float32)
    ways = [] if eyes is None else [eyes - points.world]
    if points.normals is not None:
        ways.append(points.normals.astype(np.float64))
    for way in reversed(ways):
        with np.errstate(invalid="ignore", over="ignore"):
            length = np.linalg.norm(way, axis=1)
        known = np.isfinite(length) & (length > 0)
        facing[known] = way[known] / length[known, None]
    return facing if facing.any() else None
