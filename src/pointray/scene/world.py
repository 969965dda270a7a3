"""Snapshots: immutable scenes with the tables that kernels read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles
from ..engine.kernels import records as rec
from ..engine.kernels.records import LightTree, World
from ..image.tone import srgb_to_linear
from ..model.model import Model
from ..shade.attributes import Attribute
from ..shade.environment import EnvironmentLight, Lights, no_sky
from ..shade.lights import Light, fixed, follows_camera
from ..shade.tables import light_shares, light_trees
from ..surface.tree.instance_bvh import boxes_around, build_top
from .clips import clip_records
from .instances import Instances
from .paints import Paints
from .visible_trees import PaintSources, instances_of, table_of, world_showing

FIRST_PART_KEY = 1 << 30  # first key of parts


class LightTables(NamedTuple):
    """Tables of a scene's lights: the fields of a `World` that change when a light is added, removed or moved.

    lights : (n * 18,) float64, record of each light (kind, position, power, size), without the environment light
    light_shares : cumulative distribution by which paths choose a light; empty if all lights are black
    lamps : tree of the area lights, by their bounds in the world; suns : tree of the suns with a disk, by direction
    """

    lights: Doubles
    light_shares: Doubles
    lamps: LightTree
    suns: LightTree


class BakedLight(Protocol):
    """Interface of baked light: irradiance computed once for a scene's splats and planes, and read by rendering."""

    def tables(self, scene: Snapshot, levels: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the tables in which kernels look up baked light: `World.baked` and `World.baked_frames`.

        For each instance they hold the addresses of the arrays with its irradiance, and the factor that converts stored
        values to W/m2. For a plane they also hold its grid of cells, each of which has one value.

        scene : the snapshot to render
        levels : (instances,), the level of detail that each instance shows; 0 is the model with all points
        """

    def portable(self) -> BakedLight:
        """Return the light without the rest of the scene, to be pickled; the same object until the light changes."""


class Snapshot(NamedTuple):
    """An immutable scene: all data that a picture or a batch of rays needs.

    Models that are parts on disk start closed, and rays miss them; `opened` returns a snapshot in which they are hit.

    Attributes
    ----------
    world : World
        Tables that kernels read.
    models : tuple of Model
        The distinct models. The records of instances refer to them by their index here.
    lamps : tuple of Light
        All lights but the environment light.
    numbers : (n + 1,) int32
        The number of each instance, from `Scene.add`, then -1, so that row -1 (a miss) gives -1.
    keys : (n + 1,) int32
        Unique number of each instance, by which baked light is stored, then -1. It equals `numbers`, except for a model
        in parts: all its parts have the number of the model, but each has its own key.
    boxes : (n, 6) float64
        World bounds of the instances of models, min x y z, max x y z; zero for planes.
    shown : tuple of Attribute
        The distinct attributes that colour instances, with the ranges that are shown.
    painting : (Paints, sequence of (Attribute, Model or None))
        The world's paints (tables that turn attribute values into colours), and the attribute and model of each paint;
        None for a coordinate. Needed to compute the values of models that are opened later.
    background : (3,) float64 or None
        Linear RGB, or None if transparent.
    shows_sky : bool
        Whether the environment light is the background.
    baked : BakedLight or None
        Light that the integrator "baked" shows.
    """

    world: World
    models: tuple[Model, ...]
    lamps: tuple[Light, ...]
    numbers: NDArray[np.int32]
    keys: NDArray[np.int32]
    boxes: Doubles
    shown: tuple[Attribute, ...]
    painting: tuple[Paints, PaintSources]
    background: Doubles | None
    shows_sky: bool
    baked: BakedLight | None

    @property
    def bounds(self) -> Doubles:
        """World bounds of all models, minimum and maximum, (2, 3) float64; ValueError without models."""
        return bounds_of(self.world.instances.reshape(-1, rec.INSTANCE), self.boxes)

    @property
    def on_disk(self) -> NDArray[np.int64]:
        """Rows of the instances whose models are parts on disk, opened or not, (k,) int64."""
        shapes = {k for k, model in enumerate(self.models) if model.source is not None}
        if not shapes:
            return np.zeros(0, np.int64)
        records = instances_of(self.world)
        return np.flatnonzero((records[:, rec.KIND] == rec.MODEL) & np.isin(records[:, rec.SHAPE_ROW], list(shapes)))

    def opened(self, rows: NDArray[np.int64] | None = None) -> Snapshot:
        """Return a snapshot in which rays hit the parts on disk of some instances, whose files are opened if necessary.

        rows : (k,) rows of the instances to open, from `on_disk`; rays miss all other parts on disk. None: open all

        Raises
        ------
        OSError, ValueError
            If a file cannot be opened or is damaged; the message names it.
        """
        rows = self.on_disk if rows is None else rows
        if not len(rows):
            return self
        records = instances_of(self.world)
        used = set(records[rows, rec.SHAPE_ROW].astype(int).tolist())
        return self._replace(world=world_showing(self.world, records, self.models, used, self.painting))

    def for_camera(self, record: Doubles) -> Snapshot:
        """Return the scene with the lights that follow the camera fixed in world space, as they stand for one camera.

        `lamps` stays unchanged: it shows which lights follow the camera.

        record : (16,) float64, position and axes of the camera, see `records.CAMERA`
        """
        if not any(follows_camera(light) for light in self.lamps):
            return self
        right, up, ahead = (
            record[k : k + 3] / np.linalg.norm(record[k : k + 3]) for k in (rec.ACROSS, rec.UPWARD, rec.FORWARD)
        )
        axes = np.stack([right, up, -ahead])
        placed = self._with_lamps(tuple(fixed(light, record[rec.EYE : rec.EYE + 3], axes) for light in self.lamps))
        return placed._replace(lamps=self.lamps)

    def without_camera_lights(self) -> Snapshot:
        """Return the scene without the lights that follow the camera, as for a bake, which is valid for all views."""
        if not any(follows_camera(light) for light in self.lamps):
            return self
        return self._with_lamps(tuple(light for light in self.lamps if not follows_camera(light)))

    def _with_lamps(self, lamps: tuple[Light, ...]) -> Snapshot:
        """Return the scene with all lights except the environment light replaced, and their tables rebuilt."""
        world = self.world
        bounds = _model_bounds(world.instances.reshape(-1, rec.INSTANCE), self.boxes)
        lights = _light_tables(lamps, world.sky, world.sky_mean, bounds)
        return self._replace(world=world._replace(**lights._asdict()), lamps=lamps)


def bounds_of(records: Doubles, boxes: Doubles) -> Doubles:
    """Return the world bounds of all models among instances, (2, 3) float64; ValueError without models.

    records : (n, 16), records of the instances, with kind and transform; boxes : (n, 6), their world bounds
    """
    bounds = _model_bounds(records, boxes)
    if not np.isfinite(bounds).all():
        raise ValueError("the scene contains no model")
    return bounds


def _model_bounds(records: Doubles, boxes: Doubles) -> Doubles:
    """Return the world bounds of all models among instances, (2, 3) float64; an infinite, inverted box without models.

    records : (n, 16), records of the instances, with kind and transform; boxes : (n, 6), their world bounds
    """
    boxes = boxes[records[:, rec.KIND] == rec.MODEL]
    return np.stack([boxes[:, :3].min(axis=0, initial=np.inf), boxes[:, 3:].max(axis=0, initial=-np.inf)])


def take_snapshot(
    instances: Instances,
    lights: Lights,
    clips: Doubles,
    background: Doubles | None,
    shows_sky: bool,
    baked: BakedLight | None,
) -> Snapshot:
    """Return a snapshot of instances, lights, clip planes, background and baked light.

    The snapshot shares the arrays of `instances`: call `instances.detach` before the next change.

    clips : (k, 2, 3), point and normal of each clip plane; background : (3,) linear RGB, None if transparent
    shows_sky : whether the environment light is the background
    """
    instances = instances.expand_parts()
    models, planes, materials, paints = instances.finish()
    lamps = [light for light in lights if not isinstance(light, EnvironmentLight)]
    skies = [light.tables() for light in lights if isinstance(light, EnvironmentLight)]
    sky, sky_colors, sky_rows, sky_columns, sky_mean = skies[0] if skies else no_sky()
    bounds = _model_bounds(instances.records, instances.boxes)
    top, top_boxes, top_children = _top(instances, models)
    table, longest = table_of(models)
    world = World(
        table,
        instances.records.reshape(-1),
        planes,
        top,
        top_boxes,
        top_children,
        *_light_tables(lamps, sky, sky_mean, bounds),
        materials,
        sky,
        sky_colors,
        sky_rows,
        sky_columns,
        sky_mean,
        *paints,
        srgb_to_linear(np.arange(256, dtype=np.uint8)),
        longest,
        int((instances.records[:, rec.KIND] == rec.CATCHER).sum()),
        clip_records(clips),
        np.zeros(0, np.int64),
        np.zeros(0),
    )
    numbers = np.append(instances.numbers, -1).astype(np.int32)
    is_single = np.append(np.bincount(instances.numbers)[instances.numbers] == 1, True)
    keys = np.where(is_single, numbers, FIRST_PART_KEY + np.arange(len(numbers))).astype(np.int32)
    shown, painting = tuple(instances.paints.shown), (instances.paints, instances.paints.paint_sources)
    boxes = instances.boxes
    return Snapshot(
        world, tuple(models), tuple(lamps), numbers, keys, boxes, shown, painting, background, shows_sky, baked
    )


def _light_tables(lamps: Sequence[Light], sky: Doubles, sky_mean: Doubles, bounds: Doubles) -> LightTables:
    """Return the tables of lights that kernels read.

    lamps : all lights but the environment light
    sky : (20,), record of the environment light
    sky_mean : (27,), irradiance from the environment light as spherical harmonics, 9 coefficients a colour
    bounds : (2, 3), world bounds of all models, from which the flux of suns and the sky into the scene is estimated
    """
    records = np.concatenate([*(light.record() for light in lamps), []])
    with_size, suns = light_trees(records)
    shares = light_shares(records, sky, sky_mean, bounds)
    return LightTables(records, shares, with_size, suns)


def _top(instances: Instances, models: list[Model]) -> tuple[Doubles, ...]:
    """Return `World.top`, `top_boxes` and `top_children`: the BVH over the world boxes of all instances of models.

    Its boxes bound the surfaces of the full models; coarser levels that extend beyond them are clipped. Boxes around
    the levels too, whose supports are large, made 10,000 statues 12% slower, with the same picture.
    """
    rows = np.flatnonzero(instances.records[:, rec.KIND] == rec.MODEL)
    return build_top(surface_boxes(instances.records, models, rows), rows)


def surface_boxes(records: Doubles, models: Sequence[Model], rows: NDArray[np.int64]) -> Doubles:
    """Return world boxes around the surfaces of some instances, (n, 6): min x y z, max x y z.

    They have a margin, so that a ray enters a box before its hits and the order of instances does not matter.

    records : records of all instances, flat or (m, 16), with transforms; models : those that they refer to
    rows : (n,) rows of instances of models
    """
    records = records.reshape(-1, rec.INSTANCE)[rows]
    reaches = [model.surface_bounds + [[-model.step], [model.step]] for model in models]
    bounds = np.array(reaches).reshape(-1, 2, 3)[records[:, rec.SHAPE_ROW].astype(int)]
    return boxes_around(records[:, rec.TO_MODEL :].reshape(-1, 3, 4), bounds)
