"""Blocks of 16 points along the kd order, and a tree of bounding boxes with 16 children per node.

Coordinates are scaled by a power of two, which is exact, so that no relevant squared distance over- or underflows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
from ...engine.jit import Array, borrow, i64, kernel, next_tile, run
from ...engine.simd import INF, load16, reduce_max, reduce_min
from .order import kd_order

LANES = 16  # points of a block, children of a node
BLOCK = 3 * LANES  # float32 of a block: x, y, z of its points; infinite for unused slots
NODE = 6 * LANES  # float32 of a node: the minimum x, y, z of its children, then the maximum; inverted for unused slots
CHUNK = 256  # nodes that a thread fills at a time


class Blocks(NamedTuple):
    """Points in blocks of 16 that are consecutive in kd order, for vectors of 16 lanes.

    size : number of points
    blocks : (b * 48,) float32: x of the 16 points of a block, then y, then z; scaled by a power of two
    numbers : (b * 16,) int32, the caller's row of each point, or -1 for an unused lane
    """

    size: int
    blocks: Floats
    numbers: NDArray[np.int32]


class Boxes(NamedTuple):
    """Tree of bounding boxes around blocks of 16 points; a node holds the boxes of its 16 children.

    nodes : (m * 96,) float32, minimum x, y, z of the children, then maximum; level by level from the blocks up, so that
        child c of node i is node 16 i + c one level below
    starts : (levels + 1,) int64, first node of each level, then the number of nodes
    """

    nodes: Floats
    starts: Rows


@kernel
def _fill_blocks(work: Array, positions: Array, order: Array, scale: float, blocks: Array, numbers: Array) -> None:
    """Copy points, multiplied by `scale`, into blocks of 16 points.

    work : gives each thread its next tile of blocks
    order : rows of the points in the order of the blocks; empty: the order of `positions`
    blocks, numbers : receive the coordinates, and the row of each point, -1 for unused lanes
    """
    positions, order, blocks, numbers = borrow(positions), borrow(order), borrow(blocks), borrow(numbers)
    count = len(positions)
    tile = next_tile(work)
    while tile >= 0:
        for b in range(tile * CHUNK * LANES, min((tile + 1) * CHUNK * LANES, len(numbers) // LANES)):
            for k in range(LANES):
                slot = b * LANES + k
                i = -1
                if slot < count:
                    i = i64(order[slot]) if len(order) > 0 else slot
                numbers[slot] = i
                for c in range(3):
                    blocks[b * BLOCK + c * LANES + k] = positions[i, c] * scale if i >= 0 else INF
        tile = next_tile(work)


@kernel
def _fill_leaves(work: Array, count: int, blocks: Array, nodes: Array) -> None:
    """Write the bounding box of each block of 16 points into a node of the lowest level.

    work : gives each thread its next tile of blocks
    count : number of points
    blocks : flat, x of the 16 points of a block, then y, then z
    nodes : flat, 96 floats a node: minimum x, y, z of its 16 children, then maximum
    """
    blocks, nodes = borrow(blocks), borrow(nodes)
    filled = -(-count // LANES)
    tile = next_tile(work)
    while tile >= 0:
        for b in range(tile * CHUNK * LANES, min((tile + 1) * CHUNK * LANES, filled)):
            at = b // LANES * NODE + b % LANES
            for c in range(3):
                least, greatest = INF, -INF
                for k in range(min(LANES, count - b * LANES)):
                    value = blocks[b * BLOCK + c * LANES + k]
                    least, greatest = min(least, value), max(greatest, value)
                nodes[at + c * LANES], nodes[at + (3 + c) * LANES] = least, greatest
        tile = next_tile(work)


@kernel
def _fill_levels(nodes: Array, starts: Array) -> None:
    """Write the bounding box of each node, level by level, into its parent node.

    nodes : flat, 96 floats a node: minimum x, y, z of its 16 children, then maximum
    starts : first node of each level, then the number of nodes
    """
    for level in range(len(starts) - 2):
        for i in range(starts[level], starts[level + 1]):
            j = i - starts[level]
            at = (starts[level + 1] + j // LANES) * NODE + j % LANES
            for c in range(3):
                nodes[at + c * LANES] = reduce_min(load16(nodes, i * NODE + c * LANES))
                nodes[at + (3 + c) * LANES] = reduce_max(load16(nodes, i * NODE + (3 + c) * LANES))


def scale_of(positions: Floats) -> float:
    """Return the power of two that scales coordinates to at most 1, so that squared distances stay within float32."""
    greatest = max(float(positions.max()), -float(positions.min()))
    return math.ldexp(1.0, int(np.clip(-math.frexp(greatest)[1], -120, 120)))


def make_blocks(positions: Floats, scale: float, in_order: bool) -> Blocks:
    """Arrange points in blocks of 16 consecutive ones in kd order, scaled by `scale`.

    in_order : whether the positions already are in kd order, which saves sorting them
    """
    positions = np.ascontiguousarray(positions)
    n = len(positions)
    order = np.empty(0, np.int32) if in_order or n == 0 else kd_order(positions)
    count = -(-n // LANES)
    out = np.empty(count * BLOCK, np.float32), np.empty(count * LANES, np.int32)
    run(_fill_blocks, -(-count // (CHUNK * LANES)), positions, order, np.float32(scale), *out)
    return Blocks(n, *out)


def make_boxes(points: Blocks) -> Boxes:
    """Build the tree of bounding boxes over blocks of 16 points, up to a single root."""
    counts = [-(-len(points.numbers) // LANES**2)]
    while counts[-1] > 1:
        counts.append(-(-counts[-1] // LANES))
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    nodes = np.empty((starts[-1], 2, BLOCK), np.float32)
    nodes[:, 0], nodes[:, 1] = np.inf, -np.inf
    flat = nodes.reshape(-1)
    run(_fill_leaves, -(-counts[0] // CHUNK), points.size, points.blocks, flat)
    _fill_levels(flat, starts)
    return Boxes(flat, starts)
