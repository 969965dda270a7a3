"""Classification of scattered points, such as leaves, wires and isolated points, which lie on no surface.

Planes are fitted to the neighbours of each point at four scales (`local_planes.py`). A point is on a surface if one of
them is thin relative to the spacing, agrees with neighbouring planes, and contains the point (`rules.py`). Coarse
scales average over noise and scan lines; fine scales resolve details.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arguments import check_callback
from ....base.arrays import Flags, Floats
from ....base.progress import Progress, part_of, report_progress
from ....cloud.denoising.smooth import Placed
from ....cloud.neighbors import NeighborTree, distinct, kd_order, take
from ....cloud.points import Points
from ..local_planes import LocalPlanes, columns_of, disagreement, fit_planes
from .fitted_normals import Normals, follow_normals
from .islands import absorb_islands
from .rules import AROUND, KEEP, LOSE, SPACING, VOTERS, Evidence, judge, vote

Rows = NDArray[np.integer[Any]]

FEW = VOTERS + 1  # distinct positions; fewer are no surface
NEAR = 8  # neighbours of the finest scale
COARSE, COARSEST = 4, 16  # the coarse scales use every 4th and 16th point in kd order
ROUNDS = 2  # of votes that add and remove surface points, then of votes that only add them
# A point becomes surface if this share of 68 points around it is, and it is within this many spacings of its plane.
MOSTLY, MOSTLY_OFF = 0.72, 0.8
# Local sparsity: distance of the 8th neighbour over its mean around. Scattered points above SPARSE do not follow their
# neighbours' votes; points above SPARSEST are scattered.
SPARSE, SPARSEST = 2.0, 5.0
UNUSUAL = 1.5  # noise, in medians of the cloud, above which points may be leaves
SPAN, STILL = 64, 0.2  # points classified together; least share that must still be scattered after smoothing
SORTED, FOUND, FITTED, JUDGED = 0.2, 0.5, 0.8, 0.95  # fractions of the run time


def find_scattered(
    positions: Floats,
    normals: Floats | None = None,
    *,
    fitted: bool = False,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Flags:
    """Find the points of a cloud that do not lie on a surface.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite.
    normals : (n, 3) float32, optional
        Unit normals, consistently oriented on each sheet; zero where unknown. They can only turn scattered points into
        surface points, and only if they follow the curvature.
    fitted : bool
        Whether the normals were fitted to the positions; those of a mesh or a scanner are stronger evidence.
    threads : int, optional
        Number of threads for all but the neighbour search. Default: `POINTRAY_THREADS`, else all processors.
    progress : callable, optional
        Called with the fraction completed, 0 to 1.

    Returns
    -------
    (n,) bool
        True for scattered points. Equal positions count once and share the result. Fewer than 17 distinct positions
        are all scattered.

    Raises
    ------
    ValueError
        If the shape of `positions` is not (n, 3), or `normals` has a different shape.
    """
    check_callback(progress)
    positions = _rows(positions, "positions")
    if normals is not None and (normals := _rows(normals, "normals")).shape != positions.shape:
        raise ValueError(f"normals must be {positions.shape}, one for each position, not {normals.shape}")
    if not len(positions):
        return np.zeros(0, np.bool_)
    order = kd_order(positions, threads)
    along = take(positions, order)
    first, ids = distinct(along)
    report_progress(progress, SORTED)
    known = None if normals is None else Normals(columns_of(take(normals, order[first])), fitted)
    scattered = np.empty(len(positions), np.bool_)
    scattered[order] = scattered_places(take(along, first), first, known, threads, progress)[ids]
    report_progress(progress, 1.0)
    return scattered


def scattered_places(
    places: Floats,
    rows: Rows,
    normals: Normals | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Flags:
    """Return which of some distinct positions lie on no surface, (n,) bool: leaves, wires and isolated points.

    Parameters
    ----------
    places : (n, 3) float32
        All distinct, in kd order. Fewer than 17 are all scattered.
    rows : (n,) array of ints
        Ascending index of each position's first point in the kd order of the whole cloud. Planes at coarse scales are
        fitted to every 4th and 16th row of that order, so that a part of the cloud gives the same result as the whole.
    normals : Normals, optional
        Unit normals of the positions, which can only turn scattered points into surface points.
    """
    if len(places) < FEW:
        return np.ones(len(places), np.bool_)
    return _scattered(places, rows, normals, threads, progress)


def find_scattered_placed(cloud: Points, placed: Placed, progress: Progress | None = None) -> Flags:
    """Find the points of a smoothed cloud that do not lie on a surface, (n,) bool.

    cloud : the original points; placed : the same points, smoothed, with normals and the removed noise

    Points that are scattered in the original cloud but not after smoothing were noise of a surface. But smoothing also
    flattens leaves a little. So spans of 64 points in kd order are classified together, and where noise is unusually
    high, the original positions are used instead of the smoothed ones.
    """
    normals, noise, fitted = np.asarray(placed.points.normals), placed.noise, cloud.normals is None
    part = part_of(progress, 0.0, 1.0 if noise is None else 0.5)
    found = find_scattered(cloud.positions, normals, fitted=fitted, progress=part)
    if noise is None or not found.any():
        return found
    unusual = noise > UNUSUAL * np.median(noise[noise > 0]) if (noise > 0).any() else np.zeros(len(noise), np.bool_)
    positions = np.where(unusual[:, None], cloud.positions, placed.points.positions)
    still = find_scattered(positions, normals, fitted=fitted, progress=part_of(progress, 0.5, 1.0))
    order = kd_order(cloud.positions)
    starts = np.arange(0, len(order), SPAN)
    before, after = (np.add.reduceat(mask[order].astype(np.int64), starts) for mask in (found, found & still))
    kept = np.empty(len(order), np.bool_)
    kept[order] = np.repeat(after >= STILL * before, SPAN)[: len(order)]
    return np.asarray(found & kept)


def has_few_places(positions: Floats) -> bool:
    """Return whether there are fewer than 17 distinct positions, too few to detect a surface."""
    return len(np.unique(positions[: FEW**2], axis=0)) < FEW and len(distinct(positions)[0]) < FEW


def _rows(values: Floats, name: str) -> Floats:
    values = np.ascontiguousarray(values, np.float32)
    if values.ndim != 2 or values.shape[1] != 3:
        raise ValueError(f"{name} must have the shape (n, 3), not {values.shape}")
    return values


def _scattered(
    positions: Floats, rows: Rows, normals: Normals | None, threads: int | None, progress: Progress | None
) -> Flags:
    """Return which of some distinct positions lie on no surface, (n,) bool, from planes fitted at four scales.

    positions : in kd order, at least 17; rows : their indices in the kd order of the whole cloud
    """
    near = NeighborTree(positions, in_order=True).rows(VOTERS + 1)
    xyz = columns_of(positions)
    report_progress(progress, FOUND)
    parts = [_parts(positions, rows, step) for step in (COARSE, COARSEST)]
    evidence = _evidence(positions, xyz, near, parts, threads)
    report_progress(progress, FITTED)
    surface, alone = judge(xyz, near, evidence, threads)
    reach = evidence.reaches[0]
    typical = parts[0].means(reach)
    alone[reach > SPARSEST * typical] = 1
    if normals is not None:
        follow_normals(xyz, normals, near, surface, evidence, threads)
    report_progress(progress, JUDGED)
    surface[alone > 0] = 0
    alone[(surface == 0) & (reach > SPARSE * typical)] = 1
    for limits in [(KEEP, LOSE)] * ROUNDS + [(KEEP, 0)] * ROUNDS:
        surface = vote(surface, alone, near, limits, threads)
    close = np.abs(evidence.offsets[1]) < MOSTLY_OFF * SPACING * evidence.reaches[0]
    surface[close & (alone == 0) & (parts[0].means(surface) >= MOSTLY)] = 1
    return np.asarray(absorb_islands(surface, alone, near) == 0)


class _Parts(NamedTuple):
    """Runs of consecutive points in kd order, here called parts, which sample n points for planes at a coarse scale.

    rows : (m,) int64, middle point of each part
    starts : (m,) int64, first point of each part
    part : (n,) int32, part of each point
    near : (m, 17) int32, each part and the 16 nearest ones by their middle points
    """

    rows: NDArray[np.int64]
    starts: NDArray[np.int64]
    part: NDArray[np.int32]
    near: NDArray[np.int32]

    def means(self, values: Floats) -> Floats:
        """Return, for each point, the mean of `values` (n,) over its part and the 16 parts around it."""
        sums = np.add.reduceat(values, self.starts) / np.diff(np.append(self.starts, len(values)))
        return take(sums[self.near].mean(axis=1, dtype=np.float32), self.part)


def _starts(rows: Rows, step: int) -> NDArray[np.int64]:
    """Return the index of the first of `rows` in each span of `step` rows of the whole kd order, (m,).

    rows : ascending indices in that order
    """
    number = np.asarray(rows) // step
    return np.flatnonzero(np.append(True, number[1:] != number[:-1]))


def _parts(positions: Floats, rows: Rows, step: int) -> _Parts:
    """Split the kd order into parts of `step` rows, or fewer if there would be fewer than 17 parts.

    positions : (n, 3) in kd order; rows : (n,) their indices in the kd order of the whole cloud
    """
    starts = _starts(rows, step)
    while len(starts) < FEW and step > 1:
        step //= 2
        starts = _starts(rows, step)
    sizes = np.diff(np.append(starts, len(positions)))
    middles = starts + sizes // 2
    part = np.repeat(np.arange(len(starts), dtype=np.int32), sizes)
    near = NeighborTree(np.ascontiguousarray(positions[middles]), in_order=True).rows(FEW)
    return _Parts(middles, starts, part, near)


def _evidence(
    positions: Floats, xyz: tuple[Floats, ...], near: NDArray[np.int32], parts: list[_Parts], threads: int | None
) -> Evidence:
    fine = [fit_planes(xyz, near, (1, k + 1), threads) for k in (NEAR, VOTERS)]
    coarse = [_coarse_planes(positions, xyz, some, threads) for some in parts]
    scales = (*fine, *coarse)
    bends = [disagreement(planes[:3], near, (1, VOTERS + 1), threads) for planes in fine]
    bends += [disagreement(planes[:3], near, (0, AROUND), threads) for planes in coarse]
    return Evidence(
        tuple(bends),
        tuple(planes.thickness for planes in scales),
        tuple(planes.slimness for planes in scales),
        tuple(planes.offset for planes in scales),
        coarse[0][:3],
        coarse[1][:3],
        (fine[0].reach, fine[1].reach, coarse[0].reach),
    )


def _coarse_planes(positions: Floats, xyz: tuple[Floats, ...], parts: _Parts, threads: int | None) -> LocalPlanes:
    """Fit a plane to the middle points of each part and the 16 nearest parts; return for each point its part's plane.

    The offset of the result is the signed distance of the point itself from that plane.

    positions : (n, 3); xyz : x, y and z of these
    parts : runs of consecutive points in kd order, with a middle point each
    """
    middles = positions[parts.rows]
    planes = fit_planes(columns_of(middles), parts.near, (0, FEW), threads)
    spread = LocalPlanes(*(take(values, parts.part) for values in planes))
    middle = columns_of(take(middles, parts.part))
    away = [(own - other) * n for own, other, n in zip(xyz, middle, spread[:3], strict=True)]
    return spread._replace(offset=spread.offset + away[0] + away[1] + away[2])
