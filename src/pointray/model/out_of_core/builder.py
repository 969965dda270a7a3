"""Builder of a model in parts from a cloud that does not fit into memory.

In most stages the parts are independent of each other once the previous stages are done for all parts. Results are
stored as columns in the folder "unfinished", so that an interrupted run can be resumed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ...base.disk_columns import Columns
from ...base.executor import TaskExecutor
from ...base.progress import Progress, part_of
from ...base.warning_log import warn
from ...cloud.denoising.noise import NoiseRanges, raise_to_typical
from ...cloud.georeference import SCAN
from ...cloud.normals.consistency import disagreement_share, sample_rows
from ...cloud.normals.estimate import DISAGREE, describe_repairs
from ...cloud.normals.stations import warn_of_ignored
from ...cloud.normals.units import to_units
from ...io.spooling.spooled import Spooled
from ...surface.splats.scattered.spheres import ALL_SURFACE, Drawing, check_drawing
from ...surface.splats.support import isolated_note
from ...surface.tree.settings import LOOSE_TRIM, TreeSettings
from . import layer, stages
from .arrange import CHUNK, TILE, Arrangement
from .facing import turn_fits, turn_given
from .finish import WrittenParts, finish, finish_loose, finish_surface, id_in
from .given import RADIUS, GivenColumns
from .level_steps import ModelInfo
from .second_layers import find_layers
from .separate_scattered import DIRECTIONS, LOOSE, ROW, SEPARATED, SPHERES, SURFACE, Shaping, number_rows, separate
from .stages import Cloud
from .tasks import BORDERS, RADII, SHEETS, Measure, Supporting, find_supports, find_surface, measure_noise, move_layers
from .thin_sheets import orient_sheets_of_parts
from .trees import least_size
from .work import Work

SCAN_ATTRIBUTES = SCAN, "point_source_id"  # attributes that hold the scan of each point
# Progress after each stage.
ARRANGED, SORTED, SEARCHED, MERGED_AT, TURNED_AT, EXAMINED, PLACED_AT, TURNED_FITS, FACED_AT, SUPPORTED = (
    *(0.12, 0.16, 0.22, 0.3, 0.35, 0.4, 0.5, 0.56, 0.6, 0.8),
)
LEVELED, WRITTEN = 0.95, 0.97  # progress after the levels of the surface, and of scattered points
SEPARATED_AT = 0.3  # progress after scattered points are in columns of their own; the surface takes the rest


@dataclass(frozen=True)
class BuildOptions:
    """Options of a model that is built from a cloud on disk.

    settings : the implicit surface, the samples along a ray, how far hits may lie from splats, the voxel size
    smooth : standard deviation of the noise to remove from the positions, or "auto"
    size : points of a part, a power of two
    leveled : whether parts get levels of detail
    drawing : how points that lie on no surface are drawn; None: as spheres, but like the surface with given radii
    given : whether the cloud has radii; None: decided by its columns
    """

    settings: TreeSettings
    smooth: str | float
    size: int
    leveled: bool = True
    drawing: Drawing | None = None
    given: bool | None = None


class OutOfCoreBuilder:
    """Builder of a model in parts from a cloud on disk that may be larger than memory; `build` runs all stages.

    Parameters
    ----------
    folder : path
        Folder of the model.
    columns : Columns
        Columns on disk with the cloud as read from its files; results are added.
    spooled : Spooled
        Description of the cloud in these columns.
    options : BuildOptions
    progress : callable, optional
        Called with the fraction done.
    tasks : TaskExecutor, optional
        Workers that process parts and see the folder. None: this process.
    """

    def __init__(
        self,
        folder: Path,
        columns: Columns,
        spooled: Spooled,
        options: BuildOptions,
        progress: Progress | None = None,
        tasks: TaskExecutor | None = None,
    ) -> None:
        self._folder, self._columns, self._spooled = folder, columns, spooled
        self._given_columns = given_columns = GivenColumns(columns, spooled)
        self._names = given_columns.names
        size = max(options.size, least_size(spooled.rows), TILE)
        given = given_columns.have_radii() if options.given is None else options.given
        smooth = 0.0 if given and options.smooth == "auto" else options.smooth
        self._options, self._given = replace(options, size=size, smooth=smooth), given
        scatter, factor = ("auto", 1.0) if options.drawing is None else options.drawing
        self._drawing = check_drawing(scatter, factor, given)
        viewpoint_columns = {name: f"points.{self._names[name]}" for name in SCAN_ATTRIBUTES if name in self._names}
        ignored = given_columns.ignored_stations()
        about = columns, spooled.rows, spooled.origin, spooled.georeference, viewpoint_columns
        self._cloud = Cloud(*about, given_columns.are_seen(ignored), ignored)
        self._work, self._tasks = Work(columns, spooled.rows, size, progress, tasks), tasks
        self.settings, self._progress = options.settings, progress

    def build(self) -> int:
        """Run all stages and write the model, the index file last; return the number of points.

        Points that lie on no surface are separated first. Parts of the surface are built next, then those of these
        points.
        """
        all_written, drawing = [], self._drawing
        surface, loose = self._separate()
        written = None if surface is None else surface.make()
        if written is not None:
            all_written.append(written)
        if loose is not None:
            splats = {layer.POSITIONS: "positions", layer.NORMALS: DIRECTIONS, layer.RADII: SPHERES}
            whole = layer.finest_layer(loose, splats | self._given_sources())
            span = LEVELED, WRITTEN
            all_written.append(finish_loose(self._info, loose, whole, drawing, written, self._options.leveled, span))
        settings = self._options.settings if surface is None else surface.settings
        facts = {**settings._asdict(), "smooth": self._options.smooth, **drawing.facts}
        count = 0 if loose is None else all_written[-1].layer.total
        finish(self._info, all_written, facts, count, part_of(self._progress, WRITTEN, 1.0))
        return sum(written.layer.total for written in all_written)

    def make(self) -> WrittenParts:
        """Run all stages of a surface, from sorting to radii, and write its parts; return what was written."""
        self._arrange()
        self._merge()
        self._place()
        self._support()
        return self._write()

    @property
    def _info(self) -> ModelInfo:
        """Facts that the model's files contain: folder, id, origin, georeference and names of attributes."""
        spooled = self._spooled
        return ModelInfo(self._folder, id_in(self._columns), spooled.origin, spooled.georeference, list(self._names))

    @property
    def _radii(self) -> str | None:
        """Name of the column on disk with given radii; None: radii are chosen from the spacing."""
        return f"points.{self._names[RADIUS]}" if self._given else None

    def _separate(self) -> tuple[OutOfCoreBuilder | None, Work | None]:
        """Move the points that lie on no surface to columns of their own, unless they are drawn like the surface.

        Returns
        -------
        surface : OutOfCoreBuilder or None
            Builder of the surface from the other points; None if there are no others.
        scattered : Work or None
            Columns of the points that lie on no surface; None if no point is drawn as such.
        """
        if not self._drawing.is_apart:
            return self, None
        columns, work, drawing = self._columns, self._work, self._drawing
        if columns.get("sorted") is None and columns.get("scattered") is None:
            number_rows(columns, self._cloud.total)
        if columns.get(SEPARATED) is None:
            self._arrange()
        shaping = Shaping(drawing, self._radii)
        count, loose = separate(work, self._cloud, self._given_columns.all, shaping, (SORTED, SEPARATED_AT))
        rest = part_of(self._progress, SEPARATED_AT, WRITTEN)
        if count == self._cloud.total:
            self._work = Work(columns, count, work.size, rest, self._tasks)
            return self, None
        surface, scattered = (Columns(columns.folder / name) for name in (SURFACE, LOOSE))
        surface.put("id", {"id": id_in(columns)})
        options = replace(self._options, drawing=ALL_SURFACE, given=self._given)
        about = self._spooled._replace(rows=count), options, rest, self._tasks
        made = OutOfCoreBuilder(self._folder, surface, *about) if count else None
        return made, Work(scattered, loose, work.size, self._progress, self._tasks) if loose else None

    def _arrange(self) -> None:
        columns = self._columns
        if columns.get("sorted") is None:
            names = self._given_columns.all + [ROW] * (self._given_columns.find(ROW) is not None)
            arrangement = Arrangement(columns, names, self._cloud.total, self._work.size)
            arrangement.cut_and_scatter(self._work.watch((0.0, ARRANGED)))
            arrangement.make_columns()
            self._work.each("sort", arrangement.sort, (ARRANGED, SORTED))
            columns.put("sorted", {})
            arrangement.tidy()

    def _merge(self) -> None:
        """Move second layers, such as those of misaligned scans, onto one surface.

        With given radii nothing is moved.
        """
        if self._options.smooth == 0.0 or self._given:
            return
        cloud, work = self._cloud, self._work
        statistics = work.statistics_for("layers", partial(stages.merge, cloud))
        find_layers(work, cloud, (SORTED, SEARCHED))
        work.make_column(stages.MERGED, np.float32, 3)
        work.each("merge", partial(move_layers, work, cloud, statistics), (SEARCHED, MERGED_AT))
        self._columns.put(stages.MERGED, {})

    def _place(self) -> None:
        """Find the surface: remove noise from the positions, fit or check normals, and choose their signs.

        Warn of normals that were missing or not of unit length.
        """
        cloud, sigma, work = self._cloud, self._options.smooth, self._work
        has_normals = stages.GIVEN in self._columns
        if has_normals:
            self._check_signs()
        if not has_normals or cloud.has_units:
            warn_of_ignored(cloud.ignored, len(cloud.georeference.stations))
        ranges = self._noise_ranges() if sigma == "auto" else None
        statistics = None if has_normals else work.statistics_for("fits", partial(stages.survey_fits, cloud))
        for name in (stages.PLACED, stages.NORMALS, *stages.PLANES):
            work.make_column(name, np.float32, 3)
        work.make_column(stages.NOISE, np.float32)
        work.make_column(stages.THICK, np.int8)
        if cloud.is_seen:
            work.make_column(stages.KNOWN, np.int8)
        measure = Measure(sigma, ranges, statistics)
        facts = work.each("place", partial(find_surface, work, cloud, measure), (EXAMINED, PLACED_AT))
        self._is_noisy = any(fact["is_noisy"] for fact in facts)
        if not has_normals:
            turn_fits(work, cloud, any(fact["has_planes"] for fact in facts), (PLACED_AT, TURNED_FITS))
            if not cloud.is_seen:
                orient_sheets_of_parts(work, cloud, facts, (TURNED_FITS, FACED_AT))
        repaired = [fact["mended"] for fact in facts] + [(self._columns.get(stages.TURNED) or {}).get("mended", (0, 0))]
        lost, odd = np.sum(repaired, axis=0).tolist()
        for text in describe_repairs(lost, odd, cloud.total):
            warn(text, stacklevel=4)

    def _noise_ranges(self) -> NoiseRanges:
        """Measure the noise in all parts; return it for ranges of points along the kd order of the whole cloud."""
        facts = self._work.each("noise", partial(measure_noise, self._work, self._cloud), (TURNED_AT, EXAMINED))
        kinds = np.int64, np.float32, np.float64, np.float64
        arrays = [
            np.concatenate([np.array(fact[name], kind) for fact in facts])
            for name, kind in zip(NoiseRanges._fields, kinds, strict=True)
        ]
        return raise_to_typical(NoiseRanges(*arrays))

    def _check_signs(self) -> None:
        """Recompute the signs of the normals from the files, with a warning, if over 5% of neighbours disagree."""
        columns, rows = self._columns, sample_rows(self._cloud.total)
        where = columns[self._cloud.latest(stages.MERGED, stages.POSITIONS)]
        unit, length = to_units(columns[stages.GIVEN][rows])
        good = np.flatnonzero(length > 0)
        share = disagreement_share(where[rows][good], unit[good], np.arange(len(good), dtype=np.int32))
        if share > DISAGREE:
            turn_given(self._work, self._cloud, (MERGED_AT, TURNED_AT))
            opposite = f"{100 * share:.0f}% of neighbouring normals face opposite sides"
            warn(f"{opposite}: directions kept, signs recomputed", stacklevel=5)

    def _support(self) -> None:
        """Find the support radius of each point, and write it to a column; warn of isolated points."""
        cloud, work = self._cloud, self._work
        supporting = Supporting(self._radii, self._options.settings)
        statistics = work.statistics_for("support", partial(supporting.find, cloud))
        work.make_column(RADII, np.float32)
        work.make_column(BORDERS, np.float32, 3)
        work.make_column(SHEETS, np.int8)
        find = partial(find_supports, work, cloud, supporting, statistics)
        self._supports = work.each("support", find, (FACED_AT, SUPPORTED))
        note = isolated_note(sum(fact["lone"] for fact in self._supports), cloud.total)
        if note:
            warn(note, stacklevel=4)

    def _write(self) -> WrittenParts:
        """Write the files of all parts of the surface, with levels of detail if the options say so."""
        facts, settings = self._supports, self._options.settings
        if any(fact["tight"] for fact in facts):
            settings = settings._replace(trim=LOOSE_TRIM)
        self.settings = settings
        used = [RADII, *(name for name in (BORDERS, SHEETS) if any(fact[name] for fact in facts))]
        if self._is_noisy:
            _limit_noise(self._columns)
            used.append(stages.NOISE)
        sources = {layer.POSITIONS: stages.PLACED, layer.NORMALS: self._cloud.normals, **{name: name for name in used}}
        splats = layer.finest_layer(self._work, sources | self._given_sources("points."))
        return finish_surface(self._info, self._work, splats, settings, self._options.leveled, (SUPPORTED, LEVELED))

    def _given_sources(self, prefix: str = "") -> dict[str, layer.Source | None]:
        """Return the columns of the points as given, by the names that a `Layer` has for these properties.

        prefix : of the names of the columns; "points." for those in kd order
        """
        names = {layer.GIVEN_POSITIONS: "positions", layer.GIVEN_NORMALS: "normals", layer.COLORS: "colors"}
        names |= {f"{layer.ATTRIBUTE}{k}": column for k, column in enumerate(self._names.values())}
        return {name: prefix + column for name, column in names.items()}


def _limit_noise(columns: Columns) -> None:
    """Limit the noise of each point to its radius: a surface has no bumps higher than its supports."""
    noise, radii = columns[stages.NOISE], columns[RADII]
    for start in range(0, len(radii), CHUNK):
        rows = slice(start, start + CHUNK)
        noise.write(start, np.minimum(noise[rows], radii[rows]))
