"""Votes of the edges between pieces, summed as integers, so that the result does not depend on the order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
from ...engine.jit import Array, borrow, i64, kernel, next_tile, run
from .agreement import agreement

Arrays: TypeAlias = tuple[Array, Array]

CHUNK = 2048  # points whose edges a thread handles at a time
STEPS = 1 << 24  # units of a full vote, near float32 precision; 256 votes of each of 2^31 points add up to 2^63


class Votes(NamedTuple):
    """Votes between pieces (sets of points whose normals agree): do the normals of two pieces face the same side?

    pairs : (e,) int64, ascending, each pair once: 2^32 times the lower piece, plus the other one
    sums : (e,) int64, signed votes in units of 2^-24, positive where the two agree
    masses : (e,) int64, sums of absolute votes
    """

    pairs: Rows
    sums: Rows
    masses: Rows


@kernel
def _count_votes(work: Array, near: Array, core: int, piece: Array, counts: Array) -> None:
    """Write to counts[tile] the number of edges to neighbours in another piece (set of points whose normals agree).

    work : gives each thread its next tile, 2048 points
    near : (m, k) rows of the neighbours of the points from row `core` on, themselves first
    piece : (n,) piece of each row
    """
    tile = next_tile(work)
    while tile >= 0:
        count = 0
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, near.shape[0])):
            for q in range(1, near.shape[1]):
                count += piece[core + i] != piece[near[i, q]]
        counts[tile] = count
        tile = next_tile(work)


@kernel
def _cast_votes(
    work: Array, cloud: Arrays, near: Array, core: int, labels: Arrays, starts: Array, pairs: Array, votes: Array
) -> None:
    """List the edges between neighbours in different pieces (sets of points whose normals agree), and their votes.

    work : gives each thread its next tile, 2048 points
    cloud : positions and normals, (n, 3) each
    near : (m, k) rows of the neighbours of the points from row `core` on, themselves first
    labels : piece of each row, and 1 or -1, by which its normal is multiplied to agree with the piece, (n,) each
    starts : (tiles,) index of each tile's first edge
    pairs : (e,) receives 2^32 times the lower piece, plus the other one
    votes : (e,) receives the signed confidence that the two face the same side, in units of 2^-24
    """
    (positions, normals), (piece, sign) = borrow(cloud), borrow(labels)
    near = borrow(near)
    tile = next_tile(work)
    while tile >= 0:
        t = starts[tile]
        for row in range(tile * CHUNK, min((tile + 1) * CHUNK, near.shape[0])):
            i = core + row
            for q in range(1, near.shape[1]):
                j = near[row, q]
                a, b = i64(piece[i]), i64(piece[j])
                if a != b:
                    v = agreement(positions, normals, i, j) * (sign[i] * sign[j])
                    pairs[t] = (min(a, b) << 32) | max(a, b)
                    votes[t] = round(min(max(v, -1.0), 1.0) * STEPS)
                    t += 1
        tile = next_tile(work)


def cast_votes(
    positions: Floats,
    normals: Floats,
    near: NDArray[np.int32],
    core: slice,
    piece: NDArray[np.int32],
    sign: NDArray[np.int8],
) -> Votes:
    """Sum up the votes of some points' edges to neighbours in other pieces (sets of points whose normals agree).

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32, unit
    near : (m, k) int32
        Rows of the neighbours of each point of the core, itself first.
    core : slice
        The m points.
    piece : (n,) int32
        Piece of each row, numbered across the whole cloud.
    sign : (n,) int8
        1 or -1, by which the normal of each row is multiplied to agree with its piece.
    """
    tiles = -(-len(near) // CHUNK)
    counts = np.zeros(tiles, np.int64)
    run(_count_votes, tiles, near, core.start, piece, counts)
    starts = np.concatenate([[0], np.cumsum(counts)])
    pairs, votes = np.empty(starts[-1], np.int64), np.empty(starts[-1], np.int32)
    run(_cast_votes, tiles, (positions, normals), near, core.start, (piece, sign), starts, pairs, votes)
    return _add_up(pairs, votes, np.abs(votes))


def sum_votes(votes: Sequence[Votes]) -> Votes:
    """Add up the votes of several tables for equal pairs of pieces (sets of points whose normals agree)."""
    if len(votes) == 1:
        return votes[0]
    return _add_up(*(np.concatenate(arrays) for arrays in zip(*votes, strict=True)))


def merge_votes(votes: Votes, number: Rows, sign: NDArray[np.int8]) -> Votes:
    """Return the votes between larger pieces (sets of points whose normals agree) that consist of the given ones.

    number : (p,) larger piece that each piece belongs to
    sign : (p,) 1 or -1, by which its normals are multiplied to agree with the larger piece
    """
    one, other = votes.pairs >> 32, votes.pairs & 0xFFFFFFFF
    a, b = number[one], number[other]
    outer = a != b
    pairs, sums = (np.minimum(a, b) << 32) | np.maximum(a, b), votes.sums * sign[one] * sign[other]
    return _add_up(pairs[outer], sums[outer], votes.masses[outer])


def _add_up(pairs: Rows, sums: NDArray[Any], masses: NDArray[Any]) -> Votes:
    """Sum up the votes of equal pairs of pieces (sets of points whose normals agree).

    pairs : (e,) 2^32 times the lower piece, plus the other one; in any order
    sums, masses : (e,) signed and absolute votes
    """
    order = np.argsort(pairs, kind="stable")
    pairs = pairs[order]
    first = np.flatnonzero(np.diff(pairs, prepend=-1))
    if not len(first):  # `reduceat` needs at least one
        return Votes(pairs, *np.zeros((2, 0), np.int64))
    added = (np.add.reduceat(each[order], first, dtype=np.int64) for each in (sums, masses))
    return Votes(pairs[first], *added)
