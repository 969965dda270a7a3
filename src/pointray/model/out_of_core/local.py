"""Part of a cloud with its margin: the surrounding points that its surface depends on.

Points are read as tiles, aligned ranges of the kd order, in that order. The neighbours, samples and ranges of a part's
points are thus those of the whole cloud.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats, Rows
from ...base.disk_columns import Column, Columns
from .arrange import TILE

GROUP = 64  # points whose extent defines the width of the margin around them
EDGE = 3  # points of a group at each end of an axis that are skipped as outliers
REACH = 3.0  # width of the margin in extents of a group: about 30 spacings
MOST, LEAST = 1.0, 64  # largest margin, in tiles of the part; in tiles: sparse points may have dense ones around them
PAIRS = 1 << 22  # pairs of tiles and groups tested at once


class Local(NamedTuple):
    """Rows of the points of a part and of its margin: the surrounding points that its surface depends on.

    rows : (n,) int64, ascending, their places in the kd order of the cloud
    own : (m,) int64, indices into `rows` of the part's own points; the others are its margin
    """

    rows: Rows
    own: Rows

    def read(self, column: Column) -> NDArray[Any]:
        """Return the values of the points of a part and its margin, (n, ...), from a column of the whole cloud."""
        pieces = [column[run] for run in runs_of(self.rows)]
        return np.concatenate(pieces) if len(pieces) > 1 else pieces[0]

    @property
    def tiles(self) -> Rows:
        """Numbers of the ranges of 4,096 consecutive points in kd order that hold a part and its margin, ascending."""
        return np.unique(self.rows // TILE)

    @property
    def core(self) -> slice:
        """Indices of the part's own points among those of the part and its margin; they must be consecutive."""
        return slice(int(self.own[0]), int(self.own[-1]) + 1)

    def write_all(self, columns: Columns, named: Mapping[str, NDArray[Any] | None]) -> None:
        """Write values of the part's own points to columns on disk.

        named : values of the points of the part and its margin, (n, ...), by the name of the column; None: not written
        """
        for name, values in named.items():
            if values is not None:
                self.write(columns[name], values)

    def write(self, column: Column, values: NDArray[Any]) -> None:
        """Write values of the part's own points to a column on disk.

        values : (n, ...), of the points of the part and its margin
        """
        start = 0
        for run in runs_of(self.rows[self.own]):
            column.write(run.start, values[self.own[start : start + run.stop - run.start]])
            start += run.stop - run.start


def local_of(columns: Columns, part: Rows, count: int) -> Local:
    """Return the points of a part and of its margin: the surrounding points that its surface depends on.

    A tile is here a range of 4,096 consecutive points in kd order, the unit in which points are read.

    Parameters
    ----------
    columns : Columns
        "tiles" holds the bounding boxes of all tiles, "points.positions" the positions.
    part : (t,) int64
        Tiles of the part, ascending.
    count : int
        Number of points of the cloud.
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
    """Return the rows of a part's points and of those around it, from the numbers of the tiles that contain them.

    A tile is here a range of 4,096 consecutive points in kd order.

    tiles : (k,) int64, all tiles, ascending; part : those of the part itself; count : number of points of the cloud
    """
    rows = _rows_of(tiles, count)
    return Local(rows, np.flatnonzero(np.isin(rows // TILE, part)))


def _rows_of(tiles: Rows, count: int) -> Rows:
    rows = (tiles[:, None] * TILE + np.arange(TILE)).ravel()
    return rows[rows < count]


def _margin(boxes: Floats, part: Rows, positions: Floats, reach: float) -> Rows:
    """Return the numbers of the tiles (ranges of 4,096 points in kd order) that form the margin around a part.

    These are the tiles close to the part's points, and the tiles before and after the part's own in kd order, along
    which noise is interpolated. The part's own tiles are not returned.

    boxes : (tiles, 6), bounding boxes of all tiles; part : numbers of the part's tiles
    positions : of the part's points
    reach : width of the margin around each 64 consecutive points, in diagonals of their bounding box
    """
    low, high = _widened(positions, reach)
    others = np.setdiff1d(np.arange(len(boxes)), part)
    near = (boxes[others, :3] <= high.max(axis=0)).all(axis=1) & (boxes[others, 3:] >= low.min(axis=0)).all(axis=1)
    some = others[near]
    beside = np.concatenate([part - 1, part + 1, [len(boxes) - 2]])
    found = np.union1d(some[touched(boxes[some], low, high)], np.setdiff1d(beside, part))
    return found[(found >= 0) & (found < len(boxes))]


def touched(boxes: Floats, low: Floats, high: Floats) -> Flags:
    """Return which boxes, (n, 6), low x y z and high x y z, overlap any of those given by corners, (m, 3) each."""
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
    """Return enlarged boxes around each 64 consecutive positions, as low and high corners, (k, 3) each.

    The outermost 3 points at each end of each axis are skipped.

    reach : distance by which a box is enlarged on each side, in diagonals of the box
    """
    whole = len(positions) // GROUP * GROUP
    groups = positions[:whole].reshape(-1, GROUP, 3) if whole else positions[None]
    edge = min(EDGE, (groups.shape[1] - 1) // 2)
    ordered = np.sort(groups, axis=1)
    low, high = ordered[:, edge], ordered[:, -1 - edge]
    wide = np.float32(reach) * np.linalg.norm(high - low, axis=1, keepdims=True)
    return low - wide, high + wide


def runs_of(rows: Rows) -> list[slice]:
    """Return ascending row numbers as slices of consecutive ones. rows : at least one"""
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    firsts, lasts = rows[np.append(0, breaks)], rows[np.append(breaks, len(rows)) - 1]
    return [slice(int(first), int(last) + 1) for first, last in zip(firsts, lasts, strict=True)]
