"""Radii for points that come without: the smallest that cover the surface (paper, part II; Wu and Kobbelt 2004).

A disc that reaches the farthest vertex of its point's Voronoi cell in the tangent plane covers the cell; all discs
cover the surface. The blended surface needs wider supports, as a splat's weight is zero at the edge of its support:
OVERLAP is the factor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arguments import check_numbers
from ..data import Points
from ..neighbors import NeighborTree, distinct, neighbors
from ..progress import Progress, part_of, tell
from .borders import drop_lone, find_gaps
from .medians import medians_around
from .strays import NOTICE, limit_wide
from .voronoi import Hood, measure_cells

Floats = NDArray[np.float32]

# Torus of 100,000 points, even | random: 1.5 gives 4.1 | 7.2 splats over a point, depth errors of 2e-4 | 8e-4 h and
# normals of 0.12 | 0.24 degrees; 1.8 gives 6.0 | 10.3 and 1e-4 | 5e-4, 0.08 | 0.20. No ray misses in either.
OVERLAP = 1.5
NEIGHBORS = 20  # they close the cells of even points and nine in ten of random ones
MORE = 80  # for the cells still open: beside a gap, a step of density, between lines of a scan
WIDE = 0.5  # a cell wider than this share of the distance to the 8th neighbour may lie at a border; even points: 0.46,
# random ones: 0.6
BEYOND = 40  # neighbours for cells that are open even then, from farther ahead and behind
STRAY = 2.5  # a point may be stray if its 4th neighbour is this many times farther than the cells around it reach
# A gap is open if it is 1 + CHANCE (q - 1) times as wide as usual, within VOIDS; q is the factor by which the widest
# twentieth of the cells exceed the usual size. Even points: 1.5 (the widest 1.3); a million random ones: 3 (2.7).
CHANCE, VOIDS = 3.6, (1.5, 3.0)
# No cell counts as smaller than this share of the median around it, as the least radius decides the distance of the
# samples along a ray. Random points: 15% faster, with 4% more splats over a point and the same errors.
EVEN = 0.9
CUT = 0.8  # share of the time after which all cells are measured once
CLUMP = 0.1  # points this much closer than usual count as one


def choose_radii(
    positions: Floats,
    normals: Floats,
    distances: Floats,
    near: NDArray[np.int32],
    progress: Progress | None = None,
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Radii that cover the surface, each as small as its point's Voronoi cell and its neighbours' radii allow.

    The borders of the surface are found too. Points in a clump much smaller than the spacing count as one; a stray
    point gets a radius like those of its nearest neighbours, see `limit_wide`.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite, all different.
    normals : (n, 3) float32, unit
    distances, near : (n, NEIGHBORS + 1) float32, int32
        Each point's neighbours, itself first.
    progress : callable, optional

    Returns
    -------
    radii : (n,) float32
        In the unit of the positions, greater than 0.
    borders : (n, 3) float32
        The direction out of the surface for points on an open border, unit, else zero.
    lone : (n,) bool
        Which points are stray: their radii were made smaller.

    Raises
    ------
    ValueError
        If there is only one point: it does not tell how large a splat is.
    """
    if len(positions) < 2:
        raise ValueError("points at one place say nothing about the spacing: give radii")
    found = _survey(positions, normals, distances, near, progress)
    reach = found[0]
    usual = float(np.quantile(reach, 0.25))
    if reach.min() < CLUMP * usual:
        rows, members = distinct(positions, CLUMP * usual)
        if len(rows) > 1:
            merged = positions[rows]
            reach, borders, lone = _survey(merged, normals[rows], *neighbors(merged, NEIGHBORS + 1))
            found = reach[members], borders[members], lone[members]
    return np.float32(OVERLAP) * found[0], found[1], found[2]


class _Cells:
    """The points' Voronoi cells, each measured with as many neighbours as close it, or with the most looked up."""

    def __init__(self, sites: tuple[Floats, Floats], hood: Hood, progress: Progress | None) -> None:
        self._sites = sites
        self.reach, sure = measure_cells(*sites, hood)
        # The surface may end at cells that are open or wide. The others, nearly all, need no search for gaps.
        rows = np.flatnonzero(~sure | (self.reach > WIDE * hood.distances[:, min(8, hood.near.shape[1] - 1)]))
        self.gaps = gaps = np.zeros_like(sites[0])
        gaps[rows] = find_gaps(*sites, rows, hood.near)
        tell(progress, 0.5)
        self._settled = [(hood, sure)]
        if hood.near.shape[1] == len(sites[0]) or sure.all():
            return
        tree = NeighborTree(sites[0])
        left = hood.rows[~sure]
        hood = Hood(left, *tree.query(MORE + 1, sites[0][left], part_of(progress, 0.5, 0.9)))
        sure = self._settle(hood)
        doubtful = ~sure & gaps[left].any(axis=1)
        if doubtful.any():
            self._settled[-1] = hood, ~doubtful
            self._settle(_looking_ahead(sites[0], hood, doubtful, gaps, tree))

    def _settle(self, hood: Hood) -> NDArray[np.bool_]:
        self.reach[hood.rows], sure = measure_cells(*self._sites, hood)
        self._settled.append((hood, sure))
        return sure

    def measure(self, which: NDArray[np.bool_], usual: Floats, void: float) -> NDArray[np.bool_]:
        """Measure the cells of `which` again, see `measure_cells`; returns where the surface goes on ahead."""
        closed = np.zeros(len(which), np.bool_)
        for number, (hood, settled) in enumerate(self._settled, 1):
            here = which[hood.rows] & (settled | (number == len(self._settled)))
            part = _part(hood, here)
            self.reach[part.rows], closed[part.rows] = measure_cells(*self._sites, part, self.gaps, usual, void)
        return closed


def _part(hood: Hood, which: NDArray[np.bool_]) -> Hood:
    return Hood(hood.rows[which], hood.distances[which], hood.near[which])


def _looking_ahead(positions: Floats, hood: Hood, which: NDArray[np.bool_], gaps: Floats, tree: NeighborTree) -> Hood:
    """The hoods with neighbours from across their gap and behind, however many dense points lie on this side."""
    hood = _part(hood, which)
    here, steps = positions[hood.rows], 2 * hood.distances[:, -1:] * gaps[hood.rows]
    near = np.hstack([hood.near, tree.query(BEYOND, here + steps)[1], tree.query(BEYOND, here - steps)[1]])
    distances = np.linalg.norm(positions[near] - here[:, None], axis=2)
    order = np.argsort(distances, axis=1, kind="stable")
    return Hood(hood.rows, np.take_along_axis(distances, order, 1), np.take_along_axis(near, order, 1))


def _survey(
    positions: Floats,
    normals: Floats,
    distances: Floats,
    near: NDArray[np.int32],
    progress: Progress | None = None,
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """How far each point's cell reaches, limited for outliers; the borders; and which points are outliers."""
    cells = _Cells((positions, normals), Hood(np.arange(len(positions)), distances, near), part_of(progress, 0.0, CUT))
    borders = cells.gaps
    around = medians_around(cells.reach, normals, near, own=False)
    fourth = distances[:, min(4, near.shape[1] - 1)]
    far = np.flatnonzero((fourth > STRAY * around) & (around > 0))
    above = far[_height(positions, normals, far, near[far, 1:5]) > 0.5]
    usual = around.copy()  # for a point beside denser ones, its distance from them defines what is usual
    usual[far] = np.float32(0.6) * fourth[far]
    usual[above] = around[above]
    # The points themselves tell how wide a gap may be by chance.
    common = float(np.quantile(cells.reach / np.maximum(usual, np.float32(1e-30)), 0.95))
    void = float(np.clip(1 + CHANCE * (common - 1), *VOIDS))
    doubtful = borders.any(axis=1) | (cells.reach > void * usual)
    borders[cells.measure(doubtful, usual, void)] = 0
    drop_lone(borders, near)
    reach = cells.reach
    stray = np.union1d(above, far[borders[far].any(axis=1)])
    high = above[fourth[above] > 2 * STRAY * around[above]]
    alone = np.union1d(high, stray[reach[stray] > NOTICE * around[stray]])
    reach[stray] = np.minimum(reach[stray], around[stray])
    reach = np.where(reach > 0, reach, distances[:, 1] / 2)
    lone = limit_wide(positions, normals, reach, near, around)
    lone[alone] = True
    return np.maximum(reach, np.float32(EVEN) * medians_around(reach, normals, near, own=True)), borders, lone


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
    if radii is None or radii.ndim != 1 or radii.dtype == np.bool_:
        return None
    with np.errstate(over="ignore"):
        narrow = np.asarray(radii, np.float32)
    return narrow if ((narrow > 0) & (narrow < np.inf)).all() else None
