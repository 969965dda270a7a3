"""Votes on disk: tables that fit into memory one at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ...base.arrays import Rows
from ...base.disk_columns import Columns
from ...cloud.normals.joins import InMemoryVotes, VoteTables
from ...cloud.normals.votes import Votes, sum_votes

PIECES = 1 << 18  # pieces per table; it has the votes of pairs whose lower piece is one of them, 5 to 10 for each

VOTES = "votes-"  # prefix of column names


class OnDiskVotes:
    """Votes on disk by which the signs of normals are joined across a whole cloud, as tables read one at a time.

    A vote states whether the normals of two pieces (connected points with consistent normals) agree. Each table holds
    the pairs whose lower piece is in one range. `VoteTables` is the interface.

    Parameters
    ----------
    columns : Columns
    names : sequence of str
        Columns of votes, written by `keep`; each pair occurs at most once per column.
    cuts : sequence of (t + 1,) int64
        Rows of each column at which its t tables begin and end, as `keep` returns them.
    """

    def __init__(self, columns: Columns, names: Sequence[str], cuts: Sequence[Rows]) -> None:
        self._columns, self._names, self._cuts = columns, names, cuts

    def __iter__(self) -> Iterator[Votes]:
        for k in range(len(self._cuts[0]) - 1):
            slices = [(name, slice(*cut[k : k + 2])) for name, cut in zip(self._names, self._cuts, strict=True)]
            found = [self._columns[name][rows] for name, rows in slices if rows.stop > rows.start]
            yield sum_votes([Votes(*np.ascontiguousarray(rows.T)) for rows in found or [np.empty((0, 3), np.int64)]])

    def changed(self, change: Callable[[Votes], Votes], pieces: int) -> VoteTables:
        """Return the votes after a change of each table, such as renumbering the pieces; the old columns are removed.

        change : called with the votes of a table; pieces : number of pieces afterwards; if few, votes are kept in
            memory
        """
        if pieces <= PIECES:
            return InMemoryVotes([change(votes) for votes in self])
        generation, names, cuts = _generation(self._names[0]) + 1, [], []
        for k, votes in enumerate(self):
            names.append(name_of(k, generation))
            cuts.append(keep(self._columns, names[-1], change(votes), pieces))
        for name in self._names:
            self._columns.drop(name)
        return OnDiskVotes(self._columns, names, cuts)


def keep(columns: Columns, name: str, votes: Votes, pieces: int) -> Rows:
    """Write votes to a new column on disk, as t tables one after the other; return the row at which each begins.

    A vote states whether the normals of two pieces (connected points with consistent normals) agree. A table holds the
    votes whose lower piece is in one range of pieces.

    name : name of the column; votes : the votes, sorted by pairs of pieces
    pieces : number of pieces in the whole cloud

    Returns
    -------
    (t + 1,) int64
        First row of each table in the column, then the number of rows.
    """
    columns.fill(name, np.stack(votes, axis=1))
    tables = max(-(-pieces // PIECES), 1)
    return np.searchsorted(votes.pairs, np.arange(tables + 1) * PIECES << 32)


def drop_all(columns: Columns) -> None:
    """Remove all columns on disk that hold votes on the signs of normals."""
    for name in columns.names:
        if name.startswith(VOTES):
            columns.drop(name)


def name_of(k: int, generation: int = 0) -> str:
    """Return the name of a column of votes.

    k : number of the part that the votes are from, or of the table; generation : how often the votes have been changed
    """
    return f"{VOTES}{generation:02d}-{k:04d}"


def _generation(name: str) -> int:
    return int(name.split("-")[1])
