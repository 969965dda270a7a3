"""Ranking of the candidates of one query: distances, selection within a bound, and the rank of each candidate."""

from __future__ import annotations

import math
from typing import TypeAlias

from ...engine.jit import Array, f32, f64, i64, inline
from ...engine.simd import (
    bits,
    broadcast16,
    broadcast_from,
    count_bits,
    count_where,
    load8_double,
    load16,
    narrow,
    pack,
    square_sum,
    store,
    store_packed,
    widen_high,
    widen_low,
    zeros8,
    zeros16,
)
from .single import LESS, Query
from .sites import LANES

FARTHER, LEAST, NEARER = 1.7, 0.05, 0.75  # factors of a bound's square: growth, minimum and shrinkage
SMALLEST = 1e-45  # within a smaller bound are only candidates at the query; 0.75 times a subnormal can be the same
ENOUGH = 2  # times k: at most so many candidates are ranked without shrinking the bound

Pool: TypeAlias = tuple[Array, Array, Array, Array, Array]  # x, y, z, numbers and squared distances of all candidates
Packed: TypeAlias = tuple[Array, Array, Array, Array]  # x, y, z and numbers of those within the bound
Ranked: TypeAlias = tuple[Array, Array, Array, Array]  # float32 squares, float64 squares, numbers and ranks of these
Rows: TypeAlias = tuple[float, Array, Array]  # the output table, see `search.find_nearest`


@inline
def measure_all(q: Query, pool: Pool, end: int) -> None:
    """Write the squared distances of a query from all candidates (points near it) to the last array of the pool.

    pool : x, y, z, numbers and squared distances of the candidates
    end : number of candidates
    """
    for i in range(0, end, LANES):
        x, y, z = load16(pool[0], i) - q[0], load16(pool[1], i) - q[1], load16(pool[2], i) - q[2]
        store(pool[4], i, x * x + y * y + z * z)


@inline
def _count_within(squares: Array, end: int, bound: float) -> int:
    """Count the squared distances that are certainly within a bound, whatever their rounding errors.

    squares : float32 squared distances; end : how many there are
    """
    limit, count = broadcast16(f32(bound * LESS)), 0
    for i in range(0, end, LANES):
        count += count_bits(bits(load16(squares, i) <= limit))
    return count


@inline
def bound_for(squares: Array, end: int, k: int, guess: float, limit: float) -> float:
    """Find a squared distance within which a query has k candidates or slightly more; -1 if fewer are within `limit`.

    squares : squared distances of the candidates (points near the query); end : how many there are
    guess : squared distance to try first
    limit : squared distance within which all points are among the candidates
    """
    bound = min(guess, limit)
    count = _count_within(squares, end, bound)
    while count < k:
        if bound >= limit:
            return -1.0
        bound = min(max(FARTHER * bound, LEAST * limit), limit)
        count = _count_within(squares, end, bound)
    while count > ENOUGH * k + LANES:
        count = _count_within(squares, end, NEARER * bound)
        if count < k or bound < SMALLEST:
            break
        bound *= NEARER
    return bound


@inline
def pack_within(pool: Pool, end: int, bound: float, packed: Packed) -> int:
    """Copy the candidates within a bound to contiguous memory; return their number.

    pool : x, y, z, numbers and squared distances of the candidates; end : how many there are
    bound : largest squared distance
    packed : receives x, y, z and numbers
    """
    limit, count = broadcast16(f32(bound)), 0
    for i in range(0, end, LANES):
        near = load16(pool[4], i) <= limit
        if bits(near) != 0:
            store_packed(packed[0], count, near, load16(pool[0], i))
            store_packed(packed[1], count, near, load16(pool[1], i))
            store_packed(packed[2], count, near, load16(pool[2], i))
            count += pack(near, pool[3], i, packed[3], count)
    return count


@inline
def rank(q: Query, packed: Packed, count: int, ranked: Ranked) -> None:
    """Rank candidates by distance from query q: by float32 squares if these all differ, else by float64 squares.

    Candidates at equal distance are ranked by number.

    packed : x, y, z and numbers of the candidates; count : how many there are
    ranked : receives float32 squares, float64 squares, numbers (only if some are equally distant) and ranks from 0
    """
    keys, squares, numbers, ranks = ranked
    for i in range(0, count, LANES):
        x, y, z = load16(packed[0], i), load16(packed[1], i), load16(packed[2], i)
        a, b, c = f64(q[0]), f64(q[1]), f64(q[2])
        low = square_sum(widen_low(x) - a, widen_low(y) - b, widen_low(z) - c)
        high = square_sum(widen_high(x) - a, widen_high(y) - b, widen_high(z) - c)
        store(squares, i, low)
        store(squares, i + 8, high)
        store(keys, i, narrow(low, high))
    total = 0
    for i in range(0, count, LANES):
        mine, less = load16(keys, i), zeros16()
        for j in range(count):
            less = count_where(less, broadcast_from(keys, j) < mine)
        store(ranks, i, less)
        for j in range(i, min(i + LANES, count)):
            total += i64(ranks[j])
    if 2 * total != count * (count - 1):
        _rank_ties(packed[3], count, squares, numbers, ranks)


@inline
def _rank_ties(packed: Array, count: int, squares: Array, numbers: Array, ranks: Array) -> None:
    """Rank candidates by float64 squared distance, those at equal distance by number.

    packed, count : numbers of the candidates, and how many there are
    squares : float64 squared distances of the candidates
    numbers, ranks : receive the numbers, and the ranks from 0
    """
    for i in range(count):
        numbers[i] = packed[i]
    for i in range(0, count, 8):
        mine, own, less = load8_double(squares, i), load8_double(numbers, i), zeros8()
        for j in range(count):
            square, number = squares[j], numbers[j]
            less = count_where(less, (mine > square) | ((mine >= square) & (mine <= square) & (own > number)))
        store(ranks, i, less)


@inline
def write_ranked(ranked: Ranked, packed: Packed, count: int, k: int, line: Array, at: int, rows: Rows) -> float:
    """Write a query's k nearest points, in order of rank, to its row; return the squared distance of the farthest.

    ranked : squares and ranks of the candidates, from `rank`
    packed, count : x, y, z and numbers of the candidates, and how many there are
    line : memory for sorting
    at : index at which the query's row begins
    rows : factor from scaled to true distances; flat array that receives distances, or is empty; flat array that
        receives point numbers
    """
    _, squares, numbers, ranks = ranked
    unit, distances, indices = rows
    for i in range(count):
        line[ranks[i]], numbers[ranks[i]] = packed[3][i], squares[i]
    for j in range(k):
        indices[at + j] = line[j]
    if len(distances) > 0:
        for j in range(k):
            distances[at + j] = f32(math.sqrt(numbers[j]) * unit)
    return f64(numbers[k - 1])
