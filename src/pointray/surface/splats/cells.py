"""The Voronoi cells of all points, and the gaps beside them: each with as many neighbours as close it.

A table of the neighbours of all points would take more memory than all else together. So points are measured part by
part, and those that are looked at again ask for their neighbours again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import Progress, tell
from ...cloud.neighbors import NeighborTree
from ...cloud.statistics import CloudStatistics
from .borders import find_gaps
from .closed import CLOSED, OPEN, UNSURE, USUAL, WIDE, Closed, distances, measure_closed, pack_table, room_for
from .gaps import MUCH, SOME, Limits, bridged, is_disordered
from .voronoi import Neighborhood, measure_cells

NEIGHBORS = 20  # they close the cells of even points and nine in ten of random ones
MORE, MOST = 40, 80  # neighbours for the cells still open: of uneven points; beside a gap, a step of density
MANY = 0.3  # share of open cells from which few are closed by MORE; of random points 0.1 are open
BEYOND = 40  # neighbours for cells that are open even then, from farther ahead and behind
PART = 1 << 16  # points that are measured together
MEASURED = 0.8  # share of the time until all cells are measured once
SAME = 0.99  # a cell measured again reaches less if by more than a hundredth: other arithmetic has other last bits
FIRST, AGAIN, THEN, AHEAD = range(4)  # what a cell was last measured with: NEIGHBORS, MORE, MOST, or BEYOND too

Floats = NDArray[np.float32]
Indices = NDArray[np.int32]
Rows = NDArray[Any]  # int32 or int64


class Cloud(NamedTuple):
    """Points of which cells are measured.

    positions, normals : (n, 3) float32; table : (8 n,) float32, see `pack_table`; tree : of the positions, in order
    """

    positions: Floats
    normals: Floats
    table: Floats
    tree: NeighborTree

    def around(self, rows: Rows, count: int = NEIGHBORS) -> Indices:
        """So many neighbours of some points, themselves first, (m, count + 1)."""
        return self.tree.rows_at(count + 1, self.positions[rows])


def cloud_of(positions: Floats, normals: Floats, tree: NeighborTree | None) -> Cloud:
    tree = NeighborTree(positions, in_order=True) if tree is None else tree
    return Cloud(positions, normals, pack_table(positions, normals), tree)


class Cells:
    """The points' Voronoi cells, each measured with as many neighbours as close it, or with the most looked up.

    Attributes
    ----------
    first : Closed
        What the first NEIGHBORS neighbours tell.
    reach : (n,) float32
        How far each cell reaches.
    gaps : (n, 3) float32
        The direction out of the surface where it may end, else zero.
    at_gap : (n,) bool
        Where that is.
    near : (n, k) int32
        The USUAL nearest neighbours, each point itself first, or fewer if there are no more.
    """

    def __init__(self, cloud: Cloud, progress: Progress | None) -> None:
        n = len(cloud.positions)
        self._cloud, self._whole = cloud, n <= NEIGHBORS + 1
        self._level = np.full(n, FIRST, np.uint8)
        self.gaps, self.at_gap = np.zeros((n, 3), np.float32), np.zeros(n, np.bool_)
        self.near = np.empty((n, min(USUAL + 1, n)), np.int32)
        self.first = room_for(n)
        for start in range(0, n, PART):
            part = slice(start, min(start + PART, n))
            hood = Neighborhood(np.arange(part.start, part.stop, dtype=np.int32), cloud.tree.rows(NEIGHBORS + 1, part))
            found = self._settle(hood, self._whole)
            for name in Closed._fields:
                getattr(self.first, name)[part] = getattr(found, name)
            self.near[part] = hood.near[:, : self.near.shape[1]]
            self._look_for_gaps(hood, found)
            tell(progress, MEASURED * part.stop / n)
        self.reach = self.first.reach
        self._close(np.flatnonzero(self.first.state == OPEN).astype(np.int32))
        tell(progress, 1.0)

    def _look_for_gaps(self, hood: Neighborhood, found: Closed) -> None:
        """The surface may end at cells that are open or wide. The others, nearly all, need no search for gaps."""
        some = np.flatnonzero(found.gap)
        rows = hood.rows[some].astype(np.int64)
        self.gaps[rows] = out = find_gaps(self._cloud.positions, self._cloud.normals, rows, hood.near[some])
        self.at_gap[rows] = out.any(axis=1)

    def _close(self, rows: Rows) -> None:
        """Measure the cells that are open with more and more neighbours."""
        if self._whole:
            return
        for level in (AGAIN, THEN) if len(rows) < MANY * len(self.reach) else (THEN,):
            if len(rows):
                rows = self._settle_again(rows, level)
        rows = rows[self.at_gap[rows]]
        if len(rows):
            self._settle_again(rows, AHEAD)

    def _settle_again(self, rows: Rows, level: int) -> Rows:
        """Measure cells with more neighbours; returns those that are open still."""
        self._level[rows] = level
        left = [rows[:0]]
        for hood in self._hoods(rows, level):
            found = self._settle(hood, level >= THEN or hood.near.shape[1] == len(self._level))
            self.reach[hood.rows] = found.reach
            left.append(hood.rows[found.state == OPEN])
        return np.concatenate(left)

    def _hoods(self, rows: Rows, level: int) -> Iterator[Neighborhood]:
        """The neighbours of some rows, part by part."""
        for start in range(0, len(rows), PART):
            some = np.ascontiguousarray(rows[start : start + PART], np.int32)  # one signature of the kernels
            hood = Neighborhood(some, self._cloud.around(some, (NEIGHBORS, MORE, MOST, MOST)[level]))
            yield _looking_ahead(self._cloud, hood, self.gaps) if level == AHEAD else hood

    def _settle(self, hood: Neighborhood, last: bool) -> Closed:
        """What is found of cells with a hood; none is left unsure. last : no cell will have more neighbours."""
        found = measure_closed(self._cloud.table, hood)
        rows = np.flatnonzero(found.state != CLOSED if last else found.state == UNSURE)
        if len(rows):
            part = Neighborhood(hood.rows[rows], hood.near[rows])
            found.reach[rows], sure = measure_cells(self._cloud.positions, self._cloud.normals, part)
            found.state[rows] = np.where(sure, CLOSED, OPEN)
            eighth = distances(self._cloud.positions, part, min(USUAL, hood.near.shape[1] - 1))
            found.gap[rows] &= ~sure | (found.reach[rows] > WIDE * eighth)
        return found

    def measure(self, rows: Rows, usual: Floats, void: float) -> Rows:
        """Measure the cells of some rows again, see `measure_cells`; returns those where the surface goes on ahead."""
        ahead = [rows[:0]]
        sites = self._cloud.positions, self._cloud.normals
        for level in (FIRST, AGAIN, THEN, AHEAD):
            for hood in self._hoods(rows[self._level[rows] == level], level):
                self.reach[hood.rows], closed = measure_cells(*sites, hood, self.gaps, usual, void)
                ahead.append(hood.rows[closed])
        return np.concatenate(ahead)

    def narrow(self, limits: Limits, usual: CloudStatistics) -> None:
        """Let cells in disorder, and among points drawn otherwise, not reach across wide gaps, see `gaps`."""
        far = self.reach > limits.half
        if limits.others is None and usual.share("far cells", far) < SOME:  # so fewer of them are in disorder
            return
        wide = np.flatnonzero(far)
        sites = self._cloud.positions, self._cloud.normals
        reach, none = self.reach.copy(), np.zeros(len(self.reach), np.bool_)
        mixed, disordered = none, none.copy()
        for level in (FIRST, AGAIN, THEN, AHEAD):
            for hood in self._hoods(wide[self._level[wide] == level], level):
                rows = hood.rows
                least = np.float32(0.5) * distances(sites[0], Neighborhood(rows, self.near[rows]), 1)
                found = np.maximum(bridged(*sites, hood, limits.half[rows]), least)
                less = found < SAME * reach[rows]
                rows = rows[less]
                reach[rows] = found[less]
                mixed[rows] = limits.are_mixed(sites[0][rows], self.reach[rows])
                disordered[rows] = is_disordered(*sites, rows, self._cloud.around)
        share = usual.share("disordered", mixed | disordered)
        where = mixed if share < SOME else mixed | disordered if share < MUCH else None
        np.copyto(self.reach, reach, where=True if where is None else where)


def _looking_ahead(cloud: Cloud, hood: Neighborhood, gaps: Floats) -> Neighborhood:
    """The hoods with neighbours from across their gap and behind, however many dense points lie on this side."""
    here = cloud.positions[hood.rows]
    steps = 2 * distances(cloud.positions, hood, -1)[:, None] * gaps[hood.rows]
    beyond = (cloud.tree.rows_at(BEYOND, here + side * steps) for side in (1, -1))
    near = np.hstack([hood.near, *beyond])
    squares = sum((cloud.positions[near, c] - here[:, c, None]) ** 2 for c in range(3))
    order = np.argsort(squares, axis=1, kind="stable")
    return Neighborhood(hood.rows, np.take_along_axis(near, order, 1))
