"""Raw columns: values on disk in the types of the files, until the common types are known."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.disk_columns import Column, Columns

RAW = "raw."  # prefix of the names of raw columns


class _Stretch(NamedTuple):
    """Range of rows of the cloud stored contiguously in a column. first : index of its first row in the column"""

    begin: int
    end: int
    column: Column
    first: int


class Raw:
    """One column of a cloud, possibly with missing rows. Rows of different dtypes are stored in separate columns.

    Parameters
    ----------
    columns : Columns
    number : int
        Unique number of this raw column within `columns`.
    """

    def __init__(self, columns: Columns, number: int) -> None:
        self._columns, self._number = columns, number
        self._stretches: list[_Stretch] = []
        self._of: dict[tuple[np.dtype[Any], int], Column] = {}

    def add(self, begin: int, rows: NDArray[Any]) -> None:
        """Append rows, (n,) or (n, k), which begin at row `begin` of the cloud."""
        if not len(rows):
            return
        kind = rows.dtype.newbyteorder("="), rows.shape[1] if rows.ndim > 1 else 0
        if kind not in self._of:
            self._of[kind] = self._columns.make(f"{RAW}{self._number}.{len(self._of)}", *kind)
        column = self._of[kind]
        first = len(column)
        column.append(rows)
        last = self._stretches[-1] if self._stretches else None
        if last is not None and last.column is column and last.end == begin:
            self._stretches[-1] = last._replace(end=begin + len(rows))
        else:
            self._stretches.append(_Stretch(begin, begin + len(rows), column, first))

    def read(self, begin: int, end: int, dtype: np.dtype[Any] | None = None, missing: float = 0) -> NDArray[Any]:
        """Return rows `begin` to `end` in `dtype`, by default the common type. missing : fill value of missing rows"""
        found = list(self._within(begin, end))
        if dtype is None:
            dtype = np.result_type(*(stretch.column.dtype for stretch in found))
        if len(found) == 1 and found[0].begin <= begin and end <= found[0].end:
            return _read(found[0], begin, end).astype(dtype, copy=False)
        out = np.full((end - begin, *self._shape), missing, dtype)
        for stretch in found:
            first, last = max(stretch.begin, begin), min(stretch.end, end)
            out[first - begin : last - begin] = _read(stretch, first, last)
        return out

    def sample(self, step: int) -> list[NDArray[Any]]:
        """Return every `step`-th row of the cloud, in pieces."""
        pieces = []
        for stretch in self._stretches:
            end = stretch.first + stretch.end - stretch.begin
            pieces.append(stretch.column[stretch.first + -stretch.begin % step : end : step])
        return pieces

    def whole(self, rows: int) -> Column | None:
        """Return the column if one column holds all rows of the cloud, else None."""
        one = self._stretches[0] if len(self._stretches) == 1 else None
        return one.column if one is not None and one.end - one.begin == rows else None

    def drop(self) -> None:
        """Delete the data on disk."""
        for column in self._of.values():
            self._columns.drop(column.name)
        self._of.clear()
        self._stretches.clear()

    @property
    def _shape(self) -> tuple[int, ...]:
        width = self._stretches[0].column.width
        return (width,) if width else ()

    def _within(self, begin: int, end: int) -> Iterator[_Stretch]:
        """Yield the ranges that overlap `begin` to `end`."""
        k = max(bisect_right(self._stretches, begin, key=lambda stretch: stretch.begin) - 1, 0)
        while k < len(self._stretches) and self._stretches[k].begin < end:
            if self._stretches[k].end > begin:
                yield self._stretches[k]
            k += 1


def _read(stretch: _Stretch, begin: int, end: int) -> NDArray[Any]:
    shift = stretch.first - stretch.begin
    return stretch.column[begin + shift : end + shift]
