"""Parallel gathering of array rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...engine.jit import Array, borrow, i64, kernel, next_tile, run
from ...engine.simd import prefetch

WORD = 4  # bytes copied at once
CHUNK = 1 << 14  # rows that a thread copies at a time
AHEAD = 16  # rows that are prefetched


@kernel
def _take(work: Array, words: Array, rows: Array, width: int, out: Array) -> None:
    """Copy some rows of an array to `out`, in parallel.

    work : gives each thread its next tile, 2^14 rows
    words, out : flat int32
    rows : numbers of the rows to copy
    width : int32 words of a row
    """
    words, rows, out = borrow(words), borrow(rows), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            if i + AHEAD < len(rows):
                prefetch(words, i64(rows[i + AHEAD]) * width)
            for c in range(width):
                out[i * width + c] = words[i64(rows[i]) * width + c]
        tile = next_tile(work)


def take(values: NDArray[Any], rows: NDArray[np.integer[Any]]) -> NDArray[Any]:
    """Return values[rows] for many row numbers, none of them negative, in parallel.

    24 M rows of three float32 in random order take 0.3 s on two cores; NumPy takes 1.7 s.
    """
    size = values.itemsize * values[:1].size
    if size % WORD or not values.flags.c_contiguous or len(values) == 0:
        return np.take(values, rows, axis=0)
    out = np.empty((len(rows), *values.shape[1:]), values.dtype)
    words = values.reshape(-1).view(np.int32)
    numbers = np.ascontiguousarray(rows, np.int32)
    run(_take, -(-len(rows) // CHUNK), words, numbers, size // WORD, out.reshape(-1).view(np.int32))
    return out
