"""Reordering of columns on disk: from file order to kd order, part by part."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
from ...base.disk_columns import Column, Columns
from ...base.progress import Progress, part_of, report_progress
from ...cloud.neighbors import kd_order
from ...cloud.neighbors.cuts import Cuts, find_cuts

CHUNK = 1 << 20  # rows scattered at once
TILE = 1 << 12  # points of the kd order that are read together: the unit of margins
CUT = 0.5  # progress after the cuts are found
SCATTERED, SORTED = "scattered.", "points."  # prefixes of columns


class Arrangement:
    """Reordering of a cloud's columns on disk from file order to kd order. Finished steps are not repeated.

    The steps are `cut_and_scatter`, `make_columns`, `sort` for each part, and `tidy`.

    Parameters
    ----------
    columns : Columns
        The columns of the cloud as read from its files.
    names : list of str
        Names of the columns, "positions" first.
    count : int
        Number of rows.
    size : int
        Points of a part, a power of two, at least `TILE` (4,096).
    """

    def __init__(self, columns: Columns, names: list[str], count: int, size: int) -> None:
        self._columns, self._names, self._count, self._size = columns, names, count, size
        self.parts = -(-count // size)

    def cut_and_scatter(self, progress: Progress | None = None) -> None:
        """Cut space into parts of equal numbers of points, and move all rows to new columns, part after part.

        Within a part the rows keep the order of the files. The old columns are removed.
        """
        columns = self._columns
        if columns.get("scattered") is None:
            self._cut_and_scatter(progress)
            columns.put("scattered", {"parts": self.parts})
        for name in self._names:
            columns.drop(name)

    def _cut_and_scatter(self, progress: Progress | None) -> None:
        columns = self._columns
        positions = columns["positions"]
        cuts = find_cuts(lambda: chunks_of(positions), self._count, self._size, part_of(progress, 0.0, CUT))
        there = {name: columns[name] for name in self._names}
        made = {
            name: columns.make(SCATTERED + name, column.dtype, column.width, self._count)
            for name, column in there.items()
        }
        free = np.arange(self.parts, dtype=np.int64) * self._size
        for start in range(0, self._count, CHUNK):
            rows = slice(start, min(start + CHUNK, self._count))
            self._scatter({name: column[rows] for name, column in there.items()}, start, cuts, made, free)
            report_progress(part_of(progress, CUT, 1.0), rows.stop / self._count)
        columns.sync()

    def _scatter(
        self, chunk: dict[str, NDArray[Any]], row: int, cuts: Cuts, made: dict[str, Column], free: Rows
    ) -> None:
        """Append consecutive rows of the old columns to the parts that they belong to, in the new columns.

        chunk : values of these rows by the name of the column; row : number of the first row
        cuts : planes that separate the parts
        made : the new columns by name; free : (parts,) int64, the next free row of each part, which is updated
        """
        part = cuts.parts_of(chunk["positions"], row)
        order = np.argsort(part, kind="stable")
        ends = np.bincount(part, minlength=self.parts).cumsum()
        for name, column in made.items():
            ordered = chunk[name][order]
            for k in np.flatnonzero(np.diff(ends, prepend=0)):
                column.write(int(free[k]), ordered[ends[k - 1] if k else 0 : ends[k]])
        free += np.diff(ends, prepend=0)

    def sort(self, part: int) -> None:
        """Write the rows of a part in kd order, and the bounding boxes of its ranges of 4,096 points."""
        columns = self._columns
        rows = slice(part * self._size, min((part + 1) * self._size, self._count))
        positions = columns[SCATTERED + "positions"][rows]
        order = kd_order(positions)
        for name in self._names:
            columns[SORTED + name].write(rows.start, columns[SCATTERED + name][rows][order])
        columns["tiles"].write(rows.start // TILE, boxes_of(positions[order]))

    def make_columns(self) -> None:
        """Create the columns in kd order and that of bounding boxes, which `sort` writes to, unless they exist."""
        columns = self._columns
        for name in self._names:
            if SORTED + name not in columns:
                column = columns[SCATTERED + name]
                columns.make(SORTED + name, column.dtype, column.width, self._count)
        if "tiles" not in columns:
            columns.make("tiles", np.float32, 6, -(-self._count // TILE))

    def tidy(self) -> None:
        """Remove the columns that are not in kd order, which are not needed after all parts are sorted."""
        for name in self._names:
            self._columns.drop(SCATTERED + name)


def boxes_of(positions: Floats) -> Floats:
    """Return the bounding boxes, (k, 6) as low x y z, high x y z, of consecutive ranges of `TILE` (4,096) positions."""
    first = np.arange(0, len(positions), TILE)
    low, high = np.minimum.reduceat(positions, first), np.maximum.reduceat(positions, first)
    return np.concatenate([low, high], axis=1)


def chunks_of(column: Column) -> Iterator[NDArray[Any]]:
    """Yield the rows of a column on disk in order, `CHUNK` (2^20) at a time."""
    for start in range(0, len(column), CHUNK):
        yield column[start : start + CHUNK]
