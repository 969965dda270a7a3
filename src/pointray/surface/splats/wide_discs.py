"""Wide discs: limit isolated points, and discs that a wide neighbour makes unnecessary.

A disc q times as wide as typical should be part of a surface of similar discs. Its supporters are other discs about as
wide, at most one per grid cell of that size, that lie on a smooth sheet with it: on a plane or circular arc through two
points, their connection is perpendicular to the sum of their normals. A disc needs q supporters, or it is isolated. In
scatter, many discs support each other by chance; there the required share grows with q. Isolated discs do not count as
supporters.

Where the density drops sharply, dense and sparse points both reach across the gap, so both would cover its middle. At
an edge, the wide discs of dense points would also cover detail on the other side. So dense points reach less far.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats, Rows
from ...cloud.neighbors import distinct, neighbors

NOTICE = 3.0  # wider discs, in medians of reach, are examined
OTHERS = 10.0  # this many supporters suffice for any width: a sphere of 100 points must pass
COMPANY = 20  # up to this many discs nearby, q must support; beyond, the same share. In scatter 1/3 to 1/2 do by chance
AROUND = 32  # nearest wide discs that are examined
WITHIN = 6.0  # maximum distance of supporters, in reaches of the disc
ALIKE = 0.5  # supporters reach at least this share of the least reach in an octave
CELL = 2.1  # grid cell with one candidate, in reaches: a dense scan line does not support itself
SMOOTH = (
    0.2  # maximum distance from an arc, as a share of the points' distance or of LEVEL reaches, whichever is larger
)
LEVEL = 1.5
TURNED = 0.3  # least absolute cosine of two normals on one sheet
ROUNDS = 4  # rounds in which isolated discs are removed from the supporters of others
BESIDE = 8  # neighbours that limit the disc of an isolated point
# A dense point is crowded if it reaches over CROWDED times as far as those around it. It keeps the share SPARED of its
# reach if a sparse point within ACROSS reaches also reaches that far. At a density step of factor 30, of 40,000 rays 12
# pass through with 0.6, none with 0.75 (but discs overlap too little), 0.85 and 1. At Nefertiti's base 246,939 rays
# lose 198 hits with 0.75, 324 with 0.85, 714 with 1.
CROWDED, SPARED, ACROSS = 2.0, 0.85, 2.0
CHUNK = 1 << 15  # rows at a time

Around = Callable[[Rows], NDArray[np.int32]]


class Supporters(NamedTuple):
    """Wide discs, and for each of them the other discs that show that it belongs to a surface.

    A disc's supporters are about as wide, close by, and on a smooth sheet with it. With too few, its point is isolated.

    rows : (m,) int64, points of the wide discs; fit : (m, 32) int32, points of each one's supporters, -1 for none
    around : (m,) int64, number of discs about as wide that are close by, whether on a sheet with it or not
    """

    rows: Rows
    fit: NDArray[np.int32]
    around: Rows


def limit_wide(
    positions: Floats, normals: Floats, reach: Floats, around: Around, reach_around: Floats, middle: float
) -> Flags:
    """Reduce the reach of isolated points to their neighbours', and that of dense points beside sparse ones, in place.

    Parameters
    ----------
    positions : (n, 3) float32
        All distinct.
    normals : (n, 3) float32
        Unit normals.
    reach : (n,) float32
        Distance to the farthest vertex of each point's Voronoi cell; discs are larger by the overlap of supports.
    around : callable
        Returns given rows and their neighbours, (m, k) int32.
    reach_around : (n,) float32
        Median of `reach` over the 8 nearest points of each point, on its own sheet.
    middle : float
        Median reach of all points. Only discs over 3 times as wide are examined.

    Returns
    -------
    (n,) bool
        Mask of isolated points.
    """
    typical = np.float32(middle)
    isolated = np.zeros(len(reach), np.bool_)
    rows = np.flatnonzero(reach > NOTICE * typical)
    if len(rows) == 0:
        return isolated
    supporters = _find_supporters(positions, normals, reach, rows, typical)
    rows = _find_isolated(reach, supporters, typical)
    isolated[rows] = True
    beside = around(rows)[:, 1:]
    limit = _first_medians(np.where(isolated[beside], np.float32(np.nan), reach[beside]), typical)
    isolated[rows] = reach[rows] > limit
    reach[rows] = np.minimum(reach[rows], limit)
    _spare(positions, reach, supporters, typical, reach_around)
    return isolated


def _find_supporters(positions: Floats, normals: Floats, reach: Floats, rows: Rows, typical: np.float32) -> Supporters:
    """Find, for each wide disc of `rows`, other wide discs that lie close to it and on a smooth sheet with it.

    reach : (n,) distance to the farthest vertex of each point's Voronoi cell
    typical : median of `reach` over all points

    Discs of similar width, up to a factor of two, are processed together; only one in each grid cell counts.
    """
    supporters = Supporters(rows, np.full((len(rows), AROUND), -1, np.int32), np.zeros(len(rows), np.int64))
    octaves = np.floor(np.log2(reach[rows] / (NOTICE * typical)))
    for octave in np.unique(octaves):
        least = NOTICE * typical * np.float32(2.0) ** np.float32(octave)
        wide = np.flatnonzero(reach >= ALIKE * least)
        others = wide[distinct(positions[wide], float(CELL * least))[0]]
        queried = np.flatnonzero(octaves == octave)
        for start in range(0, len(queried), CHUNK):
            some = queried[start : start + CHUNK]
            here = rows[some]
            distances, found = neighbors(positions[others], AROUND, positions[here])
            found = others[found].astype(np.int32)
            close = (distances > 0) & (distances < WITHIN * reach[here, None])
            smooth = _on_one_sheet(positions, normals, here, found, np.float32(LEVEL) * reach[here])
            supporters.fit[some, : found.shape[1]] = np.where(close & smooth, found, -1)
            supporters.around[some] = close.sum(axis=1)
    return supporters


def _on_one_sheet(positions: Floats, normals: Floats, rows: Rows, found: NDArray[np.int32], level: Floats) -> Flags:
    """Return which points lie on a smooth sheet with each row: near a circular arc perpendicular to both normals.

    rows : (m,); found : (m, k) rows of the points to test, the shape of the result
    level : (m,) length. A point may be off the arc by a fifth of its distance from the row's point, or of this length
        if that is greater

    Signs of normals are free.
    """
    away, n, m = positions[found] - positions[rows, None], normals[rows], normals[found]
    cosines = np.einsum("ijk,ik->ij", m, n)
    off = np.einsum("ijk,ik->ij", away, n) + np.copysign(1, cosines) * np.einsum("ijk,ijk->ij", away, m)
    scale = np.maximum(np.sqrt(np.einsum("ijk,ijk->ij", away, away)), level[:, None])
    return np.asarray((np.abs(off) <= 2 * SMOOTH * scale) & (np.abs(cosines) >= TURNED))


def _find_isolated(reach: Floats, supporters: Supporters, typical: np.float32) -> Rows:
    """Return the rows of wide discs that too few other wide discs support; isolated discs do not count as support.

    reach : (n,) distance to the farthest vertex of each point's Voronoi cell
    supporters : for each wide disc, others that lie on a smooth sheet with it
    typical : median of `reach` over all points
    """
    rows, fit, around = supporters
    wanted = np.minimum(reach[rows] / typical, OTHERS)
    wanted *= np.maximum(around / COMPANY * np.sqrt(wanted / OTHERS), 1)
    explained = np.append(np.ones(len(reach), np.bool_), False)  # the last entry stands for row -1: no disc
    for _ in range(ROUNDS):
        stays = explained[fit].sum(axis=1) >= wanted
        if (stays == explained[rows]).all():
            break
        explained[rows] = stays
    isolated: Rows = rows[~explained[rows]]
    return isolated


def _first_medians(values: Floats, otherwise: np.float32) -> Floats:
    """Return the median of the first 8 numbers of each row, (m,), ignoring NaN. otherwise : result if all are NaN"""
    known = ~np.isnan(values)
    first = np.where(known & (np.cumsum(known, axis=1) <= BESIDE), values, np.float32(np.inf))
    count = np.minimum(known.sum(axis=1), BESIDE)
    middle = np.sort(first, axis=1)[np.arange(len(values)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, middle, otherwise)


def _spare(positions: Floats, reach: Floats, supporters: Supporters, typical: np.float32, reach_around: Floats) -> None:
    """Reduce the reach of dense points beside sparse ones, in place: both would cover the gap between them.

    reach : (n,) distance to the farthest vertex of each point's Voronoi cell
    supporters : wide discs, and for each similar ones on one sheet with it
    typical : median of `reach` over all points
    reach_around : (n,) median of `reach` over the 8 nearest points of each point
    """
    crowded = reach > np.maximum(CROWDED * reach_around, NOTICE * typical)
    some = crowded[supporters.rows]
    rows, fit = supporters.rows[some], supporters.fit[some]
    distances = np.linalg.norm(positions[fit] - positions[rows, None], axis=2)
    sparse = (fit >= 0) & ~crowded[fit] & (reach[fit] > SPARED * reach[rows, None])
    rows = rows[(sparse & (distances < ACROSS * reach[rows, None])).any(axis=1)]
    reach[rows] = np.maximum(np.float32(SPARED) * reach[rows], np.float32(CROWDED) * reach_around[rows])
