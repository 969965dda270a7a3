"""Radii for points without given ones: the smallest that cover the surface (paper, part II; Wu and Kobbelt 2004).

A disc that reaches the farthest vertex of its point's Voronoi cell in the tangent plane covers the cell. Together such
discs cover the surface. The blended surface needs supports wider by the factor OVERLAP, because the weight of a splat
falls to zero at the edge of its support.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.arguments import check_numbers
from ...base.arrays import Flags, Floats, Rows
from ...base.progress import Progress, part_of
from ...cloud.neighbors import NeighborTree, distinct
from ...cloud.points import Points
from ...cloud.statistics import CloudStatistics
from .borders import isolated_borders
from .cells import Cells, Cloud, cloud_of
from .closed import NEAREST, distances
from .gaps import find_limits
from .medians import medians_around
from .voronoi import Neighborhood
from .wide_discs import NOTICE, limit_wide

# Torus of 100,000 points, regular | random: 1.5 gives 4.1 | 7.2 overlapping splats, depth errors of 2e-4 | 8e-4 h and
# normal errors of 0.12 | 0.24 degrees; 1.8 gives 6.0 | 10.3, 1e-4 | 5e-4, 0.08 | 0.20. No ray misses with either.
OVERLAP = 1.5
STRAY = 2.5  # a point may be isolated if its 4th neighbour is this many times as far as the cells around it extend
# A gap is open if it is 1 + CHANCE (q - 1) times as wide as typical, clipped to VOIDS; q is the 95th percentile of cell
# size over typical size. Regular points: 1.5 (the widest cell is 1.3); a million random points: 3 (the widest is 2.7).
CHANCE, VOIDS = 3.6, (1.5, 3.0)
# Cells count as no smaller than this share of the median around them, because the least radius determines the sample
# distance along rays. On random points: 15% faster, 4% more overlapping splats, same errors.
EVEN = 0.9
CUT = 0.85  # fraction of the run time at which all cells are measured
CLUMP = 0.1  # points closer than this share of the typical reach are merged
DIAGONAL = 1.8  # a little more than the diagonal of a unit cube


class Chosen(NamedTuple):
    """Radii that `choose_radii` found for n points, and the borders of their surface.

    radii : (n,) float32
        In the unit of the positions, greater than 0.
    borders : (n, 3) float32
        Unit outward direction for points on an open border, else zero.
    isolated : (n,) bool
        Isolated points, whose radii were reduced.
    facing : (n,) bool
        Points that may have neighbours with opposite normals; no other point has.
    near : (n, k) int32
        Rows of each point and its 8 nearest neighbours, or all neighbours if there are fewer.
    """

    radii: Floats
    borders: Floats
    isolated: Flags
    facing: Flags
    near: NDArray[np.int32]


def choose_radii(
    positions: Floats,
    normals: Floats,
    progress: Progress | None = None,
    tree: NeighborTree | None = None,
    statistics: CloudStatistics | None = None,
    others: Floats | None = None,
) -> Chosen:
    """Choose radii that cover the surface, each as small as the point's Voronoi cell and its neighbours' radii allow.

    Also find the borders of the surface. Points in a clump much smaller than the spacing count as one. An isolated
    point gets a radius like those of its nearest neighbours.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite, all distinct, in kd order.
    normals : (n, 3) float32
        Unit normals.
    progress : callable, optional
    tree : NeighborTree, optional
        Neighbour search over the positions, made with `in_order`. Default: made here.
    statistics : CloudStatistics, optional
        Statistics of the whole cloud, if the points are a part of one. Default: those of the points.
    others : (m, 3) float32, optional
        Scattered points of the same cloud, such as leaves. They get no radii; where they are near, discs span narrower
        gaps.

    Raises
    ------
    ValueError
        If there are fewer than two points, which have no spacing.
    """
    if len(positions) < 2:
        raise ValueError("cannot choose radii: all points have the same position; give radii")
    cloud, statistics = cloud_of(positions, normals, tree), statistics or CloudStatistics.of(len(positions))
    found = _survey(cloud, statistics, others, progress)
    cell = CLUMP * statistics.quantile("reach of small cells", found.radii, 0.25)
    if min(statistics.least("least reach", found.radii), found.radii.min()) < cell:
        found = _merged(cloud, found, cell, statistics, others)
    np.multiply(found.radii, np.float32(OVERLAP), out=found.radii)
    return found


def _merged(cloud: Cloud, found: Chosen, cell: float, statistics: CloudStatistics, others: Floats | None) -> Chosen:
    """Choose radii again, with the points in each grid cell merged: in clumps, Voronoi cells are too small.

    found : result without merging, which is returned if all points are in one grid cell
    cell : edge length of the grid cells
    statistics : of the whole cloud
    others : scattered points of the same cloud, not in `cloud`; they get no radii, but discs beside them span narrower
        gaps
    """
    nearest = distances(cloud.positions, Neighborhood(np.arange(len(found.near)), found.near), 1)
    rows, members = _in_cells(cloud.positions, nearest, cell)
    if len(rows) == 1:
        return found
    again = _survey(cloud_of(cloud.positions[rows], cloud.normals[rows], None), statistics.merged(members), others)
    return Chosen(again.radii[members], again.borders[members], again.isolated[members], found.facing, found.near)


def _in_cells(positions: Floats, nearest: Floats, cell: float) -> tuple[Rows, Rows]:
    """Merge the points that share a grid cell and are close to their nearest neighbour; all others stay.

    nearest : (n,) distance to the nearest neighbour; cell : edge length of the grid cells

    Returns the rows of the m points that remain (m,), and for each point the index of its representative in them (n,).
    """
    close = np.flatnonzero(nearest < DIAGONAL * cell)
    first, ids = distinct(positions[close], cell)
    kept = np.ones(len(positions), np.bool_)
    kept[close] = False
    kept[close[first]] = True
    members = np.cumsum(kept) - 1
    members[close] = members[close[first]][ids]
    return np.flatnonzero(kept), members


def _survey(
    cloud: Cloud, whole: CloudStatistics, others: Floats | None = None, progress: Progress | None = None
) -> Chosen:
    """Find a radius for each point from its Voronoi cell, reduce those of isolated points, and find open borders.

    whole : statistics of the whole cloud
    others : scattered points of the same cloud, not in `cloud`; they get no radii, but discs beside them span narrower
        gaps

    The radii of the result reach the farthest vertices of the cells, without the factor by which supports overlap.
    """
    positions, normals = cloud.positions, cloud.normals
    cells = Cells(cloud, part_of(progress, 0.0, CUT))
    borders, fourth, reach, near = cells.gaps, cells.first.fourth, cells.reach, cells.near
    odd = np.flatnonzero(~cells.first.one_sheet) if near.shape[1] > NEAREST else np.arange(len(near))
    neighborhood = Neighborhood(odd, cloud.around(odd))
    around = medians_around(reach, normals, near, neighborhood, own=False)
    far = np.flatnonzero((fourth > STRAY * around) & (around > 0))
    above = far[_height(positions, normals, far, near[far, 1:5]) > 0.5]
    typical = around.copy()  # where denser points are near, the distance to the 4th neighbour is the reference
    typical[far] = np.float32(0.6) * fourth[far]
    typical[above] = around[above]
    # The cell sizes themselves show how wide gaps get by chance.
    shares = np.divide(reach, np.maximum(typical, np.float32(1e-30)), dtype=np.float32)
    common = whole.quantile("reach of wide cells, in usual ones", shares, 0.95)
    void = float(np.clip(1 + CHANCE * (common - 1), *VOIDS))
    ahead = cells.measure(np.flatnonzero(cells.at_gap | (reach > np.float32(void) * typical)), typical, void)
    borders[ahead], cells.at_gap[ahead] = 0, False
    rows = np.flatnonzero(cells.at_gap)
    isolated = rows[isolated_borders(cells.at_gap, cloud.around(rows))]
    borders[isolated], cells.at_gap[isolated] = 0, False
    stray = np.union1d(above, far[cells.at_gap[far]])
    high = above[fourth[above] > 2 * STRAY * around[above]]
    alone = np.union1d(high, stray[reach[stray] > NOTICE * around[stray]])
    reach[stray] = np.minimum(reach[stray], around[stray])
    empty = np.flatnonzero(~(reach > 0))
    reach[empty] = distances(positions, Neighborhood(empty, near[empty]), 1) / 2
    wide = limit_wide(positions, normals, reach, cloud.around, around, whole.quantile("reach", reach, 0.5))
    wide[alone] = True
    cells.narrow(find_limits(positions, near, others, whole), whole)
    floor = medians_around(reach, normals, near, neighborhood, own=True)
    np.maximum(reach, np.float32(EVEN) * floor, out=reach)
    return Chosen(reach, borders, wide, cells.first.facing, near)


def _height(positions: Floats, normals: Floats, rows: Rows, near: NDArray[np.int32]) -> Floats:
    """Return how far neighbours are off the tangent plane of each of `rows`, (m,): mean sine of their angle to it.

    A large value means that the point lies above a surface. near : (m, k) rows of neighbours
    """
    away = positions[near] - positions[rows, None]
    height = np.abs(np.einsum("ijk,ik->ij", away, normals[rows]))
    return np.asarray((height / np.maximum(np.linalg.norm(away, axis=2), 1e-30)).mean(axis=1))


def check_radii(radii: ArrayLike, n: int) -> Floats:
    """Return the caller's radii as (n,) float32.

    Raises ValueError for a wrong shape, or with the first row that is not finite and positive.
    """
    array = check_numbers(radii, "radii")
    if array.shape != (n,):
        raise ValueError(f"radii must have the shape ({n},), one for each point, not {array.shape}")
    with np.errstate(over="ignore"):
        narrow = np.ascontiguousarray(array, np.float32)
    bad = ~((narrow > 0) & np.isfinite(narrow))
    if bad.any():
        row = int(bad.argmax())
        raise ValueError(f"radii must be finite and greater than 0; row {row} is {array[row]}")
    return narrow


def radii_in(points: Points) -> Floats | None:
    """Return the attribute `radius` of points as support radii (n,); None if missing or not positive everywhere."""
    radii = points.attributes.get("radius")
    return None if radii is None else radii_among(radii)


def radii_among(radii: NDArray[Any]) -> Floats | None:
    """Return the values of an attribute as float32 radii; None unless they are one positive number per point."""
    if radii.ndim != 1 or radii.dtype == np.bool_:
        return None
    with np.errstate(over="ignore"):
        narrow = np.asarray(radii, np.float32)
    return narrow if ((narrow > 0) & (narrow < np.inf)).all() else None
