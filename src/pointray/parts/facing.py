"""The sides that normals face, over all parts: as in a whole cloud, neighbours agree, and scanners see no back."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..neighbors import NeighborTree
from ..points.normals.layers import KEPT, sides
from ..points.normals.orientation import NEAR
from ..points.normals.votes import Votes
from . import signs
from .local import Local
from .stages import FACED, KNOWN, MERGED, NORMALS, PLACED, PLANES, POSITIONS, TURNED, UNITS, Cloud, units
from .work import Facts, Work

PIECE, SIGN, SIGNED = "piece", "sign", "signed"  # columns
FOUND, VOTED, LOOKED = 0.4, 0.8, 0.9  # shares of the time after which a pass is done

Span = tuple[float, float]


class Facing:
    """Signs of the normals in a column, and what they are made of.

    Parameters
    ----------
    work : Work
    cloud : Cloud
    places, normals : str
        Columns: positions, and normals of either sign.
    near : int
        Neighbours that signs pass to.
    """

    def __init__(self, work: Work, cloud: Cloud, places: str, normals: str, near: int) -> None:
        self._work, self._cloud, self._columns = work, cloud, (places, normals)
        self._near = near
        work.room(PIECE, np.int32)
        work.room(SIGN, np.int8)

    @property
    def _labels(self) -> signs.Labels:
        """The columns, opened anew: nothing that is open can be sent to workers."""
        return signs.Labels(self._work.columns[PIECE], self._work.columns[SIGN])

    def settle(self, span: Span) -> None:
        """Write the sign of each normal to the column `SIGNED`; those that scanners tell are kept."""
        begin, length = span[0], span[1] - span[0]
        passes = [(begin + a * length, begin + b * length) for a, b in ((0, FOUND), (FOUND, VOTED), (VOTED, LOOKED))]
        labels, work = self._labels, self._work
        sizes = work.all(self._find, passes[0])
        votes = work.all(partial(self._vote, sizes), passes[1])
        groups = signs.gather(sizes, votes)
        outlooks = work.all(partial(self._look, groups), passes[2])
        facing = signs.face(groups, outlooks)
        seen, away = self._told(groups)
        facing = np.where(seen[groups.group], groups.turn * np.where(away, -1, 1)[groups.group], facing).astype(np.int8)
        out, known = work.room(SIGNED, np.int8), work.columns.find(KNOWN)
        for part in range(work.parts):
            signs.write(part, labels, groups, facing, out)
            if known is not None:
                stretch = work.stretch(part)
                out.write(stretch.start, np.where(known[stretch] != 0, np.int8(1), out[stretch]))

    def _find(self, part: int) -> NDArray[np.int64]:
        return signs.find(self._load(part), self._labels)

    def _vote(self, sizes: list[NDArray[np.int64]], part: int) -> Votes:
        return signs.vote(self._load(part), self._labels, sizes)

    def _look(self, groups: signs.Groups, part: int) -> signs.Outlook:
        return signs.look(self._load(part, alone=True), part, self._labels, groups)

    def _told(self, groups: signs.Groups) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which groups have normals that scanners tell, and which of these must be turned, see `settle_unknown`."""
        counts, votes = np.zeros((2, len(groups.points)))
        known, labels = self._work.columns.find(KNOWN), self._labels
        if known is not None:
            for part in range(self._work.parts):
                stretch = self._work.stretch(part)
                some = known[stretch] != 0
                piece = labels.piece[stretch][some] + groups.first_piece[part]
                sign = labels.sign[stretch][some] * groups.turn[piece]
                counts += np.bincount(groups.group[piece], minlength=len(counts))
                votes += np.bincount(groups.group[piece], sign, len(counts))
        return counts > 0, votes < 0

    def _load(self, part: int, alone: bool = False) -> signs.Local:
        """A part with its margin; alone : without both, as neighbours are not asked for"""
        columns = self._work.columns
        local = _own(self._work, part) if alone else self._work.local(part)
        core = slice(int(local.own[0]), int(local.own[-1]) + 1)
        near = np.empty((0, 0), np.int32) if alone else near_in(self._cloud, local, core, self._near)
        places, normals = (local.read(columns[name]) for name in self._columns)
        return signs.Local(local.rows, core, places, normals, near)


def near_in(cloud: Cloud, local: Local, core: slice, count: int) -> NDArray[np.int32]:
    """The neighbours of a part's own points, (m, k), each itself first."""
    places = local.read(cloud.columns[cloud.latest(MERGED, POSITIONS)])
    near = NeighborTree(places, in_order=True).rows(count, core)
    odd = np.flatnonzero(near[:, 0] != local.own)  # another point is at the same place
    if len(odd):
        at = near[odd] == local.own[odd, None]
        near[odd] = np.where(at, near[odd, :1], near[odd])
        near[odd, 0] = local.own[odd]
    return near


def _own(work: Work, part: int) -> Local:
    stretch = work.stretch(part)
    return Local(np.arange(stretch.start, stretch.stop), np.arange(stretch.stop - stretch.start))


def turn_fits(work: Work, cloud: Cloud, has_planes: bool, span: Span) -> None:
    """Write the normals that were fitted to points, with their signs, to the column `FACED`."""
    columns, middle = work.columns, span[0] + 0.8 * (span[1] - span[0])
    if columns.get(FACED) is not None:
        return
    names = PLANES if has_planes else (PLACED, NORMALS)
    Facing(work, cloud, *names, KEPT if has_planes else NEAR).settle((span[0], middle))
    work.room(FACED, np.float32, 3)
    work.all(partial(_turn, work, cloud, has_planes), (middle, span[1]))
    columns.put(FACED, {})


def _turn(work: Work, cloud: Cloud, has_planes: bool, part: int) -> None:
    """Write the fitted normals of a part with their signs."""
    columns, stretch = work.columns, work.stretch(part)
    normals = columns[NORMALS][stretch]
    if has_planes:
        local = work.local(part)
        core = slice(int(local.own[0]), int(local.own[-1]) + 1)
        planes = local.read(columns[PLANES[1]]) * local.read(columns[SIGNED])[:, None]
        signed = sides(normals, planes, near_in(cloud, local, core, KEPT))
    else:
        signed = columns[SIGNED][stretch]
    columns[FACED].write(stretch.start, normals * signed[:, None])


def turn_given(work: Work, cloud: Cloud, span: Span) -> None:
    """Write the normals that points came with, as units with signs of their own, to the column `TURNED`."""
    columns = work.columns
    if columns.get(TURNED) is not None:
        return
    directions = work.room(UNITS, np.float32, 3)
    if cloud.is_seen:
        work.room(KNOWN, np.int8)
    first, last = (span[0] + share * (span[1] - span[0]) for share in (0.2, 0.9))
    facts = work.each("units", partial(_put_units, work, cloud), (span[0], first))
    Facing(work, cloud, cloud.latest(MERGED, POSITIONS), UNITS, NEAR).settle((first, last))
    out, signed = work.room(TURNED, np.float32, 3), columns[SIGNED]
    for part in range(work.parts):
        stretch = work.stretch(part)
        out.write(stretch.start, directions[stretch] * signed[stretch][:, None])
    columns.put(TURNED, {"mended": np.sum([fact["mended"] for fact in facts], axis=0).tolist()})


def _put_units(work: Work, cloud: Cloud, part: int) -> Facts:
    """Write the normals of a part as units."""
    local = work.local(part)
    found = units(cloud, local)
    local.write(work.columns[UNITS], found.normals)
    if found.known is not None:
        local.write(work.columns[KNOWN], found.known)
    return {"mended": list(found.mended)}
