"""Signs of normals: passed from point to point inside parts, from part to part by votes, and outward as a last resort.

Two points with normals n and m and the connecting unit vector e obey the reflection rule (Koenig and Gumhold 2009) if
their signs agree: n - 2 (n.e) e faces the same side as m. The rule holds around a rim too, where n.m alone misleads.
Edges that leave the tangent planes count less, as they cross a thin sheet. Where the rule says the opposite of n.m, the
mean of both counts: two layers of one noisy wall are no thin body (of a tower's wall 41% faced away).

The work is local: a part is a stretch of the Morton curve, and its edges are sorted and joined alone. The resulting
pieces vote on each other with all edges between them. In each round a piece joins the neighbour with the clearest
vote, and the votes of joined pieces are added up. A vote is clear if it is large, and little of it was contradicted.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...jit import Array, borrow, f32, f64, i64, inline, kernel, next_tile, run

Floats = NDArray[np.float32]
Signs = NDArray[np.int8]

NEAR = 11  # neighbours that signs pass to, the point itself first: with 7 the dragon falls into 28 groups
PART = 4096  # points
LEVELS = 256  # steps of confidence inside a part
SURE = 0.95  # confidence from which a part's points join without a vote: 0.5% of Lucy are flipped; 1.8 to 22% at 0.5
UNITED = 0.8  # a vote is as clear as its share that nothing contradicts, to this power, times its size to the rest


@inline
def agreement(positions: Array, normals: Array, i: int, j: int) -> float:
    """Signed confidence that two normals face the same side, -1 to 1."""
    square = nm = a = b = 0.0
    for c in range(3):
        e = f64(positions[j, c]) - f64(positions[i, c])
        square += e * e
        a += normals[i, c] * e
        b += normals[j, c] * e
        nm += normals[i, c] * normals[j, c]
    if square == 0.0:
        return nm
    steep = max(abs(a), abs(b)) / math.sqrt(square)
    reflected = nm - 2.0 * a * b / square
    if reflected * nm < 0.0:
        reflected = 0.5 * (nm + reflected)
    return reflected * max(1.0 - steep, 0.0)


@inline
def _climb(parent: Array, sign: Array, i: int) -> tuple[int, int]:
    """The root above i, and the sign between them."""
    s = 1
    while parent[i] != i:
        s *= sign[i]
        i = parent[i]
    return i, s


@kernel
def _join_parts(work: Array, positions: Array, normals: Array, near: Array, parent: Array, sign: Array) -> int:
    """Join each part's sure edges, surest first; parent[i]: the root of i's piece, sign[i]: the sign to it."""
    positions, normals, near = borrow(positions), borrow(normals), borrow(near)
    parent, sign = borrow(parent), borrow(sign)
    n, k = near.shape
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
            for q in range(1, k):
                j = near[i, q]
                v = agreement(positions, normals, i, j) if first <= j < last else 0.0
                level = int(min(abs(v), 1.0) * LEVELS) if abs(v) > SURE else 0
                vote[(i - first) * (k - 1) + q - 1] = level if v >= 0.0 else -level
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
            a, s = _climb(parent, sign, first + t // (k - 1))
            b, r = _climb(parent, sign, near[first + t // (k - 1), t % (k - 1) + 1])
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
        Along a Morton curve.
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
    run(_join_parts, tiles, positions, normals, near, parent, sign)
    roots, piece = np.unique(parent, return_inverse=True)
    piece = piece.astype(np.int32)
    counts = np.zeros(tiles, np.int64)
    run(_count_votes, tiles, near, piece, counts)
    starts = np.concatenate([[0], np.cumsum(counts)])
    pairs, votes = np.empty(starts[-1], np.int64), np.empty(starts[-1], np.float32)
    run(_cast_votes, tiles, positions, normals, near, piece, sign, starts, pairs, votes)
    group, turn = _join_pieces(len(roots), pairs, votes)
    return sign * turn[piece], group[piece]


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
