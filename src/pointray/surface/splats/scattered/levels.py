"""Levels of detail of scattered points: one sphere per grid cell, with the same coverage as the spheres it replaces."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from ....base.arrays import Floats
from ....cloud.neighbors import NeighborTree
from ....cloud.points import Points
from ...tree.build import Splats
from ..averages import attribute_averages
from ..groups import Groups, groups_in_cells
from .spheres import SIZE, Drawing, unit_vectors

TYPICAL = 1.15  # typical support radius of a surface, in spacings; the `spacing` of a model is in these units
# In `covering_radius`: share of the pixels inside of the outlines that spheres cover; pixels of a view; points used.
COVERED, MOST_PIXELS, ENOUGH = 0.9, 1 << 16, 200_000


class ScatteredPoints(NamedTuple):
    """Scattered points of a model or of a level of detail, with the radii of their spheres or discs.

    points : their normals are those of discs or, for spheres, mean directions away from nearby points
    radii : (n,) float32
    """

    points: Points
    radii: Floats

    def splats(self, first: int) -> Splats:
        """Return the points as splats whose `rows` count up from `first`."""
        points = self.points
        rows = np.arange(first, first + len(points), dtype=np.int32)
        return Splats(points.positions, np.asarray(points.normals), self.radii, rows, points.colors)

    def drawing(self, scatter: str, cell: float) -> Drawing:
        """Return how to draw the points of a level, with a factor for radii that makes its spacing equal to `cell`.

        The spacing is the result of `spacing_of`, the support radius of an equally dense surface.

        scatter : "spheres", "discs" or "none"; cell : edge length of the grid cells that the points were averaged in
        """
        return Drawing(scatter, float(np.median(self.radii)) * TYPICAL / (SIZE * cell))


def spacing_of(radii: Floats, drawing: Drawing) -> float:
    """Return the median support radius that a surface as dense as these scattered points would have.

    radii : (n,) of their spheres or discs. The result is comparable with the spacing of models that have a surface.
    """
    return float(np.median(radii)) * TYPICAL / (SIZE * drawing.size)


def uniform_normals(count: int) -> Floats:
    """Return equal normals, (count, 3), with which `groups_in_cells` makes one group per cell."""
    return np.tile(np.array([0, 0, 1], np.float32), (count, 1))


def coarsen_scattered(
    scattered: ScatteredPoints, cell: float, groups: Groups | None = None, categories: Collection[str] | None = None
) -> ScatteredPoints:
    """Make a coarser level of detail: average the scattered points in each grid cell to one.

    The sphere of a cell covers as much of it as the original spheres do on average at random positions, so that a crown
    stays equally dense.

    Parameters
    ----------
    scattered : ScatteredPoints
    cell : float
        Edge length of the cells.
    groups : Groups, optional
        The points of each cell. Default: all points, in a grid that starts at their least coordinates.
    categories : collection of str, optional
        Names of the attributes whose most common value is taken, not the mean. Default: detected from the values.
    """
    points = scattered.points
    if groups is None:
        groups = groups_in_cells(points.positions, uniform_normals(len(points)), cell)
    area = np.pi * groups.mean(scattered.radii.astype(np.float32) ** 2) * np.diff(groups.starts)
    radii = np.sqrt(cell**2 * -np.expm1(-area / cell**2) / np.pi).astype(np.float32)
    colors = None
    if points.colors is not None:
        colors = np.rint(np.sqrt(groups.mean(points.colors.astype(np.float32) ** 2))).astype(np.uint8)
    attributes = attribute_averages(points.attributes, groups.order, groups.starts[:-1], categories=categories)
    positions = groups.mean(points.positions).astype(np.float32)
    directions = unit_vectors(groups.mean(np.asarray(points.normals)).astype(np.float32))
    return ScatteredPoints(
        Points.about(points.origin, positions, directions, colors, attributes, points.georeference), radii
    )


def covering_radius(positions: Floats, centers: Floats, pixel: float) -> float:
    """Return the radius with which spheres hide most of what the points do that they replace, in views along the axes.

    A share COVERED of the pixels inside of the outlines is covered: spheres of a closed body hardly widen its outline,
    and those of a sheet leave few holes in it.

    positions : (n, 3) float32, the points in any order that mixes them evenly, such as kd order; some 200,000 are used
    centers : (m, 3) float32, of the spheres
    pixel : edge length of the pixels of the views, at least; the points are closer to each other
    """
    positions = positions[:: max(len(positions) // ENOUGH, 1)]
    low, size = positions.min(axis=0), np.ptp(positions, axis=0)
    pixel = max(pixel, float(np.sqrt(np.partition(size, 1)[1] * size.max() / MOST_PIXELS)))
    cells, distances = ((positions - low) / pixel).astype(int) + 1, []
    for axis in range(3):
        seen = np.zeros(np.delete(cells.max(axis=0) + 2, axis), bool)
        seen[tuple(np.delete(cells, axis, axis=1).T)] = True
        inner = seen.copy()
        inner[1:-1, 1:-1] &= seen[:-2, 1:-1] & seen[2:, 1:-1] & seen[1:-1, :-2] & seen[1:-1, 2:]
        pixels = np.argwhere(inner if inner.any() else seen) - 0.5
        flat, middles = centers.copy(), np.insert(pixels * pixel, axis, 0.0, axis=1) + low
        flat[:, axis] = middles[:, axis] = 0.0
        distances.append(NeighborTree(flat).query(1, np.ascontiguousarray(middles, np.float32))[0][:, 0])
    return float(np.quantile(np.concatenate(distances), COVERED))


def joined(surface: Points | None, scattered: Points | None) -> Points:
    """Concatenate surface and scattered points with the same origin and columns; either may be None."""
    if surface is None or scattered is None:
        return scattered if surface is None else surface  # type: ignore[return-value]
    colors = None
    if surface.colors is not None and scattered.colors is not None:
        colors = np.concatenate([surface.colors, scattered.colors])
    return Points.about(
        surface.origin,
        np.concatenate([surface.positions, scattered.positions]),
        np.concatenate([np.asarray(surface.normals), np.asarray(scattered.normals)]),
        colors,
        {name: np.concatenate([values, scattered.attributes[name]]) for name, values in surface.attributes.items()},
        surface.georeference,
    )
