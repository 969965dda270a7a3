"""Addition of an offset to all rows of an array of positions, on all cores."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles
from ..engine.jit import thread_count

BLOCK = 1 << 15  # rows added at a time: they stay in the processor's cache
PARALLEL = 1 << 20  # rows from which several threads are used


def shift_rows(rows: NDArray[Any], offset: Doubles, out: NDArray[Any]) -> None:
    """Write `rows` + `offset` to `out`, computed in float64.

    Whole blocks are added to a block of offsets, as broadcasting over rows of three takes three times as long. Threads
    share the rows: NumPy releases the interpreter's lock.

    rows, out : (n, 3), `out` C-contiguous; offset : (3,)
    """
    offsets = np.tile(offset, (min(BLOCK, len(rows)), 1))

    def work(begin: int, end: int) -> None:
        with np.errstate(over="ignore", invalid="ignore"):  # signalling NaNs; overflow to infinity
            for start in range(begin, end, BLOCK):
                part = slice(start, min(start + BLOCK, end))
                flat = offsets[: part.stop - start].reshape(-1)
                np.add(rows[part].reshape(-1), flat, out=out[part].reshape(-1), dtype=np.float64, casting="unsafe")

    n = len(rows)
    threads = 1 if n < PARALLEL else thread_count(None)
    if threads == 1:
        work(0, n)
        return
    ends = np.linspace(0, n, threads + 1).astype(int).tolist()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, ends[:-1], ends[1:]))
