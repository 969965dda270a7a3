"""Joins: pieces are merged into groups, in rounds, along the clearest votes.

In each round a piece joins the neighbour with the clearest vote, and the votes of joined pieces are added up. A vote is
clear if it is large and hardly contradicted.

Votes come in tables, one of which is in memory at a time. Pieces take at most 13 bytes each, in the first round.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...engine.jit import Array, i64, kernel
from .pieces import climb
from .votes import Votes, merge_votes, sum_votes

UNITED = 0.8  # clarity of a vote: its unopposed share to this power, times its size to the rest


class VoteTables(Protocol):
    """Votes of all pairs of pieces, in tables."""

    def __iter__(self) -> Iterator[Votes]:
        """Yield tables in the order of their pairs; each pair occurs once."""

    def changed(self, change: Callable[[Votes], Votes], pieces: int) -> VoteTables:
        """Return all tables transformed; votes of equal pairs are added up. pieces : number of pieces afterwards"""


class InMemoryVotes:
    """Votes in memory, in one table.

    Parameters
    ----------
    votes : sequence of Votes
        Of the parts of the cloud.
    """

    def __init__(self, votes: Sequence[Votes]) -> None:
        self._all = sum_votes(votes)

    def __iter__(self) -> Iterator[Votes]:
        yield self._all

    def changed(self, change: Callable[[Votes], Votes], pieces: int) -> InMemoryVotes:
        return InMemoryVotes([change(self._all)])


@kernel
def _choose(pairs: Array, sums: Array, clear: Array, best: Array, partner: Array) -> int:
    """Find each piece's neighbour with the clearest vote, the first of equal ones; may be called for several tables.

    best : (p,) clarity of the best vote so far; -1: none
    partner : (p,) the neighbour, or -1 minus it if the two disagree
    """
    for t in range(len(pairs)):
        one, other = pairs[t] >> 32, pairs[t] & 0xFFFFFFFF
        for p, q in ((one, other), (other, one)):
            if clear[t] > best[p]:
                best[p] = clear[t]
                partner[p] = q if sums[t] >= 0 else -1 - q
    return 0


@kernel
def _join(partner: Array, parent: Array, sign: Array) -> int:
    """Join each piece with its partner, if it has one."""
    for p in range(len(partner)):
        if partner[p] == p:
            continue
        agree, q = (1, i64(partner[p])) if partner[p] >= 0 else (-1, -1 - i64(partner[p]))
        a, s = climb(parent, sign, min(p, q))
        b, r = climb(parent, sign, max(p, q))
        if a != b:
            parent[b] = a
            sign[b] = s * r * agree
    return 0


@kernel
def _number(parent: Array, sign: Array, number: Array) -> int:
    """Number the groups by the order of their roots and write each piece's group; return the number of groups.

    sign : relative to the parent, then to the root. Paths are halved on the way, which avoids quadratic time.
    """
    count = 0
    for i in range(len(parent)):
        while parent[parent[i]] != parent[i]:
            sign[i] *= sign[parent[i]]
            parent[i] = parent[parent[i]]
        if parent[i] == i:
            number[i] = count
            count += 1
    for i in range(len(parent)):
        number[i] = number[parent[i]]
    return count


def _joined(pieces: int, tables: VoteTables) -> tuple[NDArray[np.int64], NDArray[np.int8], int]:
    """Join pieces for one round; return the group of each piece, its sign in it, and the number of groups."""
    best, partner = np.full(pieces, -1.0), np.arange(pieces, dtype=np.int32)
    for votes in tables:
        clear = np.abs(votes.sums) / np.maximum(votes.masses, 1) ** UNITED
        _choose(votes.pairs, votes.sums, clear, best, partner)
    del best
    parent, sign = np.arange(pieces, dtype=np.int32), np.ones(pieces, np.int8)
    _join(partner, parent, sign)
    del partner
    number = np.empty(pieces, np.int64)
    return number, sign, _number(parent, sign, number)


def join(pieces: int, tables: VoteTables) -> tuple[NDArray[np.int32], NDArray[np.int8]]:
    """Find the connected groups of pieces.

    Parameters
    ----------
    pieces : int
        Number of pieces.
    tables : Tables
        Votes of all parts of the cloud.

    Returns
    -------
    group : (pieces,) int32
        Group numbers, from 0.
    turn : (pieces,) int8
        1 or -1: sign of each piece in its group.
    """
    number, turn, size = _joined(pieces, tables)
    group, sign, before = number.astype(np.int32), turn, pieces
    while size < before:  # while there were votes
        tables, before = tables.changed(partial(merge_votes, number=number, sign=sign), size), size
        number, sign, size = _joined(before, tables)
        turn *= sign[group]
        group = number.astype(np.int32)[group]
    return group, turn
