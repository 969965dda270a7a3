"""Distinct positions, found by a hash table."""

from __future__ import annotations

import math

import numpy as np

from ...base.arrays import Floats, Indices
from ...engine.jit import Array, borrow, f64, i64, inline, kernel
from ...engine.simd import float_bits, prefetch

ROOM = 2  # table entries per point, at least
AHEAD = 16  # points whose entries are prefetched: saves a tenth of the time, 10 M points


@inline
def _key(positions: Array, i: int, c: int, cell: float) -> float:
    value = f64(positions[i, c])
    return math.floor(value / cell) if cell > 0.0 else value


@inline
def _entry(positions: Array, i: int, cell: float, mask: int) -> int:
    """Return the entry of the hash table to probe first for positions[i]: the hash of its coordinates.

    cell : 0, or the size of a grid whose cells are hashed instead
    mask : size of the table minus 1
    """
    code = i64(0)
    for c in range(3):
        key = _key(positions, i, c, cell)
        code = (code ^ (float_bits(key) if key != 0.0 else 0)) * 0x1E3779B97F4A7C15  # -0 is 0
        code ^= code >> 32
    return (code ^ (code >> 17)) & mask


@inline
def _same(positions: Array, i: int, j: int, cell: float) -> bool:
    same = True
    for c in range(3):
        same = same and _key(positions, i, c, cell) == _key(positions, j, c, cell)
    return same


@kernel
def _number(positions: Array, cell: float, table: Array, rows: Array, ids: Array) -> int:
    """Number the distinct positions in the order of their first rows; return how many there are.

    cell : 0: exact comparison; otherwise positions in the same grid cell of this size count as equal
    table : hash table, int32, filled with -1; its length is a power of two
    rows : receives the first row of each distinct position; ids : (n,) receives the number of each row's position
    """
    positions, table, rows, ids = borrow(positions), borrow(table), borrow(rows), borrow(ids)
    n, mask, count = len(positions), len(table) - 1, 0
    entries = np.empty(AHEAD, np.int64)
    for i in range(min(AHEAD, n)):
        entries[i] = _entry(positions, i, cell, mask)
    for i in range(n):
        entry = entries[i % AHEAD]
        if i + AHEAD < n:
            entries[i % AHEAD] = _entry(positions, i + AHEAD, cell, mask)
            prefetch(table, entries[i % AHEAD])
        while table[entry] >= 0 and not _same(positions, i, i64(table[entry]), cell):
            entry = (entry + 1) & mask
        if table[entry] < 0:
            table[entry], rows[count] = i, i
            ids[i] = count
            count += 1
        else:
            ids[i] = ids[i64(table[entry])]
    return count


def distinct(positions: Floats, cell: float = 0.0) -> tuple[Indices, Indices]:
    """Find which positions are distinct, and to which of these each row belongs.

    Parameters
    ----------
    positions : (n, 3) float32
    cell : float
        0 compares positions exactly; otherwise positions in the same grid cell of this size count as one.

    Returns
    -------
    rows : (m,) int32
        First row of each distinct position, ascending.
    ids : (n,) int32
        Index into `rows`: positions[rows][ids] equals positions, to within a cell.
    """
    n = len(positions)
    table = np.full(1 << max(ROOM * n - 1, 1).bit_length(), -1, np.int32)
    rows, ids = np.empty(n, np.int32), np.empty(n, np.int32)
    count = _number(np.ascontiguousarray(positions, np.float32), float(cell), table, rows, ids)
    return rows[:count], ids
