"""Conversion of the colours of files to 8 bits. Files store 8 bits, 16 bits, 8 bits in a wider type, or floats."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

GREY = 128  # sRGB of points without a colour in a cloud with colours
SHADES = 257  # 16-bit value per step of an 8-bit value
BLOCK = 1 << 14  # rows per block: they stay in the processor's cache
STRAY = 1e-3  # fraction of the nonzero values that may be out of range; these are clipped
# White, and the largest and the smallest value accepted in this range. float32 limits promote float16 in comparisons.
RANGES = tuple(
    (white, np.float32(most), np.float32(least))
    for white, most, least in ((1, 2.0, -1 / 510), (255, 255.5, -0.5), (65535, 65535.5, -0.5))
)


class ColorRange:
    """Statistics of the colours of a file, from which their range is derived: 0 to 1, to 255 or to 65535.

    Attributes
    ----------
    rows : int
        Number of rows.
    missing : int
        Number of rows with NaN, which means no colour.
    low, high : float
        Minimum and maximum of all values except NaN; inf and -inf for colours in uint8, which need none.
    """

    def __init__(self) -> None:
        self.rows = self.missing = 0
        self.low, self.high = np.inf, -np.inf
        self._colored = 0  # nonzero values
        self._above, self._below = [0] * len(RANGES), [0] * len(RANGES)  # values outside each range
        self._uses_last_bits = False

    @classmethod
    def of(cls, columns: Sequence[NDArray[Any]]) -> ColorRange:
        """Return the statistics of the colours of a file. columns : all its rows in order, as (m, 3) arrays"""
        known = cls()
        for column in columns:
            known.add(column)
        return known

    @property
    def is_empty(self) -> bool:
        """Whether all colours are zero, or all are missing: some programs write such columns for uncoloured clouds."""
        return self.rows > 0 and (self._colored == 0 or self.missing == self.rows)

    def add(self, column: NDArray[Any]) -> None:
        """Include (n, 3) more colours of the file in the statistics."""
        if not len(column):
            return
        self.rows += len(column)
        self._colored += int(np.count_nonzero(column))
        if column.dtype == np.uint8:
            return
        if column.dtype.kind == "f":
            self.missing += int(np.isnan(column).any(axis=1).sum())
        for block in _blocks(column):
            self.low = min(self.low, float(np.fmin.reduce(block, axis=None)))
            self.high = max(self.high, float(np.fmax.reduce(block, axis=None)))
            for k, (_, most, least) in enumerate(RANGES):
                self._above[k] += int(np.count_nonzero(block > most))
                self._below[k] += int(np.count_nonzero(block < least))
        if not self._uses_last_bits:
            self._uses_last_bits = _uses_last_bits(column)

    def white(self, kind: np.dtype[Any]) -> int:
        """Return the value of white, 1, 255 or 65535, in colours of dtype `kind`; ValueError if they fit no range."""
        return RANGES[self._range(kind)][0]

    def scale(self, kind: np.dtype[Any]) -> float:
        """Return the factor that converts colours of dtype `kind` to 0 to 255; raise ValueError if they fit no range.

        16-bit values that are all multiples of 256 are taken for 8 bits, shifted left.
        """
        white = self.white(kind)
        if white < 65535:
            return 255 / white
        return 1 / SHADES if self._uses_last_bits else 1 / 256  # or 8 bits, shifted left

    def note(self, kind: np.dtype[Any]) -> str:
        """Describe for the user what the conversion of colours of dtype `kind` to 8 bits loses; "" if it loses nothing.

        Points without a colour become grey, and values out of range are clipped.
        """
        k = self._range(kind)
        outside = self._above[k] + self._below[k]
        notes = [f"{self.missing:,} points without a colour (NaN) are set to grey"] * bool(self.missing)
        if outside and not self._are_bytes(kind):
            notes.append(f"{outside:,} of {3 * self.rows:,} colour values are outside 0 to {RANGES[k][0]}: clipped")
        return "; ".join(notes)

    def _range(self, kind: np.dtype[Any]) -> int:
        """Return 0, 1 or 2 for colours of dtype `kind` up to 1, 255 or 65535: their index in `RANGES`.

        It is the first range that at most 0.1% of the nonzero values exceed, and 1 for unsigned bytes. Raise ValueError
        if there is none.
        """
        if kind == np.uint8 or self.rows == 0 or self._are_bytes(kind):
            return 1
        most = STRAY * self._colored
        ranges = range(0 if kind.kind == "f" else 1, len(RANGES))
        k = next((k for k in ranges if self._above[k] <= most), None)
        if k is None or self._below[k] > most:
            whites = " or ".join(str(RANGES[k][0]) for k in ranges)
            raise ValueError(f"invalid colours: got {self.low:g} to {self.high:g}, expected 0 to {whites}")
        return k

    def _are_bytes(self, kind: np.dtype[Any]) -> bool:
        """Whether colours of dtype `kind` are unsigned bytes stored as signed ones: int8 with negative values."""
        return kind == np.int8 and self.low < 0


def _uses_last_bits(column: NDArray[Any]) -> bool:
    """Whether any colour value is not a multiple of 256; otherwise 16-bit colours are 8 bits, shifted left.

    Rows are examined in blocks up to the first such value, which is mostly among the first rows.
    """
    return column.dtype.itemsize > 1 and any(
        (block[(block > 0) & (block <= RANGES[-1][1])] % 256).any() for block in _blocks(column)
    )


def _blocks(column: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Yield the rows of an array in blocks that stay in the processor's cache."""
    for start in range(0, len(column), BLOCK):
        yield column[start : start + BLOCK]


def to_shades(column: NDArray[Any], scale: float) -> NDArray[np.uint8]:
    """Convert (n, 3) colours to 8 bits, and rows with NaN to grey.

    scale : factor that converts the values to 0 to 255; unused for types of one byte
    """
    if column.dtype.itemsize == 1:
        return column.view(np.uint8)
    shades = np.empty(column.shape, np.uint8)
    for block, out in zip(_blocks(column), _blocks(shades), strict=True):
        values = block * np.float32(scale)
        if column.dtype.kind == "f":
            values[np.isnan(values).any(axis=1)] = GREY
        out[:] = np.clip(np.rint(values), 0, 255)
    return shades
