"""Points that are scattered, as leaves, wires and single points are, instead of lying on a surface.

Planes are fitted to the neighbours of each point at four scales (`local_planes.py`). Where one of them is thin against
the spacing, agrees with the planes beside it, and has the point on it, the point is on a surface (`scatter_rules.py`).
Coarse scales see through noise and across scan lines, fine ones see details.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arguments import check_callback
from ....base.progress import Progress, part_of, tell
from ....cloud.denoising.smooth import Placed
from ....cloud.neighbors import NeighborTree, distinct, kd_order, take
from ....cloud.points import Points
from ..local_planes import LocalPlanes, columns_of, disagreement, fit_planes
from .fitted_normals import Normals, follow_normals
from .islands import follow_around
from .rules import AROUND, KEEP, LOSE, SPACING, VOTERS, Evidence, judge, vote

Floats = NDArray[np.float32]
Rows = NDArray[np.integer[Any]]

FEW = VOTERS + 1  # different positions; fewer are no surface
NEAR = 8  # neighbours of the finest scale
COARSE, COARSEST = 4, 16  # the coarse scales look at every so many points in kd order
ROUNDS = 2  # of votes that make and lose surface points, then of votes that only make them
# Share of surface among 68 points around, and distance from its plane, at which a point follows.
MOSTLY, MOSTLY_OFF = 0.72, 0.8
# Times the mean distance of the 8th neighbour around: scattered points that are sparser than the first do not follow
# their neighbours; what is sparser than the second is scattered.
SPARSE, SPARSEST = 2.0, 5.0
UNUSUAL = 1.5  # times the median noise of a cloud: more of it may be leaves
STRETCH, STILL = 64, 0.2  # points judged together, and the share that must still be scattered where they were placed
SORTED, FOUND, FITTED, JUDGED = 0.2, 0.5, 0.8, 0.95  # shares of the time


def find_scattered(
    positions: Floats,
    normals: Floats | None = None,
    *,
    fitted: bool = False,
    threads: int | None = None,
    progress: Progress | None = None,
) -> NDArray[np.bool_]:
    """Find the points of a cloud that do not lie on a surface.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite.
    normals : (n, 3) float32, optional
        Unit normals, oriented alike on each sheet; zero where unknown. They can only turn scattered points into
        surface points, and only if they follow the curvature.
    fitted : bool
        Whether the normals were fitted to the positions; those of a mesh or a scanner prove more.
    threads : int, optional
        Number of threads of all but the neighbour search. Default: `POINTRAY_THREADS`, else all processors.
    progress : callable, optional
        Called with the share done, 0 to 1.

    Returns
    -------
    (n,) bool
        True for scattered points. Equal positions count once and share the result. Fewer than 17 different positions
        are all scattered.

    Raises
    ------
    ValueError
        If `positions` or `normals` have another shape.
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
    tell(progress, SORTED)
    known = None if normals is None else Normals(columns_of(take(normals, order[first])), fitted)
    scattered = np.empty(len(positions), np.bool_)
    scattered[order] = scattered_places(take(along, first), first, known, threads, progress)[ids]
    tell(progress, 1.0)
    return scattered


def scattered_places(
    places: Floats,
    rows: Rows,
    normals: Normals | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> NDArray[np.bool_]:
    """Return which of some places lie on no surface, see `find_scattered`.

    Parameters
    ----------
    places : (n, 3) float32
        All different, in kd order.
    rows : (n,) array of ints, ascending
        Where the first point at each place stands in the kd order of the whole cloud. Coarse scales look at every so
        many rows, so that a part of the order gives what the whole does.
    normals : Normals, optional
    """
    if len(places) < FEW:
        return np.ones(len(places), np.bool_)
    return _scattered(places, rows, normals, threads, progress)


def find_scattered_placed(cloud: Points, placed: Placed, progress: Progress | None = None) -> NDArray[np.bool_]:
    """Find the scattered points of a cloud that has been placed on its surface, see `find_scattered`.

    What is scattered in the cloud, but not where its points were placed, was noise of a surface, and is smooth now. But
    placing also flattens leaves a little. So stretches of 64 points in kd order are judged together; and where noise
    seems to be unusual, the points of the cloud are judged in place of the placed ones.
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
    starts = np.arange(0, len(order), STRETCH)
    before, after = (np.add.reduceat(mask[order].astype(np.int64), starts) for mask in (found, found & still))
    kept = np.empty(len(order), np.bool_)
    kept[order] = np.repeat(after >= STILL * before, STRETCH)[: len(order)]
    return np.asarray(found & kept)


def has_few_places(positions: Floats) -> bool:
    """Whether fewer than 17 positions differ: no surface is known of them."""
    return len(np.unique(positions[: FEW**2], axis=0)) < FEW and len(distinct(positions)[0]) < FEW


def _rows(values: Floats, name: str) -> Floats:
    values = np.ascontiguousarray(values, np.float32)
    if values.ndim != 2 or values.shape[1] != 3:
        raise ValueError(f"{name} must have the shape (n, 3), not {values.shape}")
    return values


def _scattered(
    positions: Floats, rows: Rows, normals: Normals | None, threads: int | None, progress: Progress | None
) -> NDArray[np.bool_]:
    """Return which of some different positions in kd order are scattered."""
    near = NeighborTree(positions, in_order=True).rows(VOTERS + 1)
    xyz = columns_of(positions)
    tell(progress, FOUND)
    parts = [_parts(positions, rows, step) for step in (COARSE, COARSEST)]
    evidence = _evidence(positions, xyz, near, parts, threads)
    tell(progress, FITTED)
    surface, alone = judge(xyz, near, evidence, threads)
    reach = evidence.reaches[0]
    usual = parts[0].means(reach)
    alone[reach > SPARSEST * usual] = 1
    if normals is not None:
        follow_normals(xyz, normals, near, surface, evidence, threads)
    tell(progress, JUDGED)
    surface[alone > 0] = 0
    alone[(surface == 0) & (reach > SPARSE * usual)] = 1
    for limits in [(KEEP, LOSE)] * ROUNDS + [(KEEP, 0)] * ROUNDS:
        surface = vote(surface, alone, near, limits, threads)
    close = np.abs(evidence.offsets[1]) < MOSTLY_OFF * SPACING * evidence.reaches[0]
    surface[close & (alone == 0) & (parts[0].means(surface) >= MOSTLY)] = 1
    return np.asarray(follow_around(surface, alone, near) == 0)


class _Parts(NamedTuple):
    """Parts of the kd order, each with its middle point, and those around each.

    rows : (m,) int64, the middle points; starts : (m,) int64, the first points; part : (n,) int32, that of each point
    near : (m, 17) int32, the part itself and the 16 nearest ones, by their middle points
    """

    rows: NDArray[np.int64]
    starts: NDArray[np.int64]
    part: NDArray[np.int32]
    near: NDArray[np.int32]

    def means(self, values: Floats) -> Floats:
        """Return the mean over a point's part and those around it, for each point."""
        sums = np.add.reduceat(values, self.starts) / np.diff(np.append(self.starts, len(values)))
        return take(sums[self.near].mean(axis=1, dtype=np.float32), self.part)


def _starts(rows: Rows, step: int) -> NDArray[np.int64]:
    """Return the index of the first of `rows` in each stretch of `step` rows of the whole kd order."""
    number = np.asarray(rows) // step
    return np.flatnonzero(np.append(True, number[1:] != number[:-1]))


def _parts(positions: Floats, rows: Rows, step: int) -> _Parts:
    """Split the kd order into parts of `step` rows, or fewer where that gives less than 17 parts."""
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
    """Planes through the middle points around each part, for each point, with its own offset from that of its part."""
    middles = positions[parts.rows]
    planes = fit_planes(columns_of(middles), parts.near, (0, FEW), threads)
    spread = LocalPlanes(*(take(values, parts.part) for values in planes))
    middle = columns_of(take(middles, parts.part))
    away = [(own - other) * n for own, other, n in zip(xyz, middle, spread[:3], strict=True)]
    return spread._replace(offset=spread.offset + away[0] + away[1] + away[2])
