"""A part with its margin: the points around it, as far as they decide what its surface is.

All are read as tiles, aligned stretches of the kd order, in that order. So the neighbours, samples and stretches of a
part's points are those of the whole.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.disk_columns import Column, Columns
from .arrange import TILE

GROUP = 64  # points whose extent tells how far the margin around them reaches
EDGE = 3  # points of a group, on each side of an axis, that do not count: strays
REACH = 3.0  # extents of a group: some 30 spacings
MOST, LEAST = 1.0, 64  # tiles of a margin at most, in tiles of the part: sparse points have dense ones around them
PAIRS = 1 << 22  # of tiles and groups that are looked at together

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]


class Local(NamedTuple):
    """The points of some tiles.

    rows : (n,) int64, ascending, their places in the kd order of all
    own : (m,) int64, which of them are the part's own; the others are its margin
    """

    rows: Rows
    own: Rows

    def read(self, column: Column) -> NDArray[Any]:
        """The rows of a column."""
        pieces = [column[run] for run in runs_of(self.rows)]
        return np.concatenate(pieces) if len(pieces) > 1 else pieces[0]

    @property
    def tiles(self) -> Rows:
        """The tiles, ascending."""
        return np.unique(self.rows // TILE)

    def write(self, column: Column, values: NDArray[Any]) -> None:
        """Write what is found of the part's own points, out of (n, ...) values."""
        start = 0
        for run in runs_of(self.rows[self.own]):
            column.write(run.start, values[self.own[start : start + run.stop - run.start]])
            start += run.stop - run.start


def local_of(columns: Columns, part: Rows, count: int) -> Local:
    """The points of a part and of the margin around it.

    Parameters
    ----------
    columns : Columns
        "tiles" has the boxes of all tiles, "points.positions" the positions.
    part : (t,) int64
        The part's tiles, ascending.
    count : int
        Points of the whole cloud.
    """
    boxes, positions = columns["tiles"][:], columns["points.positions"]
    here = np.concatenate([positions[run] for run in runs_of(_rows_of(part, count))])
    reach = REACH
    while True:
        margin = _margin(boxes, part, here, reach)
        if len(margin) <= max(MOST * len(part), LEAST) or reach < 1.0:
            break
        reach /= 2
    return points_of(np.union1d(part, margin), part, count)


def points_of(tiles: Rows, part: Rows, count: int) -> Local:
    """The points of some tiles, of which some are the part's own."""
    rows = _rows_of(tiles, count)
    return Local(rows, np.flatnonzero(np.isin(rows // TILE, part)))


def _rows_of(tiles: Rows, count: int) -> Rows:
    rows = (tiles[:, None] * TILE + np.arange(TILE)).ravel()
    return rows[rows < count]


def _margin(boxes: Floats, part: Rows, positions: Floats, reach: float) -> Rows:
    """The tiles around a part, and those before and behind each stretch of it, which the noise goes on to."""
    low, high = _widened(positions, reach)
    others = np.setdiff1d(np.arange(len(boxes)), part)
    near = (boxes[others, :3] <= high.max(axis=0)).all(axis=1) & (boxes[others, 3:] >= low.min(axis=0)).all(axis=1)
    some = others[near]
    beside = np.concatenate([part - 1, part + 1, [len(boxes) - 2]])
    found = np.union1d(some[touched(boxes[some], low, high)], np.setdiff1d(beside, part))
    return found[(found >= 0) & (found < len(boxes))]


def touched(boxes: Floats, low: Floats, high: Floats) -> NDArray[np.bool_]:
    """Which of some boxes (n, 6) meet any of others, given by their corners (m, 3)."""
    out = np.zeros(len(boxes), np.bool_)
    step = max(PAIRS // len(low), 1)
    for start in range(0, len(boxes), step):
        some = boxes[start : start + step, None]
        meets = np.ones((len(some), len(low)), np.bool_)
        for c in range(3):
            meets &= (some[..., c] <= high[:, c]) & (some[..., 3 + c] >= low[:, c])
        out[start : start + step] = meets.any(axis=1)
    return out


def _widened(positions: Floats, reach: float) -> tuple[Floats, Floats]:
    """The boxes of groups of points without their outermost ones, widened by so many of their diagonals."""
    whole = len(positions) // GROUP * GROUP
    groups = positions[:whole].reshape(-1, GROUP, 3) if whole else positions[None]
    edge = min(EDGE, (groups.shape[1] - 1) // 2)
    ordered = np.sort(groups, axis=1)
    low, high = ordered[:, edge], ordered[:, -1 - edge]
    wide = np.float32(reach) * np.linalg.norm(high - low, axis=1, keepdims=True)
    return low - wide, high + wide


def runs_of(rows: Rows) -> list[slice]:
    """Ascending rows as stretches."""
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    firsts, lasts = rows[np.append(0, breaks)], rows[np.append(breaks, len(rows)) - 1]
    return [slice(int(first), int(last) + 1) for first, last in zip(firsts, lasts, strict=True)]
