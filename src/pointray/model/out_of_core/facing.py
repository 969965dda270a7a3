"""Orientation of normals across parts: neighbours agree as in a whole cloud, and normals face known scanners."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Rows
from ...base.disk_columns import Column
from ...cloud.neighbors import NeighborTree
from ...cloud.normals.layers import KEPT, signs_facing
from ...cloud.normals.orientation import NEAR
from . import signs
from .local import Local
from .signs import PIECE, SIGN, SIGNED, Outlook, Shared, Signs, firsts_of
from .stages import FACED, KNOWN, MERGED, NORMALS, PLACED, PLANES, POSITIONS, TURNED, UNITS, Cloud, units
from .work import Facts, Span, Work, within

FOUND, VOTED, JOINED, EXAMINED = 0.4, 0.75, 0.8, 0.9  # progress of the passes


class Facing:
    """Choice of signs for the normals of a cloud in parts, so that neighbours agree and normals face outward.

    Parameters
    ----------
    work : Work
    cloud : Cloud
    places, normals : str
        Names of the columns with positions, and with normals of arbitrary signs.
    near : int
        Number of neighbours of each point along which signs propagate.
    """

    def __init__(self, work: Work, cloud: Cloud, places: str, normals: str, near: int) -> None:
        self._work, self._cloud, self._columns = work, cloud, (places, normals)
        self._near = near
        self._signs = Signs(work.columns, np.minimum(np.arange(work.parts + 1) * work.size, cloud.total))
        for name, dtype in ((PIECE, np.int32), (SIGN, np.int8), (SIGNED, np.int8)):
            work.make_column(name, dtype)

    def orient(self, span: Span) -> None:
        """Write the sign of each normal, int8 1 or -1, to the column `SIGNED`.

        Normals whose signs are known from scanner positions keep them.

        span : begin and end of this stage, as fractions of all work
        """
        work = self._work
        firsts = firsts_of(work.all(self._find, within(span, 0.0, FOUND)))
        shared = self._signs.gather(firsts, work.all(partial(self._vote, firsts), within(span, FOUND, VOTED)))
        inward = self._signs.face(work.all(partial(self._examine, firsts, shared), within(span, JOINED, EXAMINED)))
        known = work.columns.find(KNOWN)
        if known is not None:
            seen, away = self._known_groups(firsts, known, len(inward))
            inward = np.where(seen, away, inward)
        for part in range(work.parts):
            kept = None if known is None else known[work.part_rows(part)] != 0
            self._signs.write(part, firsts, inward, kept)

    def _find(self, part: int) -> int:
        return self._signs.find(self._load(part))

    def _vote(self, firsts: Rows, part: int) -> Rows:
        return self._signs.vote(self._load(part), part, firsts)

    def _examine(self, firsts: Rows, shared: list[Shared], part: int) -> Outlook:
        return self._signs.examine(self._load(part, alone=True), part, firsts, shared[part])

    def _known_groups(self, firsts: Rows, known: Column, groups: int) -> tuple[Flags, Flags]:
        """Return which groups of points contain signs known from scanner positions, and which of these to invert.

        A group is a connected set of points whose normals are consistent with each other. Both results are masks,
        (groups,) bool.

        firsts : (parts + 1,) number of the first piece (points with reliable relative signs) of each part, then the
            number of pieces
        known : column on disk, not 0 where the sign of the normal is known; groups : number of groups
        """
        counts, votes = np.zeros((2, groups))
        for part in range(self._work.parts):
            group, sign = self._signs.known_signs(part, firsts, known[self._work.part_rows(part)] != 0)
            counts += np.bincount(group, minlength=groups)
            votes += np.bincount(group, sign, groups)
        return counts > 0, votes < 0

    def _load(self, part: int, alone: bool = False) -> signs.Local:
        """Return the positions and normals of a part and its margin, and the neighbours of its own points.

        alone : without the margin and without neighbours
        """
        columns = self._work.columns
        local = _own(self._work, part) if alone else self._work.local(part)
        near = np.empty((0, 0), np.int32) if alone else near_in(self._cloud, local, local.core, self._near)
        places, normals = (local.read(columns[name]) for name in self._columns)
        return signs.Local(local.rows, local.core, places, normals, near)


def near_in(cloud: Cloud, local: Local, core: slice | Rows, count: int) -> NDArray[np.int32]:
    """Return the nearest neighbours of m points of a part, (m, k) int32, each point itself first.

    Neighbours are indices into the points of `local`.

    cloud : positions are those after moving second layers (duplicates) onto their surface, if this was done
    local : rows of the part and its margin, in which neighbours are searched
    core : the m points, as a slice or an array of indices into `local`
    count : k; if `local` has fewer points, k is their number
    """
    places = local.read(cloud.columns[cloud.latest(MERGED, POSITIONS)])
    tree = NeighborTree(places, in_order=True)
    if isinstance(core, slice):
        rows, near = np.arange(core.start, core.stop), tree.rows(count, core)
    else:
        rows, near = core, tree.rows_at(count, places[core])
    odd = np.flatnonzero(near[:, 0] != rows)  # another point has the same position
    if len(odd):
        at = near[odd] == rows[odd, None]
        near[odd] = np.where(at, near[odd, :1], near[odd])
        near[odd, 0] = rows[odd]
    return near


def _own(work: Work, part: int) -> Local:
    part_rows = work.part_rows(part)
    return Local(np.arange(part_rows.start, part_rows.stop), np.arange(part_rows.stop - part_rows.start))


def turn_fits(work: Work, cloud: Cloud, has_planes: bool, span: Span) -> None:
    """Write the fitted normals of a cloud with consistent, outward signs to the column `FACED`, unless already done.

    has_planes : whether planes were fitted to noisy points; if so, signs are chosen for the normals of these planes,
        and each fitted normal gets the sign with which it faces, on average, the side of its neighbours' planes
    span : begin and end of this stage, as fractions of all work
    """
    columns = work.columns
    if columns.get(FACED) is not None:
        return
    names = PLANES if has_planes else (PLACED, NORMALS)
    Facing(work, cloud, *names, KEPT if has_planes else NEAR).orient(within(span, 0.0, 0.8))
    work.make_column(FACED, np.float32, 3)
    work.all(partial(_turn, work, cloud, has_planes), within(span, 0.8, 1.0))
    columns.put(FACED, {})


def _turn(work: Work, cloud: Cloud, has_planes: bool, part: int) -> None:
    """Write the fitted normals of a part with their signs to the column `FACED`.

    has_planes : whether the known signs are those of planes fitted to noisy points; if so, each normal gets the sign
        with which it faces the same side, on average, as the planes of its neighbours
    """
    columns, normals = work.columns, work.read(NORMALS, part)
    if has_planes:
        local = work.local(part)
        planes = local.read(columns[PLANES[1]]) * local.read(columns[SIGNED])[:, None]
        signed = signs_facing(normals, planes, near_in(cloud, local, local.core, KEPT))
    else:
        signed = work.read(SIGNED, part)
    work.write(FACED, part, normals * signed[:, None])


def turn_given(work: Work, cloud: Cloud, span: Span) -> None:
    """Write the normals from the files, at unit length and with recomputed signs, to the column `TURNED`.

    Needed if neighbouring normals of the files face opposite sides; done once.

    span : begin and end of this stage, as fractions of all work
    """
    columns = work.columns
    if columns.get(TURNED) is not None:
        return
    work.make_column(UNITS, np.float32, 3)
    if cloud.is_seen:
        work.make_column(KNOWN, np.int8)
    facts = work.each("units", partial(_put_units, work, cloud), within(span, 0.0, 0.2))
    Facing(work, cloud, cloud.latest(MERGED, POSITIONS), UNITS, NEAR).orient(within(span, 0.2, 0.9))
    work.make_column(TURNED, np.float32, 3)
    for part in range(work.parts):
        work.write(TURNED, part, work.read(UNITS, part) * work.read(SIGNED, part)[:, None])
    columns.put(TURNED, {"mended": np.sum([fact["mended"] for fact in facts], axis=0).tolist()})


def _put_units(work: Work, cloud: Cloud, part: int) -> Facts:
    """Write the normals of a part at unit length, and a mask of the points with known scanner positions, if any are.

    Returns
    -------
    dict
        mended : numbers of missing normals, which are replaced, and of normals of another length.
    """
    local = work.local(part)
    found = units(cloud, local)
    local.write_all(work.columns, {UNITS: found.normals, KNOWN: found.known})
    return {"mended": list(found.repaired)}
