"""Local surface fits: one robust fit for each group of four points that are consecutive in kd order.

A fit for each point would take four times as long, and so would a search for 48 neighbours of each. The few points off
the surface of their group are examined one by one afterwards.
"""

from __future__ import annotations

import math

import numpy as np

from ...base.arrays import Flags, Floats, Rows
from ...base.progress import Progress, report_progress
from ...engine.jit import Array, borrow, f64, inline, kernel, next_tile, run
from ...engine.kernels.vec import tangents
from ..neighbors import NeighborTree
from .fits import fit, new_memory, nth

AROUND = 48  # neighbours of a fit, itself included: a layer with a tenth of the points is found up to 5 spacings away
KEPT = 16  # neighbours that are stored: noise is averaged over them
CORE = 8  # neighbour whose distance defines the local density
GROUP = 4  # points that share a fit
CANDIDATES = 64  # neighbours of the middle point, which include those of the whole group
CHUNK = 256  # groups of a tile
ROWS = 1 << 15  # groups of a table at a time


@inline
def _keep(
    positions: Array, row: int, near: Array, reach: Array, i: int, aside: float, kept: Array, away: Array
) -> float:
    """Write the neighbours of a point to kept[row], nearest first; return the distance of the farthest of them.

    The neighbours are searched among candidates that all points of a group share: those nearest to its middle point.

    row : row of the point; i : number of its group
    near : (m, k) rows of the candidates of each group, nearest to the middle point first
    reach : (m, k) distances of the candidates from the middle point
    aside : distance of the point from the middle point
    kept : (n, c) receives the c neighbours
    away : memory for c squared distances
    """
    most = kept.shape[1]
    for j in range(near.shape[1]):
        if j >= most and reach[i, j] - aside > 0.0 and (reach[i, j] - aside) ** 2 > away[most - 1]:
            break  # the rest is farther still
        other, square = near[i, j], 0.0
        for c in range(3):
            step = f64(positions[other, c]) - f64(positions[row, c])
            square += step * step
        slot = min(j, most)
        if slot == most:
            if square >= away[most - 1]:
                continue
            slot = most - 1
        while slot > 0 and away[slot - 1] > square:
            away[slot], kept[row, slot] = away[slot - 1], kept[row, slot - 1]
            slot -= 1
        away[slot], kept[row, slot] = square, other
    return math.sqrt(away[most - 1])


@kernel
def _survey(
    work: Array, positions: Array, members: Array, near: Array, reach: Array, about: Array, kept: Array, is_done: Array
) -> None:
    """Fit a surface to each group of points; write the points' heights above it, and their nearest neighbours.

    work : gives each thread its next tile, 256 groups
    members : (m, g) rows of each group, the middle one first
    near : (m, k) nearest neighbours of the middle one of each group
    reach : (m, k) distances of these neighbours from the middle one
    about : (n, 4) receives each point's height above the surface, the noise and the point spacing of the surface, and
        the distance to the point's eighth neighbour
    kept : (n, c) receives the nearest neighbours of each point
    is_done : (n,) receives 1 for rows that are done, 0 for those too far from the middle
    """
    positions, near, about, kept = borrow(positions), borrow(near), borrow(about), borrow(kept)
    k, whole = min(AROUND, near.shape[1]), near.shape[1] == len(positions)
    memory, away = new_memory(k), np.empty(kept.shape[1])
    x = memory[6]
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(members))):
            middle = members[i, 0]
            n, noise, far = fit(positions, middle, near, i, k, False, memory)
            one, two = tangents(n)
            spacing = far * math.sqrt(math.pi / k * max(1.0 - x[0] * x[0], 0.01))
            for row in members[i]:
                p = q = height = aside = 0.0
                for c in range(3):
                    step = (f64(positions[row, c]) - f64(positions[middle, c])) / far
                    p, q, height = p + step * one[c], q + step * two[c], height + step * n[c]
                    aside += step * step
                height -= x[0] + x[1] * p + x[2] * q + x[3] * p * p + x[4] * p * q + x[5] * q * q
                aside = math.sqrt(aside) * far
                last = _keep(positions, row, near, reach, i, aside, kept, away)
                is_done[row] = whole or last + aside <= reach[i, near.shape[1] - 1]
                about[row, 0], about[row, 1], about[row, 2] = abs(height) * far, noise * far, spacing
                about[row, 3] = math.sqrt(away[min(CORE, len(away) - 1)])
        tile = next_tile(work)


@kernel
def _share(work: Array, rows: Array, about: Array, near: Array, out: Array) -> None:
    """Write the noise at each row: the median of noise over spacing of its neighbours, times the row's own spacing.

    work : gives each thread its next tile, 256 rows
    rows : (m,)
    about : (n, 4) noise and spacing in the second and the third column; neighbours with NaN are skipped
    near : (n, k) rows of neighbours
    out : (m,) NaN if there is none
    """
    about, near, out, k = borrow(about), borrow(near), borrow(out), near.shape[1]
    values, scratch = np.empty(k), np.empty(k)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            count = 0
            for j in near[rows[i]]:
                value = about[j, 1] / about[j, 2]
                if value >= 0.0:
                    values[count] = value
                    count += 1
            out[i] = nth(values, count, count // 2, scratch) * about[rows[i], 2] if count > 0 else math.nan
        tile = next_tile(work)


class LocalSurfaceFits:
    """Surfaces fitted robustly to groups of four points, consecutive in kd order; NaN where none was fitted.

    Attributes
    ----------
    tree : NeighborTree
        Of all positions.
    height, noise, spacing : (n,) float32
        Distance of each position from the fitted surface, and the surface's noise and point spacing.
    core : (n,) float32
        Distance to its eighth neighbour.
    near : (n, k) int32
        Its nearest neighbours, itself first.
    known : (m,) bool
        Which groups are fitted: group g holds the four rows from 4 g on.
    """

    def __init__(self, positions: Floats) -> None:
        n = len(positions)
        self._positions, self.tree = positions, NeighborTree(positions, in_order=True)
        self._about = np.full((n, 4), np.nan, np.float32)
        self.height, self.noise, self.spacing, self.core = self._about.T
        self.near = np.zeros((n, min(KEPT, n)), np.int32)
        self.known = np.zeros(-(-n // GROUP), np.bool_)

    def examine(self, groups: Rows, progress: Progress | None = None) -> None:
        """Fit surfaces to some groups of four points, unless they are fitted already.

        groups : (g,) numbers of groups; group g holds the four rows from 4 g on
        """
        groups = groups[~self.known[groups]]
        self.known[groups] = True
        for start in range(0, len(groups), ROWS):
            rows = GROUP * groups[start : start + ROWS, None] + np.arange(GROUP)
            rows = np.minimum(rows, len(self._positions) - 1)
            is_done = self._fit(_middle_first(self._positions, rows))
            left = _pairs(rows, ~is_done[rows])  # those far from the middle of their group need neighbours of their own
            if len(left):
                is_done |= self._fit(left)
                left = np.unique(left[~is_done[left]])
            if len(left):
                self._fit(left.reshape(-1, 1))
            report_progress(progress, min((start + ROWS) / len(groups), 1.0))

    def shared(self, rows: Rows) -> Floats:
        """Return the noise at some rows, (m,): the median of noise / spacing of their neighbours, times their spacing.

        Noise is the standard deviation of points from their surface; that of a single fit may be off by a tenth.
        """
        out = np.empty(len(rows), np.float32)
        run(_share, -(-len(rows) // CHUNK), rows, self._about, self.near, out)
        return out

    def _fit(self, members: Rows) -> Flags:
        """Fit a surface to each group of rows; return which rows are done, (n,) bool.

        Those far from their group's middle are not: they need neighbours of their own.

        members : (m, g) rows of each group, the middle one first
        """
        is_done = np.zeros(len(self._positions), np.bool_)
        reach, near = self.tree.query(CANDIDATES, self._positions[members[:, 0]])
        run(_survey, -(-len(members) // CHUNK), self._positions, members, near, reach, self._about, self.near, is_done)
        return is_done


def _pairs(groups: Rows, chosen: Flags) -> Rows:
    """Return the chosen rows of each group in pairs, (p, 2); an odd one is paired with itself.

    groups, chosen : (m, 4) rows of each group, and which of them are chosen
    """
    order = np.argsort(~chosen, axis=1, kind="stable")
    rows, chosen = np.take_along_axis(groups, order, axis=1), np.take_along_axis(chosen, order, axis=1)
    pairs, both = rows.reshape(-1, 2), chosen.reshape(-1, 2)
    return np.where(both[:, 1:], pairs, pairs[:, :1])[both[:, 0]]


def _middle_first(positions: Floats, rows: Rows) -> Rows:
    """Return groups of rows, (m, g), with the row nearest to the mean position of its group first.

    positions, rows : (n, 3), and (m, g)
    """
    places = positions[rows]
    away = ((places - places.mean(axis=1, keepdims=True)) ** 2).sum(axis=2)
    return np.take_along_axis(rows, away.argsort(axis=1), axis=1)
