"""Rows of a binary PLY element with lists. Each row begins where the previous one ends, so they are walked in order.

The loop is compiled: 5 million faces take 20 ms, compared with 9 s in Python.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....engine.jit import Array, i64, inline, kernel
from ._header import Element

UNSIGNED, SIGNED, FLOAT = range(3)
KINDS = {"u": UNSIGNED, "i": SIGNED, "f": FLOAT}
CUT_OFF, NO_LENGTH = -1, -2
# Columns of the table of properties: kind and bytes of a value or of a list's length; bytes of a list item, or 0.
KIND, SIZE, ITEM = range(3)


@inline
def _whole_of_float(bits: int, mantissa: int, bias: int) -> int:
    """Return the integer encoded by the bits of a float; -1 if it has a fraction, is negative or exceeds 2^53.

    mantissa : bits of the fraction, 23 or 52; bias : of the exponent, 127 or 1023
    """
    fraction, power = bits & ((1 << mantissa) - 1), (bits >> mantissa) & (2 * bias + 1)
    if power == 0 and fraction == 0:
        return 0
    shift = mantissa + bias - power  # number of fractional bits of the mantissa
    value = fraction | (1 << mantissa)
    negative = (bits >> mantissa) & (2 * bias + 2) != 0
    if negative or shift < 0 or shift > mantissa or value & ((1 << shift) - 1) != 0:
        return -1
    return value >> shift


@inline
def _length_at(data: Array, at: int, big: bool, kind: int, size: int) -> int:
    """Return the length of the list at a byte; negative if it is invalid.

    data : (bytes,) uint8; big : whether bytes are big-endian
    kind : type of the length: 0 unsigned, 1 signed integer, 2 float; size : its bytes
    """
    bits = 0
    for k in range(size):
        bits = (bits << 8) | i64(data[at + (k if big else size - 1 - k)])
    if kind == FLOAT:
        return _whole_of_float(bits, 23, 127) if size == 4 else _whole_of_float(bits, 52, 1023)
    if kind == SIGNED and bits >> (8 * size - 1) != 0:
        return -1
    return bits


@kernel
def _walk(data: Array, start: int, count: int, big: bool, properties: Array, offsets: Array) -> tuple[int, int]:
    """Find the numbers in the rows of an element, whose lists give the rows different sizes; store their offsets.

    Return (offset after the last row, count), or in case of an error (CUT_OFF or NO_LENGTH, number of the row).

    data : (bytes,) uint8, the file; start : offset of the first row
    count : number of rows; big : whether numbers are big-endian
    properties : (k, 3) int64, for each property, a number or a list, the type of the number or of the list's length
    (0 unsigned, 1 signed integer, 2 float), the bytes of that number or length, and the bytes of a list item (0 for a
    number)
    offsets : (count, numbers in a row) int64, receives the offset of each number; with 0 rows nothing is stored
    """
    at = start
    for row in range(count):
        scalar = 0
        for p in range(len(properties)):
            size, item = properties[p, SIZE], properties[p, ITEM]
            if size > len(data) - at:
                return CUT_OFF, row
            if item == 0:
                if len(offsets) > 0:
                    offsets[row, scalar] = at
                scalar += 1
                at += size
                continue
            length = _length_at(data, at, big, properties[p, KIND], size)
            at += size
            if length < 0:
                return NO_LENGTH, row
            if length > (len(data) - at) // item:
                return CUT_OFF, row
            at += length * item
    return at, count


def _table(element: Element) -> NDArray[np.int64]:
    """Return the properties as a table for the kernel, (k, 3) int64.

    A row has the type of a number or of a list's length (0 unsigned, 1 signed, 2 float), its bytes, and the bytes of a
    list's items, 0 for a number.
    """
    rows = []
    for p in element.properties:
        first, item = (p.type, 0) if p.length is None else (p.length, p.type.itemsize)
        rows.append((KINDS[first.kind], first.itemsize, item))
    return np.array(rows, np.int64).reshape(-1, 3)


def walk_rows(
    data: NDArray[np.uint8],
    start: int,
    count: int,
    element: Element,
    order: str,
    offsets: NDArray[np.int64],
    partial: bool = False,
) -> tuple[int, int]:
    """Find the numbers in the rows of an element whose lists give the rows different sizes.

    Parameters
    ----------
    data : (bytes,) uint8
        The file, read-only.
    start : int
        Offset of the first row.
    count : int
        Number of rows.
    element : Element
    order : {"<", ">"}
        Byte order.
    offsets : (count, scalars) or (0, scalars) int64
        Filled with the offset of each scalar value.
    partial : bool
        Whether the file may end before the rows do.

    Returns
    -------
    end : int
        Offset after the last row, if the rows are complete.
    rows : int
        Number of complete rows.

    Raises
    ------
    ValueError
        If a list length is invalid, or rows are missing and `partial` is False.
    """
    end, row = _walk(data, start, count, order == ">", _table(element), offsets)
    if end == NO_LENGTH:
        raise ValueError(f"is damaged: element {element.name!r}, row {row:,}: invalid list length")
    if end == CUT_OFF and not partial:
        raise ValueError(f"is cut off in the element {element.name!r}, row {row:,} of {count:,}")
    return int(end), int(row)


def scalars_at(data: NDArray[np.uint8], offsets: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the values of a dtype at (n,) offsets in (bytes,) uint8, which need not be aligned."""
    rows: NDArray[np.uint8] = data[offsets[:, None] + np.arange(dtype.itemsize)]
    return rows.view(dtype)[:, 0]
