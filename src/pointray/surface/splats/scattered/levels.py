"""Levels of detail of scattered points: one sphere for each cell of a grid, as wide as those that it stands for."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....cloud.points import Points
from ...tree.build import Splats
from ..averages import attribute_averages
from ..groups import Groups, groups_in_cells
from .spheres import SIZE, Drawing, unit_vectors

TYPICAL = 1.15  # chosen support radii of a surface, in spacings: a model's `spacing` is in these

Floats = NDArray[np.float32]


class Loose(NamedTuple):
    """Scattered points of a model or of a level of detail. radii : (n,) float32"""

    points: Points
    radii: Floats

    def splats(self, first: int) -> Splats:
        """Return the points as splats, in rows from `first` on."""
        points = self.points
        rows = np.arange(first, first + len(points), dtype=np.int32)
        return Splats(points.positions, np.asarray(points.normals), self.radii, rows, points.colors)

    def drawing(self, scatter: str, cell: float) -> Drawing:
        """Return how the points are drawn; the size makes `cell` their spacing."""
        return Drawing(scatter, float(np.median(self.radii)) * TYPICAL / (SIZE * cell))


def spacing_of(radii: Floats, drawing: Drawing) -> float:
    """The spacing that scattered points of these radii stand for."""
    return float(np.median(radii)) * TYPICAL / (SIZE * drawing.size)


def without_sides(count: int) -> Floats:
    """Return normals for `groups_in_cells` with which a cell has one group, whatever its points face, (count, 3)."""
    return np.tile(np.array([0, 0, 1], np.float32), (count, 1))


def coarsen_scattered(
    loose: Loose, cell: float, groups: Groups | None = None, categories: Collection[str] | None = None
) -> Loose:
    """Return one point, the mean, for each cell of a grid.

    Its sphere hides as much of the cell as the spheres that it stands for, if these lie at random: a crown stays as
    dense as it looks.

    Parameters
    ----------
    loose : Loose
    cell : float
        Edge of the cells.
    groups : Groups, optional
        The points of each cell. None: all points, in a grid that begins at their least coordinates.
    categories : collection of str, optional
        The attributes that have categories, see `attribute_averages`.
    """
    points = loose.points
    if groups is None:
        groups = groups_in_cells(points.positions, without_sides(len(points)), cell)
    area = np.pi * groups.mean(loose.radii.astype(np.float32) ** 2) * np.diff(groups.starts)
    radii = np.sqrt(cell**2 * -np.expm1(-area / cell**2) / np.pi).astype(np.float32)
    colors = None
    if points.colors is not None:
        colors = np.rint(np.sqrt(groups.mean(points.colors.astype(np.float32) ** 2))).astype(np.uint8)
    attributes = attribute_averages(points.attributes, groups.order, groups.starts[:-1], categories=categories)
    positions = groups.mean(points.positions).astype(np.float32)
    directions = unit_vectors(groups.mean(np.asarray(points.normals)).astype(np.float32))
    return Loose(Points.about(points.origin, positions, directions, colors, attributes, points.survey), radii)


def joined(surface: Points | None, loose: Points | None) -> Points:
    """Points of a surface and scattered ones, with the same origin and columns; one of both may be absent."""
    if surface is None or loose is None:
        return loose if surface is None else surface  # type: ignore[return-value]
    colors = None
    if surface.colors is not None and loose.colors is not None:
        colors = np.concatenate([surface.colors, loose.colors])
    return Points.about(
        surface.origin,
        np.concatenate([surface.positions, loose.positions]),
        np.concatenate([np.asarray(surface.normals), np.asarray(loose.normals)]),
        colors,
        {name: np.concatenate([values, loose.attributes[name]]) for name, values in surface.attributes.items()},
        surface.survey,
    )
