"""Building of models: points to splats to a tree, and again with other settings."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Flags, Floats
from ..base.progress import StageProgress
from ..cloud.denoising.smooth import Placed
from ..cloud.points import Points
from ..cloud.preparation import placed_for_model
from ..engine.kernels.tree import Tree, no_tree
from ..surface.splats.build import Sizes, SplatBuild, check_size, make_splats
from ..surface.splats.scattered.classification import find_scattered_placed, has_few_places
from ..surface.splats.scattered.spheres import NOTHING_TO_DRAW, Drawing, make_scattered
from ..surface.tree.build import Splats, build_tree
from ..surface.tree.scattered import scattered_of, with_scattered
from ..surface.tree.settings import LOOSE_TRIM, TreeSettings
from ..surface.tree.stored import stored_splats
from .model_data import ModelData


class BuildOptions(NamedTuple):
    """Checked options of a model.

    settings : the implicit surface, the samples along a ray, how far hits may lie from splats, the voxel size
    scale : factor for the radii of the surface
    smooth : standard deviation of the noise to remove from the positions, or "auto"
    drawing : how points that lie on no surface are drawn, such as spheres
    """

    settings: TreeSettings
    scale: float
    smooth: str | float
    drawing: Drawing


def ignore_progress(stage: str, share: float) -> None:
    """Do nothing: the progress callback for callers without one."""


def build_model(
    points: Points,
    used: NDArray[np.int32],
    given: Floats | None,
    mask: Flags | None,
    options: BuildOptions,
    report: StageProgress,
) -> ModelData:
    """Build a model of points: normals, removal of noise, detection of scattered points, radii, and the tree.

    Scattered points are those that lie on no surface, such as leaves and wires.

    Parameters
    ----------
    points : Points
        The n points.
    used : (m,) int32
        Rows of the finite points.
    given : (n,) float32, optional
        Radii. Default: chosen from the spacing of neighbours.
    mask : (n,) bool, optional
        Mask of the scattered points. Default: detected, unless the options draw them like the surface.
    options : BuildOptions
    report : callable
        Called with the name of the stage and its completed share.

    Raises
    ------
    ValueError
        If all points are scattered and the options do not draw them, or all points coincide and no radii are given.
    """
    report("normals", 0.0)
    cloud = points if len(used) == len(points) else points.select(used)
    drawing = options.drawing
    sizes, scattered, made = Sizes(None if given is None else given[used], options.scale), None, None
    found: Flags | None = None
    placed: list[Placed] = []  # empty if all points are scattered
    if drawing.is_apart and (mask is not None or has_few_places(cloud.positions)):
        found = np.ones(len(used), np.bool_) if mask is None else mask[used]
    if found is None or not found.all():
        placed = [placed_for_model(cloud, options.smooth, given is None, partial(report, "normals"))]
    if found is None and drawing.is_apart:
        found = find_scattered_placed(cloud, placed[0], partial(report, "scattered points"))
    if found is not None and found.any():
        if drawing.scatter != "none":
            scattered = make_scattered(cloud, found, used, drawing, sizes.given)
        elif found.all():
            raise ValueError(NOTHING_TO_DRAW)
        placed = [] if found.all() else [placed[0].select(~found)]
        used, sizes = used[~found], sizes.select(~found)._replace(others=cloud.positions[found])
    if placed:  # `make_splats` alone holds the placed points, and frees them
        made = make_splats(placed.pop(), used, sizes, options.settings, partial(report, "radii"))
    return assemble(points, options, made, scattered, report)


def assemble(
    points: Points, options: BuildOptions, made: SplatBuild | None, scattered: Splats | None, report: StageProgress
) -> ModelData:
    """Return a model with a tree over the splats of the surface and over the points drawn as spheres or discs.

    points : the n points, as given
    made : splats of the surface and the rows of their points; None: no surface
    scattered : splats drawn as spheres or discs; None: only surface
    report : called with the name of the stage and its completed share
    """
    settings = options.settings
    if made is not None and made.tight:
        settings = settings._replace(trim=LOOSE_TRIM)
    radii: Floats = np.zeros(len(points), np.float32)
    tree: Tree = no_tree(np.zeros(6, np.float32))
    if made is not None:
        radii[made.rows] = made.radii
        tree = build_tree(made.splats, settings, progress=partial(report, "tree"), in_order=True)
    if scattered is not None:
        check_size(scattered.radii, "scatter_size")
        radii[scattered.rows] = scattered.radii
        tree = with_scattered(tree, scattered, options.drawing.kind)
    return ModelData(settings, options.smooth, options.drawing, points, radii, points.bounds, tree)


def rebuild_model(data: ModelData, options: BuildOptions, report: StageProgress) -> ModelData:
    """Build a model of the same points with another implicit surface, other samples or scaled radii.

    Normals, denoised positions and points drawn as spheres or discs are taken from `data`, an existing model.
    """
    points, radii = data.points, data.radii
    used = np.flatnonzero(points.finite & (radii > 0) & ~data.scattered).astype(np.int32)
    made = None
    if len(used):
        sizes = Sizes(radii[used], options.scale)
        made = make_splats(_placed(data, used), used, sizes, options.settings, partial(report, "radii"))
    return assemble(points, options, made, scattered_of(data.tree, radii), report)


def _placed(data: ModelData, used: NDArray[np.int32]) -> Placed:
    """Return some points of a model at the denoised positions of their splats, with unit normals and the removed noise.

    used : (m,) int32, rows of the points; those without a splat get the given position and the normal 0
    """
    splats, points = stored_splats(data.tree), data.points
    positions, normals = points.positions.copy(), np.zeros_like(points.positions)
    noise = np.zeros(len(positions), np.float32)
    positions[splats.rows], normals[splats.rows] = splats.positions, splats.normals
    noise[splats.rows] = 0.0 if splats.noise is None else splats.noise
    return Placed(points.changed(positions=positions, normals=normals).select(used), noise[used])
