"""Colours of files as 8 bits: files keep them as 8 bits, as 16 bits, as 8 bits in a wider type, or as floats."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

GREY = 128  # sRGB of points without a colour, beside points that have one
SHADES = 257  # 16-bit values to one of 8 bits
BLOCK = 1 << 15  # rows that are looked at together
STRAY = 1e-3  # share of the values, except zeros, that may be out of range: they are clipped
# The value of white, and the greatest and the least value that are taken for one of this range: in a type that makes
# float16 wider where they are compared.
RANGES = tuple(
    (white, np.float32(most), np.float32(least))
    for white, most, least in ((1, 2.0, -1 / 510), (255, 255.5, -0.5), (65535, 65535.5, -0.5))
)


class ColorRange:
    """What is known of the colours of a file, from which their range follows: 0 to 1, to 255 or to 65535.

    Attributes
    ----------
    rows : int
    missing : int
        Rows with NaN, which stands for no colour.
    low, high : float
    """

    def __init__(self) -> None:
        self.rows = self.missing = 0
        self.low, self.high = np.inf, -np.inf
        self._colored = 0  # values that are not 0
        self._above, self._below = [0] * len(RANGES), [0] * len(RANGES)  # values outside of each range
        self._uses_last_bits = False

    @classmethod
    def of(cls, columns: Sequence[NDArray[Any]]) -> ColorRange:
        """What is known of (n, 3) colours, the parts of one file."""
        known = cls()
        for column in columns:
            known.add(column)
        return known

    @property
    def is_empty(self) -> bool:
        """Whether all colours are zero, or all missing: programs write such columns for clouds without any."""
        return self.rows > 0 and (self._colored == 0 or self.missing == self.rows)

    def add(self, column: NDArray[Any]) -> None:
        """Take the values of (n, 3) colours into account."""
        if not len(column):
            return
        self.rows += len(column)
        self._colored += int(np.count_nonzero(column))
        if column.dtype == np.uint8:
            return
        if column.dtype.kind == "f":
            self.missing += int(np.isnan(column).any(axis=1).sum())
        self.low = min(self.low, float(np.fmin.reduce(column, axis=None)))
        self.high = max(self.high, float(np.fmax.reduce(column, axis=None)))
        for k, (_, most, least) in enumerate(RANGES):
            self._above[k] += int(np.count_nonzero(column > most))
            self._below[k] += int(np.count_nonzero(column < least))
        if not self._uses_last_bits:
            self._uses_last_bits = _uses_last_bits(column)

    def white(self, kind: np.dtype[Any]) -> int:
        """The value of white: 1, 255 or 65535. kind : dtype of the colours; ValueError if they are no colours"""
        return RANGES[self._range(kind)][0]

    def scale(self, kind: np.dtype[Any]) -> float:
        """What values of this dtype are multiplied by to become 8 bits; ValueError if they are no colours."""
        white = self.white(kind)
        if white < 65535:
            return 255 / white
        return 1 / SHADES if self._uses_last_bits else 1 / 256  # or 8 bits, moved up

    def note(self, kind: np.dtype[Any]) -> str:
        """What a user has to know of how colours of this dtype become 8 bits; empty, if nothing."""
        k = self._range(kind)
        outside = self._above[k] + self._below[k]
        notes = [f"{self.missing:,} points have no colour (NaN): they are grey"] * bool(self.missing)
        if outside and not self._are_bytes(kind):
            notes.append(f"{outside:,} of {3 * self.rows:,} colour values are not within 0 to {RANGES[k][0]}: clipped")
        return "; ".join(notes)

    def _range(self, kind: np.dtype[Any]) -> int:
        """Which of `RANGES` it is: the first with few values above."""
        if kind == np.uint8 or self.rows == 0 or self._are_bytes(kind):
            return 1
        most = STRAY * self._colored
        ranges = range(0 if kind.kind == "f" else 1, len(RANGES))
        k = next((k for k in ranges if self._above[k] <= most), None)
        if k is None or self._below[k] > most:
            whites = " or ".join(str(RANGES[k][0]) for k in ranges)
            raise ValueError(f"its colours reach from {self.low:g} to {self.high:g}, not from 0 to {whites}")
        return k

    def _are_bytes(self, kind: np.dtype[Any]) -> bool:
        """Whether they are bytes of a writer that knows no unsigned ones."""
        return kind == np.int8 and self.low < 0


def _uses_last_bits(column: NDArray[Any]) -> bool:
    """Whether any value is no multiple of 256; mostly the first rows have one."""
    blocks = (column[start : start + BLOCK] for start in range(0, len(column), BLOCK))
    return column.dtype.itemsize > 1 and any(
        (block[(block > 0) & (block <= RANGES[-1][1])] % 256).any() for block in blocks
    )


def to_shades(column: NDArray[Any], scale: float) -> NDArray[np.uint8]:
    """Colours as 8 bits; those of rows with NaN are grey. scale : see `ColorRange`"""
    if column.dtype.itemsize == 1:
        return column.view(np.uint8)
    values = column * np.float32(scale)
    if column.dtype.kind == "f":
        values[np.isnan(values).any(axis=1)] = GREY
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
