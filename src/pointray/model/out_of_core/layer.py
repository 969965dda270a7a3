"""Level of detail of all parts: splats in columns, contiguous for each part, in the order of the parts.

Each splat belongs to one part, but may be close to splats of other parts: `near` finds these without reading all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats, Rows
from ...base.disk_columns import Column, Columns
from .arrange import CHUNK, TILE, boxes_of
from .local import touched
from .work import Work

Source = str | NDArray[Any]  # a column name, or an array

# Properties. Given positions and normals, at level 0, are those of the files.
POSITIONS, NORMALS, RADII, NOISE, COLORS = "positions", "normals", "radii", "noise", "colors"
LIMITS, BORDERS, SHEETS = "limits", "borders", "sheets"
GIVEN_POSITIONS, GIVEN_NORMALS = "given.positions", "given.normals"
ATTRIBUTE = "attribute."  # prefix, followed by the number of the attribute
BOXES = "boxes"  # column of the tiles' bounding boxes
FOUR = 4  # splats of a block, which share their noise


class Layer:
    """The splats of one level of detail of a model in parts, in columns on disk, part after part.

    Parameters
    ----------
    number : int
        Number of the level; 0 is the full model.
    columns : Columns
    capacity : (parts,) int64
        Rows reserved for each part in the columns.
    sizes : (parts,) int64
        Number of splats of each part, which are the first of its rows.
    sources : dict of str to str or array
        Column on disk (its name) or array of each property of the splats, such as "positions", "normals" and "radii".
    """

    def __init__(
        self, number: int, columns: Columns, capacity: Rows, sizes: Rows, sources: dict[str, Source] | None = None
    ) -> None:
        self.number, self.columns, self.capacity, self.sizes = number, columns, capacity, sizes
        self.sources: dict[str, Source] = sources or {}
        self._open: dict[str, Column] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickles: without open files, which each process opens when it needs them."""
        return {**self.__dict__, "_open": {}}

    @property
    def total(self) -> int:
        """Number of splats of all parts."""
        return int(self.sizes.sum())

    def own(self, part: int) -> slice:
        """Return the rows of a part's splats in the columns."""
        first = int(self.capacity[:part].sum())
        return slice(first, first + int(self.sizes[part]))

    def rows_of(self, numbers: slice) -> Rows:
        """Return the rows in the columns of a range of splats.

        After the splats of each part the columns may have unused rows.

        numbers : of the splats, part after part, counted without unused rows
        """
        ends = np.cumsum(self.sizes)
        places = np.arange(numbers.start, min(numbers.stop, int(ends[-1])))
        part = np.searchsorted(ends, places, side="right")
        return np.asarray(places - (ends - self.sizes)[part] + (np.cumsum(self.capacity) - self.capacity)[part])

    def __contains__(self, name: str) -> bool:
        return name in self.sources

    def column(self, name: str) -> Column | NDArray[Any]:
        """Return the column on disk, or the array, with a property of the splats of all parts.

        name : such as "positions"
        """
        source = self.sources[name]
        return self._opened(source) if isinstance(source, str) else source

    def _opened(self, name: str) -> Column:
        if name not in self._open:
            self._open[name] = self.columns[name]
        return self._open[name]

    def read(self, name: str, rows: slice | Rows) -> NDArray[Any]:
        """Return some rows of a property of the splats, such as "positions".

        At level 0 the noise of each splat is the largest of its block of four, as a tree stores it.
        """
        column = self.column(name)
        if name != NOISE or self.number:
            return np.asarray(column[rows])
        numbers = np.arange(rows.start, rows.stop) if isinstance(rows, slice) else rows
        block = numbers // FOUR * FOUR
        return np.max([column[np.minimum(block + k, len(column) - 1)] for k in range(FOUR)], axis=0)

    def find(self, name: str, rows: slice | Rows) -> NDArray[Any] | None:
        """Return some rows of a property of the splats, such as "colors"; None if the splats do not have it."""
        return self.read(name, rows) if name in self else None

    def chunks(self, name: str) -> Iterator[NDArray[Any]]:
        """Yield the values of a property of all splats, part by part, at most 2^20 at a time."""
        column = self.column(name)
        for part in range(len(self.sizes)):
            own = self.own(part)
            for start in range(own.start, own.stop, CHUNK):
                yield np.asarray(column[start : min(start + CHUNK, own.stop)])

    def make(self, name: str, dtype: Any, width: int = 0) -> None:
        """Create a column on disk for a property of the splats, unless it exists.

        width : numbers in a row, 0 for one axis
        """
        self._make(name, dtype, width, int(self.capacity.sum()))
        self.sources[name] = self._name(name)

    def make_boxes(self) -> None:
        """Create the column of bounding boxes that `write_boxes` writes to, unless it exists."""
        self._make(BOXES, np.float32, 6, int(_tiles(self.capacity).sum()))

    def _make(self, name: str, dtype: Any, width: int, rows: int) -> None:
        if self._name(name) not in self.columns:
            self.columns.make(self._name(name), dtype, width, rows)

    def _name(self, name: str) -> str:
        return f"level.{self.number}.{name}"

    def write(self, name: str, part: int, values: NDArray[Any]) -> None:
        """Write a property of the splats of a part to its column on disk. values : (n,) or (n, width)"""
        self._opened(self._name(name)).write(self.own(part).start, values)

    def drop(self) -> None:
        """Remove all columns of this level from the disk."""
        self._open.clear()  # disk space of open files is not freed
        for name in self.columns.names:
            if name.startswith(self._name("")):
                self.columns.drop(name)

    def write_all(self, part: int, named: Mapping[str, NDArray[Any] | None]) -> dict[str, Any]:
        """Write the properties of the splats of a part, and bounding boxes for `near`.

        named : values by the name of the property, positions among them; None: not written

        Returns
        -------
        dict
            size : number of splats; low, high : corners of their bounding box, missing for a part without splats.
        """
        for name, values in named.items():
            if values is not None:
                self.write(name, part, values)
        positions = named[POSITIONS]
        assert positions is not None
        self.write_boxes(part, positions)
        return {"size": len(positions), **corners(positions)}

    def write_boxes(self, part: int, positions: Floats) -> None:
        """Write the bounding boxes of each 4,096 consecutive splats of a part, by which `near` finds splats."""
        if len(positions):
            first = int(_tiles(self.capacity[:part]).sum())
            self._opened(self._name(BOXES)).write(first, boxes_of(positions))

    def near(self, part: int | None, boxes: Floats, wide: Floats | None, keep: Callable[[slice], Flags]) -> Rows:
        """Return the rows, ascending, of the splats that `keep` selects, testing only those near some boxes.

        A tile is here a range of 4,096 consecutive splats of a part, whose bounding box is known. Splats of tiles that
        do not overlap any of the boxes are not read.

        Parameters
        ----------
        part : int, optional
            Part whose splats are left out, such as the one that the boxes surround.
        boxes : (m, 6) float32
            Boxes, low x y z, high x y z.
        wide : (parts,) float32, optional
            Distance by which the tiles of each part are enlarged on all sides before the test for overlap.
        keep : callable
            Called with ranges of rows in tiles that overlap; returns a mask of the rows to return.
        """
        found = [np.zeros(0, np.int64)]
        for rows in self._touched(part, boxes, wide):
            for start in range(rows.start, rows.stop, CHUNK):
                some = slice(start, min(start + CHUNK, rows.stop))
                found.append(some.start + np.flatnonzero(keep(some)))
        return np.concatenate(found)

    def boxes(self, part: int) -> Floats:
        """Return the bounding boxes of each 4,096 consecutive splats of a part, (n, 6)."""
        first = int(_tiles(self.capacity[:part]).sum())
        return np.asarray(self._opened(self._name(BOXES))[first : first + int(_tiles(self.sizes[part]))])

    def _touched(self, part: int | None, boxes: Floats, wide: Floats | None) -> Iterator[slice]:
        """Yield the rows of all tiles (ranges of 4,096 splats of a part) that overlap some boxes, in long ranges.

        part : whose rows are skipped, or None; boxes : (m, 6); wide : (parts,) enlargement of the tiles, or None
        """
        counts = _tiles(self.sizes)
        owner = np.repeat(np.arange(len(counts)), counts)
        number = np.arange(len(owner)) - (np.cumsum(counts) - counts)[owner]  # number of each tile within its part
        firsts, ends = np.cumsum(self.capacity) - self.capacity, np.cumsum(self.capacity) - self.capacity + self.sizes
        tiles = self._opened(self._name(BOXES))[:][
            (np.cumsum(_tiles(self.capacity)) - _tiles(self.capacity))[owner] + number
        ]
        if wide is not None:
            tiles = tiles + wide[owner, None] * np.array([-1, -1, -1, 1, 1, 1], np.float32)
        low, high = boxes[:, :3], boxes[:, 3:]
        others = np.ones(len(owner), np.bool_) if part is None else owner != part
        near = np.flatnonzero(touched(tiles, low.min(axis=0)[None], high.max(axis=0)[None]) & others)
        near = near[touched(tiles[near], low, high)]
        ends_here = (np.diff(near) > 1) | (np.diff(owner[near]) > 0)
        for run in np.split(near, np.flatnonzero(ends_here) + 1):
            if len(run):
                place = firsts[owner[run[0]]] + number[run] * TILE
                yield slice(int(place[0]), int(min(place[-1] + TILE, ends[owner[run[0]]])))


def finest_layer(work: Work, sources: Mapping[str, Source | None]) -> Layer:
    """Return the splats of a full model in parts, level 0, from columns on disk or arrays.

    sources : column name or array of each property of the splats; None and missing columns are left out
    """
    names = work.columns.names
    known = {
        name: source
        for name, source in sources.items()
        if source is not None and (not isinstance(source, str) or source in names)
    }
    sizes = np.array([rows.stop - rows.start for rows in map(work.part_rows, range(work.parts))], np.int64)
    return Layer(0, work.columns, sizes, sizes, known)


def corners(positions: Floats) -> dict[str, Any]:
    """Return the corners of the bounding box of positions, low and high, as lists of 3; empty without positions."""
    if not len(positions):
        return {}
    return {"low": positions.min(axis=0).astype(float).tolist(), "high": positions.max(axis=0).astype(float).tolist()}


def _tiles(rows: Any) -> Any:
    """Return the number of tiles (4,096 consecutive splats) that hold `rows` splats; also for arrays of numbers."""
    return -(-rows // TILE)
