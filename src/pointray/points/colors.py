"""Colours of files as 8 bits: files keep them as 8 bits, as 16 bits, as 8 bits in a wider type, or as floats."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

SHADES = 257  # 16-bit values to one of 8 bits
BLOCK = 1 << 15  # rows that are looked at together


def to_uint8(columns: Sequence[NDArray[Any]]) -> list[NDArray[np.uint8]]:
    """The (n, 3) colours of files or of parts of them as 8 bits, told from all values of the same dtype together.

    Raises
    ------
    ValueError
        If values are negative, beyond 65535, or floats beyond 255 or NaN.
    """
    kinds = [column.dtype.newbyteorder("=") for column in columns]
    shades = {kind: Shades() for kind in kinds}
    for column, kind in zip(columns, kinds, strict=True):
        if kind != np.uint8:
            shades[kind].add(column)
    scales = {kind: known.scale(kind) for kind, known in shades.items()}
    return [to_shades(column, scales[kind]) for column, kind in zip(columns, kinds, strict=True)]


class Shades:
    """What is known of the values of colours, which tells what they are multiplied by.

    Attributes
    ----------
    low, high : number or None
        The least one and the greatest one; None: there are no values yet.
    fine : bool
        Whether the last 8 bits of any whole number are used.
    """

    def __init__(self) -> None:
        self.low: Any = None
        self.high: Any = None
        self.fine = False

    def add(self, column: NDArray[Any]) -> None:
        """Take the values of (n, 3) colours into account."""
        if not column.size:
            return
        fine = not self.fine and column.dtype.kind in "iu" and _uses_last_bits(column)
        self._widen(column.min(), column.max(), fine)

    def join(self, other: Shades) -> None:
        """Take the values into account that another one knows."""
        if other.low is not None:
            self._widen(other.low, other.high, other.fine)

    def scale(self, kind: np.dtype[Any]) -> float:
        """What values of this dtype are multiplied by; ValueError if they are no colours."""
        if kind == np.uint8 or self.low is None:
            return 1.0
        low, high = kind.type(self.low), kind.type(self.high)
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
        return 1 / SHADES if self.fine else 1 / 256  # or 8 bits, moved up

    def _widen(self, low: Any, high: Any, fine: bool) -> None:
        self.low = low if self.low is None else np.minimum(self.low, low)  # NaN stays
        self.high = high if self.high is None else np.maximum(self.high, high)
        self.fine |= fine


def _uses_last_bits(column: NDArray[Any]) -> bool:
    """Whether any of some whole numbers is no multiple of 256; mostly the first rows tell."""
    blocks = (column[start : start + BLOCK] for start in range(0, len(column), BLOCK))
    if column.dtype.itemsize == 1:
        return any(block.any() for block in blocks)
    return any((block & 255).any() for block in blocks)


def to_shades(column: NDArray[Any], scale: float) -> NDArray[np.uint8]:
    """Colours as 8 bits. scale : see `Shades`"""
    if column.dtype == np.uint8:
        return column
    if scale == 1.0 and column.dtype.kind != "f":
        return column.astype(np.uint8)
    out = np.empty(column.shape, np.uint8)
    np.clip(np.rint(column * np.float32(scale)), 0, 255, out=out, casting="unsafe")
    return out
