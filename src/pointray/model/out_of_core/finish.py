"""Writing of a model in parts from splats in columns."""

from __future__ import annotations

import secrets
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.disk_columns import Column, Columns
from ...base.progress import Progress, report_progress
from ...engine.kernels.tree import LONGEST
from ...surface.splats.scattered.spheres import Drawing
from ...surface.tree.build import Splats
from ...surface.tree.settings import TreeSettings
from ...surface.tree.top import Groups
from ..model_folder import Index, PartFile, write_columns, write_index, write_part
from . import layer
from .arrange import CHUNK
from .layer import Layer
from .level_steps import ATTRIBUTE, ModelInfo
from .levels import median_of, write_levels
from .scattered_parts import LooseParts, write_loose_levels, write_loose_part
from .separate_scattered import DIRECTIONS, SPHERES
from .stages import NOISE, PLACED, POSITIONS, Cloud
from .tasks import BORDERS, RADII, SHEETS
from .trees import Plan, bounds_about, cells_of, plan_of, shown, tree_of
from .work import Facts, Work

SHOWN, TREES = 0.07, 0.6  # progress after boxes, and after trees; levels of detail take the rest

Span = tuple[float, float]


class Described(NamedTuple):
    """Description of the surface of a model.

    settings, smooth : see `Model`
    attributes : dict of str to str, the columns of the attributes
    optional : tuple of str, those of the columns `BORDERS`, `SHEETS` and `NOISE` that any splat needs
    leveled : whether it gets levels of detail
    """

    settings: TreeSettings
    smooth: str | float
    attributes: dict[str, str]
    optional: tuple[str, ...]
    leveled: bool


class WrittenParts(NamedTuple):
    """Written parts of the surface, or of the scattered points.

    rows : number of points; files : index entries of the parts; supports : bounding boxes of supports
    longest : longest sampling step
    columns : (positions, normals and colours by name, each may be None; attributes; radii)
    median : median radius, or None
    """

    rows: int
    files: list[PartFile]
    supports: list[list[float]]
    longest: float
    columns: tuple[dict[str, Column | None], dict[str, Column], Column]
    median: float | None = None


class Chain:
    """Concatenation of columns, for `write_columns`."""

    def __init__(self, columns: list[Column]) -> None:
        self._columns = columns
        self._ends = np.cumsum([len(column) for column in columns])
        self.dtype, self.shape = columns[0].dtype, (int(self._ends[-1]), *columns[0].shape[1:])

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        start, stop, _ = rows.indices(self.shape[0])
        pieces = [
            column[max(start - first, 0) : max(min(stop - first, len(column)), 0)]
            for first, column in zip([0, *self._ends[:-1].tolist()], self._columns, strict=True)
        ]
        return np.concatenate(pieces)


def _chained(columns: list[Column | None]) -> Chain | None:
    there = [column for column in columns if column is not None]
    return Chain(there) if there else None


class Numbers:
    """Row numbers, as if read from a column."""

    def __getitem__(self, rows: Any) -> NDArray[np.int32]:
        return np.arange(rows.start, rows.stop, dtype=np.int32) if isinstance(rows, slice) else rows.astype(np.int32)


def finish_surface(named: ModelInfo, work: Work, cloud: Cloud, model: Described, span: Span) -> WrittenParts:
    """Write the parts of the surface."""
    columns, size = work.columns, work.size
    if NOISE in model.optional:
        _limit_noise(columns)
    first, grown = (span[0] + share * (span[1] - span[0]) for share in (SHOWN, TREES))
    shows = work.all(partial(_show, work, cloud, model), (span[0], first), "boxes")
    plan = plan_of(shows, columns[RADII], size)
    grow = partial(_grow, named.folder, named.id, work, cloud, model, plan)
    trees = work.each("tree", grow, (first, grown if model.leveled else span[1]))
    files, median = [PartFile.of(tree["file"]) for tree in trees], None
    if model.leveled:
        whole = _layer_of(work, cloud, model)
        median = median_of(whole, columns)
        files = write_levels(work, whole, named, cells_of(plan), files, (grown, span[1]))
    points = {name: columns.find(f"points.{name}") for name in ("positions", "normals", "colors")}
    attributes = {name: columns[column] for name, column in model.attributes.items()}
    longest, supports = max(tree["longest"] for tree in trees), [plan.supports.astype(float).tolist()]
    return WrittenParts(cloud.total, files, supports, longest, (points, attributes, columns[RADII]), median)


def finish_loose(
    named: ModelInfo, work: Work, drawing: Drawing, surface: WrittenParts | None, leveled: bool, span: Span
) -> WrittenParts:
    """Write the parts of scattered points, which follow those of the surface, see `separate_scattered`."""
    columns, middle = work.columns, (span[0] + span[1]) / 2
    sources: dict[str, Any] = {layer.POSITIONS: "positions", layer.NORMALS: DIRECTIONS, layer.RADII: SPHERES}
    if "colors" in columns:
        sources[layer.COLORS] = "colors"
    keys = {name: f"{ATTRIBUTE}{k}" for k, name in enumerate(named.attributes)}
    sources |= {key: key for key in keys.values()}
    sizes = np.array([rows.stop - rows.start for rows in map(work.part_rows, range(work.parts))], np.int64)
    parts, rows = ([], 0) if surface is None else (surface.files, surface.rows)
    loose = LooseParts(Layer(0, columns, sizes, sizes, sources), drawing, len(parts), rows)
    facts = work.each("tree", partial(write_loose_part, named, loose), (span[0], middle if leveled else span[1]))
    files = [PartFile.of(fact["file"]) for fact in facts]
    if leveled:
        median = None if surface is None else surface.median
        files = write_loose_levels(work, loose, named, (median, parts), files, (middle, span[1]))
    points = {name: columns.find(name) for name in ("positions", "normals", "colors")}
    attributes = {name: columns[key] for name, key in keys.items()}
    supports = [fact["supports"] for fact in facts]
    return WrittenParts(int(sizes.sum()), files, supports, 0.0, (points, attributes, columns[SPHERES]))


def finish(
    named: ModelInfo, all_written: list[WrittenParts], settings: dict[str, Any], loose: int, report: Progress | None
) -> None:
    """Write the points and, last, the index. loose : number of scattered points"""
    points = {
        name: _chained([written.columns[0][name] for written in all_written]) for name in all_written[0].columns[0]
    }
    attributes = {name: _chained([written.columns[1][name] for written in all_written]) for name in named.attributes}
    radii = _chained([written.columns[2] for written in all_written])
    assert radii is not None
    known = {name: column for name, column in attributes.items() if column is not None}
    about = named.folder, named.id
    sizes = write_columns(*about, named.origin, points, known, radii, lambda share: report_progress(report, share))
    files = [file for written in all_written for file in written.files]
    boxes = np.array([file.bounds for file in files])
    bounds = [boxes[:, 0].min(axis=0).tolist(), boxes[:, 1].max(axis=0).tolist()]
    supports = np.array([box for written in all_written for box in written.supports])
    around = [*supports[:, :3].min(axis=0).tolist(), *supports[:, 3:].max(axis=0).tolist()]
    longest = max(written.longest for written in all_written)
    index = Index(named.id, settings, named.georeference.facts, bounds, around, longest, *sizes, files, loose)
    write_index(named.folder, index)


def _splats_of(cloud: Cloud, model: Described) -> Splats:
    """Return all splats, in newly opened columns."""
    columns = cloud.columns
    arrays: list[Any] = [
        *(columns[PLACED], columns[cloud.normals], columns[RADII], Numbers()),
        columns.find("points.colors"),
        *(columns[name] if name in model.optional else None for name in (BORDERS, SHEETS, NOISE)),
    ]
    return Splats(*arrays)


def _show(work: Work, cloud: Cloud, model: Described, part: int) -> tuple[Groups, NDArray[np.float32]]:
    """Return the groups and bounds of a part that other parts need."""
    return shown(_splats_of(cloud, model), work.size, part)


def _grow(folder: Path, id: str, work: Work, cloud: Cloud, model: Described, plan: Plan, part: int) -> Facts:
    """Write the file of a part with its tree."""
    tree = tree_of(_splats_of(cloud, model), plan, part, model.settings)
    here = work.columns[POSITIONS][work.part_rows(part)]
    file = write_part(folder, id, part, len(here), bounds_about(here, cloud.origin), tree)
    return {"file": file.facts, "longest": float(tree.head[LONGEST])}


def _layer_of(work: Work, cloud: Cloud, model: Described) -> Layer:
    """Return the splats as the finest layer of levels of detail."""
    columns = work.columns
    sources: dict[str, Any] = {layer.POSITIONS: PLACED, layer.NORMALS: cloud.normals, layer.RADII: RADII}
    if NOISE in model.optional:
        sources[layer.NOISE] = NOISE
    if "points.colors" in columns:
        sources[layer.COLORS] = "points.colors"
    sources |= {f"{ATTRIBUTE}{k}": column for k, column in enumerate(model.attributes.values())}
    sizes = np.array([rows.stop - rows.start for rows in map(work.part_rows, range(work.parts))], np.int64)
    return Layer(0, columns, sizes, sizes, sources)


def _limit_noise(columns: Columns) -> None:
    """Limit the noise to the radii: a surface has no bumps higher than its supports."""
    noise, radii = columns[NOISE], columns[RADII]
    for start in range(0, len(radii), CHUNK):
        rows = slice(start, start + CHUNK)
        noise.write(start, np.minimum(noise[rows], radii[rows]))


def id_in(columns: Columns) -> str:
    """Return the id that all files of the folder contain; create it if missing."""
    facts = columns.get("id")
    if facts is None:
        facts = {"id": secrets.token_hex(8)}
        columns.put("id", facts)
    return str(facts["id"])
