"""Points that are scattered, as leaves, wires and single points are, instead of lying on a surface.

Planes are fitted to the neighbours of each point at four scales (`local_planes.py`). Where one of them is thin against
the spacing, agrees with the planes beside it, and has the point on it, the point is on a surface (`scatter_rules.py`).
Coarse scales see through noise and across scan lines, fine ones see details.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arguments import check_callback
from ..neighbors import NeighborTree, distinct, kd_order, take
from ..progress import Progress, tell
from .local_planes import LocalPlanes, columns_of, disagreement, fit_planes, off_arcs
from .scatter_rules import AROUND, KEEP, LOSE, SPACING, VOTERS, Evidence, judge, medians, vote

Floats = NDArray[np.float32]
Rows = NDArray[np.integer[Any]]

FEW = VOTERS + 1  # different positions; fewer are no surface
NEAR = 8  # neighbours of the finest scale
COARSE, COARSEST = 4, 16  # the coarse scales look at every so many points in kd order
ROUNDS = 2  # of votes that make and lose surface points, then of votes that only make them
MOSTLY, MOSTLY_OFF = (
    0.72,
    0.8,
)  # share of surface among 68 points around, and distance from its plane, at which a point follows
# Times the mean distance of the 8th neighbour around: scattered points that are sparser than the first do not follow
# their neighbours; what is sparser than the second is scattered.
SPARSE, SPARSEST = 2.0, 5.0
BLOCK = 256  # points in kd order whose normals are judged together
# Normals of a file prove a surface if they turn with it: heights off the arcs, over those off the planes, with 1 for
# fitted normals of scattered points: 95% of the blocks of Autzen have over 0.79, of those of Lucy less than 0.77.
BLOCK_ARCS, ARCS, ARCS_OFF, FLAT = 0.72, 0.6, 0.3, 0.17
IN_PLANE = 3  # of 8 neighbours that lie in one plane with a point by both normals: an edge
SORTED, FOUND, FITTED, JUDGED = 0.2, 0.5, 0.8, 0.95  # shares of the time


def find_scattered(
    positions: Floats, normals: Floats | None = None, *, threads: int | None = None, progress: Progress | None = None
) -> NDArray[np.bool_]:
    """Find the points of a cloud that do not lie on a surface.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite.
    normals : (n, 3) float32, optional
        Unit normals of a mesh or a scanner, oriented alike on each sheet; zero where unknown. They can only turn
        scattered points into surface points, and only if they follow the curvature. Do not pass fitted normals.
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
    sorted_normals = None if normals is None else take(normals, order[first])
    scattered = np.empty(len(positions), np.bool_)
    scattered[order] = scattered_places(take(along, first), first, sorted_normals, threads, progress)[ids]
    tell(progress, 1.0)
    return scattered


def scattered_places(
    places: Floats,
    rows: Rows,
    normals: Floats | None = None,
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
    normals : (n, 3) float32, optional
    """
    if len(places) < FEW:
        return np.ones(len(places), np.bool_)
    return _scattered(places, rows, None if normals is None else columns_of(normals), threads, progress)


def _rows(values: Floats, name: str) -> Floats:
    values = np.ascontiguousarray(values, np.float32)
    if values.ndim != 2 or values.shape[1] != 3:
        raise ValueError(f"{name} must have the shape (n, 3), not {values.shape}")
    return values


def _scattered(
    positions: Floats,
    rows: Rows,
    normals: tuple[Floats, ...] | None,
    threads: int | None,
    progress: Progress | None,
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
        _follow_normals((xyz, normals, near), _starts(rows, BLOCK), surface, alone, threads)
    tell(progress, JUDGED)
    surface[alone > 0] = 0
    alone[(surface == 0) & (reach > SPARSE * usual)] = 1
    for limits in [(KEEP, LOSE)] * ROUNDS + [(KEEP, 0)] * ROUNDS:
        surface = vote(surface, alone, near, limits, threads)
    close = np.abs(evidence.offsets[1]) < MOSTLY_OFF * SPACING * evidence.reaches[0]
    surface[close & (alone == 0) & (parts[0].means(surface) >= MOSTLY)] = 1
    return np.asarray(surface == 0)


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
    """Where stretches of so many rows begin among those that are there."""
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


def _follow_normals(
    known: tuple[tuple[Floats, ...], tuple[Floats, ...], NDArray[np.int32]],
    starts: NDArray[np.int64],
    surface: Floats,
    alone: Floats,
    threads: int | None,
) -> None:
    """Mark points as surface, in place, where the normals turn as those of a curved surface do.

    known : places, normals and neighbours; starts : of the blocks of points that are judged together
    """
    xyz, normals, near = known
    *found, same = off_arcs(xyz, normals, near, (1, AROUND), threads)
    arc, plane = (medians(values, near, threads) for values in found)
    open_ = surface == 0
    turned = np.add.reduceat(arc * open_, starts) < BLOCK_ARCS * np.add.reduceat(plane * open_, starts)
    turned = np.repeat(turned, np.diff(np.append(starts, len(surface))))
    follows = turned | (plane < FLAT) | ((arc < ARCS_OFF) & (arc < ARCS * plane))
    follows |= same >= IN_PLANE
    surface[follows] = 1
    alone[turned] = 0
