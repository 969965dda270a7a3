"""Grid of a level of detail across parts: which splats share a cell, and which part owns the merged splat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...base.arrays import Floats, Rows
from ...surface.splats.groups import Groups, cell_numbers, groups_in_cells
from ...surface.splats.scattered.levels import uniform_normals
from .layer import NORMALS, POSITIONS, Layer
from .sorted_sets import distinct_numbers, isin_sorted


@dataclass(frozen=True)
class Grid:
    """Grid of cubic cells, in each of which a level of detail merges splats.

    cell : edge of a cell; low : (3,) lower corner of the grid, relative to the points' origin
    """

    cell: float
    low: list[float]


def cells_of_part(layer: Layer, grid: Grid, part: int, sides: bool = True) -> tuple[Rows, Groups] | None:
    """Group the splats in each cell of a grid; return the groups of a part, each to be merged into one splat.

    A group belongs to the part of its first splat; its other splats may be those of other parts. None is returned if
    the part has no group.

    layer : splats of all parts
    sides : whether splats in a cell whose normals have different main directions form different groups

    Returns
    -------
    rows : (n,) int64, ascending
        Rows of the part's splats, and of those of other parts that share cells with them.
    groups : Groups
        The part's groups, as indices into `rows`.
    """
    if not layer.sizes[part]:
        return None
    own, (cell, low) = layer.own(part), (grid.cell, np.array(grid.low, np.float32))

    def facing(rows: slice | Rows, count: int) -> Floats:
        return layer.read(NORMALS, rows) if sides else uniform_normals(count)

    def numbers(rows: slice) -> Rows:
        positions = layer.read(POSITIONS, rows)
        return cell_numbers(positions, facing(rows, len(positions)), cell, low)

    mine = distinct_numbers(numbers(own))
    others = layer.near(
        part, widened(layer.boxes(part), 1.01 * cell), None, lambda rows: isin_sorted(mine, numbers(rows))
    )
    rows = np.sort(np.concatenate([others, np.arange(own.start, own.stop)]))
    groups = groups_in_cells(layer.read(POSITIONS, rows), facing(rows, len(rows)), cell, low)
    owner = rows[groups.first]
    is_own = (owner >= own.start) & (owner < own.stop)
    return (rows, groups.pick(is_own)) if is_own.any() else None


def widened(boxes: Floats, reach: float) -> Floats:
    """Return boxes, (n, 6) as low x y z, high x y z, enlarged by a distance on each side."""
    return np.concatenate([boxes[:, :3] - np.float32(reach), boxes[:, 3:] + np.float32(reach)], axis=1)
