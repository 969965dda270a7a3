"""Scattered points of a model in parts: separate parts, which follow those of the surface.

Their trees hold nothing else, so each point belongs to one part, and a part is a range of their kd order. Levels of
detail are those of the whole model: a cell that several parts share gives one point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ...base.disk_columns import Columns
from ...cloud.points import Points
from ...engine.kernels.tree import BOUNDS, Tree, no_tree
from ...surface.splats.scattered.levels import ScatteredPoints, coarsen_scattered, spacing_of
from ...surface.splats.scattered.spheres import Drawing
from ...surface.tree.build import Splats
from ...surface.tree.scattered import with_scattered
from ...surface.tree.stored import find_surface_bounds
from ..levels_of_detail import LEVEL_SETTINGS
from ..model_file import Level
from ..model_folder import PartFile, write_level, write_part
from .grid import Grid, cells_of_part
from .layer import ATTRIBUTE, COLORS, NORMALS, POSITIONS, RADII, Layer
from .level_steps import LevelProgress, ModelInfo, points_at, splats_at
from .levels import Steps, make_columns, median_of, write_all_levels
from .trees import bounds_about
from .work import Facts, Span, Work, within


@dataclass(frozen=True)
class LooseParts:
    """Scattered points (those on no surface, drawn as spheres or discs) of all parts of a model.

    layer : the points at full detail, with positions, radii, optionally colours and attributes, and as normals the
        directions in which the spheres or discs face
    drawing : spheres or discs, and a factor for their radii
    first_part, first_row : number of the parts and of the points of the surface, which come first in the folder
    """

    layer: Layer
    drawing: Drawing
    first_part: int = 0
    first_row: int = 0


def write_loose_part(named: ModelInfo, loose: LooseParts, part: int) -> Facts:
    """Write the file of a part of scattered points (drawn as spheres or discs).

    named : facts that all files contain; loose : the points; part : number among the parts of scattered points

    Returns
    -------
    dict
        file : index entry; supports : (6,) bounds of its spheres or discs.
    """
    own, layer = loose.layer.own(part), loose.layer
    splats = splats_at(layer, own, loose.first_row + own.start)
    tree = _tree_of(splats, loose.drawing)
    bounds = bounds_about(splats.positions, named.origin)
    file = write_part(named.folder, named.id, loose.first_part + part, len(splats.radii), bounds, tree)
    file = file._replace(spacing=spacing_of(splats.radii, loose.drawing))
    return {"file": file.facts, "supports": tree.head[BOUNDS : BOUNDS + 6].astype(float).tolist()}


def write_loose_levels(
    work: Work,
    loose: LooseParts,
    named: ModelInfo,
    surface: tuple[float | None, list[PartFile]],
    parts: Any,
    span: Span,
) -> list[PartFile]:
    """Write levels of detail of scattered points (drawn as spheres or discs); return the index entries of their parts.

    Parameters
    ----------
    surface : (float or None, list of PartFile)
        Median radius of the model's surface, which decides on the grid cells of the levels, and the parts of the
        surface; None and an empty list if there is no surface.
    parts : list of PartFile
        Index entries of the scattered points' parts without levels.
    span : (float, float)
        Begin and end of this stage, as fractions of all work.
    """

    def shape(layer: Layer, cell: float, written: list[LevelProgress | None], span: Span) -> list[Facts]:
        do = partial(_write_loose_level, layer, loose, cell, named, written)
        return work.each(f"level-{layer.number}-tree", do, within(span, 0.5, 1.0))

    median, others = surface
    cell = spacing_in(loose, work.columns) if median is None else median
    reaches = [part.reach for part in others]
    steps = Steps(cell, named.attributes, make_columns, coarsen_loose_part, shape, reaches)
    return write_all_levels(work, loose.layer, steps, parts, span)


def spacing_in(loose: LooseParts, columns: Columns) -> float:
    """Return the spacing of points to which the median radius of all scattered points (spheres or discs) corresponds.

    columns : columns on disk in which the median is stored
    """
    return spacing_of(np.array([median_of(loose.layer, columns)], np.float32), loose.drawing)


def coarsen_loose_part(fine: Layer, coarse: Layer, grid: Grid, categories: list[str], part: int) -> Facts:
    """Write the next level of detail of a part of scattered points: one sphere or disc for those in each grid cell.

    fine : points of the finer level, which are averaged; coarse : the next level, which is written
    categories : names of the columns of attributes with categories, which get the most common one instead of a mean

    Returns
    -------
    dict
        size : number of points; low, high : corners of their bounding box, missing without points.
    """
    cells = cells_of_part(fine, grid, part, sides=False)
    if cells is None:
        return {"size": 0}
    rows, groups = cells
    names = [name for name in fine.sources if name.startswith(ATTRIBUTE)]
    attributes = {name: fine.read(name, rows) for name in names}
    columns = fine.read(POSITIONS, rows), fine.read(NORMALS, rows), fine.find(COLORS, rows), attributes
    some = ScatteredPoints(Points.about(np.zeros(3), *columns), fine.read(RADII, rows))
    found = coarsen_scattered(some, grid.cell, groups, categories)
    points = found.points
    named = {POSITIONS: points.positions, NORMALS: points.normals, RADII: found.radii, COLORS: points.colors}
    return coarse.write_all(part, {**named, **points.attributes})


def _write_loose_level(
    layer: Layer, loose: LooseParts, cell: float, named: ModelInfo, written: list[LevelProgress | None], part: int
) -> Facts:
    """Build the tree of a level of detail of a part of scattered points and write the level's file.

    No file is written if `written` says so, or if the part has no points in the level.

    layer : points of the level; loose : the scattered points of the full model
    cell : edge of the cells of the level's grid; named : facts that all files contain
    written : for each part its levels written so far, or None if this level of the part is not to be written

    Returns
    -------
    dict
        file : index entry of the level, None if no file was written
        reach : (2, 3) bounds of its spheres or discs; missing if no file was written
    """
    before, own = written[part], layer.own(part)
    if before is None or own.start == own.stop:
        return {"file": None}
    splats = splats_at(layer, own)
    points = points_at(layer, own, named)
    drawing = ScatteredPoints(points, splats.radii).drawing(loose.drawing.scatter, cell)
    tree = _tree_of(splats, drawing)
    settings = {**LEVEL_SETTINGS._asdict(), "smooth": 0.0, **drawing.facts}
    level = Level(settings, points, splats.radii, points.bounds, tree)
    file = write_level(named.folder, named.id, loose.first_part + part, before.levels + 1, level)
    reach = find_surface_bounds(tree)
    assert reach is not None
    file = file._replace(spacing=spacing_of(splats.radii, drawing))
    return {"file": file._asdict(), "reach": reach.tolist()}


def _tree_of(splats: Splats, drawing: Drawing) -> Tree:
    return with_scattered(no_tree(np.zeros(6, np.float32)), splats, drawing.kind)
