"""Exact search for the k nearest points of many queries, 16 queries (a block) at a time.

All blocks of points within some distance of a block of queries are collected; the distance is what the previous block
needed. Each query measures the distances of all their points, 16 at a time in float32, packs the points within its own
bound (k or slightly more) and ranks them by their distances in float64. A query that finds fewer than k points repeats
with a larger distance. A query with too many points around it (a step in density, many coincident points) traverses
the tree alone (`single.py`).

Ties are ranked by the caller's rows, also at the end of the list, unless hundreds of points coincide with the query.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from ...engine.jit import Array, borrow, f32, i64, inline, keep_alive, kernel, next_tile
from ...engine.simd import (
    ZERO,
    Bits,
    bits,
    broadcast16,
    count_bits,
    count_trailing_zeros,
    load16,
    load16_int,
    store,
    vmax,
)
from .rank import FARTHER, Packed, Pool, Ranked, Rows, bound_for, measure_all, pack_within, rank, write_ranked
from .single import MORE, STACK, Best, Query, Tree, search_alone
from .sites import BLOCK, LANES, NODE

CHUNK = 64  # blocks of queries per task
SPARE, PER_NEIGHBOR = 32, 2  # capacity for collected blocks: a constant, plus one for each second neighbour
TRIES = 3  # distances tried per block
BEYOND = 1.21  # factor on the squared distance that the previous block needed

Batch: TypeAlias = tuple[Array, Array, int]  # blocks of queries, their numbers, the first query: see `find_nearest`
Memory: TypeAlias = tuple[Pool, Packed, Ranked, Array, Best, Array, Array]  # ..., line, best, stack, found


@inline
def _collect(tree: Tree, low: Query, high: Query, square: float, stack: Array, found: Array) -> int:
    """List the blocks of 16 points within a distance of a box around queries; return their number, or -1 if too many.

    tree : blocks of 16 points, their numbers, nodes of bounding boxes, first node of each level
    low, high : corners of the box
    square : squared distance
    stack : memory for nodes of the tree
    found : receives the numbers of the blocks, as many as it has room for
    """
    nodes, starts = tree[2], tree[3]
    square = f32(square * MORE)
    stack[0, 0], stack[0, 1] = len(starts) - 2, 0
    depth, count, none = 1, 0, broadcast16(ZERO)
    while depth > 0:
        depth -= 1
        level, j = stack[depth, 0], stack[depth, 1]
        at = (starts[level] + j) * NODE
        x = vmax(vmax(load16(nodes, at) - high[0], low[0] - load16(nodes, at + 48)), none)
        y = vmax(vmax(load16(nodes, at + 16) - high[1], low[1] - load16(nodes, at + 64)), none)
        z = vmax(vmax(load16(nodes, at + 32) - high[2], low[2] - load16(nodes, at + 80)), none)
        near = bits(x * x + y * y + z * z <= square)
        if level == 0:
            if count + count_bits(near) > len(found):
                return -1
            while near != 0:
                found[count] = j * LANES + count_trailing_zeros(near)
                near &= near - 1
                count += 1
        else:
            while near != 0:
                stack[depth, 0], stack[depth, 1] = level - 1, j * LANES + count_trailing_zeros(near)
                near &= near - 1
                depth += 1
    return count


@inline
def _pool(tree: Tree, found: Array, count: int, pool: Pool) -> None:
    """Copy the points of some blocks (16 points each) to contiguous memory.

    tree : blocks of 16 points, their numbers, nodes of bounding boxes, first node of each level
    found, count : numbers of the blocks, and how many there are
    pool : receives x, y, z and numbers of the points
    """
    blocks, numbers = tree[0], tree[1]
    for t in range(count):
        b = i64(found[t])
        store(pool[0], LANES * t, load16(blocks, b * BLOCK))
        store(pool[1], LANES * t, load16(blocks, b * BLOCK + LANES))
        store(pool[2], LANES * t, load16(blocks, b * BLOCK + 2 * LANES))
        store(pool[3], LANES * t, load16_int(numbers, b * LANES))


@inline
def _query(batch: Batch, slot: int) -> Query:
    """Return the scaled coordinates of query `slot` of a batch, whose first array holds blocks of 16 queries."""
    queries, at = batch[0], slot // LANES * BLOCK + slot % LANES
    return queries[at], queries[at + LANES], queries[at + 2 * LANES]


@inline
def _row(batch: Batch, slot: int) -> int:
    """Return the output row of query `slot` of a batch: its number, or without numbers its index in the batch."""
    return i64(batch[1][slot]) if len(batch[1]) > 0 else slot - batch[2]


@inline
def _box(batch: Batch, block: int, count: int) -> tuple[Query, Query]:
    """Return the bounding box, its minimum and its maximum, of the first `count` queries of a block of 16."""
    low = high = _query(batch, block * LANES)
    for slot in range(block * LANES + 1, block * LANES + count):
        q = _query(batch, slot)
        low = min(low[0], q[0]), min(low[1], q[1]), min(low[2], q[2])
        high = max(high[0], q[0]), max(high[1], q[1]), max(high[2], q[2])
    return low, high


@inline
def _search_single(tree: Tree, batch: Batch, slot: int, k: int, memory: Memory, rows: Rows) -> float:
    """Find and write the k nearest points of query `slot` alone; return the squared distance of the farthest.

    tree : blocks of 16 points, their numbers, nodes of bounding boxes, first node of each level
    batch : blocks of 16 queries, their numbers (perhaps none), and the index of the first query
    rows : factor from scaled to true distances; flat array that receives distances, or is empty; flat array that
        receives point numbers
    """
    best = memory[4]
    farthest = search_alone(tree, _query(batch, slot), k, memory[5], best)
    unit, distances, indices = rows
    at = k * _row(batch, slot)
    for j in range(k):
        indices[at + j] = best[1][j]
        if len(distances) > 0:
            distances[at + j] = f32(math.sqrt(best[0][j]) * unit)
    return farthest


@inline
def _search_pool(
    batch: Batch, block: int, waiting: Bits, end: int, k: int, limit: float, memory: Memory, rows: Rows
) -> tuple[Bits, float]:
    """Find and write the k nearest points of those queries of a block that have k points within a distance.

    Returns the queries that remain, as bits, and the largest squared distance of a neighbour that was found.

    batch, block : blocks of 16 queries, their numbers (perhaps none), and the first query; number of the block
    waiting : queries of the block to answer, as bits
    end : number of points in the memory's pool, which holds all points within the distance
    limit : square of the distance
    rows : factor from scaled to true distances; flat array that receives distances, or is empty; flat array that
        receives point numbers
    """
    pool, packed, ranked, line = memory[0], memory[1], memory[2], memory[3]
    left, near, needed = waiting, limit / BEYOND, 0.0
    while left != 0:
        one = count_trailing_zeros(left)
        left &= left - 1
        q = _query(batch, block * LANES + one)
        measure_all(q, pool, end)
        bound = bound_for(pool[4], end, k, near * BEYOND, limit)
        if bound >= 0.0:
            inside = pack_within(pool, end, bound, packed)
            rank(q, packed, inside, ranked)
            near = write_ranked(ranked, packed, inside, k, line, k * _row(batch, block * LANES + one), rows)
            needed = max(needed, near)
            waiting ^= 1 << one
    return waiting, needed


@inline
def _search_block(
    tree: Tree, batch: Batch, block: int, count: int, k: int, limit: float, memory: Memory, rows: Rows
) -> float:
    """Find and write the k nearest points of the queries of a block; return the largest squared distance found.

    tree : blocks of 16 points, their numbers, nodes of bounding boxes, first node of each level
    batch : blocks of 16 queries, their numbers (perhaps none), and the index of the first query
    count : number of queries of the block, at most 16
    limit : squared distance to search first; if not positive, it is taken from a single query
    rows : factor from scaled to true distances; flat array that receives distances, or is empty; flat array that
        receives point numbers
    """
    low, high = _box(batch, block, count)
    waiting, needed, tried, is_measured = (1 << count) - 1, 0.0, 0, False
    while waiting != 0 and tried < TRIES:
        if limit <= 0.0:
            one, is_measured = count_trailing_zeros(waiting), True
            needed = max(needed, _search_single(tree, batch, block * LANES + one, k, memory, rows))
            waiting &= waiting - 1
            limit = needed * BEYOND
        collected = _collect(tree, low, high, limit, memory[5], memory[6])
        if collected >= 0:
            _pool(tree, memory[6], collected, memory[0])
            waiting, greatest = _search_pool(batch, block, waiting, collected * LANES, k, limit, memory, rows)
            needed, limit = max(needed, greatest), limit * FARTHER
        if collected < 0 or limit == 0.0:
            tried, limit = TRIES if is_measured else tried, 0.0
        tried += 1
    while waiting != 0:
        needed = max(
            needed, _search_single(tree, batch, block * LANES + count_trailing_zeros(waiting), k, memory, rows)
        )
        waiting &= waiting - 1
    return needed


@kernel
def find_nearest(work: Array, tree: Tree, batch: Batch, end: int, k: int, rows: Rows) -> None:
    """Write the k nearest points of all queries before `end` to their rows, nearest first.

    work : gives each thread its next tile, 64 blocks of 16 queries
    tree : blocks of 16 points, numbers of the points, nodes of bounding boxes, first node of each level
    batch : blocks of 16 queries, their numbers, and the first query, a multiple of 16; if there are no numbers (an
        empty array), queries are numbered from the first
    rows : factor from scaled to true distances; flat array that receives distances, or is empty; flat array that
        receives point numbers; row i of both begins at k times i
    """
    tree, batch, rows = borrow(tree), borrow(batch), borrow(rows)
    most = SPARE + k // PER_NEIGHBOR
    size = LANES * (most + 2)
    reals, wholes, doubles = np.empty((9, size), np.float32), np.empty((4, size), np.int32), np.empty((2, size))
    stack, squares, found = np.empty((STACK, 2), np.int64), np.empty(STACK), np.empty(most, np.int32)
    pool, packed = (reals[0], reals[1], reals[2], wholes[0], reals[3]), (reals[4], reals[5], reals[6], wholes[1])
    ranked, alone = (reals[7], doubles[0], doubles[1], wholes[2]), (doubles[0], wholes[3], squares, reals[8])
    memory = borrow((pool, packed, ranked, wholes[3], alone, stack, found))
    tile = next_tile(work)
    while tile >= 0:
        needed, first = 0.0, batch[2] // LANES + tile * CHUNK
        for block in range(first, min(first + CHUNK, -(-end // LANES))):
            count = min(LANES, end - block * LANES)
            needed = _search_block(tree, batch, block, count, k, needed * BEYOND, memory, rows)
        tile = next_tile(work)
    keep_alive((reals, wholes, doubles, stack, squares, found))
