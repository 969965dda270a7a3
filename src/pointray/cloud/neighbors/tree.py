"""Python interface of the neighbour search."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...base.arrays import Floats, Indices
from ...base.progress import Progress, part_of, report_progress
from ...engine.jit import run
from .search import CHUNK, find_nearest
from .sites import LANES, Blocks, Boxes, make_blocks, make_boxes, scale_of

TREE = 0.3  # share of the time for building the tree, if 20 neighbours are searched
ROWS = 1 << 16  # rows per chunk


class Near(NamedTuple):
    """Neighbours of m queries, nearest first.

    distances : (m, k) float32
    indices : (m, k) int32, rows of the searched positions
    """

    distances: Floats
    indices: Indices


class NeighborTree:
    """Tree of positions for repeated neighbour queries.

    Results are exact: the k positions with the least float64 distances, ties by row, unless hundreds of positions
    coincide with the query.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite.
    in_order : bool
        Whether the positions are in the order of `kd_order`; saves sorting them.
    """

    def __init__(self, positions: Floats, in_order: bool = False) -> None:
        self._scale = scale_of(positions)
        self._points: Blocks = make_blocks(positions, self._scale, in_order)
        self._boxes: Boxes = make_boxes(self._points)
        self._in_order = in_order

    def query(self, k: int, queries: Floats | None = None, progress: Progress | None = None) -> Near:
        """Find the k nearest positions of each query.

        Parameters
        ----------
        k : int
            Number of neighbours; with fewer positions, all are returned.
        queries : (m, 3) float32, optional
            None: the positions; each is its own first neighbour, unless it has duplicates.
        progress : callable, optional
            Called with the fraction done.

        Returns
        -------
        distances : (m, min(k, n)) float32
        indices : (m, min(k, n)) int32
            Rows of the tree's n positions, nearest first.
        """
        queried = self._points if queries is None else make_blocks(queries, self._scale, False)
        k = min(k, self._points.size)
        distances = np.empty((queried.size, k), np.float32)
        return Near(distances, self._search(queried, (0, queried.size), distances, k, progress))

    def rows(self, k: int, part: slice | None = None, progress: Progress | None = None) -> Indices:
        """Find the rows of the k nearest of the n positions to each position, (n, min(k, n)) int32, nearest first.

        part : only this range of the positions, which must be in kd order; it begins at a multiple of 16
        """
        span = (0, self._points.size) if part is None else (part.start, min(part.stop, self._points.size))
        k = min(k, self._points.size)
        return self._search(self._points, span, np.empty((0, k), np.float32), k, progress)

    def rows_at(self, k: int, queries: Floats) -> Indices:
        """Find the rows of the k nearest of the n positions to each query, (m, min(k, n)) int32, nearest first.

        queries : (m, 3) float32
        """
        queried, k = make_blocks(queries, self._scale, False), min(k, self._points.size)
        return self._search(queried, (0, queried.size), np.empty((0, k), np.float32), k, None)

    def _search(
        self, queried: Blocks, span: tuple[int, int], distances: Floats, k: int, progress: Progress | None
    ) -> Indices:
        count = span[1] - span[0]
        indices = np.empty((count, k), np.int32)
        numbers = np.empty(0, np.int32) if queried is self._points and self._in_order else queried.numbers
        tree = self._points.blocks, self._points.numbers, *self._boxes
        rows = 1.0 / self._scale, distances.reshape(-1), indices.reshape(-1)
        tiles = -(-count // (LANES * CHUNK))
        run(find_nearest, tiles, tree, (queried.blocks, numbers, span[0]), span[1], k, rows, progress=progress)
        report_progress(progress, 1.0)
        return indices


def neighbors(positions: Floats, k: int, queries: Floats | None = None, progress: Progress | None = None) -> Near:
    """Find the k nearest positions of each query: distances and row numbers, (m, min(k, n)) each, nearest first.

    positions : (n, 3) float32, finite
    queries : (m, 3) float32; None: the positions, each of which is its own first neighbour unless it has duplicates
    """
    tree = NeighborTree(positions)
    report_progress(progress, TREE)
    return tree.query(k, queries, part_of(progress, TREE, 1.0))


def neighbor_chunks(positions: Floats, k: int, progress: Progress | None = None) -> Iterator[tuple[slice, Indices]]:
    """Yield the rows of the k nearest positions chunk by chunk, for tables too large for memory.

    Each item is a range of the n positions and the (m, min(k, n)) int32 rows of their neighbours, nearest first.

    positions : (n, 3) float32 in the order of `kd_order`
    """
    tree = NeighborTree(positions, in_order=True)
    for start in range(0, len(positions), ROWS):
        part = slice(start, min(start + ROWS, len(positions)))
        yield part, tree.rows(k, part)
        report_progress(progress, part.stop / len(positions))
