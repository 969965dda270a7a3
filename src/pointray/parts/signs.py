"""Signs of normals of a cloud in parts: to the bit those of `orient` for the whole.

Each pass goes over all parts, in any order, or at once: what it needs is known before it begins, and a part writes the
labels of its own rows only, the same whenever it is asked. So a pass may be shared out, and goes on after a break.

    find       a part -> how many points its pieces have; their labels
    vote       a part and the labels around it -> the votes of its edges
    gather     all of these -> the groups of the whole
    look       a part -> which groups in it face inward, and samples of those that reach farther
    face       all of these -> the sign of each piece
    write      a part's labels -> its signs
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..points.normals.joins import join
from ..points.normals.outward import Sample, inward_of, take_sample
from ..points.normals.pieces import TILE, find_pieces
from ..points.normals.votes import Votes, cast_votes
from ..progress import Progress, part_of, tell

FOUND, VOTED, JOINED, LOOKED = 0.4, 0.75, 0.85, 0.95  # shares of the time after which a pass is done

Floats = NDArray[np.float32]
Whole = NDArray[np.int64]
Signs = NDArray[np.int8]
Result = TypeVar("Result")


class Rows(Protocol):
    """A column, in memory or on disk."""

    def __getitem__(self, rows: slice | NDArray[np.integer[Any]]) -> NDArray[Any]:
        """Some rows."""

    def write(self, start: int, rows: NDArray[Any]) -> None:
        """Write rows, from number `start` on."""


class Local(NamedTuple):
    """A part with a margin, and the neighbours of its own points.

    Attributes
    ----------
    rows : (n,) int64
        The numbers of the points in the order of the whole, ascending.
    core : slice
        The part's own points among them, m, which follow each other in the whole too.
    positions : (n, 3) float32
        All different.
    normals : (n, 3) float32, unit
        Of either sign; or other unit vectors, such as those of planes.
    near : (m, k) int32
        For each of the part's own points its neighbours among the n, the point itself first.
    """

    rows: Whole
    core: slice
    positions: Floats
    normals: Floats
    near: NDArray[np.int32]


class Labels(NamedTuple):
    """What is known of each row of the whole.

    piece : (rows,) int32, its piece, counted in its part
    sign : (rows,) int8, its sign in its piece
    """

    piece: Rows
    sign: Rows


class Groups(NamedTuple):
    """The groups of the whole's pieces, which are counted part after part.

    Attributes
    ----------
    first_row, first_piece : (parts + 1,) int64
        Of each part; how many there are.
    sizes : (p,) int64
        How many points each piece has.
    group : (p,) int32
        From 0.
    turn : (p,) int8
        The sign of each piece in its group.
    points : (g,) int64
        How many points each group has.
    """

    first_row: Whole
    first_piece: Whole
    sizes: Whole
    group: NDArray[np.int32]
    turn: Signs
    points: Whole

    def among(self, pieces: slice) -> Whole:
        """How many points each group has in some of the pieces."""
        return _points_of(self.group[pieces], self.sizes[pieces], len(self.points))


class Outlook(NamedTuple):
    """What a part tells of the groups in it.

    inward : (i,) int32, groups that lie in this part alone and face inward
    sample : points of those that reach into other parts
    """

    inward: NDArray[np.int32]
    sample: Sample


def find(local: Local, labels: Labels) -> Whole:
    """Label the points of a part by their pieces; returns how many points each piece has.

    Raises
    ------
    ValueError
        If the part does not begin where a tile of the whole does.
    """
    first = int(local.rows[local.core.start])
    if first % TILE:
        raise ValueError(f"a part begins at a multiple of {TILE:,} rows, not at row {first:,}")
    found = find_pieces(local.positions, local.normals, local.near, local.core)
    labels.piece.write(first, found.piece)
    labels.sign.write(first, found.sign)
    return found.sizes


def vote(local: Local, labels: Labels, sizes: Sequence[Whole]) -> Votes:
    """The votes of the edges that begin in a part; sizes : what `find` told of each part, in their order."""
    first_row, first_piece = _firsts(sizes)
    part = np.searchsorted(first_row, local.rows, side="right") - 1
    piece = labels.piece[local.rows] + first_piece[part].astype(np.int32)
    return cast_votes(local.positions, local.normals, local.near, local.core, piece, labels.sign[local.rows])


def gather(sizes: Sequence[Whole], votes: Sequence[Votes]) -> Groups:
    """The groups of the whole, from what `find` and `vote` told of each part."""
    together = np.concatenate(sizes)
    group, turn = join(len(together), votes)
    return Groups(*_firsts(sizes), together, group, turn, _points_of(group, together, int(group.max()) + 1))


def look(local: Local, part: int, labels: Labels, groups: Groups) -> Outlook:
    """Which groups in a part face inward; a group that reaches into other parts is left to `face`."""
    first, last = groups.first_piece[part : part + 2].tolist()
    earlier, here = groups.among(slice(0, first)), groups.among(slice(first, last))
    rows = slice(*groups.first_row[part : part + 2].tolist())
    piece = labels.piece[rows] + first
    signs, each = labels.sign[rows] * groups.turn[piece], groups.group[piece]
    positions, normals = local.positions[local.core], local.normals[local.core]
    sample = take_sample(positions, normals, signs, each, groups.points, earlier)
    is_alone = (here == groups.points)[sample.groups]
    inward = inward_of([sample.only(is_alone)], groups.points)
    return Outlook(np.flatnonzero(inward).astype(np.int32), sample.only(~is_alone))


def face(groups: Groups, outlooks: Sequence[Outlook]) -> Signs:
    """The sign of each piece, (p,), from what `look` told of each part, in their order."""
    inward = inward_of([each.sample for each in outlooks], groups.points)
    inward[np.concatenate([each.inward for each in outlooks])] = True
    return groups.turn * np.where(inward[groups.group], np.int8(-1), np.int8(1))


def write(part: int, labels: Labels, groups: Groups, facing: Signs, signs: Rows) -> None:
    """Write the signs, int8, of a part's points; facing : what `face` told."""
    rows = slice(*groups.first_row[part : part + 2].tolist())
    signs.write(rows.start, labels.sign[rows] * facing[labels.piece[rows] + groups.first_piece[part]])


def sign_all(
    parts: Sequence[Callable[[], Local]], labels: Labels, signs: Rows, progress: Progress | None = None
) -> None:
    """Write the signs of all points, so that normals agree and face outward, or up if there is no outside.

    Parameters
    ----------
    parts : sequence of callables
        Each loads a part; they follow each other in the whole.
    labels : Labels
        Columns with a row for each point, which are overwritten.
    signs : Rows
        A column with a row for each point, int8: 1 or -1.
    progress : callable, optional
        Called with the share done.

    Raises
    ------
    ValueError
        If a part does not begin where a tile of the whole does.
    """
    n = len(parts)
    sizes = _each(lambda part: find(parts[part](), labels), n, part_of(progress, 0.0, FOUND))
    votes = _each(lambda part: vote(parts[part](), labels, sizes), n, part_of(progress, FOUND, VOTED))
    groups = gather(sizes, votes)
    tell(progress, JOINED)
    outlooks = _each(lambda part: look(parts[part](), part, labels, groups), n, part_of(progress, JOINED, LOOKED))
    facing = face(groups, outlooks)
    _each(lambda part: write(part, labels, groups, facing, signs), n, part_of(progress, LOOKED, 1.0))


def _each(task: Callable[[int], Result], parts: int, progress: Progress | None) -> list[Result]:
    """What a pass tells of each part."""
    results = []
    for part in range(parts):
        results.append(task(part))
        tell(progress, (part + 1) / parts)
    return results


def _firsts(sizes: Sequence[Whole]) -> tuple[Whole, Whole]:
    """The first row and the first piece of each part, and how many there are."""
    rows, pieces = [int(each.sum()) for each in sizes], [len(each) for each in sizes]
    return np.cumsum([0, *rows]), np.cumsum([0, *pieces])


def _points_of(group: NDArray[np.int32], sizes: Whole, groups: int) -> Whole:
    """How many points each group has, (groups,), in pieces of some sizes."""
    return np.bincount(group, sizes, groups).astype(np.int64)
