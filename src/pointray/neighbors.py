"""Nearest neighbours.

This uses SciPy's kd-tree, not pykdtree. The 9 nearest of each of a million surface points take 0.7 s with SciPy and
0.5 s with pykdtree (two threads), but SciPy keeps to the number of threads it is given, and pykdtree's OpenMP hangs in
a forked process. The order matters more: along a Morton curve both are four times as fast as in random order.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .jit import thread_count
from .progress import Progress, part_of, tell

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]

TREE = 0.1  # share of the time for 20 neighbours that the tree takes

_CHUNK = 1 << 16  # rows of a table at a time
_ASKED = 1 << 13  # queries at a time: SciPy answers in float64 and int64, four times what is kept


class NeighborTree:
    """A tree of positions for repeated neighbour queries.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite.
    """

    def __init__(self, positions: Floats) -> None:
        self._positions = positions
        self._order = morton_order(positions).astype(np.int32)
        # These options halve the time to build; queries are no slower.
        self._tree: Any = cKDTree(positions[self._order], balanced_tree=False, compact_nodes=False)

    def query(
        self, k: int, queries: Floats | None = None, progress: Progress | None = None
    ) -> tuple[Floats, NDArray[np.int32]]:
        """The k nearest positions of each query, nearest first.

        Parameters
        ----------
        k : int
            If there are fewer positions, all are returned.
        queries : (m, 3) float32, optional
            None: the positions themselves; each is then among its own neighbours (first, unless it has duplicates).
        progress : callable, optional

        Returns
        -------
        distances : (m, min(k, n)) float32
        indices : (m, min(k, n)) int32
        """
        asked = self._order if queries is None else morton_order(queries)
        path = (self._positions if queries is None else queries)[asked]
        k = min(k, len(self._positions))
        distances, indices = np.empty((len(path), k), np.float32), np.empty((len(path), k), np.int32)
        ranks = np.arange(1, k + 1)

        def ask(part: slice) -> None:
            rows = asked[part]
            distances[rows], near = self._tree.query(path[part], ranks)
            indices[rows] = self._order[near]

        # SciPy's own threads are not used: an exception in them (std::bad_alloc) is only printed, and the neighbours
        # are wrong; and they go on after an interrupt. The pool passes errors on and waits for its last thread.
        step = min(_ASKED, max(1, -(-len(path) // thread_count())))
        with ThreadPoolExecutor(thread_count()) as pool:
            parts = [slice(start, start + step) for start in range(0, len(path), step)]
            for part, _ in zip(parts, pool.map(ask, parts), strict=True):
                tell(progress, min(part.stop / len(path), 1.0))
        return distances, indices


def neighbors(
    positions: Floats, k: int, queries: Floats | None = None, progress: Progress | None = None
) -> tuple[Floats, NDArray[np.int32]]:
    """The k nearest positions of each query, see `NeighborTree.query`."""
    tree = NeighborTree(positions)
    tell(progress, TREE)
    return tree.query(k, queries, part_of(progress, TREE, 1.0))


def neighbor_chunks(
    positions: Floats, k: int, progress: Progress | None = None
) -> Iterator[tuple[slice, NDArray[np.int32]]]:
    """The k nearest of each position, a part of the rows at a time: (rows, (m, min(k, n)) int32), nearest first.

    This serves tables too large to be held at once. It is fast only along a Morton curve (see `morton_order`).
    """
    tree = NeighborTree(positions)
    for start in range(0, len(positions), _CHUNK):
        part = slice(start, start + _CHUNK)
        yield part, tree.query(k, positions[part])[1]
        tell(progress, min(part.stop / len(positions), 1.0))


def distinct(positions: Floats, cell: float = 0.0) -> tuple[Rows, Rows]:
    """One row for each distinct position, and the number of each row's position among them.

    Parameters
    ----------
    positions : (n, 3) float32
    cell : float
        0 groups equal positions; otherwise all positions in a grid cell of this size count as one.

    Returns
    -------
    rows : (m,) int64
        The first row of each group, ascending.
    ids : (n,) int64
        positions[rows][ids] equals positions, to within the size of a cell.
    """
    keys = np.floor(positions / np.float64(cell)) if cell else positions + np.float32(0)  # -0 is 0
    _, first, ids = np.unique(_hash(keys), return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return np.sort(first), rank[ids]


def _hash(keys: NDArray[Any]) -> NDArray[np.uint64]:
    """A 64-bit hash of each row: one sort instead of three. Two of a million rows collide once in 10^7 models."""
    code = np.zeros(len(keys), np.uint64)
    for column in keys.T:
        code ^= np.ascontiguousarray(column, np.float64).view(np.uint64)
        code *= np.uint64(0x9E3779B97F4A7C15)
        code ^= code >> np.uint64(32)
        code *= np.uint64(0xD6E8FEB86659FD93)
        code ^= code >> np.uint64(29)
    return code


def morton_order(positions: Floats) -> Rows:
    """Row numbers along a Morton curve through the positions' bounds (21 bits an axis)."""
    low, high = positions.min(axis=0).astype(np.float64), positions.max(axis=0).astype(np.float64)
    scale = (2**21 - 1) / max(float((high - low).max()), 1e-300)
    code = np.zeros(len(positions), np.uint64)
    for axis in range(3):
        code |= _spread(((positions[:, axis] - low[axis]) * scale).astype(np.uint64)) << np.uint64(axis)
    return np.argsort(code)


def _spread(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Insert two zeros above each of the 21 bits."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
    return bits
