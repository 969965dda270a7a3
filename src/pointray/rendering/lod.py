"""Which level of detail of an instance is shown: the coarsest whose points are still finer than a pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..kernels.records import (
    BY_COORDINATE,
    INSTANCE,
    KIND,
    MODEL,
    PAINT,
    PAINT_COARSER,
    PAINT_KIND,
    PAINT_SIZE,
    SHAPE_ROW,
    TO_MODEL,
    World,
)
from ..model import COARSER, Model
from ..scene.shown import world_showing
from ..scene.world import Snapshot
from ..splats.levels import SUPPORT
from .camera import Camera

# Pixels: the largest support, in the median. With 1.2, 1.6, 2.0 and 2.6, frames of 24 statues of a million points, 100
# pixels high, change by 0.81, 0.78, 0.75 and 0.65 of what they do with all points, and their error is 0.0065, 0.0068,
# 0.0071 and 0.0086; it is 0.0070 with all points.
FINENESS = 1.9
FINEST = 0.25  # share of FINENESS: the limit, however many samples a pixel has


def at_distance(
    scene: Snapshot, camera: Camera, spp: int, held: NDArray[np.int64] | None = None
) -> tuple[World, NDArray[np.int64]]:
    """The scene's world with the fitting level for each instance; the world itself where no model has levels.

    Also returns which level each instance has, (instances,): 0 is the model itself.

    Instances coloured by classes of an attribute keep their finest model.

    Parameters
    ----------
    spp : int
        Samples for each pixel: the more there are, the finer a level is.
    held : (n,) int64, optional
        Rows of instances: of others that lie on disk nothing is opened, and rays hit nothing. None: all.
    """
    world = scene.world
    families = [(model, *model.levels) for model in scene.models]
    shown = np.zeros(world.instances.size // INSTANCE, np.int64)
    if all(len(family) == 1 for family in families):
        return scene.opened(held).world, shown
    first = np.cumsum([0, *(len(family) for family in families)])
    levels = [level for family in families for level in family]
    instances = world.instances.reshape(-1, INSTANCE).copy()
    rows = np.flatnonzero(instances[:, KIND] == MODEL)
    shapes = instances[rows, SHAPE_ROW].astype(int)
    pixel = _pixel_sizes(camera, scene.boxes[rows]) * _scales(instances[rows])  # in the model's unit
    finest = _finest(spp)
    for k, family in enumerate(families):
        spacing = [level.spacing for level in family[1:]]
        mine = shapes == k
        level = np.searchsorted(spacing, finest * pixel[mine], side="right")
        shown[rows[mine]] = _repaint(world, instances, rows[mine], level, len(spacing))
        instances[rows[mine], SHAPE_ROW] = first[k] + shown[rows[mine]]
    used = set(instances[rows if held is None else held, SHAPE_ROW].astype(int).tolist())
    return world_showing(world, instances, levels, used, scene.painting), shown


def is_far(model: Model, camera: Camera, spp: int) -> bool:
    """Whether a picture of the model, where it was scanned, would show one of its levels of detail, if it had any."""
    pixel = float(_pixel_sizes(camera, model.bounds.reshape(1, 6))[0])
    return COARSER * SUPPORT * model.spacing <= _finest(spp) * pixel


def _finest(spp: int) -> float:
    """Pixels: the largest spacing of points that is shown."""
    return float(FINENESS * max(spp**-0.5, FINEST))


def _repaint(
    world: World, instances: NDArray[np.float64], rows: NDArray[np.int64], level: NDArray[np.int64], count: int
) -> NDArray[np.int64]:
    """Give instances the paints of their levels of detail; returns the levels, 0 where a level has no such paint.

    count : number of levels of each model, which may have been made after the paints
    """
    painted = np.flatnonzero(instances[rows, PAINT] >= 0)
    records = world.paints.reshape(-1, PAINT_SIZE)[instances[rows[painted], PAINT].astype(int)]
    by_splats = records[:, PAINT_KIND] != BY_COORDINATE
    level[painted[by_splats & (records[:, PAINT_COARSER] != count)]] = 0
    instances[rows[painted[by_splats]], PAINT] += level[painted[by_splats]]
    return level


def _scales(instances: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much the transforms from the world into the models enlarge, (n,)."""
    a, b, c = (instances[:, TO_MODEL + 4 * k : TO_MODEL + 4 * k + 3].T for k in range(3))
    volume = sum(a[k] * (b[k - 2] * c[k - 1] - b[k - 1] * c[k - 2]) for k in range(3))
    return np.asarray(np.cbrt(np.abs(volume)))


def _pixel_sizes(camera: Camera, boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """World size of a pixel at the nearest points of boxes, (n,)."""
    eye = np.asarray(camera.eye)
    away = np.linalg.norm(np.maximum(np.maximum(boxes[:, :3] - eye, eye - boxes[:, 3:]), 0.0), axis=1)
    height = camera.size[1]
    if camera.projection == "panorama":
        return np.asarray(away * np.pi / height)
    half = np.tan(np.radians(camera.fov) / 2.0)
    if camera.projection == "orthographic":
        away = np.full(len(boxes), float(np.linalg.norm(np.subtract(camera.target, eye))))
    return np.asarray(away * 2.0 * half / height)
