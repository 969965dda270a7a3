"""What is usual in a whole cloud: numbers by which all its points are measured.

They come from a sample: stretches of the kd order, with all their points. So a part of a cloud that does not fit into
memory is measured by the same numbers as the whole, once the sample has been examined.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.int64]

STRETCH, STRETCHES = 1 << 16, 16  # points, and how many of the stretches stand for a larger cloud
# Bits of a number that is told. The rest depends on how far a part's margin reaches, and through these numbers the last
# bits of 6 in 10 hits (docs/decisions/parts.md).
BITS = 8
SAMPLE = 20_000  # numbers that tell where a quantile of many lies
MARGIN = 0.02  # share of the numbers to either side among which it is looked for: 5 times what the sample may be off


def sample_of(count: int) -> list[slice]:
    """The stretches of the kd order that stand for a cloud of so many points: all, if there are few."""
    whole = count // STRETCH
    if whole < STRETCHES:
        return [slice(0, count)]
    return [slice(k * STRETCH, (k + 1) * STRETCH) for k in np.arange(STRETCHES) * whole // STRETCHES]


class CloudStatistics:
    """Numbers that tell what is usual in a cloud.

    Parameters
    ----------
    rows : (m,) int64, optional
        The sample, among the points at hand. None: all of them.
    known : dict of str to float, optional
        Numbers that were found before.
    is_told : bool
        Whether these are all: the points at hand are a part of the cloud.

    Attributes
    ----------
    known : dict of str to float
        All that were found so far.
    """

    def __init__(self, rows: Rows | None = None, known: dict[str, float] | None = None, is_told: bool = False) -> None:
        self.known: dict[str, float] = {} if known is None else known
        self._rows, self._is_told = rows, is_told
        self._members: Rows | None = None
        self._suffix = ""

    @classmethod
    def of(cls, count: int) -> CloudStatistics:
        """For a whole cloud of so many points, in kd order."""
        stretches = sample_of(count)
        if len(stretches) == 1:
            return cls()
        return cls(np.concatenate([np.arange(one.start, one.stop) for one in stretches]))

    def ask(self, name: str, find: Callable[[], float]) -> float:
        """The number with a name; it is found, if it is not known."""
        own = name + self._suffix
        if self._is_told and own not in self.known and name in self.known:  # no points of the sample count as one
            return self.known[name]
        if own not in self.known:
            self.known[own] = float(find())
        return self.known[own]

    def settle(self, names: tuple[str, ...], find: Callable[[], tuple[float, ...]]) -> None:
        """Find numbers that are found together, unless they are known."""
        if names[0] not in self.known:
            self.known.update(zip(names, map(float, find()), strict=True))

    def quantile(self, name: str, values: NDArray[np.float32], share: float) -> float:
        """The quantile of numbers, one for each point at hand."""
        return self.ask(name, lambda: quantize(quantile(self._of_sample(values), share)))

    def least(self, name: str, values: NDArray[np.float32]) -> float:
        """The least of numbers, one for each point at hand."""
        return self.ask(name, lambda: float(self._of_sample(values).min()))

    def diagonal(self, name: str, positions: NDArray[np.float32]) -> float:
        """The diagonal of the box of the middle 98% of positions, one for each point at hand."""

        def find() -> float:
            some = self._of_sample(positions)
            spans = (quantile(some[:, c], 0.99) - quantile(some[:, c], 0.01) for c in range(3))
            return quantize(math.hypot(*spans))

        return self.ask(name, find)

    def share(self, name: str, flags: NDArray[np.bool_]) -> float:
        """How many of the points at hand have a flag, of all."""
        return self.ask(name, lambda: quantize(float(self._of_sample(flags).mean())))

    def merged(self, members: Rows) -> CloudStatistics:
        """What is usual where points count as one: `members` has the number of each point's place among all places."""
        other = CloudStatistics(self._rows, self.known, self._is_told)
        other._members, other._suffix = members, " of places"
        return other

    def some(self, count: int, most: int) -> Rows:
        """At most so many rows of the sample, chosen at random, for `count` points at hand."""
        rows = np.random.default_rng(0).permutation(count if self._rows is None else len(self._rows))[:most]
        return rows if self._rows is None else self._rows[rows]

    def spread(self, count: int, most: int) -> Rows:
        """About so many rows of the sample, evenly spread, for `count` points at hand; less than twice as many."""
        rows = np.arange(count) if self._rows is None else self._rows
        return rows[:: max(len(rows) // most, 1)]

    def quantile_among(self, name: str, values: NDArray[np.float32], rows: Rows, share: float) -> float:
        """The quantile of the numbers of some rows, rounded up: those of `rows_to_ask`."""
        return self.ask(name, lambda: -quantize(-float(np.quantile(values[rows], share)), is_limit=True))

    def rows_to_ask(self, count: int) -> Rows:
        """About `SAMPLE` rows of `count` points at hand; none if all numbers are known."""
        return np.zeros(0, np.int64) if self._is_told else self.spread(count, SAMPLE)

    def _of_sample(self, values: NDArray[Any]) -> NDArray[Any]:
        """The numbers of the sample's points."""
        rows = self._rows
        if self._members is not None:
            rows = self._members if rows is None else self._members[rows]
        return values if rows is None else values[rows]


def quantize(value: float, is_limit: bool = False) -> float:
    """The number to BITS bits, so that it is the same for values that hardly differ. is_limit : rounded down"""
    if not math.isfinite(value):
        return value
    fraction, exponent = math.frexp(value)
    scaled = fraction * (1 << BITS)
    return math.ldexp(math.floor(scaled) if is_limit else round(scaled), exponent - BITS)


def quantile(values: NDArray[np.float32], share: float) -> float:
    """The exact quantile of numbers, like `np.quantile`, in a fifth of the time: a sample tells where it lies."""
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
