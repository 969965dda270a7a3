"""Neighbours of a few points of a large cloud: only points in the cells around them are searched."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats
from ...engine.jit import Array, borrow, f64, i64, inline, kernel, next_tile, run
from . import distinct, neighbors

Rows = NDArray[np.integer[Any]]

FEW = 500_000  # smaller clouds are searched completely
GUESS, GUESSED = 20_000, 500  # sample by which the cell size is guessed, and its queries
WIDE = 1.5  # cell size, in distances to the last neighbour
SOUND = 0.8  # share of neighbourhoods that must lie within their cells; the others are dropped
TABLE = 1 << 24  # hash values of cells
CHUNK = 1 << 16  # points that a thread tests at a time
FAR = 2.0**61  # cells from the origin


class Neighborhoods(NamedTuple):
    """Nearest distinct positions of some points of a cloud, nearest first.

    Attributes
    ----------
    rows : (m, k) int
        One row of the cloud at each of these positions; the first one is the point itself.
    shared : (m, k) int
        Number of rows of the cloud at that position.
    farthest : (m,) float32
        Distance to the farthest of them.
    """

    rows: Rows
    shared: Rows
    farthest: Floats


def find_neighborhoods(positions: Floats, count: int, k: int, seed: int = 0) -> Neighborhoods:
    """Find the k nearest distinct positions of `count` random points of a cloud, or of all points if there are fewer.

    In large clouds only points near the chosen ones are searched; up to a fifth of the chosen ones, in sparse
    regions, may then be left out.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite.
    """
    random = np.random.default_rng(seed)
    queries = np.sort(random.choice(len(positions), min(count, len(positions)), replace=False, shuffle=False))
    if len(positions) <= FEW:
        return _nearest(positions, np.arange(len(positions)), queries, k)
    some = positions[random.integers(len(positions), size=GUESS)]
    some = some[distinct(some)[0]]
    farthest = float(np.median(neighbors(some, k, some[:GUESSED])[0][:, -1]))
    cell = WIDE * farthest * np.sqrt(GUESS / len(positions))  # for points on a surface
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
    """Find the k nearest distinct positions of some rows.

    around : rows among which neighbours are searched, including the queries
    queries : (m,) rows whose neighbours are wanted
    """
    rows, ids = distinct(positions[around])
    shared = np.bincount(ids)
    distances, near = neighbors(positions[around[rows]], k, positions[queries])
    return Neighborhoods(around[rows[near]], shared[near], distances[:, -1])


def rows_around(positions: Floats, queries: Floats, cell: float) -> Rows:
    """Return the rows in the grid cells of the queries and in adjacent cells, and some others, ascending.

    A hash table marks the cells; rows of other cells with the same hash are returned as well.

    positions : (n, 3) float32
    queries : (m, 3) float32
    cell : size of a cell
    """
    wanted, chosen = np.zeros(TABLE, np.bool_), np.empty(len(positions), np.bool_)
    _mark(np.ascontiguousarray(queries), float(cell), wanted)
    run(_choose, -(-len(positions) // CHUNK), np.ascontiguousarray(positions), float(cell), wanted, chosen)
    return np.flatnonzero(chosen)


@inline
def _cell_of(positions: Array, i: int, cell: float) -> tuple[int, int, int]:
    """Return the three integer coordinates of the grid cell of positions[i]; `cell` is its size.

    Cells are at most 2^61 from the origin: farther positions are clamped.
    """
    x, y, z = f64(positions[i, 0]) / cell, f64(positions[i, 1]) / cell, f64(positions[i, 2]) / cell
    return (
        i64(math.floor(min(max(x, -FAR), FAR))),
        i64(math.floor(min(max(y, -FAR), FAR))),
        i64(math.floor(min(max(z, -FAR), FAR))),
    )


@inline
def _hash_of(x: int, y: int, z: int) -> int:
    """Return the hash, below 2^24, of the grid cell with integer coordinates x, y, z."""
    return (x * 73856093 ^ y * 19349663 ^ z * 83492791) & (TABLE - 1)


@kernel
def _mark(queries: Array, cell: float, wanted: Array) -> None:
    """Mark the hash values of the grid cells of the queries, and of the 26 cells around each.

    queries : (m, 3) positions
    cell : size of a cell
    wanted : (2^24,) bool, receives the marks
    """
    for i in range(len(queries)):
        x, y, z = _cell_of(queries, i, cell)
        for k in range(27):
            wanted[_hash_of(x + k // 9 - 1, y + k // 3 % 3 - 1, z + k % 3 - 1)] = True


@kernel
def _choose(work: Array, positions: Array, cell: float, wanted: Array, chosen: Array) -> None:
    """Write to chosen[i] whether positions[i] is in a grid cell whose hash value is marked.

    cell : size of a cell
    wanted : (2^24,) bool, the marks
    """
    positions, wanted, chosen = borrow(positions), borrow(wanted), borrow(chosen)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(chosen))):
            x, y, z = _cell_of(positions, i, cell)
            chosen[i] = wanted[_hash_of(x, y, z)]
        tile = next_tile(work)
