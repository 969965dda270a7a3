"""The neighbours of a few points among very many: only the points in the cells around them are searched."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..neighbors import distinct, neighbors

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]

FEW = 500_000  # no more points than this are all searched
GUESS, GUESSED = 20_000, 500  # sample that tells how large cells must be, and how many of it are queried
WIDE = 1.5  # the size of a cell, in distances to the last neighbour
SOUND = 0.8  # share of neighbourhoods that must lie within their cells; the others are left out
TABLE = 1 << 24  # hash numbers of cells
CHUNK = 1 << 18  # points that are tested together


class Neighborhoods(NamedTuple):
    """The nearest distinct positions of a few points.

    Attributes
    ----------
    rows : (m, k) int64
        One row for each position, nearest first: the first is the point itself.
    shared : (m, k) int64
        How many rows have that position.
    farthest : (m,) float32
        Distance to the last position.
    """

    rows: Rows
    shared: Rows
    farthest: Floats


def find_neighborhoods(positions: Floats, count: int, k: int, seed: int = 0) -> Neighborhoods:
    """The k nearest distinct positions of `count` random points, or of all points if there are fewer.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite.
    """
    random = np.random.default_rng(seed)
    queries = np.sort(random.permutation(len(positions))[:count])
    if len(positions) <= FEW:
        return _nearest(positions, np.arange(len(positions)), queries, k)
    some = positions[random.integers(len(positions), size=GUESS)]
    some = some[distinct(some)[0]]
    farthest = float(np.median(neighbors(some, k, some[:GUESSED])[0][:, -1]))
    cell = WIDE * farthest * np.sqrt(GUESS / len(positions))  # of a surface
    while cell > 0:
        around = rows_around(positions, positions[queries], cell)
        found = _nearest(positions, around, queries, k)
        sound = found.farthest <= cell
        if len(around) == len(positions):
            return found
        if found.rows.shape[1] == k and sound.mean() >= SOUND:
            return Neighborhoods(*(array[sound] for array in found))
        cell *= 2
    return _nearest(positions, np.arange(len(positions)), queries, k)


def _nearest(positions: Floats, around: Rows, queries: Rows, k: int) -> Neighborhoods:
    """The neighbourhoods of the rows `queries` among the rows `around`, which contain them."""
    rows, ids = distinct(positions[around])
    shared = np.bincount(ids)
    distances, near = neighbors(positions[around[rows]], k, positions[queries])
    return Neighborhoods(around[rows[near]], shared[near], distances[:, -1])


def rows_around(positions: Floats, queries: Floats, cell: float) -> Rows:
    """The rows in the cells of the queries and in the adjacent cells, and a few others with equal hashes."""
    beside = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    wanted = np.zeros(TABLE, np.bool_)
    for step in beside:
        wanted[_numbers_of(queries, cell, step)] = True
    starts = range(0, len(positions), CHUNK)
    chunks = [start + np.flatnonzero(wanted[_numbers_of(positions[start : start + CHUNK], cell)]) for start in starts]
    return np.concatenate(chunks)


def _numbers_of(rows: Floats, cell: float, step: Any = (0, 0, 0)) -> Rows:
    """A hash below TABLE for the cell that is `step` cells away from each row's cell."""
    number = np.zeros(len(rows), np.int64)
    for axis, factor in enumerate((73856093, 19349663, 83492791)):
        index = np.floor(np.clip(rows[:, axis] / np.float64(cell), -(2.0**62), 2.0**62)).astype(np.int64)
        number ^= (index + step[axis]) * factor
    return number & (TABLE - 1)
