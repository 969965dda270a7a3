"""Selection of the rows of a file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_mapping, check_numbers, check_whole, wrong
from ..base.arrays import Doubles
from .formats._source import Chunk

Values = Mapping[str, tuple[float, ...]]


@dataclass(frozen=True)
class Selection:
    """Conditions on the rows to read, all of which must hold.

    Attributes
    ----------
    every : int
        Every n-th row of the file, beginning with the first, independent of the other conditions.
    max_points : int or None
        Maximum number of rows, evenly spread.
    bounds : (2, 3) float64 or None
        World box, including its faces.
    keep, drop : dict of str to tuple of float
        Attribute values of the rows to keep or to drop.
    """

    every: int = 1
    max_points: int | None = None
    bounds: Doubles | None = None
    keep: Values | None = None
    drop: Values | None = None

    def __post_init__(self) -> None:
        check_whole(self.every, "every", 1)
        if self.max_points is not None:
            check_whole(self.max_points, "max_points", 1, or_none=True)
        if self.bounds is not None:
            object.__setattr__(self, "bounds", checked_bounds(self.bounds))
        for name in ("keep", "drop"):
            object.__setattr__(self, name, _checked_values(getattr(self, name), name))

    @property
    def filters(self) -> bool:
        """Whether rows are selected by values (bounds, keep, drop): their number is unknown until they are read."""
        return self.bounds is not None or bool(self.keep) or bool(self.drop)

    @property
    def is_all(self) -> bool:
        """Whether every row of a file is selected."""
        return self.every == 1 and self.max_points is None and not self.filters

    def apply(self, chunk: Chunk, start: int) -> Chunk:
        """Return the selected rows of a chunk, ignoring `max_points`.

        start : row number in the file of its first row
        """
        if self.every > 1:
            chunk = chunk.select(slice(-start % self.every, None, self.every))
        if not self.filters or not len(chunk.positions):
            return chunk
        rows = np.ones(len(chunk.positions), np.bool_)
        if self.bounds is not None:
            low, high = self.bounds
            for axis in range(3):
                column = chunk.positions[:, axis]
                rows &= (column >= low[axis]) & (column <= high[axis])
        for values, wanted in ((self.keep, True), (self.drop, False)):
            for name, some in (values or {}).items():
                rows &= np.isin(_column(chunk, name), some) == wanted
        return chunk if rows.all() else chunk.select(rows)


def checked_bounds(value: Any) -> Doubles:
    """Check a box given as two corners or six numbers, minimum first; return it as (2, 3) float64."""
    box = check_numbers(value, "bounds", "x0,y0,z0,x1,y1,z1").astype(np.float64)
    if box.shape not in ((2, 3), (6,)):
        raise wrong("bounds", "x0,y0,z0,x1,y1,z1", value)
    box = box.reshape(2, 3)
    if np.isnan(box).any() or not (box[0] <= box[1]).all():
        raise ValueError(f"bounds must be x0,y0,z0,x1,y1,z1, minimum first, not {box.reshape(-1).tolist()}")
    return box


class Thinning:
    """Reduction of a stream of chunks to at most `limit` evenly spread rows.

    If the number of rows is known, exactly `limit` are kept. Otherwise every n-th row is kept, and n is doubled
    whenever there are too many.

    Parameters
    ----------
    limit : int or None
        Maximum number of rows; None keeps all.
    count : int or None
        Number of rows to come, if known.
    """

    def __init__(self, limit: int | None, count: int | None) -> None:
        self.limit = limit
        self._count = None if limit is None or count is None or count <= limit else count
        self._whole = limit is None or (count is not None and count <= limit)
        self._step, self._seen, self._kept = 1, 0, 0

    def apply(self, chunk: Chunk) -> Chunk:
        """Return those rows of the next chunk of the stream that are kept."""
        n, start = len(chunk.positions), self._seen
        self._seen += n
        if self._whole or not n:
            return chunk
        if self._count is not None:
            assert self.limit is not None
            rows = np.arange(start, start + n) * self.limit
            return chunk.select((rows + self.limit) // self._count > rows // self._count)
        return chunk.select(slice(-start % self._step, None, self._step))

    def is_over(self, more: int) -> bool:
        """Count `more` rows as kept; return whether there are now too many, so that `halve` must be called."""
        self._kept += more
        return not self._whole and self._count is None and self.limit is not None and self._kept > self.limit

    def halve(self, chunks: list[Chunk]) -> list[Chunk]:
        """Return the chunks of all rows kept so far, thinned by a factor of 2, 4 or more until they fit the limit."""
        assert self.limit is not None
        while self._kept > self.limit:
            self._step *= 2
            thinner, start = [], 0
            for chunk in chunks:
                thinner.append(chunk.select(slice(start % 2, None, 2)))
                start += len(chunk.positions)
            chunks, self._kept = thinner, -(-start // 2)
        return chunks


def _column(chunk: Chunk, name: str) -> NDArray[Any]:
    if name not in chunk.attributes:
        known = ", ".join(sorted(chunk.attributes)) or "none"
        raise ValueError(f"no attribute {name!r} for keep or drop; available: {known}")
    values = chunk.attributes[name]
    if values.ndim > 1:
        raise ValueError(f"attribute {name!r} has {values.shape[1]} columns; keep and drop need one")
    return values


def _checked_values(values: Any, name: str) -> dict[str, tuple[float, ...]] | None:
    if values is None:
        return None
    known = check_mapping(values, name)
    return {str(key): _numbers(some, f"{name}: {key}") for key, some in known.items()}


def _numbers(some: Any, name: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(x) for x in np.atleast_1d(np.asarray(some, np.float64)).reshape(-1))
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be numbers, not {some!r}") from None
    if not numbers:
        raise ValueError(f"{name} must be at least one number")
    return numbers


def lengths(chunks: Iterator[Chunk]) -> Iterator[tuple[Chunk, int]]:
    """Yield each chunk of a file with the row number at which it begins."""
    start = 0
    for chunk in chunks:
        yield chunk, start
        start += len(chunk.positions)
