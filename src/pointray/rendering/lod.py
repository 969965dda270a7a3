"""Selection of levels of detail: the coarsest level whose points are finer than a pixel."""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Flags
from ..engine.kernels import records as rec
from ..engine.kernels.records import World
from ..model.levels_of_detail import COARSER
from ..model.model import Model
from ..scene.visible_trees import instances_of, world_showing
from ..scene.world import Snapshot
from ..surface.splats.levels import SUPPORT
from .camera import Camera
from .window import may_see

# Largest median support, in pixels. With 1.2, 1.6, 2.0 and 2.6, frames of 24 statues of a million points, 100 pixels
# high, change by 0.81, 0.78, 0.75 and 0.65 of what they do with all points, and their error is 0.0065, 0.0068, 0.0071
# and 0.0086; it is 0.0070 with all points.
FINENESS = 1.9
SKIPPED = 2  # levels by which a substitute may be finer, and by which a level opened first is coarser
AROUND = 0.05  # extent of a part's surface beyond its points, relative to its box
FINEST = 0.25  # lower limit of the size for many samples a pixel, relative to FINENESS


class Fetch(Protocol):
    """Interface of a loader that opens models on disk in the background, while others are shown in their place."""

    def want(self, models: list[Model]) -> None:
        """Open these models in their order, as far as memory allows, replacing earlier requests.

        A level is skipped if a finer one of the same part, earlier in the list, fits into memory.
        """

    def open(self, model: Model) -> bool:
        """Open a model now, waiting for its file; return whether it is open."""


def at_distance(
    scene: Snapshot, camera: Camera, spp: int | None, fetch: Fetch | None = None, held: NDArray[np.int64] | None = None
) -> tuple[World, NDArray[np.int64]]:
    """Return a scene's world with a level of detail chosen for each instance, and the chosen levels.

    An instance gets the coarsest level whose splats are small enough for the size of a pixel at its nearest point.
    Instances coloured by classes of an attribute keep the model with all points, unless they are parts on disk.

    Parameters
    ----------
    spp : int or None
        Samples a pixel: more samples select finer levels. None: no levels.
    fetch : Fetch, optional
        Opens models on disk in the background; until then other levels are shown. None: open them now.
    held : (n,) int64, optional
        Rows of instances to open. Rays miss other instances whose models are on disk. None: all.

    Returns
    -------
    world : World
    levels : (instances,) int64
        0: the model with all points; k: the k-th of `Model.levels`, counted from 1.
    """
    families = [(model, *model.levels) for model in scene.models]
    shown = np.zeros(scene.world.instances.size // rec.INSTANCE, np.int64)
    waits = fetch is None or not any(model.source for model in scene.models)
    if waits and all(len(family) == 1 for family in families):
        return scene.opened(held).world, shown
    records = instances_of(scene.world).copy()
    rows = np.flatnonzero(records[:, rec.KIND] == rec.MODEL)
    fitting = Fitting(scene, camera, rows, families)
    wanted = fitting.levels(_finest(spp))
    if fetch is not None:
        wanted = _open_levels(fetch, fitting, wanted, spp)
    first = np.cumsum([0, *(len(family) for family in families)])
    for k, family in enumerate(families):
        mine = rows[fitting.shapes == k]
        shown[mine] = _repaint(scene.world, records, mine, wanted[fitting.shapes == k], len(family) - 1)
        records[mine, rec.SHAPE_ROW] = first[k] + shown[mine]
    models = [level for family in families for level in family]
    needed, records[rows, rec.SHAPE_ROW] = np.unique(records[rows, rec.SHAPE_ROW].astype(int), return_inverse=True)
    models = [models[k] for k in needed]
    used = set(records[rows if held is None else held, rec.SHAPE_ROW].astype(int).tolist())
    if fetch is not None:
        used = {k for k in used if (source := models[k].source) is None or source.is_open}
    return world_showing(scene.world, records, models, used, scene.painting), shown


class Fitting:
    """Selection of levels of detail for instances of models, by distance from a camera.

    Parameters
    ----------
    rows : (n,) int64
        Rows of the instances of models in the scene.

    Attributes
    ----------
    families : list of tuple of Model
        Each model of the scene with its levels.
    shapes : (n,) int64
        Row in `families` of each instance.
    pixels : (n,) float64
        Size of a pixel at the nearest point of each instance, in model units.
    is_seen : (n,) bool
        Whether the camera may see each instance.
    """

    def __init__(
        self, scene: Snapshot, camera: Camera, rows: NDArray[np.int64], families: list[tuple[Model, ...]]
    ) -> None:
        records, boxes = instances_of(scene.world)[rows], scene.boxes[rows]
        self.families, self.shapes = families, records[:, rec.SHAPE_ROW].astype(int)
        self.pixels = _pixel_sizes(camera, boxes) * _scales(records)
        self._seen = camera, boxes

    @cached_property
    def is_seen(self) -> Flags:
        camera, boxes = self._seen
        beyond = AROUND * (boxes[:, 3:] - boxes[:, :3])
        return may_see(camera, np.concatenate([boxes[:, :3] - beyond, boxes[:, 3:] + beyond], axis=1))

    def levels(self, finest: float) -> NDArray[np.int64]:
        """Return the level of detail of each instance, (n,): the coarsest that is fine enough; 0 is the model itself.

        Parts on disk outside the view, which may cast shadows, get coarser ones.

        finest : largest median support radius of a level's splats, in pixels; 0: no levels
        """
        found = np.zeros(len(self.shapes), np.int64)
        for k, family in enumerate(self.families):
            mine = self.shapes == k
            spacing = [level.spacing for level in family[1:]]
            found[mine] = np.searchsorted(spacing, finest * self.pixels[mine], side="right")
            if family[0].source is not None:
                found[mine] = np.minimum(found[mine] + np.where(self.is_seen[mine], 0, SKIPPED), len(spacing))
        return found


def _open_levels(fetch: Fetch, fitting: Fitting, wanted: NDArray[np.int64], spp: int | None) -> NDArray[np.int64]:
    """Return the level of detail to show now for each instance, (n,): an open one close to the wanted one.

    The wanted levels are requested from `fetch`, those of visible and near instances first; before them, coarser ones
    that suffice for one sample a pixel, so that the first image can show them.

    fetch : opens models on disk in the background; fitting : the instances' models, visibility and pixel sizes
    wanted : (n,), the best level of each instance; spp : samples a pixel, None: only models with all points
    """
    order = np.lexsort((fitting.pixels, ~fitting.is_seen)).tolist()
    families, shapes = fitting.families, fitting.shapes
    shown, soon = wanted.copy(), []
    for k in order:
        family, level = families[shapes[k]], int(wanted[k])
        if family[level].source is None:
            continue
        shown[k] = level = _nearest_open(fetch, family, level)
        middle = min(int(wanted[k]) + SKIPPED, len(family) - 1)
        if level > middle:
            soon.append(family[middle])
    rough = fitting.levels(_finest(1)) if spp is not None and spp > 1 else wanted
    coarser = np.minimum(wanted + 1, [len(families[shape]) - 1 for shape in shapes])  # if memory is short
    later = [families[shapes[k]][int(levels[k])] for levels in (rough, wanted, coarser) for k in order]
    fetch.want(list(dict.fromkeys(model for model in (*soon, *later) if model.source is not None)))
    return shown


def _nearest_open(fetch: Fetch, family: tuple[Model, ...], level: int) -> int:
    """Return the index of the open level of detail to show in place of a wanted one, which may be open itself.

    If none is open, the coarsest level is opened now; if that fails, the wanted index is returned.

    family : a model on disk and its levels of detail, from fine to coarse
    level : index of the wanted one in `family`, 0 for the model itself
    """
    finer, coarser = range(level, max(level - SKIPPED, 0) - 1, -1), range(level + 1, len(family))
    for near in (*finer, *coarser):
        source = family[near].source
        if source is not None and source.is_open:
            return near
    last = len(family) - 1  # small, and stays open
    return last if last > 0 and fetch.open(family[last]) else level


def is_far(model: Model, camera: Camera, spp: int) -> bool:
    """Return whether a camera is so far from a model without levels of detail that the first one would be used.

    The model is taken as untransformed. spp : samples a pixel
    """
    pixel = float(_pixel_sizes(camera, model.bounds.reshape(1, 6))[0])
    return COARSER * SUPPORT * model.spacing <= _finest(spp) * pixel


def _finest(spp: int | None) -> float:
    """Return the largest median support radius that splats of a level of detail may have, in pixels; 0: no levels.

    spp : samples a pixel, more of which need finer levels; None: no levels
    """
    if spp is None:
        return 0.0
    return float(FINENESS * max(spp**-0.5, FINEST))


def _repaint(
    world: World, instances: Doubles, rows: NDArray[np.int64], level: NDArray[np.int64], count: int
) -> NDArray[np.int64]:
    """Set the paints (colour tables of attributes) of one model's instances to those of their levels of detail.

    Returns the levels to use, (n,): 0 (all points) where a paint was made for another number of levels.

    instances : (m, 16), records of all instances, modified; rows : (n,), rows of this model's instances
    level : (n,), level of each of these, modified; count : number of the model's levels, which may have changed since
    """
    painted = np.flatnonzero(instances[rows, rec.PAINT] >= 0)
    records = world.paints.reshape(-1, rec.PAINT_SIZE)[instances[rows[painted], rec.PAINT].astype(int)]
    by_splats = records[:, rec.PAINT_KIND] != rec.BY_COORDINATE
    level[painted[by_splats & (records[:, rec.PAINT_COARSER] != count)]] = 0
    instances[rows[painted[by_splats]], rec.PAINT] += level[painted[by_splats]]
    return level


def _scales(instances: Doubles) -> Doubles:
    """Return the scale factors of the transforms from world to model space, (n,): cube roots of their determinants.

    instances : (n, 16), records of instances
    """
    a, b, c = (instances[:, rec.TO_MODEL + 4 * k : rec.TO_MODEL + 4 * k + 3].T for k in range(3))
    volume = sum(a[k] * (b[k - 2] * c[k - 1] - b[k - 1] * c[k - 2]) for k in range(3))
    return np.asarray(np.cbrt(np.abs(volume)))


def _pixel_sizes(camera: Camera, boxes: Doubles) -> Doubles:
    """Return the world size of a pixel at the nearest points of boxes, (n,). boxes : (n, 6), min x y z, max x y z"""
    eye = np.asarray(camera.eye)
    away = np.linalg.norm(np.maximum(np.maximum(boxes[:, :3] - eye, eye - boxes[:, 3:]), 0.0), axis=1)
    height = camera.size[1]
    if camera.projection == "panorama":
        return np.asarray(away * np.pi / height)
    half = np.tan(np.radians(camera.fov) / 2.0)
    if camera.projection == "orthographic":
        away = np.full(len(boxes), float(np.linalg.norm(np.subtract(camera.target, eye))))
    return np.asarray(away * 2.0 * half / height)
