"""Helpers of mutators: numbers at the edges of their types, as text and as bytes, and damage to any bytes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
Rng = np.random.Generator

WORDS = (
    *("nan", "-nan", "inf", "-inf", "1e400", "-1e400", "1e-320", "1e30", "-1e30", "1e15", "0", "-0", "-0.0", "-1"),
    *("1", "2", "255", "256", "65536", "2147483647", "2147483648", "-2147483648", "4294967296", "1.5", "0.5"),
    *("9223372036854775807", "9223372036854775808", "99999999999999999999999", "0x10", "1_000", "1,5", "+3", "007"),
    *("1d5", "1e", "--1", "''", "x", "true", "none", "\u0661", "\xe9", "1e5", "-7"),
)
FLOATS = (np.nan, -np.nan, np.inf, -np.inf, 3e38, -3e38, 1e30, -1e30, 1e-45, -1e-45, 1e-38, 0.0, -0.0, 1.0, -1.0, 1e15)


def pick(rng: Rng, values: Sequence[T]) -> T:
    """Choose one of the values."""
    return values[int(rng.integers(len(values)))]


def corrupt(rng: Rng, data: bytes, ops: int = 3) -> bytes:
    """Change, insert, remove, double or cut off bytes at one to `ops` places, most of them near the start."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, ops + 1))):
        if not out:
            break
        at = int(rng.random() ** 2 * len(out))
        length = int(min(2.0 ** (rng.random() * 8), len(out) - at))
        kind = int(rng.integers(8))
        if kind <= 1:
            out[at] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            out[at : at + length] = rng.bytes(length)
        elif kind == 3:
            out[at:at] = rng.bytes(length)
        elif kind == 4:
            del out[at : at + length]
        elif kind == 5:
            out[at:at] = out[at : at + length]
        elif kind == 6:
            out[at : at + length] = bytes([pick(rng, (0, 255, 0x7F, 10, 13, 32))]) * length
        else:
            del out[int(np.sqrt(rng.random()) * len(out)) :]
    return bytes(out)


def extremes_of(dtype: np.dtype[Any], length: int, partner: int) -> list[int]:
    """Values at which checks of an index may fail: ends of the type and of the length, and both less the partner."""
    low, high = int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)
    ends = [low, high, -1, 0, length - 1, length, length + 1, ~length, low + 1]
    ends += [end - partner for end in (low, high, -1, length, length + 1)]
    return sorted({value for value in ends if low <= value <= high})


def poison(rng: Rng, array: NDArray[np.floating[Any]], share: float = 0.0) -> None:
    """Set one to four numbers of a flat array, or a share of all, to the worst values of floats."""
    if array.size == 0:
        return
    count = max(int(rng.integers(1, 5)), int(share * array.size))
    rows = rng.integers(0, array.size, count)
    with np.errstate(over="ignore"):
        array[rows] = rng.choice(FLOATS, count).astype(array.dtype)
