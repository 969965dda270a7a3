"""Preallocated arrays for files whose number of rows is known."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .formats._source import Chunk


class Filling:
    """Arrays for all rows of a file, filled chunk by chunk while the chunks are still in the processor's cache.

    Parameters
    ----------
    count : int
        Maximum number of rows. The operating system commits the memory as rows are written.
    """

    def __init__(self, count: int) -> None:
        self._count, self._done = count, 0
        self._whole: Chunk | None = None

    def add(self, chunk: Chunk) -> None:
        """Copy the rows of the next chunk into the arrays."""
        n = len(chunk.positions)
        if self._whole is None:
            self._whole = chunk if n == self._count else chunk.each(self._empty_rows)
        if self._whole is not chunk:
            self._put(chunk, slice(self._done, self._done + n))
        self._done += n

    @property
    def chunks(self) -> list[Chunk]:
        """All rows added so far as one chunk, in a list; an empty list before the first chunk."""
        if self._whole is None:
            return []
        return [self._whole if self._done == self._count else self._whole.select(slice(self._done))]

    def _empty_rows(self, column: NDArray[Any]) -> NDArray[Any]:
        """Return an uninitialized array for all rows of the file, with the dtype and width of one chunk's column."""
        return np.empty((self._count, *column.shape[1:]), column.dtype.newbyteorder("="))

    def _put(self, chunk: Chunk, rows: slice) -> None:
        assert self._whole is not None
        assert list(chunk.attributes) == list(self._whole.attributes)
        columns = iter(chunk.columns)

        def put(into: NDArray[Any]) -> NDArray[Any]:
            column = next(columns)
            into = into.astype(np.result_type(into, column), copy=False)  # in text, a later chunk may have fractions
            _copy(column, into[rows])
            return into

        self._whole = self._whole.each(put)


def _copy(column: NDArray[Any], into: NDArray[Any]) -> None:
    """Copy the rows of `column` to the array `into`.

    Rows contiguous in memory are copied as one item each, which takes half of the time.
    """
    if column.ndim == 2 and column.dtype == into.dtype and column.strides[1] == column.itemsize:
        piece = np.dtype((np.void, column.shape[1] * column.itemsize))
        into.view(piece)[:] = column.view(piece)
    else:
        into[:] = column
