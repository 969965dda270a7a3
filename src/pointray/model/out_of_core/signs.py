"""Signs of normals of a cloud in parts, equal to those of `orient` for the whole cloud.

Each pass handles all parts, in any order or concurrently: its inputs are complete before it begins, and each part
writes only its own rows, always with the same values. Passes can thus be distributed, and resumed.

find       part -> number of pieces of its points
vote       part and the labels around it -> votes of its edges
gather     all of these -> groups of the whole cloud
examine    part -> which of its groups face inward, and samples of groups that extend into other parts
face       all of these -> which groups are inverted
write      labels of a part -> signs

Data with a row per point, piece, or pair of pieces stays in columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats, Rows
from ...base.disk_columns import Columns
from ...cloud.normals.joins import join
from ...cloud.normals.outward import Sample, inward_of, take_sample
from ...cloud.normals.pieces import TILE, find_pieces
from ...cloud.normals.votes import cast_votes
from .disk_votes import OnDiskVotes, drop_all, keep, name_of

# Columns: per point its piece, numbered within the part, its sign in the piece, and its final sign; per piece, numbered
# part by part, its group and its sign in the group; per group its number of points.
PIECE, SIGN, SIGNED, GROUP, TURN, POINTS = "piece", "sign", "signed", "group", "turn", "group.points"


class Local(NamedTuple):
    """A part of a cloud with a margin (surrounding points), and the neighbours of its own points.

    Attributes
    ----------
    rows : (n,) int64
        Numbers of the points in the order of the whole cloud, ascending.
    core : slice
        The part's own m points among them, consecutive in the whole cloud as well.
    positions : (n, 3) float32
        All distinct.
    normals : (n, 3) float32, unit
        Arbitrary signs; may be other unit vectors, such as those of planes.
    near : (m, k) int32
        Neighbours of each of the part's own points among the n, the point itself first.
    """

    rows: Rows
    core: slice
    positions: Floats
    normals: Floats
    near: NDArray[np.int32]


class Shared(NamedTuple):
    """Groups (connected points whose normals have consistent signs) of a part that also lie in other parts.

    groups : (s,) int32, ascending numbers of the groups
    earlier : (s,) int64, number of their points in earlier parts
    """

    groups: NDArray[np.int32]
    earlier: Rows


class Outlook(NamedTuple):
    """Which groups of a part face inward; a group is a set of connected points whose normals have consistent signs.

    inward : (i,) int32, groups within this part alone that face inward
    sample : points of groups that extend into other parts, which are decided for all parts together
    """

    inward: NDArray[np.int32]
    sample: Sample


class Signs:
    """Passes over a cloud in parts that find consistent, outward signs of its normals.

    Points are joined to pieces within a part, whose normals have reliable relative signs, and pieces to groups by votes
    of the edges between neighbours. Groups are then turned outward. Can be sent to other processes that see the
    columns.

    Parameters
    ----------
    columns : Columns
        `PIECE`, `SIGN` and `SIGNED` have a row for each point; they are overwritten.
    starts : (parts + 1,) int64
        First row of each part, then the number of rows.
    """

    def __init__(self, columns: Columns, starts: Rows) -> None:
        self._columns, self._starts = columns, starts

    def find(self, local: Local) -> int:
        """Join points of a part to pieces, whose normals have reliable relative signs; return the number of pieces.

        The piece of each point and its sign in the piece are written to columns.

        Raises
        ------
        ValueError
            If the part does not begin at a multiple of 2,048 rows of the whole cloud.
        """
        first = int(local.rows[local.core.start])
        if first % TILE:
            raise ValueError(f"a part must begin at a multiple of {TILE:,} rows, not at row {first:,}")
        found = find_pieces(local.positions, local.normals, local.near, local.core)
        self._columns[PIECE].write(first, found.piece)
        self._columns[SIGN].write(first, found.sign)
        return len(found.sizes)

    def vote(self, local: Local, part: int, firsts: Rows) -> Rows:
        """Write votes on whether pieces agree in their signs, from the edges between neighbouring points.

        A piece is a set of points with reliable relative signs. The votes of a part are those of edges from its own
        points to other pieces. They are stored in tables, each for a range of pieces.

        firsts : (parts + 1,) first piece of each part, then the number of pieces, from the results of `find`

        Returns
        -------
        (t + 1,) int64
            First row of each table in the column of votes, then the number of votes.
        """
        of = np.searchsorted(self._starts, local.rows, side="right") - 1
        piece = self._columns[PIECE][local.rows] + firsts[of].astype(np.int32)
        sign = self._columns[SIGN][local.rows]
        votes = cast_votes(local.positions, local.normals, local.near, local.core, piece, sign)
        return keep(self._columns, name_of(part), votes, int(firsts[-1]))

    def gather(self, firsts: Rows, cuts: Sequence[Rows]) -> list[Shared]:
        """Join the pieces of all parts to groups with consistent signs, by votes; write group and sign of each piece.

        A piece is a set of points with reliable relative signs.

        firsts : (parts + 1,) first piece of each part, then the number of pieces
        cuts : for each part, the rows in its column of votes at which tables of votes begin, as `vote` returns them

        Returns
        -------
        list of Shared
            For each part, the groups that also lie in other parts.
        """
        names = [name_of(part) for part in range(len(cuts))]
        group, turn = join(int(firsts[-1]), OnDiskVotes(self._columns, names, cuts))
        drop_all(self._columns)
        points, running = np.zeros((2, int(group.max()) + 1), np.int64)
        for part in range(len(cuts)):
            ids, here = self._groups_in(part, group[firsts[part] : firsts[part + 1]])
            points[ids] += here
        for name, rows in ((GROUP, group), (TURN, turn), (POINTS, points)):
            self._columns.fill(name, rows)
        shared = []
        for part in range(len(cuts)):
            ids, here = self._groups_in(part, group[firsts[part] : firsts[part + 1]])
            ids, here = ids[here < points[ids]], here[here < points[ids]]
            shared.append(Shared(ids, running[ids]))
            running[ids] += here
        return shared

    def examine(self, local: Local, part: int, firsts: Rows, shared: Shared) -> Outlook:
        """Return which groups within a part have normals that face into the body that the points enclose.

        Groups that continue in other parts are decided once all parts are examined, by the returned sample of points.

        A piece is a set of points with reliable relative signs, a group a set of connected pieces with consistent
        signs.

        local : positions and normals of the part's points; firsts : (parts + 1,) first piece of each part, then the
            number of pieces
        shared : groups of the part that lie in other parts too
        """
        piece, signs, group = self._labels(part, firsts)
        groups, each = np.unique(group, return_inverse=True)
        points, earlier = self._columns[POINTS][groups], np.zeros(len(groups), np.int64)
        others = np.searchsorted(groups, shared.groups)
        earlier[others] = shared.earlier
        positions, normals = local.positions[local.core], local.normals[local.core]
        sample = take_sample(positions, normals, signs, each.astype(np.int32)[piece], points, earlier)
        is_alone = ~np.isin(sample.groups, others)
        inward = inward_of([sample.only(is_alone)], points)
        rest = sample.only(~is_alone)
        return Outlook(groups[inward], rest._replace(groups=groups[rest.groups]))

    def face(self, outlooks: Sequence[Outlook]) -> Flags:
        """Return which groups must be inverted to face outward, (g,) bool.

        A group is a set of connected points whose normals have consistent signs.

        outlooks : results of `examine` in the order of the parts
        """
        inward = inward_of([each.sample for each in outlooks], self._columns[POINTS][:])
        inward[np.concatenate([each.inward for each in outlooks])] = True
        return inward

    def write(self, part: int, firsts: Rows, inward: Flags, kept: Flags | None = None) -> None:
        """Write the final sign, int8 1 or -1, of each normal of a part to the column `SIGNED`.

        A piece is a set of points with reliable relative signs, a group a set of connected pieces with consistent
        signs.

        firsts : (parts + 1,) first piece of each part, then the number of pieces
        inward : (g,) whether to invert each group; kept : mask of the part's points whose normals keep their sign
        """
        piece, signs, group = self._labels(part, firsts)
        signs *= np.where(inward[group], np.int8(-1), np.int8(1))[piece]
        if kept is not None:
            signs[kept] = 1
        self._columns[SIGNED].write(int(self._starts[part]), signs)

    def known_signs(self, part: int, firsts: Rows, known: Flags) -> tuple[NDArray[np.int32], NDArray[np.int8]]:
        """Return votes of the known normals of a part on the signs of the groups of points that they belong to.

        A piece is a set of points with reliable relative signs, a group a set of connected pieces with consistent
        signs.

        firsts : (parts + 1,) first piece of each part, then the number of pieces
        known : mask of the part's points with known normals

        Returns
        -------
        group : (k,) int32
            Group of each point with a known normal.
        sign : (k,) int8
            1 if its normal has the sign that is consistent with the group, else -1.
        """
        piece, signs, group = self._labels(part, firsts)
        return group[piece[known]], signs[known]

    def _labels(self, part: int, firsts: Rows) -> tuple[NDArray[Any], NDArray[np.int8], NDArray[np.int32]]:
        """Return how the points of a part are joined to pieces and groups by the signs of their normals.

        A piece is a set of points with reliable relative signs, a group a set of connected pieces with consistent
        signs.

        firsts : (parts + 1,) first piece of each part, then the number of pieces

        Returns
        -------
        piece : (n,)
            Piece of each point, numbered within the part.
        sign : (n,) int8
            Sign of each point's normal in its group.
        group : (p,) int32
            Group of each piece of the part.
        """
        rows, pieces = slice(*self._starts[part : part + 2].tolist()), slice(*firsts[part : part + 2].tolist())
        piece, columns = self._columns[PIECE][rows], self._columns
        return piece, columns[SIGN][rows] * columns[TURN][pieces][piece], columns[GROUP][pieces]

    def _groups_in(self, part: int, group: NDArray[np.int32]) -> tuple[NDArray[np.int32], Rows]:
        """Return the numbers of the groups in a part, ascending, and how many of its points each has.

        A group is a set of connected pieces, and a piece one of points, whose normals have consistent signs.

        group : (p,) group of each piece of the part
        """
        ids, each = np.unique(group, return_inverse=True)
        sizes = np.bincount(self._columns[PIECE][slice(*self._starts[part : part + 2].tolist())], minlength=len(group))
        return ids, np.bincount(each, sizes, len(ids)).astype(np.int64)


def firsts_of(pieces: Sequence[int]) -> Rows:
    """Return the number of the first piece of each part, numbered part after part, then the number of pieces.

    pieces : number of pieces (points with reliable relative signs of their normals) of each part
    """
    return np.cumsum([0, *pieces])
