"""Voronoi cells of all points and the gaps beside them, with as many neighbours as it takes to close each cell.

A table of the neighbours of all points would take more memory than everything else together. So points are measured in
parts, and the neighbours of points that are measured again are searched for again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Indices
from ...base.progress import Progress, report_progress
from ...cloud.neighbors import NeighborTree
from ...cloud.statistics import CloudStatistics
from .borders import find_gaps
from .closed import CLOSED, NEAREST, OPEN, UNSURE, WIDE, Closed, distances, measure_closed, pack_table, room_for
from .gaps import MUCH, SOME, Limits, bridged, is_disordered
from .voronoi import Neighborhood, measure_cells

NEIGHBORS = 20  # close the cells of regular points and 90% of the cells of random points
MORE, MOST = 40, 80  # for cells that stay open: unevenly spaced points; points beside a gap or a step of density
MANY = 0.3  # share of open cells above which few are closed by MORE; for random points 10% are open
BEYOND = 40  # extra neighbours from farther ahead and behind for cells that stay open even then
PART = 1 << 16  # points measured together
MEASURED = 0.8  # fraction of the run time at which all cells are measured once
SAME = 0.99  # a cell shrinks only if its new reach is more than 1% smaller: rounding differs between the methods
FIRST, AGAIN, THEN, AHEAD = range(4)  # neighbours a cell was last measured with: NEIGHBORS, MORE, MOST, MOST and BEYOND

Rows = NDArray[Any]  # int32 or int64


class Cloud(NamedTuple):
    """Points whose Voronoi cells are measured.

    positions, normals : (n, 3) float32, in kd order; tree : neighbour search over the positions
    table : (8 n,) float32, position, normal and two zeros of each point
    """

    positions: Floats
    normals: Floats
    table: Floats
    tree: NeighborTree

    def around(self, rows: Rows, count: int = NEIGHBORS) -> Indices:
        """Return the row numbers of points and of their `count` nearest neighbours, (m, count + 1).

        There are fewer columns if the cloud has fewer points. rows : (m,) the points
        """
        return self.tree.rows_at(count + 1, self.positions[rows])


def cloud_of(positions: Floats, normals: Floats, tree: NeighborTree | None) -> Cloud:
    tree = NeighborTree(positions, in_order=True) if tree is None else tree
    return Cloud(positions, normals, pack_table(positions, normals), tree)


class Cells:
    """Voronoi cells of all points of a cloud, in their tangent planes.

    Each cell is measured with the 20 nearest neighbours of its point. If farther ones could change the cell, it is
    measured again with up to 80, and beside a gap in the surface also with points from across the gap.

    Attributes
    ----------
    first : Closed
        Results from the first 20 neighbours.
    reach : (n,) float32
        Distance from each point to the farthest vertex of its cell.
    gaps : (n, 3) float32
        Outward direction where the surface may end, else zero.
    at_gap : (n,) bool
        Where `gaps` is not zero.
    near : (n, k) int32
        Rows of each point and its 8 nearest neighbours, or all neighbours if there are fewer.
    """

    def __init__(self, cloud: Cloud, progress: Progress | None) -> None:
        n = len(cloud.positions)
        self._cloud, self._whole = cloud, n <= NEIGHBORS + 1
        self._level = np.full(n, FIRST, np.uint8)
        self.gaps, self.at_gap = np.zeros((n, 3), np.float32), np.zeros(n, np.bool_)
        self.near = np.empty((n, min(NEAREST + 1, n)), np.int32)
        self.first = room_for(n)
        for start in range(0, n, PART):
            part = slice(start, min(start + PART, n))
            neighborhood = Neighborhood(
                np.arange(part.start, part.stop, dtype=np.int32), cloud.tree.rows(NEIGHBORS + 1, part)
            )
            found = self._settle(neighborhood, self._whole)
            for name in Closed._fields:
                getattr(self.first, name)[part] = getattr(found, name)
            self.near[part] = neighborhood.near[:, : self.near.shape[1]]
            self._look_for_gaps(neighborhood, found)
            report_progress(progress, MEASURED * part.stop / n)
        self.reach = self.first.reach
        self._close(np.flatnonzero(self.first.state == OPEN).astype(np.int32))
        report_progress(progress, 1.0)

    def _look_for_gaps(self, neighborhood: Neighborhood, found: Closed) -> None:
        """Set `gaps` and `at_gap` for the points at which the surface may end.

        neighborhood : points and their neighbours
        found : measurements of the cells of these points; `found.gap` is a mask of the points to examine
        """
        some = np.flatnonzero(found.gap)
        rows = neighborhood.rows[some].astype(np.int64)
        self.gaps[rows] = out = find_gaps(self._cloud.positions, self._cloud.normals, rows, neighborhood.near[some])
        self.at_gap[rows] = out.any(axis=1)

    def _close(self, rows: Rows) -> None:
        """Update `reach`, the distance to the farthest vertex, for the cells of `rows`, from more neighbours.

        These are the open cells, which farther neighbours could change.
        """
        if self._whole:
            return
        for level in (AGAIN, THEN) if len(rows) < MANY * len(self.reach) else (THEN,):
            if len(rows):
                rows = self._settle_again(rows, level)
        rows = rows[self.at_gap[rows]]
        if len(rows):
            self._settle_again(rows, AHEAD)

    def _settle_again(self, rows: Rows, level: int) -> Rows:
        """Measure the cells of `rows` with more neighbours and update `reach`, the distance to their farthest vertices.

        level : AGAIN, with 40 neighbours; THEN, with 80; AHEAD, with 80 and points from across the gap beside a point

        Returns the rows whose cells even more neighbours could change.
        """
        self._level[rows] = level
        left = [rows[:0]]
        for neighborhood in self._neighborhoods(rows, level):
            found = self._settle(neighborhood, level >= THEN or neighborhood.near.shape[1] == len(self._level))
            self.reach[neighborhood.rows] = found.reach
            left.append(neighborhood.rows[found.state == OPEN])
        return np.concatenate(left)

    def _neighborhoods(self, rows: Rows, level: int) -> Iterator[Neighborhood]:
        """Yield points and their neighbours, at most 65,536 points at a time.

        level : FIRST, AGAIN or THEN, with 20, 40 or 80 neighbours; AHEAD, with 80 and points from across the gap beside
            each point
        """
        for start in range(0, len(rows), PART):
            some = np.ascontiguousarray(rows[start : start + PART], np.int32)  # so that kernels need one signature
            neighborhood = Neighborhood(some, self._cloud.around(some, (NEIGHBORS, MORE, MOST, MOST)[level]))
            yield _with_neighbors_ahead(self._cloud, neighborhood, self.gaps) if level == AHEAD else neighborhood

    def _settle(self, neighborhood: Neighborhood, last: bool) -> Closed:
        """Measure Voronoi cells of points from the given neighbours: the distance to the farthest vertex, and a state.

        The state is CLOSED, or OPEN if a farther neighbour could change the cell.

        last : whether no cell will get more neighbours; then the distance is also measured for cells that stay OPEN
        """
        found = measure_closed(self._cloud.table, neighborhood)
        rows = np.flatnonzero(found.state != CLOSED if last else found.state == UNSURE)
        if len(rows):
            part = Neighborhood(neighborhood.rows[rows], neighborhood.near[rows])
            found.reach[rows], sure = measure_cells(self._cloud.positions, self._cloud.normals, part)
            found.state[rows] = np.where(sure, CLOSED, OPEN)
            eighth = distances(self._cloud.positions, part, min(NEAREST, neighborhood.near.shape[1] - 1))
            found.gap[rows] &= ~sure | (found.reach[rows] > WIDE * eighth)
        return found

    def measure(self, rows: Rows, typical: Floats, void: float) -> Rows:
        """Update `reach`, the distance to the farthest vertex, for cells of `rows`, without vertices across wide gaps.

        typical : (n,) median of this distance over the 8 nearest points; more for isolated points beside dense ones
        void : vertices up to this many times the median away count; they lie in the middle of gaps, so wider gaps stay
            open

        Returns the rows of the points on no open border.
        """
        ahead = [rows[:0]]
        sites = self._cloud.positions, self._cloud.normals
        for level in (FIRST, AGAIN, THEN, AHEAD):
            for neighborhood in self._neighborhoods(rows[self._level[rows] == level], level):
                self.reach[neighborhood.rows], closed = measure_cells(*sites, neighborhood, self.gaps, typical, void)
                ahead.append(neighborhood.rows[closed])
        return np.concatenate(ahead)

    def narrow(self, limits: Limits, statistics: CloudStatistics) -> None:
        """Reduce `reach`, the distance to the farthest vertex, where discs would span wide gaps among scattered points.

        This concerns cells in disorder, as in a tree crown, whose neighbours do not lie on smooth sheets with them, and
        cells that cover scattered points.

        limits : half the width of the widest gap at each point, and the scattered points
        statistics : of the whole cloud
        """
        far = self.reach > limits.half
        if limits.others is None and statistics.share("far cells", far) < SOME:  # fewer of them can be disordered
            return
        wide = np.flatnonzero(far)
        sites = self._cloud.positions, self._cloud.normals
        reach, none = self.reach.copy(), np.zeros(len(self.reach), np.bool_)
        mixed, disordered = none, none.copy()
        for level in (FIRST, AGAIN, THEN, AHEAD):
            for neighborhood in self._neighborhoods(wide[self._level[wide] == level], level):
                rows = neighborhood.rows
                least = np.float32(0.5) * distances(sites[0], Neighborhood(rows, self.near[rows]), 1)
                found = np.maximum(bridged(*sites, neighborhood, limits.half[rows]), least)
                less = found < SAME * reach[rows]
                rows = rows[less]
                reach[rows] = found[less]
                mixed[rows] = limits.are_mixed(sites[0][rows], self.reach[rows])
                disordered[rows] = is_disordered(*sites, rows, self._cloud.around)
        share = statistics.share("disordered", mixed | disordered)
        where = mixed if share < SOME else mixed | disordered if share < MUCH else None
        np.copyto(self.reach, reach, where=True if where is None else where)


def _with_neighbors_ahead(cloud: Cloud, neighborhood: Neighborhood, gaps: Floats) -> Neighborhood:
    """Return points beside gaps in the surface with 80 more neighbours each: 40 from across the gap, 40 from behind.

    neighborhood : the points, and their nearest neighbours
    gaps : (n, 3) unit direction of the gap at each point of the cloud

    Dense points on the point's own side may fill the list of neighbours, so that none across the gap is in it.
    """
    here = cloud.positions[neighborhood.rows]
    steps = 2 * distances(cloud.positions, neighborhood, -1)[:, None] * gaps[neighborhood.rows]
    beyond = (cloud.tree.rows_at(BEYOND, here + side * steps) for side in (1, -1))
    near = np.hstack([neighborhood.near, *beyond])
    squares = sum((cloud.positions[near, c] - here[:, c, None]) ** 2 for c in range(3))
    order = np.argsort(squares, axis=1, kind="stable")
    return Neighborhood(neighborhood.rows, np.take_along_axis(near, order, 1))
