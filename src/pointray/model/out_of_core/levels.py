"""Levels of detail of all parts, same as those of the whole model; each part has its own splats and a margin.

Each level is made for all parts before the next one. A cell of the grid that a cut passes through thus gives one splat
for all points in it, which the trees on both sides of the cut contain. Results stay in columns until the next level is
done.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...base.arrays import Doubles
from ...base.disk_columns import Columns
from ...cloud.statistics import quantize
from ...surface.splats.averages import have_categories
from ...surface.splats.levels import LEAST_GAIN, LEAST_POINTS, THIN
from ..levels_of_detail import COARSER
from ..model_folder import LevelFile, PartFile
from . import level_steps
from .grid import Grid
from .layer import ATTRIBUTE, BORDERS, COLORS, LIMITS, NOISE, NORMALS, POSITIONS, RADII, SHEETS, Layer
from .level_steps import LevelProgress, ModelInfo, SharedValues
from .trees import box_around, nth_least
from .work import Facts, Span, Work, within

SHOWN = 0.05  # progress after the boxes of the finest splats are written
COARSENED, SUPPORTED = 0.3, 0.6  # progress within a level


class Steps(NamedTuple):
    """Functions that make a level of detail, of a surface or of points drawn as spheres or discs.

    cell : grid cell edge that would correspond to the full model; level 1 is made with twice this edge, level 2 with
        four times, and so on
    names : names of the attributes
    make_columns : creates the columns of a level on disk; called with the finer level and the new level
    coarsen : writes the splats of one part of a level, averaged from the finer level, like `coarsen_part`
    shape : writes the files of a level; called with the level, the edge of its grid cells, the levels written of each
        part so far and the span of progress; returns facts about each part
    others : surface bounds, (2, 3) or None, of parts of the model that get no levels here; the bounds of coarse levels
        are clipped to the bounds of all parts together, including these
    """

    cell: float
    names: list[str]
    make_columns: Callable[[Layer, Layer], None]
    coarsen: Callable[..., Facts]
    shape: Callable[[Layer, float, list[LevelProgress | None], Span], list[Facts]]
    others: Sequence[Any] = ()


def write_levels(
    work: Work, whole: Layer, named: ModelInfo, cells: Doubles, parts: list[PartFile], span: Span
) -> list[PartFile]:
    """Write the files of all levels of detail of a surface in parts; return the parts' index entries, with levels.

    Parameters
    ----------
    whole : Layer
        The splats of the full model.
    named : ModelInfo
        Facts that all files contain.
    cells : (parts, 6) float64
        Box of space that belongs to each part: low x y z, high x y z.
    parts : list of PartFile
        Index entries without levels.
    span : (float, float)
        Begin and end of this stage, as fractions of all work.
    """

    def shape(layer: Layer, cell: float, written: list[LevelProgress | None], span: Span) -> list[Facts]:
        return _shaped(work, layer, cell, named, cells, written, span)

    steps = Steps(median_of(whole, work.columns), named.attributes, _make_columns, level_steps.coarsen_part, shape)
    return write_all_levels(work, whole, steps, parts, span)


def write_all_levels(work: Work, whole: Layer, steps: Steps, parts: list[PartFile], span: Span) -> list[PartFile]:
    """Write the files of all levels of detail, each made from the finer level.

    The last level is the coarsest in which any part has at least 700 splats.

    whole : splats of the full model; steps : functions that make a level
    parts : index entries of the parts, without levels; span : begin and end of this stage, as fractions of all work

    Returns
    -------
    list of PartFile
        The entries `parts` with their levels, and with surface bounds (`reach`) that include the levels.
    """
    columns, fine = work.columns, whole
    span = within(span, SHOWN, 1.0)
    whole.make_boxes()
    facts = work.each("level-0", partial(level_steps.show_part, whole), (span[0], span[0]))
    cell, last = steps.cell, whole.sizes
    files: list[list[LevelFile]] = [[] for _ in parts]
    reaches = [[part.reach] for part in parts]
    while True:
        number, cell = fine.number + 1, COARSER * cell
        middle = span[0] + (1 - COARSER**-2) * (span[1] - span[0])
        coarse = Layer(number, columns, fine.sizes, fine.sizes)
        if not _is_done(columns, number + 1):
            steps.make_columns(fine, coarse)
        grid = Grid(cell, np.min([fact["low"] for fact in facts if "low" in fact], axis=0).tolist())
        facts = _coarsened(work, (fine, coarse), grid, steps, (span[0], middle))
        coarse.sizes = np.array([fact["size"] for fact in facts], np.int64)
        large = coarse.sizes >= LEAST_POINTS
        if not large.any():
            break
        wanted = large & (coarse.sizes * LEAST_GAIN <= last)
        written = [
            LevelProgress(len(some), some[-1].spacing if some else 0.0) if wanted[part] else None
            for part, some in enumerate(files)
        ]
        for part, fact in enumerate(steps.shape(coarse, cell, written, (span[0], middle))):
            if fact["file"] is not None:
                files[part].append(LevelFile(**fact["file"]))
                reaches[part].append(fact["reach"])
        columns.put(f"level-{number}", {})
        fine.drop()
        last = np.where(wanted, coarse.sizes, last)
        fine, span = coarse, (middle, span[1])
    for layer in (fine, coarse):
        layer.drop()
    return [
        part._replace(levels=some, reach=reach)
        for part, some, reach in zip(parts, files, _widened(reaches, steps.others), strict=True)
    ]


def _coarsened(work: Work, layers: tuple[Layer, Layer], grid: Grid, steps: Steps, span: Span) -> list[Facts]:
    """Write the splats of a level of detail for all parts, merged from those of the finer level.

    layers : the finer level, which is read, and the new level, which is written
    grid : cells in which splats are merged; steps : functions that make a level
    span : begin and end of the work on this level, as fractions of all work

    Returns
    -------
    list of dict
        One for each part. size : number of its splats; low, high : corners of their bounding box.
    """
    fine, coarse = layers
    keys = {f"{ATTRIBUTE}{k}": name for k, name in enumerate(steps.names)}
    known = work.columns.get_or_put(
        f"level-{coarse.number}-categories",
        lambda: {"names": [key for key, name in keys.items() if have_categories(name, fine.chunks(key))]},
    )
    do = partial(steps.coarsen, fine, coarse, grid, known["names"])
    return work.each(f"level-{coarse.number}-points", do, within(span, 0.0, COARSENED))


def _shaped(
    work: Work,
    layer: Layer,
    cell: float,
    named: ModelInfo,
    cells: Doubles,
    written: list[LevelProgress | None],
    span: Span,
) -> list[Facts]:
    """Find the support radii of a level of detail of a surface, and write its files.

    layer : splats of the level; cell : edge of the cells of the level's grid
    named : facts that all files contain; cells : (parts, 6), the box of space that belongs to each part
    written : for each part its levels written so far, or None if this level of the part is not to be written
    span : begin and end of the work on this level, as fractions of all work

    Returns
    -------
    list of dict
        One for each part. file : index entry, None if no file was written; reach : (2, 3) bounds of the surface.
    """
    columns, stage = work.columns, f"level-{layer.number}"
    known = columns.get_or_put(f"{stage}-usual", lambda: level_steps.survey_supports(layer, cell))
    supports = work.each(
        f"{stage}-support", partial(level_steps.support_part, layer, cell, known), within(span, COARSENED, SUPPORTED)
    )
    if not any(fact["borders"] for fact in supports):
        layer.sources.pop(BORDERS, None)
    if sum(fact["sheets"] for fact in supports) < THIN * layer.total:
        layer.sources.pop(SHEETS, None)
    reference = columns.get_or_put(
        f"{stage}-steps",
        lambda: {"reference": quantize(nth_least(lambda: layer.chunks(RADII), layer.total // 50), is_limit=True)},
    )["reference"]
    boxes = np.array([fact["supports"] for fact in supports if "supports" in fact], np.float32)
    longest = np.array([fact["longest"] for fact in supports], np.float32)
    whole = SharedValues(box_around(boxes), reference, longest)
    return work.each(
        f"{stage}-tree",
        partial(level_steps.tree_part, layer, cells, whole, named, written),
        within(span, SUPPORTED, 1.0),
    )


def _make_columns(fine: Layer, coarse: Layer) -> None:
    """Create the columns on disk of a level of detail of a surface. fine : the finer level; coarse : the level"""
    for name in (BORDERS, LIMITS, SHEETS):
        coarse.make(name, np.int8 if name == SHEETS else np.float32, 3 if name == BORDERS else 0)
    make_columns(fine, coarse)


def make_columns(fine: Layer, coarse: Layer) -> None:
    """Create the columns on disk of a new level of detail, both of its surface and of points drawn as spheres or discs.

    fine : the next finer level; only if it has colours, noise of splats or attributes, the new one has them
    coarse : the new level
    """
    coarse.make_boxes()
    for name in (NORMALS, POSITIONS):
        coarse.make(name, np.float32, 3)
    coarse.make(RADII, np.float32)
    for name in fine.sources:
        if name in (COLORS, NOISE) or name.startswith(ATTRIBUTE):
            column = fine.column(name)
            coarse.make(name, column.dtype, column.shape[1] if len(column.shape) > 1 else 0)


def _is_done(columns: Columns, number: int) -> bool:
    """Return whether level `number` is written for all parts; the columns that it was made from may be gone then."""
    return columns.get(f"level-{number}") is not None


def median_of(layer: Layer, columns: Columns) -> float:
    """Return the median of the support radii of all splats, equal to NumPy's; found once and stored.

    layer : splats of the full model; columns : where the median is stored
    """

    def compute() -> Facts:
        places = {(layer.total - 1) // 2, layer.total // 2}
        middles = [nth_least(lambda: layer.chunks(RADII), place) for place in places]
        return {"radius": float(np.mean(np.array(middles, np.float32)))}

    return float(columns.get_or_put("level-0-median", compute)["radius"])


def _widened(reaches: list[list[Any]], others: Sequence[Any] = ()) -> list[Any]:
    """Return the surface bounds of each part over all its levels, clipped to the bounds of all full parts together.

    Coarse levels extend beyond the full model, where their surface is not shown.

    reaches : for each part the bounds of the full part, then of its levels, (2, 3) each; None: no surface
    others : bounds of further full parts, (2, 3) or None, which only enlarge the box to which results are clipped
    """
    finest = np.array([box for box in (*(boxes[0] for boxes in reaches), *others) if box is not None])
    if not len(finest):
        return [None] * len(reaches)
    low, high = finest[:, 0].min(axis=0), finest[:, 1].max(axis=0)
    return [
        None
        if boxes[0] is None
        else [
            np.maximum(np.min([box[0] for box in boxes], axis=0), low).tolist(),
            np.minimum(np.max([box[1] for box in boxes], axis=0), high).tolist(),
        ]
        for boxes in reaches
    ]
