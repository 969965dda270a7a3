"""Statistics of a whole cloud, by which all its points are measured.

They are computed from a sample: ranges of the kd order, each with all its points. After the sample has been evaluated,
the parts of a cloud that does not fit into memory are measured by the same numbers as the whole.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Flags, Floats, Rows

RANGE, RANGES = 1 << 16, 16  # points of a range; ranges in the sample of a large cloud
# Bits of a quantized number. The remaining bits depend on how far a part's margin extends; through these numbers they
# would change the last bits of 6 in 10 hits (docs/decisions/parts.md).
BITS = 8
SAMPLE = 20_000  # values that locate a quantile of many
MARGIN = 0.02  # share of the values on either side in which the quantile is searched: 5 times the sample's error


def sample_of(count: int) -> list[slice]:
    """Return ranges of rows in kd order that represent a cloud of `count` points; if there are few, one of all rows."""
    whole = count // RANGE
    if whole < RANGES:
        return [slice(0, count)]
    return [slice(k * RANGE, (k + 1) * RANGE) for k in np.arange(RANGES) * whole // RANGES]


class CloudStatistics:
    """Numbers that describe a whole cloud, such as its noise or size; computed on demand from a sample, cached by name.

    Parts of a cloud too large for memory are processed with the same numbers as the whole.

    Parameters
    ----------
    rows : (m,) int64, optional
        The sample, as rows of the points in memory. None: all rows.
    known : dict of str to float, optional
        Numbers computed before.
    is_complete : bool
        Whether `known` holds all numbers because the points in memory are only a part of the cloud.

    Attributes
    ----------
    known : dict of str to float
        All numbers computed so far.
    """

    def __init__(
        self, rows: Rows | None = None, known: dict[str, float] | None = None, is_complete: bool = False
    ) -> None:
        self.known: dict[str, float] = {} if known is None else known
        self._rows, self._is_complete = rows, is_complete
        self._members: Rows | None = None
        self._suffix = ""

    @classmethod
    def of(cls, count: int) -> CloudStatistics:
        """Return the statistics of a whole cloud of `count` points in kd order, with a sample of at most 16 ranges."""
        ranges = sample_of(count)
        if len(ranges) == 1:
            return cls()
        return cls(np.concatenate([np.arange(one.start, one.stop) for one in ranges]))

    def get_or_compute(self, name: str, find: Callable[[], float]) -> float:
        """Return the number cached by this name; if there is none, call `find` to compute it."""
        own = name + self._suffix
        if self._is_complete and own not in self.known and name in self.known:  # no sampled points coincide
            return self.known[name]
        if own not in self.known:
            self.known[own] = float(find())
        return self.known[own]

    def compute_together(self, names: tuple[str, ...], find: Callable[[], tuple[float, ...]]) -> None:
        """Call `find`, which returns a number for each name, and cache these, unless they are cached."""
        if names[0] not in self.known:
            self.known.update(zip(names, map(float, find()), strict=True))

    def quantile(self, name: str, values: Floats, share: float) -> float:
        """Return the quantile `share` (0 to 1) of `values` in the sample, rounded to 8 bits and cached by name.

        values : (n,) one number per point in memory
        """
        return self.get_or_compute(name, lambda: quantize(quantile(self._of_sample(values), share)))

    def least(self, name: str, values: Floats) -> float:
        """Return the minimum of `values` in the sample, cached by name.

        values : (n,) one number per point in memory
        """
        return self.get_or_compute(name, lambda: float(self._of_sample(values).min()))

    def diagonal(self, name: str, positions: Floats) -> float:
        """Return the diagonal of the box around the central 98% of the sample, rounded to 8 bits and cached.

        positions : (n, 3) the points in memory
        """

        def find() -> float:
            some = self._of_sample(positions)
            spans = (quantile(some[:, c], 0.99) - quantile(some[:, c], 0.01) for c in range(3))
            return quantize(math.hypot(*spans))

        return self.get_or_compute(name, find)

    def share(self, name: str, flags: Flags) -> float:
        """Return the share of sampled points, 0 to 1, whose flag is set, rounded to 8 bits and cached by name.

        flags : (n,) one per point in memory
        """
        return self.get_or_compute(name, lambda: quantize(float(self._of_sample(flags).mean())))

    def merged(self, members: Rows) -> CloudStatistics:
        """Return the same statistics for values with one row for each group of merged points instead of each point.

        Numbers are cached under other names, since merging changes them.

        members : (n,) the row of these values for each point in memory
        """
        other = CloudStatistics(self._rows, self.known, self._is_complete)
        other._members, other._suffix = members, " of places"
        return other

    def some(self, count: int, most: int) -> Rows:
        """Return at most `most` random rows of the sample.

        count : number of points in memory
        """
        rows = np.random.default_rng(0).permutation(count if self._rows is None else len(self._rows))[:most]
        return rows if self._rows is None else self._rows[rows]

    def spread(self, count: int, most: int) -> Rows:
        """Return evenly spaced rows of the sample, at least `most` if it has as many, and less than twice as many.

        count : number of points in memory
        """
        rows = np.arange(count) if self._rows is None else self._rows
        return rows[:: max(len(rows) // most, 1)]

    def quantile_of_rows(self, name: str, values: Floats, rows: Rows, share: float) -> float:
        """Return the quantile `share` (0 to 1) of the values at some rows, rounded up to 8 bits and cached by name.

        values : (n,) one number per point in memory
        rows : rows at which values are computed, from `rows_for_quantile`
        """
        return self.get_or_compute(name, lambda: -quantize(-float(np.quantile(values[rows], share)), is_limit=True))

    def rows_for_quantile(self, count: int) -> Rows:
        """Return about 20,000 rows of the sample, for `quantile_of_rows`; no rows if all numbers are known.

        count : number of points in memory
        """
        return np.zeros(0, np.int64) if self._is_complete else self.spread(count, SAMPLE)

    def _of_sample(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the sampled points.

        values : (n, ...) one row per point in memory
        """
        rows = self._rows
        if self._members is not None:
            rows = self._members if rows is None else self._members[rows]
        return values if rows is None else values[rows]


def quantize(value: float, is_limit: bool = False) -> float:
    """Round a number to 8 significant bits, so that nearly equal numbers of a cloud's parts become equal.

    is_limit : whether to round down, not to nearest
    """
    if not math.isfinite(value):
        return value
    fraction, exponent = math.frexp(value)
    scaled = fraction * (1 << BITS)
    return math.ldexp(math.floor(scaled) if is_limit else round(scaled), exponent - BITS)


def quantile(values: Floats, share: float) -> float:
    """Return the quantile `share` (0 to 1) of values, (n,), as `np.quantile` does, in a fifth of the time.

    A sorted sample brackets the quantile, so that only few values have to be partitioned.
    """
    if len(values) > 2 * SAMPLE:
        sample = np.sort(values[:: len(values) // SAMPLE])
        low, high = (int(np.clip((share + side) * len(sample), 0, len(sample) - 1)) for side in (-MARGIN, MARGIN))
        some = values[(values >= sample[low]) & (values <= sample[high])]
        place = share * (len(values) - 1) - np.count_nonzero(values < sample[low])
        if 0 <= place <= len(some) - 1:
            first = math.floor(place)
            after = min(first + 1, len(some) - 1)
            some.partition([first, after])
            return float(np.float32(some[first] + (place - first) * (float(some[after]) - float(some[first]))))
    return float(np.quantile(values, share))
