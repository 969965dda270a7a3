"""Binary min-heap in two arrays: keys and rows."""

from __future__ import annotations

from ...engine.jit import Array, routine


@routine
def push(keys: Array, rows: Array, size: int, key: float, row: int) -> int:
    """Push `row` with its key onto a binary min-heap; return the new size. keys, rows : the heap, `size` long"""
    i = size
    while i > 0:
        up = (i - 1) >> 1
        if keys[up] <= key:
            break
        keys[i], rows[i] = keys[up], rows[up]
        i = up
    keys[i], rows[i] = key, row
    return size + 1


@routine
def pop(keys: Array, rows: Array, size: int) -> int:
    """Remove the row with the least key, rows[0], from a binary min-heap; return the new size.

    keys, rows : the heap, `size` long. The caller has read its first row before.
    """
    size -= 1
    key, row = keys[size], rows[size]
    i = 0
    while True:
        down = 2 * i + 1
        if down >= size:
            break
        if down + 1 < size and keys[down + 1] < keys[down]:
            down += 1
        if keys[down] >= key:
            break
        keys[i], rows[i] = keys[down], rows[down]
        i = down
    keys[i], rows[i] = key, row
    return size
