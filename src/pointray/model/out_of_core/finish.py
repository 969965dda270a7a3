"""Writing of a model in parts from splats in columns."""

from __future__ import annotations

import secrets
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats
from ...base.disk_columns import Column, Columns
from ...base.progress import Progress, report_progress
from ...engine.kernels.tree import LONGEST
from ...surface.splats.scattered.spheres import Drawing
from ...surface.tree.build import Splats
from ...surface.tree.settings import TreeSettings
from ...surface.tree.top import Groups
from ..model_folder import Index, PartFile, write_index, write_part, write_points
from .layer import (
    ATTRIBUTE,
    BORDERS,
    COLORS,
    GIVEN_NORMALS,
    GIVEN_POSITIONS,
    NOISE,
    NORMALS,
    POSITIONS,
    RADII,
    SHEETS,
    Layer,
)
from .level_steps import ModelInfo
from .levels import median_of, write_levels
from .scattered_parts import LooseParts, write_loose_levels, write_loose_part
from .trees import Plan, bounds_about, box_around, cells_of, plan_of, shown, tree_of
from .work import Facts, Span, Work, within

SHOWN, TREES = 0.07, 0.6  # progress after boxes, and after trees; levels of detail take the rest


class WrittenParts(NamedTuple):
    """Parts of a model that are written to files: those of the surface, or those of points drawn as spheres or discs.

    layer : points of the parts, as given and as rays meet them
    files : entries of the parts in the index file
    supports : boxes that together enclose all supports of the parts, (6,) each
    longest : longest distance between a ray's samples; 0 for parts of spheres or discs
    median : median support radius of a surface with levels of detail, else None
    """

    layer: Layer
    files: list[PartFile]
    supports: list[list[float]]
    longest: float = 0.0
    median: float | None = None


class Chain:
    """Concatenation of columns on disk or arrays, which `write_points` reads by slices like one array."""

    def __init__(self, columns: list[Column | NDArray[Any]]) -> None:
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


class Numbers:
    """Stand-in for a column on disk whose value in each row is the number of that row.

    It is the field `rows` of splats that are in the order of their points.
    """

    def __getitem__(self, rows: Any) -> NDArray[np.int32]:
        return np.arange(rows.start, rows.stop, dtype=np.int32) if isinstance(rows, slice) else rows.astype(np.int32)


def finish_surface(
    named: ModelInfo, work: Work, layer: Layer, settings: TreeSettings, leveled: bool, span: Span
) -> WrittenParts:
    """Write the files of the parts of a surface, and of their levels of detail; return what was written.

    named : facts that all files contain; layer : splats of the full model
    settings : of the tree; leveled : whether to write levels of detail
    span : begin and end of this stage, as fractions of all work
    """
    grown = within(span, 0.0, TREES if leveled else 1.0)
    shows = work.all(partial(_show, layer, work.size), within(span, 0.0, SHOWN), "boxes")
    plan = plan_of(shows, layer.column(RADII), work.size)
    trees = work.each("tree", partial(_grow, named, layer, plan, settings), (within(span, SHOWN, 1.0)[0], grown[1]))
    files, median = [PartFile.of(tree["file"]) for tree in trees], None
    if leveled:
        median = median_of(layer, work.columns)
        files = write_levels(work, layer, named, cells_of(plan), files, (grown[1], span[1]))
    supports = [plan.supports.astype(float).tolist()]
    return WrittenParts(layer, files, supports, max(tree["longest"] for tree in trees), median)


def finish_loose(
    named: ModelInfo,
    work: Work,
    layer: Layer,
    drawing: Drawing,
    surface: WrittenParts | None,
    leveled: bool,
    span: Span,
) -> WrittenParts:
    """Write the files of the parts of scattered points (drawn as spheres or discs); return what was written.

    These parts follow those of the surface.

    named : facts that all files contain
    layer : the scattered points; drawing : whether these are drawn as spheres or discs, and a factor for their radii
    surface : the parts of the surface, written before; None: no surface
    leveled : whether to write levels of detail; span : begin and end of this stage, as fractions of all work
    """
    middle = (span[0] + span[1]) / 2
    parts, rows = ([], 0) if surface is None else (surface.files, surface.layer.total)
    loose = LooseParts(layer, drawing, len(parts), rows)
    facts = work.each("tree", partial(write_loose_part, named, loose), (span[0], middle if leveled else span[1]))
    files = [PartFile.of(fact["file"]) for fact in facts]
    if leveled:
        median = None if surface is None else surface.median
        files = write_loose_levels(work, loose, named, (median, parts), files, (middle, span[1]))
    return WrittenParts(layer, files, [fact["supports"] for fact in facts])


def finish(
    named: ModelInfo,
    all_written: list[WrittenParts],
    settings: dict[str, Any],
    loose: int,
    report: Progress | None,
    bounds: list[list[float]] | None = None,
) -> None:
    """Write the points of all parts and, last, the index file, which makes the folder a model.

    named : facts that all files contain
    all_written : the parts of the surface, then those of scattered points, whose files exist already
    settings : of the model, as JSON types; loose : number of scattered points (drawn as spheres or discs)
    report : called with the fraction done
    bounds : (2, 3) of the model, world; None: of the points of all parts
    """
    given = {
        "points.positions": GIVEN_POSITIONS,
        "points.normals": GIVEN_NORMALS,
        "points.colors": COLORS,
        **{f"attribute.{name}": f"{ATTRIBUTE}{k}" for k, name in enumerate(named.attributes)},
        "radii": RADII,
    }
    columns = {
        name: Chain([written.layer.column(source) for written in all_written])
        for name, source in given.items()
        if source in all_written[0].layer
    }
    sizes = write_points(named.folder, named.id, named.origin, columns, partial(report_progress, report))
    files = [file for written in all_written for file in written.files]
    if bounds is None:
        boxes = np.array([file.bounds for file in files])
        bounds = [boxes[:, 0].min(axis=0).tolist(), boxes[:, 1].max(axis=0).tolist()]
    supports = np.array([box for written in all_written for box in written.supports])
    around, longest = box_around(supports).tolist(), max(written.longest for written in all_written)
    index = Index(named.id, settings, named.georeference.facts, bounds, around, longest, *sizes, files, loose)
    write_index(named.folder, index)


def _splats_of(layer: Layer) -> Splats:
    """Return the splats of a full model, with columns on disk or arrays as fields."""
    arrays: list[Any] = [layer.column(name) for name in (POSITIONS, NORMALS, RADII)]
    arrays.append(Numbers())
    arrays += [layer.column(name) if name in layer else None for name in (COLORS, BORDERS, SHEETS, NOISE)]
    return Splats(*arrays)


def _show(layer: Layer, size: int, part: int) -> tuple[Groups, Floats]:
    """Return the bounds of a part that the trees of other parts need: of each 64 blocks, and (6,) of all its supports.

    layer : splats of all parts; size : number of splats of each part
    """
    return shown(_splats_of(layer), size, part)


def _grow(named: ModelInfo, layer: Layer, plan: Plan, settings: TreeSettings, part: int) -> Facts:
    """Build the tree of a part of a surface and write it to the part's file.

    named : facts that all files contain; layer : splats of all parts
    plan : values that the trees of all parts share

    Returns
    -------
    dict
        file : index entry of the part; longest : longest distance between a ray's samples.
    """
    tree, here = tree_of(_splats_of(layer), plan, part, settings), layer.read(GIVEN_POSITIONS, layer.own(part))
    file = write_part(named.folder, named.id, part, len(here), bounds_about(here, named.origin), tree)
    return {"file": file.facts, "longest": float(tree.head[LONGEST])}


def id_in(columns: Columns) -> str:
    """Return the hexadecimal number that all files of a model in parts contain; create and store it if missing."""
    return str(columns.get_or_put("id", lambda: {"id": secrets.token_hex(8)})["id"])
