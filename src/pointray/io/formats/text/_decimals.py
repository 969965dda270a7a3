"""Numbers as decimal text, many at a time: the shortest decimals that restore a value.

A column of texts is an array of characters, (width, n) uint8, in which 0 stands for nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Doubles, Flags
from ....cloud.georeference import RESIDUAL
from ....cloud.points import Points
from .._world import world_rows

MOST_DECIMALS = 15
EXACT = 2.0**53  # float64 holds all integers below; so integer / 10^decimals is rounded once, like a parsed text
SAMPLE = 256  # values that decide which numbers of decimals are tried
MOST_DIGITS = 18  # of an int64
ZERO, MINUS, POINT = ord("0"), ord("-"), ord(".")

GRID = 1e-6  # of a step of a file's integer coordinates: tolerance of their texts
DEGREE = 1e-12  # tolerance of longitudes and latitudes: 0.1 micrometres

Rows = slice | NDArray[np.integer[Any]]
Texts = NDArray[np.uint8]
Accept = Callable[[Doubles, NDArray[np.int64]], Flags]


def joined(columns: Sequence[Texts], separator: str) -> bytes:
    """Return the lines of a text, each of the texts of one row. separator : between two columns"""
    n = columns[0].shape[1]
    parts: list[Texts] = []
    for column in columns:
        parts += [column, np.full((1, n), ord(separator), np.uint8)]
    parts[-1] = np.full((1, n), ord("\n"), np.uint8)
    return np.concatenate(parts).T.tobytes().translate(None, b"\0")


def coordinates(points: Points, rows: Rows, station: Sequence[float] | None = None) -> list[tuple[Doubles, Accept]]:
    """Return the coordinates of some rows, x, y and z, each with what accepts candidates that restore the points.

    Those of points with an origin have as many decimals as restore their float32 positions; those of points from files
    with integer coordinates restore these integers.

    station : scanner position, in the coordinates of the file, to which they are relative
    """
    known, local = points.georeference, points.positions[rows]
    world = world_rows(points, rows).astype(np.float64)
    at = np.zeros(3) if station is None else np.array(station)
    has_grid = points.attributes.get(RESIDUAL) is not None and known.scale is not None
    found: list[tuple[Doubles, Accept]] = []
    for k in range(3):
        column = world[:, k] - at[k]
        if has_grid or (known.projection is not None and k < 2):
            step = GRID * known.scale[k] if has_grid and known.scale else DEGREE
            found.append((column, partial(_is_near, column, step)))
        else:
            found.append((column, partial(_is_restored, local[:, k], float(at[k]), float(points.origin[k]))))
    return found


def _is_near(values: Doubles, step: float, found: Doubles, rows: NDArray[np.int64]) -> Flags:
    return np.asarray(np.abs(found - values[rows]) <= step)


def _is_restored(
    local: NDArray[np.float32], station: float, origin: float, found: Doubles, rows: NDArray[np.int64]
) -> Flags:
    return np.asarray((found + station - origin).astype(np.float32) == local[rows])  # as readers compute it


def texts_of(values: NDArray[Any]) -> Texts:
    """Return the texts of integers, bools, or floats, (n,), which restore the values to the last bit."""
    if values.dtype.kind in "iub":
        return integers(values)
    if values.dtype == np.float32:
        return floats(values.astype(np.float64), lambda found, rows: found.astype(np.float32) == values[rows], 9)
    return floats(values, lambda found, rows: found == values[rows])


def integers(values: NDArray[Any]) -> Texts:
    """Return the texts of integers or bools, (n,)."""
    negative = values < 0
    sizes = values.astype(np.uint64)
    sizes = np.where(negative, np.uint64(0) - sizes, sizes)
    return np.concatenate([_sign(negative), _whole(sizes)])


def floats(values: Doubles, accept: Accept, digits: int = 17) -> Texts:
    """Return texts of floats, (n,), with as few decimals as restore the values.

    accept : (m,) candidates and their (m,) row numbers -> whether the candidates restore these rows
    digits : significant digits of texts with an exponent, for values that no such decimals restore
    """
    whole, decimals, left = _shortest(values, accept)
    texts = _fixed(whole, decimals)
    if not len(left):
        return texts
    special = values[left]
    is_nan = np.isnan(special)
    form = f"%.{digits}g"
    words = np.array([(form % x if digits < 17 else repr(x)).encode() for x in special[~is_nan].tolist()] or [b"0"])
    width = max(words.dtype.itemsize, 3)
    if len(texts) < width:
        texts = np.concatenate([texts, np.zeros((width - len(texts), len(values)), np.uint8)])
    texts[:, left] = 0
    texts[:3, left[is_nan]] = np.frombuffer(b"nan", np.uint8)[:, None]
    if not is_nan.all():
        texts[: words.dtype.itemsize, left[~is_nan]] = words.view(np.uint8).reshape(len(words), -1).T
    return texts


def _shortest(values: Doubles, accept: Accept) -> tuple[NDArray[np.int64], int, NDArray[np.int64]]:
    """Return integers and a number of decimals, value = integer / 10^decimals; and the rows without such an integer."""
    n = len(values)
    whole = np.zeros(n, np.int64)
    left = np.flatnonzero(np.abs(values) < EXACT)
    odd = np.flatnonzero(~(np.abs(values) < EXACT))
    first, last = _range(values, left[:: max(len(left) // SAMPLE, 1)], accept)
    for decimals in range(first, last + 1):
        numbers, good = _tried(values[left], left, decimals, accept)
        numbers, fits = numbers[good], np.abs(numbers[good]) < 10.0 ** (MOST_DIGITS - last + decimals)
        found = left[good]
        whole[found[fits]] = numbers[fits].astype(np.int64) * 10 ** (last - decimals)
        odd = np.concatenate([odd, found[~fits]])
        left = left[~good]
        if not len(left):
            break
    return whole, max(last, 0), np.sort(np.concatenate([odd, left]))


def _range(values: Doubles, some: NDArray[np.int64], accept: Accept) -> tuple[int, int]:
    """Return the fewest and the most decimals to be tried; (0, -1) if most values need more. some : rows of a sample"""
    left, first = some, -1
    for decimals in range(MOST_DECIMALS + 1):
        _, good = _tried(values[left], left, decimals, accept)
        first = decimals if first < 0 and good.any() else first
        left = left[~good]
        if not len(left):
            return first, decimals
    return (0, -1) if 2 * len(left) > len(some) or first < 0 else (first, MOST_DECIMALS)


def _tried(values: Doubles, rows: NDArray[np.int64], decimals: int, accept: Accept) -> tuple[Doubles, Flags]:
    """Return values in steps of the last decimal, rounded, and whether they restore the rows."""
    power = 10.0**decimals
    numbers = np.rint(values * power)
    with np.errstate(over="ignore"):
        return numbers, (np.abs(numbers) < EXACT) & accept(numbers / power, rows)


def _fixed(whole: NDArray[np.int64], decimals: int) -> Texts:
    """Return the texts of whole / 10^decimals, without zeros at their ends."""
    size = np.abs(whole).astype(np.uint64)
    power = np.uint64(10**decimals)
    parts = [_sign(whole < 0), _whole(size // power)]
    if decimals:
        rest, seen = size % power, np.zeros(len(whole), np.bool_)
        tail = np.zeros((decimals + 1, len(whole)), np.uint8)
        for k in range(decimals, 0, -1):
            rest, digit = _divided(rest)
            seen |= digit != 0
            tail[k] = (digit + np.uint8(ZERO)) * seen
        tail[0] = np.uint8(POINT) * seen
        parts.append(tail)
    return np.concatenate(parts)


def _sign(negative: Flags) -> Texts:
    return (np.uint8(MINUS) * negative)[None] if negative.any() else np.zeros((0, len(negative)), np.uint8)


def _whole(sizes: NDArray[np.uint64]) -> Texts:
    """Return the digits of unsigned integers."""
    most = int(sizes.max()) if len(sizes) else 0
    count = len(str(most))
    out = np.zeros((count, len(sizes)), np.uint8)
    rest = sizes
    for k in range(count):
        shown = rest != 0 if k else True
        rest, digit = _divided(rest)
        out[count - 1 - k] = (digit + np.uint8(ZERO)) * shown
    return out


def _divided(values: NDArray[np.uint64]) -> tuple[NDArray[np.uint64], NDArray[np.uint8]]:
    """Return the quotients and the remainders of a division by ten."""
    if len(values) and values.max() < 2**32:  # twice as fast
        narrow = values.astype(np.uint32)
        quotient = narrow // np.uint32(10)
        return quotient.astype(np.uint64), (narrow - quotient * np.uint32(10)).astype(np.uint8)
    quotient = values // np.uint64(10)
    return quotient, (values - quotient * np.uint64(10)).astype(np.uint8)
