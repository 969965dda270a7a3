"""A cloud that does not fit into memory -> a model in parts.

Stages follow each other. Of most, each part is independent of the others, once the stages before are done for all
parts; what each finds stays in columns in the folder "unfinished", so that an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ..points.normals.checks import RUN, RUNS, agreement_share
from ..points.normals.estimate import DISAGREE, told
from ..points.normals.units import to_units
from ..points.smoothing.noise import Stretches, settled
from ..points.usual import Usual
from ..progress import Progress
from ..splats.make import check_size
from ..splats.radii import radii_among
from ..splats.support import Support, lone_note
from ..survey import SCAN
from ..tree.settings import LOOSE_TRIM, TreeSettings
from .arrange import CHUNK, TILE, Arrangement
from .columns import Columns
from .facing import turn_fits, turn_given
from .finish import BORDERS, RADII, SHEETS, Described, finish
from .local import Local
from .spooled import Spooled
from .stages import (
    GIVEN,
    KNOWN,
    MERGED,
    NOISE,
    NORMALS,
    PLACED,
    PLANES,
    POSITIONS,
    Cloud,
    examine,
    fit,
    merge,
    place,
    support,
    survey_fits,
)
from .trees import least_size
from .work import Facts, Work

SEERS = SCAN, "point_source_id"  # attributes that tell who saw each point
RADIUS = "radius"  # the attribute that holds given radii
# Shares of the time after which stages are done.
ARRANGED, SORTED, MERGED_AT, TURNED_AT, EXAMINED, PLACED_AT, FACED_AT, SUPPORTED = (
    *(0.12, 0.16, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8),
)


@dataclass(frozen=True)
class Wanted:
    """How a model is made, see `Model`.

    size : points of a part, a power of two
    leveled : whether parts get levels of detail
    """

    settings: TreeSettings
    smooth: str | float
    size: int
    leveled: bool = True


class Large:
    """A cloud on disk, stage by stage.

    Parameters
    ----------
    folder : path
        Of the model.
    columns : Columns
        What `spool` has left, and what is found.
    spooled : Spooled
    wanted : Wanted
    progress : callable, optional
    """

    def __init__(
        self, folder: Path, columns: Columns, spooled: Spooled, wanted: Wanted, progress: Progress | None = None
    ) -> None:
        self._folder, self._columns, self._spooled = folder, columns, spooled
        self._names = {name: f"attribute.{k}" for k, name in enumerate(spooled.attributes)}
        size = max(wanted.size, least_size(spooled.rows), TILE)
        given = self._given_radii()
        smooth = 0.0 if given and wanted.smooth == "auto" else wanted.smooth
        self._wanted, self._given = replace(wanted, size=size, smooth=smooth), given
        seers = {name: f"points.{self._names[name]}" for name in SEERS if name in self._names}
        self._cloud = Cloud(columns, spooled.rows, spooled.origin, spooled.survey, seers, self._is_seen())
        self._work = Work(columns, spooled.rows, size, progress)

    def build(self) -> None:
        """Do all stages, and write the model; the index comes last."""
        self._arrange()
        self._merge()
        self._place()
        self._support()
        self._write()

    def _given_radii(self) -> bool:
        """Whether the cloud comes with radii, see `radii_in`."""
        name = self._names.get(RADIUS, RADIUS)
        column = self._columns.find(name) or self._columns.find(f"points.{name}")
        if column is None or column.width or column.dtype == np.bool_:
            return False
        chunks = (column[start : start + CHUNK] for start in range(0, len(column), CHUNK))
        return all(radii_among(chunk) is not None for chunk in chunks)

    def _is_seen(self) -> bool:
        """Whether it is told of any point who saw it, see `eyes_of`."""
        stations, name = len(self._spooled.survey.stations), self._names.get(SCAN)
        column = None if name is None else self._columns.find(name) or self._columns.find(f"points.{name}")
        if column is None or column.width:
            return stations == 1
        chunks = (column[start : start + CHUNK] for start in range(0, len(column), CHUNK))
        return any(bool(((chunk >= 0) & (chunk < stations) & (chunk == np.rint(chunk))).any()) for chunk in chunks)

    def _arrange(self) -> None:
        columns = self._columns
        names = [name for name in ("positions", "normals", "colors") if name in columns or f"points.{name}" in columns]
        names += list(self._names.values())
        arrangement = Arrangement(columns, names, self._cloud.total, self._work.size)
        if columns.get("sorted") is None:
            arrangement.cut_and_scatter(self._work.watch((0.0, ARRANGED)))
            arrangement.make_room()
            self._work.each("sort", arrangement.sort, (ARRANGED, SORTED))
            columns.put("sorted", {})
            arrangement.tidy()

    def _merge(self) -> None:
        """Move second layers onto one surface."""
        if self._wanted.smooth == 0.0 or self._given:
            return
        usual = self._work.surveyed("layers", lambda local, usual: merge(self._cloud, local, usual))
        room = self._work.room(MERGED, np.float32, 3)

        def move(part: int) -> None:
            local = self._work.local(part)
            local.write(room, merge(self._cloud, local, usual))

        self._work.each("merge", move, (SORTED, MERGED_AT))
        self._columns.put(MERGED, {})

    def _place(self) -> None:
        """Find normals and noise, and move noisy points."""
        cloud, sigma, work = self._cloud, self._wanted.smooth, self._work
        has_normals = GIVEN in self._columns
        if has_normals:
            self._check_signs()
        stretches = self._stretches() if sigma == "auto" else None
        usual = None if has_normals else work.surveyed("fits", partial(survey_fits, cloud))
        rooms = {name: work.room(name, np.float32, 3) for name in (PLACED, NORMALS, *PLANES)}
        noise, known = work.room(NOISE, np.float32), work.room(KNOWN, np.int8) if cloud.is_seen else None

        def put(part: int) -> Facts:
            local = work.local(part)
            rest = local, sigma, stretches
            found = place(cloud, *rest) if usual is None else fit(cloud, *rest, usual)
            local.write(rooms[PLACED], found.positions)
            local.write(rooms[NORMALS], found.normals)
            if found.noise is not None:
                local.write(noise, found.noise)
            for name, values in zip(PLANES, found.planes or (), strict=False):
                local.write(rooms[name], values)
            if known is not None and found.known is not None:
                local.write(known, found.known)
            said = {"is_noisy": found.noise is not None, "has_planes": found.planes is not None}
            return {**said, "mended": list(found.mended)}

        facts = work.each("place", put, (EXAMINED, PLACED_AT))
        self._is_noisy = any(fact["is_noisy"] for fact in facts)
        if not has_normals:
            turn_fits(work, cloud, any(fact["has_planes"] for fact in facts), (PLACED_AT, FACED_AT))
        lost, odd = np.sum([fact["mended"] for fact in facts], axis=0).tolist()
        for text in told(lost, odd, cloud.total):
            warnings.warn(text, stacklevel=4)

    def _stretches(self) -> Stretches:
        """The noise of all parts."""

        def look(part: int) -> Facts:
            found = examine(self._cloud, self._work.local(part))
            return {name: values.tolist() for name, values in found._asdict().items()}

        facts = self._work.each("noise", look, (TURNED_AT, EXAMINED))
        kinds = np.int64, np.float32, np.float64, np.float64
        arrays = [
            np.concatenate([np.array(fact[name], kind) for fact in facts])
            for name, kind in zip(Stretches._fields, kinds, strict=True)
        ]
        return settled(Stretches(*arrays))

    def _check_signs(self) -> None:
        """Warn of normals that look to opposite sides or inwards."""
        columns, total = self._columns, self._cloud.total
        rows = np.arange(total)
        if total > RUNS * RUN:
            rows = (np.linspace(0, total - RUN, RUNS).astype(np.int64)[:, None] + np.arange(RUN)).ravel()
        where = columns[self._cloud.latest(MERGED, POSITIONS)]
        unit, length = to_units(columns[GIVEN][rows])
        good = np.flatnonzero(length > 0)
        share = agreement_share(where[rows][good], unit[good], np.arange(len(good), dtype=np.int32))
        if share > DISAGREE:
            turn_given(self._work, self._cloud, (MERGED_AT, TURNED_AT))
            opposite = f"{100 * share:.0f}% of neighbouring normals look to opposite sides"
            warnings.warn(f"{opposite}: directions kept, signs set anew", stacklevel=5)

    def _support(self) -> None:
        """Find the support of each point."""
        cloud, settings = self._cloud, self._wanted.settings
        radii = f"points.{self._names[RADIUS]}" if self._given else None

        def find(local: Local, usual: Usual) -> Support:
            given = None if radii is None else np.asarray(local.read(self._columns[radii]), np.float32)
            return support(cloud, local, given, settings, usual)

        usual = self._work.surveyed("support", find)
        room = self._work.room(RADII, np.float32)
        borders, sheets = self._work.room(BORDERS, np.float32, 3), self._work.room(SHEETS, np.int8)

        def put(part: int) -> Facts:
            local = self._work.local(part)
            found = find(local, usual)
            check_size(found.radii)
            local.write(room, found.radii)
            if found.borders is not None:
                local.write(borders, found.borders)
            if found.sheets is not None:
                local.write(sheets, found.sheets)
            return {
                "borders": found.borders is not None,
                "sheets": found.sheets is not None and bool(found.sheets[local.own].any()),
                "lone": int(found.lone[local.own].sum()),
                "tight": found.tight,
            }

        self._supports = self._work.each("support", put, (FACED_AT, SUPPORTED))
        note = lone_note(sum(fact["lone"] for fact in self._supports), cloud.total)
        if note:
            warnings.warn(note, stacklevel=4)

    def _write(self) -> None:
        """Write all files of the model."""
        facts, settings = self._supports, self._wanted.settings
        if any(fact["tight"] for fact in facts):
            settings = settings._replace(trim=LOOSE_TRIM)
        optional = [name for name in (BORDERS, SHEETS) if any(fact[name] for fact in facts)]
        optional += [NOISE] if self._is_noisy else []
        attributes = {name: f"points.{column}" for name, column in self._names.items()}
        model = Described(settings, self._wanted.smooth, attributes, tuple(optional), self._wanted.leveled)
        finish(self._folder, self._work, self._cloud, model, (SUPPORTED, 1.0))
