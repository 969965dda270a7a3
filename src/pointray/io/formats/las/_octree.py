"""Octree of a COPC file that is written: the level of each point, and the order of the points by nodes.

Each node holds a sample of the points in its cube, at most one in each cell of a grid, and its children hold the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Doubles, Rows

BITS = 21  # per axis of a Morton code
FINEST = 7  # a node has at most 2^7 cells along each edge
LARGEST_SAMPLE = 1 << 16  # points of the root, which decides the number of cells of all nodes
LEAF = 1 << 14  # a node with fewer points has no children
CHUNK = 1 << 18  # rows at a time

Codes = NDArray[np.uint64]


class Node(NamedTuple):
    """A node: its level, the numbers of its cube along x, y and z, and the range of its points in the order."""

    key: tuple[int, int, int, int]
    begin: int
    end: int


class Octree(NamedTuple):
    """Octree of all points.

    Attributes
    ----------
    low : (3,) float64
        Minimum corner of the cube of the root.
    side, spacing : float
        Edge length of this cube, and of its cells.
    order : (n,) int
        Row numbers of the points, node after node, coarse nodes first.
    nodes : list of Node
    """

    low: Doubles
    side: float
    spacing: float
    order: Rows
    nodes: list[Node]


def build(rows: Rows, bounds: tuple[Doubles, Doubles], coordinates: Callable[[Rows], Doubles]) -> Octree:
    """Build the octree of points.

    Parameters
    ----------
    rows : (n,) int
        Row numbers of the points.
    bounds : two (3,) float64
        Minimum of their coordinates, and a little more than their maximum.
    coordinates : callable
        (m,) row numbers -> coordinates, (m, 3) float64.
    """
    low = bounds[0]  # copclib takes the minimum of all points for the corner of the cube
    side = float((bounds[1] - bounds[0]).max())
    codes = np.empty(len(rows), np.uint64)
    for start in range(0, len(rows), CHUNK):
        part = slice(start, start + CHUNK)
        codes[part] = morton(coordinates(rows[part]), low, side)
    order = np.argsort(codes).astype(np.int32)
    codes = codes[order]
    bits = _cell_bits(codes)
    levels = _levels(codes, bits)
    by_level = np.argsort(levels, kind="stable").astype(np.int32)
    nodes = list(_nodes(codes[by_level], levels[by_level]))
    return Octree(low, side, side / 2**bits, rows[order[by_level]], nodes)


def morton(xyz: Doubles, low: Doubles, side: float) -> Codes:
    """Return the Morton codes of points in a cube, (m,), of 21 bits for each axis, x the lowest.

    xyz : (m, 3); low, side : minimum corner and edge length of the cube
    """
    cells = np.clip((xyz - low) * (2.0**BITS / side), 0, 2**BITS - 1).astype(np.uint64)
    codes = np.zeros(len(xyz), np.uint64)
    for k in range(3):
        codes |= _spread(cells[:, k]) << np.uint64(k)
    return codes


def _spread(values: Codes) -> Codes:
    """Insert two zeros after each of the lowest 21 bits."""
    values = values.copy()
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        values = (values | values << np.uint64(shift)) & np.uint64(mask)
    return values


def _gathered(code: int) -> int:
    """Return every third bit of a number."""
    return sum((code >> 3 * k & 1) << k for k in range(BITS))


def _starts(values: Codes) -> NDArray[np.int64]:
    """Return where runs of equal numbers begin."""
    return np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))


def _cell_bits(codes: Codes) -> int:
    """Return the binary logarithm of the number of cells of a node along each edge. codes : sorted, (n,)"""
    for bits in range(FINEST, 1, -1):
        if len(_starts(codes >> np.uint64(3 * (BITS - bits)))) <= LARGEST_SAMPLE:
            return bits
    return 1


def _levels(codes: Codes, bits: int) -> NDArray[np.uint8]:
    """Return the level of each point, (n,): the coarsest at which a node has room for it.

    codes : sorted, (n,); bits : of the number of cells of a node along each edge
    """
    levels = np.zeros(len(codes), np.uint8)
    left = np.arange(len(codes), dtype=np.int32)
    for level in range(BITS - bits + 1):
        own = codes[left]
        first = _starts(own >> np.uint64(3 * (BITS - level)))
        sizes = np.diff(np.append(first, len(own)))
        chosen = np.repeat(sizes <= (LEAF if level < BITS - bits else len(own)), sizes)
        cells = _starts(own >> np.uint64(3 * (BITS - level - bits)))
        chosen[(cells + np.append(cells[1:], len(own))) // 2] = True  # the middle one of each cell
        levels[left[chosen]] = level
        left = left[~chosen]
        if not len(left):
            break
    return levels


def _nodes(codes: Codes, levels: NDArray[np.uint8]) -> Iterator[Node]:
    """Yield the nodes of points sorted by level, then by code."""
    ends = np.cumsum(np.bincount(levels))
    for level, (begin, end) in enumerate(zip((0, *ends[:-1]), ends, strict=True)):
        if begin == end:
            continue
        cubes = codes[begin:end] >> np.uint64(3 * (BITS - level))
        starts = _starts(cubes)
        for first, last in zip(starts, np.append(starts[1:], end - begin), strict=True):
            cube = int(cubes[first])
            x, y, z = (_gathered(cube >> k) for k in range(3))
            yield Node((level, x, y, z), int(begin + first), int(begin + last))
