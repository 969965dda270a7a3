"""Radii for points that come without: the smallest that cover the surface (paper, part II; Wu and Kobbelt 2004).

A disc that reaches the farthest vertex of its point's Voronoi cell in the tangent plane covers the cell; all discs
cover the surface. The blended surface needs wider supports, as a splat's weight is zero at the edge of its support:
OVERLAP is the factor.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.arguments import check_numbers
from ...base.progress import Progress, part_of
from ...cloud.neighbors import NeighborTree, distinct
from ...cloud.points import Points
from ...cloud.statistics import CloudStatistics
from .borders import lone_borders
from .cells import Cells, Cloud, cloud_of
from .closed import USUAL, distances
from .gaps import find_limits
from .medians import medians_around
from .voronoi import Neighborhood
from .wide_discs import NOTICE, limit_wide

Floats = NDArray[np.float32]

# Torus of 100,000 points, even | random: 1.5 gives 4.1 | 7.2 splats over a point, depth errors of 2e-4 | 8e-4 h and
# normals of 0.12 | 0.24 degrees; 1.8 gives 6.0 | 10.3 and 1e-4 | 5e-4, 0.08 | 0.20. No ray misses in either.
OVERLAP = 1.5
STRAY = 2.5  # a point may be stray if its 4th neighbour is this many times farther than the cells around it reach
# A gap is open if it is 1 + CHANCE (q - 1) times as wide as usual, within VOIDS; q is the factor by which the widest
# twentieth of the cells exceed the usual size. Even points: 1.5 (the widest 1.3); a million random ones: 3 (2.7).
CHANCE, VOIDS = 3.6, (1.5, 3.0)
# No cell counts as smaller than this share of the median around it, as the least radius decides the distance of the
# samples along a ray. Random points: 15% faster, with 4% more splats over a point and the same errors.
EVEN = 0.9
CUT = 0.85  # share of the time after which all cells are measured
CLUMP = 0.1  # points this much closer than usual count as one
DIAGONAL = 1.8  # of a cell of a grid of size 1, and a little more


class Chosen(NamedTuple):
    """What `choose_radii` returns.

    radii : (n,) float32
        In the unit of the positions, greater than 0.
    borders : (n, 3) float32
        The direction out of the surface for points on an open border, unit, else zero.
    lone : (n,) bool
        Which points are stray: their radii were made smaller.
    facing : (n,) bool
        Which points may have neighbours that face away from them; no others have.
    near : (n, k) int32
        The 8 nearest neighbours, each point itself first, or fewer if there are no more.
    """

    radii: Floats
    borders: Floats
    lone: NDArray[np.bool_]
    facing: NDArray[np.bool_]
    near: NDArray[np.int32]


def choose_radii(
    positions: Floats,
    normals: Floats,
    progress: Progress | None = None,
    tree: NeighborTree | None = None,
    usual: CloudStatistics | None = None,
    others: Floats | None = None,
) -> Chosen:
    """Radii that cover the surface, each as small as its point's Voronoi cell and its neighbours' radii allow.

    The borders of the surface are found too. Points in a clump much smaller than the spacing count as one; a stray
    point gets a radius like those of its nearest neighbours, see `limit_wide`.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite, all different, in kd order.
    normals : (n, 3) float32, unit
    progress : callable, optional
    tree : NeighborTree, optional
        Of the positions, in order.
    usual : CloudStatistics, optional
        Of the cloud that the points are a part of. None: they are the whole.
    others : (m, 3) float32, optional
        Points of the cloud that are drawn otherwise: discs do not reach across gaps that are wide among all points, see
        `gaps`.

    Raises
    ------
    ValueError
        If there is only one point: it does not tell how large a splat is.
    """
    if len(positions) < 2:
        raise ValueError("points at one place say nothing about the spacing: give radii")
    cloud, usual = cloud_of(positions, normals, tree), usual or CloudStatistics.of(len(positions))
    found = _survey(cloud, usual, others, progress)
    cell = CLUMP * usual.quantile("reach of small cells", found.radii, 0.25)
    if min(usual.least("least reach", found.radii), found.radii.min()) < cell:
        found = _merged(cloud, found, cell, usual, others)
    np.multiply(found.radii, np.float32(OVERLAP), out=found.radii)
    return found


def _merged(cloud: Cloud, found: Chosen, cell: float, usual: CloudStatistics, others: Floats | None) -> Chosen:
    """The survey of points of which those in one cell of a grid count as one; what was found, if all of them do."""
    nearest = distances(cloud.positions, Neighborhood(np.arange(len(found.near)), found.near), 1)
    rows, members = _in_cells(cloud.positions, nearest, cell)
    if len(rows) == 1:
        return found
    again = _survey(cloud_of(cloud.positions[rows], cloud.normals[rows], None), usual.merged(members), others)
    return Chosen(again.radii[members], again.borders[members], again.lone[members], found.facing, found.near)


def _in_cells(positions: Floats, nearest: Floats, cell: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """See `distinct`; only points closer than a cell's diagonal to their nearest neighbour may share theirs."""
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
    """How far each point's cell reaches, limited for outliers; the borders; and which points are outliers.

    whole : what is usual in the cloud that the points are a part of; others : its points beside these
    """
    positions, normals = cloud.positions, cloud.normals
    cells = Cells(cloud, part_of(progress, 0.0, CUT))
    borders, fourth, reach, near = cells.gaps, cells.first.fourth, cells.reach, cells.near
    odd = np.flatnonzero(~cells.first.one_sheet) if near.shape[1] > USUAL else np.arange(len(near))
    hood = Neighborhood(odd, cloud.around(odd))
    around = medians_around(reach, normals, near, hood, own=False)
    far = np.flatnonzero((fourth > STRAY * around) & (around > 0))
    above = far[_height(positions, normals, far, near[far, 1:5]) > 0.5]
    usual = around.copy()  # for a point beside denser ones, its distance from them defines what is usual
    usual[far] = np.float32(0.6) * fourth[far]
    usual[above] = around[above]
    # The points themselves tell how wide a gap may be by chance.
    shares = np.divide(reach, np.maximum(usual, np.float32(1e-30)), dtype=np.float32)
    common = whole.quantile("reach of wide cells, in usual ones", shares, 0.95)
    void = float(np.clip(1 + CHANCE * (common - 1), *VOIDS))
    ahead = cells.measure(np.flatnonzero(cells.at_gap | (reach > np.float32(void) * usual)), usual, void)
    borders[ahead], cells.at_gap[ahead] = 0, False
    rows = np.flatnonzero(cells.at_gap)
    lone = rows[lone_borders(cells.at_gap, cloud.around(rows))]
    borders[lone], cells.at_gap[lone] = 0, False
    stray = np.union1d(above, far[cells.at_gap[far]])
    high = above[fourth[above] > 2 * STRAY * around[above]]
    alone = np.union1d(high, stray[reach[stray] > NOTICE * around[stray]])
    reach[stray] = np.minimum(reach[stray], around[stray])
    empty = np.flatnonzero(~(reach > 0))
    reach[empty] = distances(positions, Neighborhood(empty, near[empty]), 1) / 2
    wide = limit_wide(positions, normals, reach, cloud.around, around, whole.quantile("reach", reach, 0.5))
    wide[alone] = True
    cells.narrow(find_limits(positions, near, others, whole), whole)
    floor = medians_around(reach, normals, near, hood, own=True)
    np.maximum(reach, np.float32(EVEN) * floor, out=reach)
    return Chosen(reach, borders, wide, cells.first.facing, near)


def _height(positions: Floats, normals: Floats, rows: NDArray[np.int64], near: NDArray[np.int32]) -> Floats:
    """How steeply the neighbours lie above or below each row's tangent plane: the mean sine."""
    away = positions[near] - positions[rows, None]
    height = np.abs(np.einsum("ijk,ik->ij", away, normals[rows]))
    return np.asarray((height / np.maximum(np.linalg.norm(away, axis=2), 1e-30)).mean(axis=1))


def check_radii(radii: ArrayLike, n: int) -> Floats:
    """The caller's radii as (n,) float32; ValueError names the first row that is not a valid radius."""
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
    """The support radii that come with points: the numbers of the attribute `radius`, if each is a positive one."""
    radii = points.attributes.get("radius")
    return None if radii is None else radii_among(radii)


def radii_among(radii: NDArray[Any]) -> Floats | None:
    """The values of an attribute as radii; None if not each is a positive number."""
    if radii.ndim != 1 or radii.dtype == np.bool_:
        return None
    with np.errstate(over="ignore"):
        narrow = np.asarray(radii, np.float32)
    return narrow if ((narrow > 0) & (narrow < np.inf)).all() else None
