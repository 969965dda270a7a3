"""Steps that make a level of detail of a part: its splats, their supports, its tree; same as a whole model's levels.

A splat that replaces several splats of different parts belongs to the part of the first of them. Other parts see it in
their margins.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...base.arrays import Doubles, Flags, Floats, Rows
from ...cloud.georeference import Georeference
from ...cloud.neighbors import kd_order
from ...cloud.points import Points
from ...cloud.sampled_statistics import SampledStatistics
from ...cloud.statistics import CloudStatistics, sample_of
from ...surface.splats.averages import attribute_averages
from ...surface.splats.levels import SUPPORT, Fine, means_of
from ...surface.splats.support import Support, find_support
from ...surface.tree.build import Splats, bounds_of
from ...surface.tree.leaves import longest_step
from ...surface.tree.stored import find_surface_bounds
from ..levels_of_detail import LEVEL_SAMPLES, LEVEL_SETTINGS
from ..model_file import Level
from ..model_folder import write_level
from .arrange import boxes_of
from .grid import Grid, cells_of_part, widened
from .layer import ATTRIBUTE, BORDERS, COLORS, LIMITS, NOISE, NORMALS, POSITIONS, RADII, SHEETS, Layer, corners
from .sorted_sets import distinct_numbers, isin_sorted
from .trees import tree_within, with_margins
from .work import Facts

# Least margin around a part's splats, in cells, that their supports depend on: 80 neighbours lie within 5 cells, and
# those searched across a gap within 14.
MARGIN = 16
LEAST = 1 << 16  # splats that a margin may always have, however small the part
WIDEST = 4.0  # width in cells that only a few supports exceed


class SharedValues(NamedTuple):
    """Values that the trees of all parts share at one level of detail, so that rays get the same hits as in one tree.

    supports : (6,) float32, bounds of all supports, where the samples along a ray begin
    reference : 2% quantile of the level's support radii; sample distances are those for it times powers of two
    longest : (parts,) float32, largest radius of each part
    """

    supports: Floats
    reference: float
    longest: Floats


class LevelProgress(NamedTuple):
    """How far the levels of detail of a part are written.

    levels : their number; spacing : median radius of the last one, 0 if there is none
    """

    levels: int
    spacing: float


class ModelInfo(NamedTuple):
    """Facts about a model in parts that its files contain.

    folder : folder of the files; id : hexadecimal number, contained in all of them
    origin : (3,) float64, of the positions; attributes : names
    """

    folder: Path
    id: str
    origin: Doubles
    georeference: Georeference
    attributes: list[str]


def show_part(layer: Layer, part: int) -> Facts:
    """Write bounding boxes of each 4,096 splats of a part at full detail, by which those near other parts are found.

    Returns
    -------
    dict
        low, high : corners of the bounding box of all its splats.
    """
    positions = layer.read(POSITIONS, layer.own(part))
    layer.write_boxes(part, positions)
    return corners(positions)


def coarsen_part(fine: Layer, coarse: Layer, grid: Grid, categories: list[str], part: int) -> Facts:
    """Write the splats of a part's next level of detail: means of the splats in each grid cell that face the same way.

    fine : splats of the finer level, which are averaged; coarse : the next level, which is written
    categories : names of the columns of attributes with categories, which get the most common one instead of a mean

    Returns
    -------
    dict
        size : number of splats; low, high : corners of their bounding box, missing without splats.
    """
    cells = cells_of_part(fine, grid, part)
    if cells is None:
        return {"size": 0}
    rows, groups = cells
    columns = fine.read(POSITIONS, rows), fine.read(NORMALS, rows), fine.read(RADII, rows)
    found = means_of(groups, Fine(*columns, fine.find(COLORS, rows), fine.find(NOISE, rows)), grid.cell)
    for name in [name for name in fine.sources if name.startswith(ATTRIBUTE)]:
        some = {name: fine.read(name, rows)}
        means = attribute_averages(some, groups.order, groups.starts[:-1], categories=categories)
        coarse.write(name, part, means[name])
    named = {POSITIONS: found.positions, NORMALS: found.normals, LIMITS: found.limits}
    return coarse.write_all(part, {**named, COLORS: found.colors, NOISE: found.noise})


def survey_supports(layer: Layer, cell: float) -> dict[str, float]:
    """Compute the statistics, by name, from which support radii are chosen in all parts of a level of detail.

    They are computed from a sample of the splats. cell : edge of the level's grid
    """
    rows = own = np.concatenate([layer.rows_of(some) for some in sample_of(layer.total)])
    if len(own) < layer.total:
        here, reach = layer.read(POSITIONS, own), MARGIN * cell
        rows = np.union1d(own, layer.near(None, widened(boxes_of(here), reach), None, _around(layer, here, reach)))
    known: dict[str, float] = {}
    _supports(layer, rows, cell, known, own)
    return known


def support_part(layer: Layer, cell: float, known: dict[str, float], part: int) -> Facts:
    """Find the support radii, open borders and close sheets of a part's splats at a level; write them to its columns.

    layer : the level of detail; cell : edge of the level's grid
    known : statistics of the whole level by name, from which radii are chosen in all parts

    Returns
    -------
    dict
        longest : largest support radius
        supports : (6,) box around the supports, missing without splats
        borders : whether there are open borders
        sheets : number of splats with an opposite sheet close by
    """
    own = layer.own(part)
    if own.start == own.stop:
        return {"longest": 0.0, "borders": False, "sheets": 0}
    here, reach = layer.read(POSITIONS, own), MARGIN * cell
    while True:
        others = layer.near(part, widened(layer.boxes(part), reach), None, _around(layer, here, reach))
        if len(others) <= max(len(here), LEAST) or reach < cell:
            break
        reach /= 2
    rows = np.sort(np.concatenate([others, np.arange(own.start, own.stop)]))
    mine = slice(int(np.searchsorted(rows, own.start)), int(np.searchsorted(rows, own.stop)))
    found = _supports(layer, rows, cell, known)
    radii = found.radii[mine]
    borders = np.zeros((len(here), 3), np.float32) if found.borders is None else found.borders[mine]
    sheets = np.zeros(len(here), np.int8) if found.sheets is None else found.sheets[mine]
    for name, values in ((RADII, radii), (BORDERS, borders), (SHEETS, sheets)):
        layer.write(name, part, values)
    splats = Splats(here, here, radii, np.zeros(0, np.int32), None)
    facts = {"longest": float(radii.max()), "supports": bounds_of(splats).astype(float).tolist()}
    return {**facts, "borders": bool(borders.any()), "sheets": int(sheets.sum())}


def _supports(layer: Layer, rows: Rows, cell: float, known: dict[str, float], sample: Rows | None = None) -> Support:
    """Return the support radii, open borders and close sheets of some splats of a level of detail, in the rows' order.

    rows : rows of the splats; cell : edge of the level's grid, by which radii have a lower limit
    known : statistics of the whole level by name, from which radii are chosen
    sample : rows from which `known` is filled; None: `known` is filled already
    """
    positions = layer.read(POSITIONS, rows)
    order = kd_order(positions)
    back = np.empty(len(order), np.int64)
    back[order] = np.arange(len(order))
    if (positions == positions[0]).all():  # their spacing is undefined
        radii = np.full(len(rows), SUPPORT * cell, np.float32)
        return Support(radii, None, None, False, None, np.zeros(len(rows), np.bool_))
    statistics = CloudStatistics(None, known, is_complete=True)
    if sample is not None:
        statistics = SampledStatistics(np.flatnonzero(np.isin(rows[order], sample)), known)
    found = find_support(
        positions[order],
        layer.read(NORMALS, rows)[order],
        None,
        1.0,
        borders=True,
        sheets=True,
        within=(SUPPORT * cell, layer.read(LIMITS, rows)[order]),
        statistics=statistics,
    )
    sheets = None if found.sheets is None else found.sheets[back]
    borders = None if found.borders is None else found.borders[back]
    return found._replace(radii=found.radii[back], borders=borders, sheets=sheets)


def tree_part(
    layer: Layer, cells: Doubles, whole: SharedValues, named: ModelInfo, written: list[LevelProgress | None], part: int
) -> Facts:
    """Build the tree of a part's level of detail and write the level's file.

    No file is written if `written` says so, if the level has no surface, or if its median radius is less than that of
    the part's previous level.

    layer : splats of the level in all parts; cells : (parts, 6), the box of space that belongs to each part
    whole : values that the trees of all parts share; named : facts that all files contain
    written : for each part its levels written so far, or None if this level of the part is not to be written

    Returns
    -------
    dict
        file : index entry of the level, None if no file was written
        reach : (2, 3) bounds of the surface; missing if no file was written
    """
    before = written[part]
    rows = None if before is None else _reaching(layer, cells[part], whole, longest_step(LEVEL_SAMPLES))
    if before is None or rows is None or not len(rows):
        return {"file": None}
    rows = rows[kd_order(layer.read(POSITIONS, rows))]
    splats = splats_at(layer, rows)
    tree = tree_within(splats, cells[part], (whole.supports, whole.reference), LEVEL_SETTINGS)
    tree = with_margins(tree, cells[part])
    reach = find_surface_bounds(tree)
    if reach is None:
        return {"file": None}
    used, order = np.unique(tree.order, return_inverse=True)
    empty = int(used[0] < 0)
    tree, used = tree._replace(order=(order.ravel() - empty).astype(np.int32)), used[empty:]
    radii = splats.radii[used]
    if np.median(radii) < before.spacing:
        return {"file": None}
    points = points_at(layer, rows[used], named)
    level = Level({**LEVEL_SETTINGS._asdict(), "smooth": 0.0}, points, radii, points.bounds, tree)
    file = write_level(named.folder, named.id, part, before.levels + 1, level)
    return {"file": file._asdict(), "reach": reach.tolist()}


def splats_at(layer: Layer, rows: slice | Rows, first: int = 0) -> Splats:
    """Return the splats of some rows of a level of detail.

    first : number of the first splat, by which a tree refers to its point; the others get the following ones
    """
    positions, normals, radii = (layer.read(name, rows) for name in (POSITIONS, NORMALS, RADII))
    colors, borders, sheets, noise = (layer.find(name, rows) for name in (COLORS, BORDERS, SHEETS, NOISE))
    numbers = np.arange(first, first + len(radii), dtype=np.int32)
    noise = None if noise is None else np.minimum(noise, radii)
    return Splats(positions, normals, radii, numbers, colors, borders, sheets, noise)


def points_at(layer: Layer, rows: slice | Rows, named: ModelInfo) -> Points:
    """Return some splats of a level of detail as points, with colours and attributes."""
    attributes = {name: layer.read(f"{ATTRIBUTE}{k}", rows) for k, name in enumerate(named.attributes)}
    columns = layer.read(POSITIONS, rows), layer.read(NORMALS, rows), layer.find(COLORS, rows)
    return Points.about(named.origin, *columns, attributes, named.georeference)


def _reaching(layer: Layer, cell: Doubles, whole: SharedValues, step: float) -> Rows:
    """Return the rows of the splats of a level whose supports reach into a box, or come within one sampling step of it.

    cell : (6,), the box: low x y z, high x y z; whole : values of all parts, of which the largest radii are used
    step : length of a sampling step, in radii of the splats in the box
    """

    def reach(around: float) -> Rows:
        def keep(rows: slice) -> Flags:
            positions, wide = layer.read(POSITIONS, rows), layer.read(RADII, rows)[:, None] + np.float32(around)
            return np.asarray(((positions + wide >= cell[:3]) & (positions - wide <= cell[3:])).all(axis=1))

        return layer.near(None, cell[None].astype(np.float32), whole.longest + np.float32(around), keep)

    rows = reach(0.0)
    if not len(rows):
        return rows
    radii = layer.read(RADII, rows)
    return reach(step * min(float(radii.max()), WIDEST * float(np.median(radii))))


def _around(layer: Layer, positions: Floats, reach: float) -> Callable[[slice], Flags]:
    """Return a function that marks the splats near some positions, for `Layer.near`: it takes a range of rows.

    It marks all splats within the distance `reach`, and some slightly farther away.
    """
    low = positions.min(axis=0).astype(np.float64) - 2 * reach
    count = np.floor((positions.max(axis=0) - low) / reach).astype(np.int64) + 3

    def numbers(some: Floats) -> tuple[Rows, Flags]:
        at = np.floor((some - low) / reach).astype(np.int64)
        inside = ((at >= 0) & (at < count)).all(axis=1)
        return (at[:, 0] * count[1] + at[:, 1]) * count[2] + at[:, 2], inside

    cells = distinct_numbers(numbers(positions)[0])
    for stride in (1, int(count[2]), int(count[1] * count[2])):
        cells = distinct_numbers(np.concatenate([cells - stride, cells, cells + stride]))

    def keep(rows: slice) -> Flags:
        found, inside = numbers(layer.read(POSITIONS, rows))
        return inside & isin_sorted(cells, found)

    return keep
