"""Levels of detail of a model in memory: coarser versions, each with half as many points along a line."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..base.arrays import Floats
from ..base.choices import AS_SPHERES
from ..base.progress import StageProgress
from ..cloud.denoising.smooth import Placed
from ..cloud.points import Points
from ..surface.splats.build import Sizes, make_splats
from ..surface.splats.levels import LEAST_GAIN, LEAST_POINTS, SUPPORT, coarsen
from ..surface.splats.scattered.levels import ScatteredPoints, coarsen_scattered, covering_radius, joined
from ..surface.splats.scattered.spheres import Drawing
from ..surface.tree.settings import check_settings
from ..surface.tree.stored import stored_splats
from .building import BuildOptions, assemble, ignore_progress
from .model_data import ModelData

LEVEL_SAMPLES = 2  # N of levels of detail: error and flicker of 4, in 0.86 (1,000 statues) to 0.92 (24) of the time
LEVEL_SETTINGS = check_settings("paper", LEVEL_SAMPLES, 1, "auto")
FEWEST_SPHERES = 50  # points of the last level, which is drawn as spheres
SPHERES_FINER = 0.7  # ratio of their cells to those that the next level would have
PIXEL = 0.3  # of the views that determine their radius, in cells
COARSER = 2.0  # ratio of a level's cell size to that of the level before; for the first level to the model's spacing


def make_levels(data: ModelData, report: StageProgress) -> Iterator[ModelData]:
    """Yield the levels of detail of a model, from fine to coarse, each with twice the point spacing of the one before.

    Points that share a grid cell and face about the same way are averaged. The first level that would have fewer than
    700 points is drawn as spheres only, and is the last; no level has fewer than 50 points, or more than 2/3 as many as
    the one before.

    report : called with the name of the stage and its completed share
    """
    rows, positions, normals, noise = stored_splats(data.tree, by_row=False)
    points = data.points
    colors = None if points.colors is None else points.colors[rows]
    attributes = {name: values[rows] for name, values in points.attributes.items()}
    cloud = Points.about(points.origin, positions, normals, colors, attributes, points.georeference)
    radii, some = data.radii[rows], data.scattered[rows]
    surface: Points | None = cloud
    scattered: ScatteredPoints | None = None
    if some.any():
        scattered = ScatteredPoints(cloud.select(some), radii[some])
        surface = None if some.all() else cloud.select(~some)
        radii, noise = radii[~some], None if noise is None else noise[~some]
    spacing, count, limits = data.spacing if surface is None else float(np.median(radii)), len(rows), radii
    while True:
        spacing *= COARSER
        finer = surface, scattered
        if surface is not None:
            surface, limits, noise = coarsen(surface, radii, spacing, noise)
        scattered = None if scattered is None else coarsen_scattered(scattered, spacing)
        before, count = count, _count(surface, scattered)
        if count < FEWEST_SPHERES or count * LEAST_GAIN > before:
            return
        report("levels", 1.0 - count / len(points))
        if count < LEAST_POINTS:
            if finer[0] is not None:
                yield _as_spheres(finer[0], finer[1], radii, (spacing * SPHERES_FINER, positions))
            return
        drawing = data.drawing if scattered is None else scattered.drawing(data.drawing.scatter, spacing)
        placed = None if surface is None else Placed(surface, noise)
        level = _make_level(placed, (SUPPORT * spacing, limits), scattered, drawing)
        radii = level.radii[: len(limits)]
        yield level


def _as_spheres(
    surface: Points, scattered: ScatteredPoints | None, radii: Floats, means: tuple[float, Floats]
) -> ModelData:
    """Build a level of detail of spheres only, for instances of a few pixels, from the points of the finer level.

    surface, radii : points of the surface, and their support radii; scattered : the others, if any
    means : edge length of the grid cells in which points are averaged, and all points of the model, (n, 3) float32
    """
    cell, positions = means
    mean = coarsen(surface, radii, cell)[0]
    radius = covering_radius(positions, mean.positions, cell * PIXEL)
    spheres = ScatteredPoints(mean, np.full(len(mean), radius, np.float32))
    if scattered is not None:
        others = coarsen_scattered(scattered, cell)
        spheres = ScatteredPoints(joined(mean, others.points), np.concatenate([spheres.radii, others.radii]))
    options = BuildOptions(LEVEL_SETTINGS, 1.0, 0.0, spheres.drawing(AS_SPHERES, cell))
    return assemble(spheres.points, options, None, spheres.splats(0), ignore_progress)


def _count(surface: Points | None, scattered: ScatteredPoints | None) -> int:
    return (0 if surface is None else len(surface)) + (0 if scattered is None else len(scattered.points))


def _make_level(
    placed: Placed | None, within: tuple[float, Floats], scattered: ScatteredPoints | None, drawing: Drawing
) -> ModelData:
    """Build a level of detail, with support radii and a tree, from averages of the points of the finer level.

    placed : the n averaged points of the surface, and the noise that was removed from each; None: no surface
    within : limits of the support radii: the least radius, and the largest radius of each point, (n,) float32, so that
        an isolated point stays about as small as in the finer level
    scattered : averaged points drawn as spheres or discs, as `drawing` says; None: only surface
    """
    points = joined(None if placed is None else placed.points, None if scattered is None else scattered.points)
    made, count = None, 0
    if placed is not None:
        count = len(placed.points)
        made = make_splats(placed, np.arange(count, dtype=np.int32), Sizes(within=within), LEVEL_SETTINGS)
    # Normals are not repaired: neighbours may face opposite sides.
    splats = None if scattered is None else scattered.splats(count)
    return assemble(points, BuildOptions(LEVEL_SETTINGS, 1.0, 0.0, drawing), made, splats, ignore_progress)
