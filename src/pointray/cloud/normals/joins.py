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
    """Votes between pieces (sets of points whose normals agree), in tables that are read one at a time.

    A vote says how clearly the normals of two pieces face the same side, or opposite sides.
    """

    def __iter__(self) -> Iterator[Votes]:
        """Yield the tables of votes in the order of their pairs of pieces (sets of points); each pair occurs once."""

    def changed(self, change: Callable[[Votes], Votes], pieces: int) -> VoteTables:
        """Return the votes after `change` is applied to each table, with the votes of equal pairs added up.

        change : replaces pieces (sets of points whose normals agree) by larger ones they were joined to
        pieces : number of pieces afterwards
        """


class InMemoryVotes:
    """Votes between pieces (sets of points whose normals agree) of a cloud in memory, in one table.

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
def _choose(pairs: Array, sums: Array, clear: Array, best: Array, partner: Array) -> None:
    """Find the neighbour of each piece with which it agrees, or disagrees, most clearly, from a table of votes.

    A piece is a set of points whose normals agree. Called for one table after another to update the results. The
    first of equally clear neighbours counts.

    pairs : (e,) 2^32 times the lower piece, plus the other one
    sums : (e,) signed votes, positive where the two agree
    clear : (e,) clarity of each vote, large if the vote is large and hardly contradicted
    best : (p,) clarity of the clearest vote so far, -1 if there is none; updated
    partner : (p,) the neighbour of that vote, or -1 minus it if the two disagree; updated
    """
    for t in range(len(pairs)):
        one, other = pairs[t] >> 32, pairs[t] & 0xFFFFFFFF
        for p, q in ((one, other), (other, one)):
            if clear[t] > best[p]:
                best[p] = clear[t]
                partner[p] = q if sums[t] >= 0 else -1 - q


@kernel
def _join(partner: Array, parent: Array, sign: Array) -> None:
    """Join each piece (points whose normals agree) with its chosen neighbour in a forest of groups (union-find).

    partner : (p,) the neighbour, -1 minus it if the two face opposite sides, or the piece itself if it has none
    parent, sign : (p,) the forest: each piece's parent, and 1 or -1, whether it faces the same side as that
    """
    for p in range(len(partner)):
        if partner[p] == p:
            continue
        agree, q = (1, i64(partner[p])) if partner[p] >= 0 else (-1, -1 - i64(partner[p]))
        a, s = climb(parent, sign, min(p, q))
        b, r = climb(parent, sign, max(p, q))
        if a != b:
            parent[b] = a
            sign[b] = s * r * agree


@kernel
def _number(parent: Array, sign: Array, number: Array) -> int:
    """Number the groups of joined pieces (sets of points whose normals agree); return the number of groups.

    They are numbered in the order of their roots. Paths are halved on the way, which avoids quadratic time.

    parent : (p,) each piece's parent in its group
    sign : (p,) 1 or -1, whether a piece faces the same side as its parent; afterwards, as the root
    number : (p,) receives the group of each piece
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
    """Join each piece (points whose normals agree) with the neighbour of the clearest vote, once.

    Returns the group of each piece, (pieces,); 1 or -1, by which its normals are multiplied to agree within the group,
    (pieces,); the number of groups.

    pieces : number of pieces
    tables : votes between them
    """
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
    """Join pieces (sets of points whose normals agree) to groups, round by round, along the clearest votes.

    Parameters
    ----------
    pieces : int
        Number of pieces.
    tables : VoteTables
        Votes between them, of all parts of the cloud.

    Returns
    -------
    group : (pieces,) int32
        Group of each piece, numbered from 0; pieces that no votes connect are in different groups.
    turn : (pieces,) int8
        1 or -1, by which the normals of each piece are multiplied to agree within the group.
    """
    number, turn, size = _joined(pieces, tables)
    group, sign, before = number.astype(np.int32), turn, pieces
    while size < before:  # while there were votes
        tables, before = tables.changed(partial(merge_votes, number=number, sign=sign), size), size
        number, sign, size = _joined(before, tables)
        turn *= sign[group]
        group = number.astype(np.int32)[group]
    return group, turn
