"""Columns on disk with the types of the files, until the common types are known."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.disk_columns import Column, Columns

RAW = "raw."  # prefix of the names of raw columns


class _RowRange(NamedTuple):
    """Rows `begin` to `end` of the cloud, contiguous in a column. first : index of row `begin` in the column"""

    begin: int
    end: int
    column: Column
    first: int


class Raw:
    """One column of a cloud on disk, with the types of the files. Rows of files that lack the column are missing.

    Rows of different dtypes or widths are stored in separate columns.

    Parameters
    ----------
    columns : Columns
        Folder of the columns on disk.
    number : int
        Number of this column, unique within the folder: a part of the names of files.
    """

    def __init__(self, columns: Columns, number: int) -> None:
        self._columns, self._number = columns, number
        self._ranges: list[_RowRange] = []
        self._of: dict[tuple[np.dtype[Any], int], Column] = {}

    def add(self, begin: int, rows: NDArray[Any]) -> None:
        """Append rows, (n,) or (n, k). begin : row number in the cloud of the first of them"""
        if not len(rows):
            return
        kind = rows.dtype.newbyteorder("="), rows.shape[1] if rows.ndim > 1 else 0
        if kind not in self._of:
            self._of[kind] = self._columns.make(f"{RAW}{self._number}.{len(self._of)}", *kind)
        column = self._of[kind]
        first = len(column)
        column.append(rows)
        last = self._ranges[-1] if self._ranges else None
        if last is not None and last.column is column and last.end == begin:
            self._ranges[-1] = last._replace(end=begin + len(rows))
        else:
            self._ranges.append(_RowRange(begin, begin + len(rows), column, first))

    def read(self, begin: int, end: int, dtype: np.dtype[Any] | None = None, missing: float = 0) -> NDArray[Any]:
        """Return rows `begin` to `end` of the cloud in `dtype`, by default one that holds the values of all these rows.

        missing : value of rows that the column lacks
        """
        found = list(self._within(begin, end))
        if dtype is None:
            dtype = np.result_type(*(span.column.dtype for span in found))
        if len(found) == 1 and found[0].begin <= begin and end <= found[0].end:
            return _read(found[0], begin, end).astype(dtype, copy=False)
        out = np.full((end - begin, *self._shape), missing, dtype)
        for span in found:
            first, last = max(span.begin, begin), min(span.end, end)
            out[first - begin : last - begin] = _read(span, first, last)
        return out

    def sample(self, step: int) -> list[NDArray[Any]]:
        """Return every `step`-th row of the cloud, in pieces; missing rows are skipped."""
        pieces = []
        for span in self._ranges:
            end = span.first + span.end - span.begin
            pieces.append(span.column[span.first + -span.begin % step : end : step])
        return pieces

    def whole(self, rows: int) -> Column | None:
        """Return the column on disk that holds all rows of the cloud; None if several hold them or some are missing.

        rows : number of rows of the cloud
        """
        one = self._ranges[0] if len(self._ranges) == 1 else None
        return one.column if one is not None and one.end - one.begin == rows else None

    def drop(self) -> None:
        """Delete the data on disk."""
        for column in self._of.values():
            self._columns.drop(column.name)
        self._of.clear()
        self._ranges.clear()

    @property
    def _shape(self) -> tuple[int, ...]:
        width = self._ranges[0].column.width
        return (width,) if width else ()

    def _within(self, begin: int, end: int) -> Iterator[_RowRange]:
        """Yield the stored ranges that overlap rows `begin` to `end` of the cloud."""
        k = max(bisect_right(self._ranges, begin, key=lambda span: span.begin) - 1, 0)
        while k < len(self._ranges) and self._ranges[k].begin < end:
            if self._ranges[k].end > begin:
                yield self._ranges[k]
            k += 1


def _read(span: _RowRange, begin: int, end: int) -> NDArray[Any]:
    shift = span.first - span.begin
    return span.column[begin + shift : end + shift]
