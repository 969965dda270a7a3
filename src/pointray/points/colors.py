"""Colours of files as 8 bits: files keep them as 8 bits, as 16 bits, as 8 bits in a wider type, or as floats."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

SHADES = 257  # 16-bit values to one of 8 bits


def to_uint8(columns: Sequence[NDArray[Any]]) -> list[NDArray[np.uint8]]:
    """The (n, 3) colours of files or of parts of them as 8 bits, told from all values of the same dtype together.

    Raises
    ------
    ValueError
        If values are negative, beyond 65535, or floats beyond 255 or NaN.
    """
    known = {dtype: _scale_of([c for c in columns if c.dtype == dtype]) for dtype in {c.dtype for c in columns}}
    return [_scaled(column, known[column.dtype]) for column in columns]


def _scale_of(columns: list[NDArray[Any]]) -> float:
    """What values are multiplied by."""
    kind = columns[0].dtype
    columns = [column for column in columns if column.size]
    if kind == np.uint8 or not columns:
        return 1.0
    low, high = min(c.min() for c in columns), max(c.max() for c in columns)
    if kind == np.int8 and low < 0:  # bytes of a writer that knows no unsigned ones
        return 1.0
    if kind.kind == "f":
        if not (low >= 0 and high <= 255):  # NaN too
            raise ValueError(f"its colours reach from {low} to {high}, not 0 to 1 or 255")
        return 1.0 if 2 < high <= 255 else 255.0
    if low < 0 or high > 65535:
        raise ValueError(f"its colours reach from {low} to {high}, not 0 to 255 or 65535")
    if high <= 255:
        return 1.0
    if all(not (column & 255).any() for column in columns):  # 8 bits, moved up
        return 1 / 256
    return 1 / SHADES


def _scaled(column: NDArray[Any], scale: float) -> NDArray[np.uint8]:
    if column.dtype == np.uint8:
        return column
    if scale == 1.0 and column.dtype.kind != "f":
        return column.astype(np.uint8)
    out = np.empty(column.shape, np.uint8)
    np.clip(np.rint(column * np.float32(scale)), 0, 255, out=out, casting="unsafe")
    return out
