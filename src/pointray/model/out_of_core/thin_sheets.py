"""Orientation of thin sheets across parts, equal to that of the whole cloud to the bit; see `cloud.normals.sheets`.

A winding number is a sum over all points, by tiles of the kd order; all parts know the roots of the tiles' trees. A
pass reads the tiles that its numbers need. Each pass writes columns of its own before the next one begins, so computing
a part twice is harmless.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats, Rows
from ...cloud.normals import sheets
from ...cloud.normals.orientation import NEAR
from ...cloud.normals.winding import TILE, Frame, Splats, Winding, roots_of, spacings, top_of
from .facing import near_in
from .local import Local, runs_of
from .stages import FACED, PARTED, PLACED, THICK, Cloud
from .work import Facts, Span, Work

# Columns: square root of each point's area; whether a ring has found it, in its own part or from another part; gain of
# its numbers; whether it is flipped at first, undecided by numbers, flipped back, flipped by its edges.
SPACING, FOUND, BESIDE, GAIN = "spacing", "found", "beside", "gain"
TURNS, UNSURE, BACK, VOTED = "turns", "unsure", "turned.back", "voted"
TOP, NUMBERS, DONE = "winding", "numbers", "sheets-done"


class Field(NamedTuple):
    """State of the points from which winding numbers (1 inside a closed surface, 0 outside) are computed.

    scale : divisor of the points' spacings with which the numbers jump by 1 at the surface; None: not known yet
    has_turned : whether normals are flipped as the column `TURNS` says
    """

    scale: float | None = None
    has_turned: bool = False

    @property
    def top(self) -> str:
        """Name of the column with the tree over all tiles of 4,096 points, by which distant points are summarized."""
        return f"{TOP}-{(self.scale is not None) + self.has_turned}"


class Around(NamedTuple):
    """A part with its margin (surrounding points), and the neighbours of some of its own points.

    local : rows of the n points of the part and its margin
    rows : (m,) int64, which of the n points the neighbours are known of
    positions, normals : (n, 3) float32
    near : (n, k) int32, neighbours of these m points as indices among the n, the point itself first; 0 for other points
    """

    local: Local
    rows: Rows
    positions: Floats
    normals: Floats
    near: NDArray[np.int32]


class ThinSheets:
    """Passes over the parts of a cloud that flip wrong normals where two sheets are closer than their points.

    Wrong normals are found by winding numbers (1 inside a closed surface, 0 outside): those one step in front of and
    behind a point add up to 1, unless another sheet is close. Can be sent to workers.

    Parameters
    ----------
    work : Work
    cloud : Cloud
    frame : Frame
        Origin and unit of the positions.
    thick : sequence of int
        Number of points of each part that may be near two sheets.
    """

    def __init__(self, work: Work, cloud: Cloud, frame: Frame, thick: Sequence[int]) -> None:
        self._work, self._cloud, self._frame, self._thick = work, cloud, frame, list(thick)

    def orient(self, span: Span) -> bool:
        """Write all normals, some flipped, to the column `PARTED`; return whether any may be flipped.

        The column is not written if the cloud has no inside, or no point is close to two sheets.

        span : begin and end of this stage, as fractions of all work
        """
        work = self._work
        ends = np.linspace(*span, 13)
        spans = iter(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))

        def each(do: Any) -> list[Any]:
            return work.all(do, next(spans), "sheets")

        for name in (SPACING, GAIN):
            work.make_column(name, np.float32)
        for name in (TURNS, UNSURE, BACK, VOTED, *_ring_columns()):
            work.make_column(name, np.int8)
        each(self._measure)
        self._write_top(each, Field())
        near, far = (np.concatenate(numbers) for numbers in zip(*each(self._sample), strict=True))
        scale = sheets.scale_of(near, far)
        if scale is None:
            return False
        field = Field(scale)
        self._write_top(each, field)
        for ring in range(sheets.RINGS):
            self._mark(ring, each(partial(self._ring, field, ring)))
        if not any(each(partial(self._turn, field))):
            return False
        field = Field(scale, has_turned=True)
        self._write_top(each, field)
        each(partial(self._weigh, field))
        each(self._turn_back)
        each(self._vote)
        work.make_column(PARTED, np.float32, 3)
        each(self._write)
        return True

    def _write_top(self, each: Any, field: Field) -> None:
        """Write to a column the tree over all tiles of 4,096 points, by which winding numbers summarize distant points.

        A winding number is 1 inside a closed surface, 0 outside.

        each : calls a function with the number of each part and returns the results
        field : state of the points, by which the column is named
        """
        self._work.columns.fill(field.top, top_of(np.concatenate(each(partial(self._roots, field)))))

    def _measure(self, part: int) -> None:
        """Write the spacing (square root of the area per point) of each point of a part to the column `SPACING`."""
        local = self._work.local(part)
        positions = self._frame.of(local.read(self._work.columns[PLACED]))
        near = near_in(self._cloud, local, local.core, NEAR)
        self._work.write(SPACING, part, spacings(positions, near, local.core.start))

    def _read(self, field: Field, tiles: Rows) -> Splats:
        """Return positions, normals and spacings of the points of some tiles (ranges of 4,096 points in kd order)."""
        rows = (tiles[:, None] * TILE + np.arange(TILE)).ravel()
        columns, runs = self._work.columns, runs_of(rows[rows < self._cloud.total])
        placed, normals, spacing = (_rows(columns[name], runs) for name in (PLACED, FACED, SPACING))
        if field.has_turned:
            normals *= _signs(_rows(columns[TURNS], runs))
        if field.scale is not None:
            spacing /= np.float32(field.scale)
        return Splats(self._frame.of(placed), normals, spacing)

    def _around(self, field: Field, rows: Rows, step: float = sheets.STEP) -> Floats:
        """Return the winding numbers a step in front of and a step behind some points, (m, 2).

        The winding number is 1 inside a closed surface and 0 outside.

        field : state of the points from which winding numbers are computed; rows : rows of the m points in the cloud
        step : length of the step, in spacings of the point
        """
        tiles = -(-self._cloud.total // TILE)
        return Winding(self._work.columns[field.top][:], tiles, partial(self._read, field)).around(rows, step)

    def _roots(self, field: Field, part: int) -> Floats:
        part_rows = self._work.part_rows(part)
        return roots_of(self._read(field, np.arange(part_rows.start // TILE, -(-part_rows.stop // TILE))))

    def _sample(self, part: int) -> tuple[Floats, Floats]:
        """Return winding numbers around m sampled points of a part, which show whether the cloud has an inside.

        The winding number is 1 inside a closed surface and 0 outside.

        Returns
        -------
        near : (m, 2) float32
            One spacing in front of each point, and one spacing behind.
        far : (m, 2) float32
            1.5 spacings in front of each point, and behind.
        """
        rows, part_rows = sheets.sample_of(self._cloud.total), self._work.part_rows(part)
        rows = rows[(rows >= part_rows.start) & (rows < part_rows.stop)]
        return self._around(Field(), rows, 1.0), self._around(Field(), rows)

    def _ring(self, field: Field, ring: int, part: int) -> Rows:
        """Find points of a part that are near two sheets, and mark their neighbours.

        Winding numbers in front of and behind such a point do not add up to 1.

        ring : number of the pass. Pass 0 examines a sample of the points that may be near two sheets, the others those
            that earlier passes have marked.

        Returns
        -------
        (k,) int64
            Rows of the neighbours in other parts, which are still to be marked.
        """
        part_rows, before = self._work.part_rows(part), self._suspects(part, ring)
        if ring == 0:
            thick, earlier = np.flatnonzero(self._work.read(THICK, part)), sum(self._thick[:part])
            step = sheets.step_of(sum(self._thick), self._cloud.total)
            rows = thick[-earlier % step :: step]
        else:
            rows = np.flatnonzero(before)
        rows = rows[sheets.is_odd(self._around(field, rows + part_rows.start))]
        around = self._neighborhood(part, rows)
        beside = around.local.rows[np.unique(around.near[around.rows])]
        is_own = (beside >= part_rows.start) & (beside < part_rows.stop)
        self._write_flags(f"{FOUND}-{ring}", part, beside[is_own] - part_rows.start)
        return np.asarray(beside[~is_own])

    def _mark(self, ring: int, rows: Sequence[Rows]) -> None:
        """Mark points that `_ring` found as neighbours of other parts' points near two sheets.

        rows : their rows in the cloud, an array from each part; ring : number of the pass
        """
        beside = np.unique(np.concatenate(rows))
        for run in runs_of(beside) if len(beside) else []:
            self._work.columns[f"{BESIDE}-{ring}"].write(run.start, np.ones(run.stop - run.start, np.int8))

    def _suspects(self, part: int, rings: int = sheets.RINGS) -> Flags:
        """Return a mask of the part's points that may be near two sheets, as marked by the first `rings` passes."""
        found = self._zeros(part, np.bool_)
        for name in _ring_columns(rings):
            found |= self._work.read(name, part) != 0
        return found

    def _neighborhood(self, part: int, rows: Rows) -> Around:
        """Return a part with its margin, and the neighbours of some of its points.

        rows : of these points within the part
        """
        local, columns = self._work.local(part), self._work.columns
        mine = local.own[rows]
        near = np.zeros((len(local.rows), NEAR), np.int32)
        if len(mine):
            near[mine] = near_in(self._cloud, local, mine, NEAR)
        return Around(local, mine, self._frame.of(local.read(columns[PLACED])), local.read(columns[FACED]), near)

    def _turn(self, field: Field, part: int) -> bool:
        """Decide which marked points of a part are flipped; write 1 for each of them to the column `TURNS`.

        Marked points may be near two sheets. Their winding numbers (1 inside, 0 outside) and the side of the other
        sheet decide; the winding numbers are stored. Returns whether the part has any marked points.
        """
        rows = np.flatnonzero(self._suspects(part))
        numbers = self._around(field, rows + self._work.part_rows(part).start)
        self._work.columns.fill(f"{NUMBERS}-{part:04d}", numbers)
        _, mine, positions, normals, near = self._neighborhood(part, rows)
        self._write_flags(TURNS, part, rows[sheets.is_wrong(mine, numbers, positions, normals, near)])
        return len(rows) > 0

    def _weigh(self, field: Field, part: int) -> None:
        """Write how much closer to 0 or 1 flipping has brought the winding numbers around each marked point of a part.

        Marked points may be near two sheets. The results are written to the column `GAIN`. The column `UNSURE` gets a 1
        for points whose winding numbers do not decide whether to flip them.
        """
        gain, rows = self._zeros(part, np.float32), np.flatnonzero(self._suspects(part))
        before = self._work.columns[f"{NUMBERS}-{part:04d}"][:]
        after = self._around(field, rows + self._work.part_rows(part).start)
        gain[rows] = sheets.energy(before) - sheets.energy(after)
        self._work.write(GAIN, part, gain)
        self._write_flags(UNSURE, part, rows[sheets.is_unsure(before, after)])

    def _turn_back(self, part: int) -> None:
        """Decide which flipped points of a part are flipped back; write 1 for each of them to the column `BACK`.

        A point is flipped back if all flips have brought the winding numbers around it and its neighbours, in total, no
        closer to 0 or 1.
        """
        turned = np.flatnonzero(self._work.read(TURNS, part))
        local, mine, _, _, near = self._neighborhood(part, turned)
        self._write_flags(BACK, part, turned[local.read(self._work.columns[GAIN])[near[mine]].sum(axis=1) <= 0])

    def _vote(self, part: int) -> None:
        """Find undecided points of a part that contradict their neighbours' normals; write 1 for each to `VOTED`.

        Undecided are points whose winding numbers do not decide, and points flipped back. Points with a 1 in the column
        are flipped.
        """
        columns = self._work.columns
        unsure = np.flatnonzero(self._work.read(UNSURE, part) | self._work.read(BACK, part))
        local, mine, positions, normals, near = self._neighborhood(part, unsure)
        normals *= _signs(local.read(columns[TURNS]) ^ local.read(columns[BACK]))
        self._write_flags(VOTED, part, unsure[sheets.disagrees(mine, positions, normals, near)])

    def _write_flags(self, name: str, part: int, rows: Rows) -> None:
        """Write a column of flags for a part's points: 1 for some of them, and 0 for the others.

        rows : within the part
        """
        flags = self._zeros(part, np.int8)
        flags[rows] = 1
        self._work.write(name, part, flags)

    def _zeros(self, part: int, dtype: Any) -> NDArray[Any]:
        """Return an array with a zero for each point of a part."""
        part_rows = self._work.part_rows(part)
        return np.zeros(part_rows.stop - part_rows.start, dtype)

    def _write(self, part: int) -> None:
        turns, back, voted = (self._work.read(name, part) for name in (TURNS, BACK, VOTED))
        self._work.write(PARTED, part, self._work.read(FACED, part) * _signs(turns ^ back ^ voted))


def _rows(column: Any, runs: list[slice]) -> NDArray[Any]:
    return np.concatenate([column[run] for run in runs])


def _signs(turned: NDArray[np.int8]) -> NDArray[np.int8]:
    """Return -1 where points are flipped, else 1, (n, 1) int8. turned : (n,), not 0 where flipped"""
    return np.where(turned, np.int8(-1), np.int8(1))[:, None]


def _ring_columns(rings: int = sheets.RINGS) -> list[str]:
    return [f"{name}-{ring}" for ring in range(rings) for name in (FOUND, BESIDE)]


def orient_sheets_of_parts(work: Work, cloud: Cloud, facts: Sequence[Facts], span: Span) -> None:
    """Flip wrong normals of thin plates and cavities, where two sheets are close, unless already done.

    facts : of each part: "thick", the number of points that may be near two sheets, and "low" and "high", its bounding
        box
    span : begin and end of this stage, as fractions of all work
    """
    thick = [fact["thick"] for fact in facts]
    if work.columns.get(DONE) is not None or not sum(thick):
        return
    low, high = (np.array([fact[name] for fact in facts], np.float32) for name in ("low", "high"))
    frame = Frame(work.columns[PLACED][:1][0], float((high.max(axis=0) - low.min(axis=0)).max()))
    if ThinSheets(work, cloud, frame, thick).orient(span):
        work.columns.put(PARTED, {})
    work.columns.put(DONE, {})
