"""Signs of normals: passed from point to point inside parts, from part to part by votes, and outward as a last resort.

Two points with normals n and m and the connecting unit vector e obey the reflection rule (Koenig and Gumhold 2009) if
their signs agree: n - 2 (n.e) e faces the same side as m. The rule holds around a rim too, where n.m alone misleads.
Edges that leave the tangent planes count less, as they cross a thin sheet. Where the rule says the opposite of n.m, the
mean of both counts: two layers of one noisy wall are no thin body (of a tower's wall 41% faced away).

The work is local: a part is a stretch of the kd order, and its edges are sorted and joined alone. The resulting
pieces vote on each other with all edges between them. In each round a piece joins the neighbour with the clearest
vote, and the votes of joined pieces are added up. A vote is clear if it is large, and little of it was contradicted.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...jit import Array, borrow, f32, i64, inline, kernel, next_tile, run
from ...simd import ONE, ZERO, Real, gather_rows8, load_apart16, select, store, vmax, vsqrt

Floats = NDArray[np.float32]
Signs = NDArray[np.int8]
Reals: TypeAlias = tuple[Real, Real, Real]

NEAR = 11  # neighbours that signs pass to, the point itself first: with 7 the dragon falls into 28 groups
PART = 2048  # points: with 4,096, 5.3% of a layered wall face away, not 4.2%
LEVELS = 256  # steps of confidence inside a part
SURE = 0.95  # confidence from which a part's points join without a vote: 0.5% of Lucy are flipped; 1.8 to 22% at 0.5
TINY = f32(1e-37)  # a square of a distance is not less
UNITED = 0.8  # a vote is as clear as its share that nothing contradicts, to this power, times its size to the rest


@inline
def _dot(a: Reals, b: Reals) -> Real:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def _agreement(e: Reals, n: Reals, m: Reals) -> Real:
    """Signed confidence that two normals a vector e apart face the same side, -1 to 1; of one pair or of 16."""
    square, a, b, nm = _dot(e, e), _dot(n, e), _dot(m, e), _dot(n, m)
    inverse = ONE / vmax(square, square * ZERO + TINY)
    steep = vsqrt(vmax(a * a, b * b) * inverse)
    reflected = nm - f32(2.0) * a * b * inverse
    mean = f32(0.5) * (nm + reflected)
    reflected = select(reflected * nm < ZERO, mean, reflected)
    return reflected * vmax(ONE - steep, square * ZERO)


@inline
def agreement(positions: Array, normals: Array, i: int, j: int) -> float:
    """Signed confidence that the normals of two points face the same side, -1 to 1."""
    n, m = (normals[i, 0], normals[i, 1], normals[i, 2]), (normals[j, 0], normals[j, 1], normals[j, 2])
    e = positions[j, 0] - positions[i, 0], positions[j, 1] - positions[i, 1], positions[j, 2] - positions[i, 2]
    return _agreement(e, n, m)


@inline
def _agreements(table: Array, near: Array, first: int, q: int, k: int, out: Array) -> None:
    """Write the confidence of 16 points that follow each other in their q-th neighbours, of k.

    table : flat, a row of eight for each point, its position and its normal first
    """
    at = 8 * first
    n = load_apart16(table, at + 3, 8), load_apart16(table, at + 4, 8), load_apart16(table, at + 5, 8)
    x, y, z, u, v, w, _, _ = gather_rows8(table, near, first * k + q, k)
    x = x - load_apart16(table, at, 8)
    y = y - load_apart16(table, at + 1, 8)
    z = z - load_apart16(table, at + 2, 8)
    store(out, 0, _agreement((x, y, z), n, (u, v, w)))


@inline
def _climb(parent: Array, sign: Array, i: int) -> tuple[int, int]:
    """The root above i, and the sign between them."""
    s = 1
    while parent[i] != i:
        s *= sign[i]
        i = parent[i]
    return i, s


@inline
def _climb_halving(parent: Array, sign: Array, i: int) -> tuple[int, int]:
    """`_climb`, which halves the way for those that follow."""
    s = 1
    while parent[i] != i:
        above = parent[i]
        sign[i] *= sign[above]
        parent[i] = parent[above]
        s *= sign[i]
        i = parent[i]
    return i, s


@kernel
def _join_parts(work: Array, table: Array, near: Array, k: int, parent: Array, sign: Array) -> int:
    """Join each part's sure edges, surest first; parent[i]: the root of i's piece, sign[i]: the sign to it.

    table : flat, see `_agreements`, with rows for whole lanes; near : flat, k for each row of the table
    """
    table, near, parent, sign = borrow(table), borrow(near), borrow(parent), borrow(sign)
    n, lanes = len(parent), np.empty(16, np.float32)
    size = np.empty(PART, np.int32)
    vote = np.empty(PART * (k - 1), np.int16)
    order = np.empty(PART * (k - 1), np.int32)
    start = np.empty(LEVELS + 2, np.int64)
    tile = next_tile(work)
    while tile >= 0:
        first = tile * PART
        last = min(first + PART, n)
        start[:] = 0
        for i in range(first, last):
            parent[i], sign[i], size[i - first] = i, 1, 1
        for i in range(first, last, 16):
            for q in range(1, k):
                _agreements(table, near, i, q, k, lanes)
                for lane in range(min(16, last - i)):
                    j, v = near[(i + lane) * k + q], lanes[lane]
                    level = int(min(abs(v), 1.0) * LEVELS) if first <= j < last and abs(v) > SURE else 0
                    vote[(i + lane - first) * (k - 1) + q - 1] = level if v >= 0.0 else -level
                    start[LEVELS - level + 1] += 1
        for level in range(LEVELS):
            start[level + 1] += start[level]
        for t in range((last - first) * (k - 1)):
            level = LEVELS - abs(vote[t])
            if level < LEVELS:
                order[start[level]] = t
                start[level] += 1
        for u in range(start[LEVELS - 1]):
            t = order[u]
            i, j = first + t // (k - 1), i64(near[(first + t // (k - 1)) * k + t % (k - 1) + 1])
            if parent[i] == parent[j]:  # so it is for most edges: half the time
                continue
            a, s = _climb_halving(parent, sign, i)
            b, r = _climb_halving(parent, sign, j)
            if a != b:
                if size[a - first] < size[b - first]:
                    a, b = b, a
                parent[b] = a
                sign[b] = s * r * (1 if vote[t] > 0 else -1)
                size[a - first] += size[b - first]
        for i in range(first, last):
            a, s = _climb(parent, sign, i)
            order[i - first] = a
            vote[i - first] = s
        for i in range(first, last):
            parent[i], sign[i] = order[i - first], vote[i - first]
        tile = next_tile(work)
    return 0


@kernel
def _count_votes(work: Array, near: Array, piece: Array, counts: Array) -> int:
    """Write to counts[part] the number of edges that leave their piece."""
    tile = next_tile(work)
    while tile >= 0:
        count = 0
        for i in range(tile * PART, min((tile + 1) * PART, near.shape[0])):
            for q in range(1, near.shape[1]):
                count += piece[i] != piece[near[i, q]]
        counts[tile] = count
        tile = next_tile(work)
    return 0


@kernel
def _cast_votes(
    work: Array,
    positions: Array,
    normals: Array,
    near: Array,
    piece: Array,
    sign: Array,
    starts: Array,
    pairs: Array,
    votes: Array,
) -> int:
    """List the edges between pieces as pairs of pieces, lower one first, with their signed confidence."""
    positions, normals, near, piece, sign = (
        borrow(positions),
        borrow(normals),
        borrow(near),
        borrow(piece),
        borrow(sign),
    )
    tile = next_tile(work)
    while tile >= 0:
        t = starts[tile]
        for i in range(tile * PART, min((tile + 1) * PART, near.shape[0])):
            for q in range(1, near.shape[1]):
                j = near[i, q]
                a, b = i64(piece[i]), i64(piece[j])
                if a != b:
                    pairs[t] = (min(a, b) << 32) | max(a, b)
                    votes[t] = agreement(positions, normals, i, j) * (sign[i] * sign[j])
                    t += 1
        tile = next_tile(work)
    return 0


@kernel
def _join_clearest(
    one: Array, other: Array, votes: Array, clear: Array, best: Array, parent: Array, sign: Array
) -> int:
    """Join each piece with the neighbour whose vote is clearest; returns the number of joins."""
    best[:] = -1
    for t in range(len(votes)):
        for p in (one[t], other[t]):
            if best[p] < 0 or clear[t] > clear[best[p]]:
                best[p] = t
    joins = 0
    for p in range(len(best)):
        t = best[p]
        if t >= 0:
            a, s = _climb(parent, sign, one[t])
            b, r = _climb(parent, sign, other[t])
            if a != b:
                parent[b] = a
                sign[b] = s * r * (1 if votes[t] >= 0.0 else -1)
                joins += 1
    return joins


@kernel
def _flatten(parent: Array, sign: Array) -> int:
    """Make every parent a root; paths are halved on the way, so that long ones do not cost quadratic time."""
    for i in range(len(parent)):
        while parent[parent[i]] != parent[i]:
            sign[i] *= sign[parent[i]]
            parent[i] = parent[parent[i]]
    return 0


def agree(positions: Floats, normals: Floats, near: NDArray[np.int32]) -> tuple[Signs, NDArray[np.int64]]:
    """Signs with which neighbouring normals agree, and the connected group of each point.

    Parameters
    ----------
    positions : (n, 3) float32
        In kd order.
    normals : (n, 3) float32, unit
    near : (n, k) int32
        Rows of the neighbours, the point itself first.

    Returns
    -------
    signs : (n,) int8
        1 or -1; all signs of a group together may be wrong.
    groups : (n,) int64
        From 0.
    """
    n, tiles = len(positions), -(-len(positions) // PART)
    parent, sign = np.empty(n, np.int32), np.empty(n, np.int8)
    run(_join_parts, tiles, *_for_lanes(positions, normals, near), near.shape[1], parent, sign)
    is_root = parent == np.arange(n, dtype=np.int32)
    piece = (np.cumsum(is_root, dtype=np.int32) - 1)[parent]
    counts = np.zeros(tiles, np.int64)
    run(_count_votes, tiles, near, piece, counts)
    starts = np.concatenate([[0], np.cumsum(counts)])
    pairs, votes = np.empty(starts[-1], np.int64), np.empty(starts[-1], np.float32)
    run(_cast_votes, tiles, positions, normals, near, piece, sign, starts, pairs, votes)
    group, turn = _join_pieces(int(is_root.sum()), pairs, votes)
    return sign * turn[piece], group[piece]


def _for_lanes(positions: Floats, normals: Floats, near: NDArray[np.int32]) -> tuple[Floats, NDArray[np.int32]]:
    """The table and the neighbours that `_join_parts` reads, with rows for whole lanes; those beyond are empty."""
    n, rows = len(positions), -(-len(positions) // 16) * 16
    table = np.zeros((rows, 8), np.float32)
    table[:n, :3], table[:n, 3:6] = positions, normals
    if rows > n:
        near = np.concatenate([near, np.zeros((rows - n, near.shape[1]), np.int32)])
    return table.reshape(-1), np.ascontiguousarray(near).reshape(-1)


def _join_pieces(count: int, pairs: NDArray[np.int64], votes: Floats) -> tuple[NDArray[np.int64], Signs]:
    """The group of each piece and its sign in it, by rounds of joins; votes are added up anew after each round."""
    group, turn = np.arange(count), np.ones(count, np.int8)
    mass = np.abs(votes)
    while len(pairs):
        pairs, sums, mass = _add_up(pairs, votes, mass)
        size = int(group.max()) + 1
        parent, sign = np.arange(size), np.ones(size, np.int8)
        one, other = pairs >> 32, pairs & 0xFFFFFFFF
        clear = np.abs(sums) / np.maximum(mass, f32(1e-30)) ** f32(UNITED)
        _join_clearest(one, other, sums, clear, np.empty(size, np.int64), parent, sign)
        _flatten(parent, sign)
        roots, number = np.unique(parent, return_inverse=True)
        turn *= sign[group]
        group = number[group]
        a, b = number[one], number[other]
        outer = a != b
        votes, mass = (sums * sign[one] * sign[other])[outer], mass[outer]
        pairs = ((np.minimum(a, b) << 32) | np.maximum(a, b))[outer]
    return group, turn


def _add_up(pairs: NDArray[np.int64], *votes: Floats) -> tuple[NDArray[Any], ...]:
    """Each pair once, and the sums of its votes."""
    order = np.argsort(pairs, kind="stable")
    sorted_pairs = pairs[order]
    first = np.flatnonzero(np.diff(sorted_pairs, prepend=-1))
    return sorted_pairs[first], *(np.add.reduceat(each[order], first) for each in votes)
