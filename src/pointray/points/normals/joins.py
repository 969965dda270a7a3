"""Joins: pieces become groups, in rounds, along the clearest votes.

In each round a piece joins the neighbour with the clearest vote, and the votes of joined pieces are added up. A vote
is clear if it is large, and little of it was contradicted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...jit import Array, kernel
from .pieces import climb
from .votes import Votes, sum_of, turned

UNITED = 0.8  # a vote is as clear as its share that nothing contradicts, to this power, times its size to the rest


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
            a, s = climb(parent, sign, one[t])
            b, r = climb(parent, sign, other[t])
            if a != b:
                parent[b] = a
                sign[b] = s * r * (1 if votes[t] >= 0 else -1)
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


def join(pieces: int, votes: Sequence[Votes]) -> tuple[NDArray[np.int32], NDArray[np.int8]]:
    """The connected groups of pieces.

    Parameters
    ----------
    pieces : int
        How many there are.
    votes : sequence of Votes
        Those of all parts of the cloud.

    Returns
    -------
    group : (pieces,) int32
        From 0.
    turn : (pieces,) int8
        1 or -1: the sign of each piece in its group.
    """
    group, turn, left = np.arange(pieces, dtype=np.int32), np.ones(pieces, np.int8), sum_of(votes)
    size = pieces
    while len(left.pairs):
        parent, sign = np.arange(size), np.ones(size, np.int8)
        clear = np.abs(left.sums) / np.maximum(left.masses, 1) ** UNITED
        one, other = left.pairs >> 32, left.pairs & 0xFFFFFFFF
        _join_clearest(one, other, left.sums, clear, np.empty(size, np.int64), parent, sign)
        _flatten(parent, sign)
        is_root = parent == np.arange(size)
        number = (np.cumsum(is_root) - 1)[parent]
        turn *= sign[group]
        group = number[group].astype(np.int32)
        left, size = turned(left, number, sign), int(is_root.sum())
    return group, turn
