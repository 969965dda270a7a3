"""The parts of a scene become what kernels read of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..engine.kernels.records import (
    ACROSS,
    CATCHER,
    EYE,
    FORWARD,
    INSTANCE,
    KIND,
    MODEL,
    SHAPE_ROW,
    TO_MODEL,
    UPWARD,
    LightTree,
    World,
)
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
from .visible_trees import Coats, instances_of, table_of, world_showing

PARTS = 1 << 30  # numbers from which keys of parts are counted


class LightTables(NamedTuple):
    """The parts of a `World` that depend on its lights."""

    lights: NDArray[np.float64]
    light_shares: NDArray[np.float64]
    lamps: LightTree
    suns: LightTree


class BakedLight(Protocol):
    """The light that is kept for a scene: `baking.baked.Baked`."""

    def tables(self, scene: Snapshot, levels: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any]]:
        """What kernels read of it: `World.baked` and `World.baked_frames`, for instances in these levels of detail."""

    def portable(self) -> BakedLight:
        """The light alone, which can be pickled: the same object until the light changes."""


class Snapshot(NamedTuple):
    """A scene as it was at one moment: all that a picture or a batch of rays needs of it. Nothing in it changes.

    Parts of models that lie on disk are not open in it: rays hit nothing of them, see `opened`.

    Attributes
    ----------
    world : World
        What kernels read.
    models : tuple of Model
        In the order of the world's table.
    lamps : tuple of Light
        All lights but the environment light.
    numbers : (n + 1,) int32
        What `Scene.add` returned for each instance; -1 behind the last one, so that row -1 (a miss) is -1.
    keys : (n + 1,) int32
        The same, but each part of a model in parts has one of its own.
    boxes : (n, 6) float64
        World bounds of instances, see `Instances.boxes`.
    shown : tuple of Attribute
        The attributes that colour instances, each once, with the ranges that are shown.
    painting : (Paints, sequence of (Attribute, Model or None))
        The paints of the world, and what each shows.
    background : (3,) float64 or None
        Linear RGB; None: transparent.
    shows_sky : bool
        Whether the environment light is the background.
    baked : BakedLight or None
    """

    world: World
    models: tuple[Model, ...]
    lamps: tuple[Light, ...]
    numbers: NDArray[np.int32]
    keys: NDArray[np.int32]
    boxes: NDArray[np.float64]
    shown: tuple[Attribute, ...]
    painting: tuple[Paints, Coats]
    background: NDArray[np.float64] | None
    shows_sky: bool
    baked: BakedLight | None

    @property
    def bounds(self) -> NDArray[np.float64]:
        """See `Scene.bounds`."""
        return bounds_of(self.world.instances.reshape(-1, INSTANCE), self.boxes)

    @property
    def on_disk(self) -> NDArray[np.int64]:
        """The rows of instances whose models are parts that lie on disk."""
        shapes = {k for k, model in enumerate(self.models) if model.source is not None}
        if not shapes:
            return np.zeros(0, np.int64)
        records = instances_of(self.world)
        return np.flatnonzero((records[:, KIND] == MODEL) & np.isin(records[:, SHAPE_ROW], list(shapes)))

    def opened(self, rows: NDArray[np.int64] | None = None) -> Snapshot:
        """The scene with parts that lie on disk: those of some rows of instances, or all; they are opened.

        Raises
        ------
        OSError, ValueError
            If a file cannot be opened, or is damaged; the message names it.
        """
        rows = self.on_disk if rows is None else rows
        if not len(rows):
            return self
        records = instances_of(self.world)
        used = set(records[rows, SHAPE_ROW].astype(int).tolist())
        return self._replace(world=world_showing(self.world, records, self.models, used, self.painting))

    def for_camera(self, record: NDArray[np.float64]) -> Snapshot:
        """The scene in front of a camera, given its record: lights that follow the camera are placed by it.

        `lamps` are as they were, so that it is known which of them follow.
        """
        if not any(follows_camera(light) for light in self.lamps):
            return self
        right, up, ahead = (record[k : k + 3] / np.linalg.norm(record[k : k + 3]) for k in (ACROSS, UPWARD, FORWARD))
        axes = np.stack([right, up, -ahead])
        placed = self._lit_by(tuple(fixed(light, record[EYE : EYE + 3], axes) for light in self.lamps))
        return placed._replace(lamps=self.lamps)

    def without_camera_lights(self) -> Snapshot:
        """The scene without the lights that follow the camera."""
        if not any(follows_camera(light) for light in self.lamps):
            return self
        return self._lit_by(tuple(light for light in self.lamps if not follows_camera(light)))

    def _lit_by(self, lamps: tuple[Light, ...]) -> Snapshot:
        """The scene with other lamps."""
        world = self.world
        bounds = _around(world.instances.reshape(-1, INSTANCE), self.boxes)
        lights = _light_tables(lamps, world.sky, world.sky_mean, bounds)
        return self._replace(world=world._replace(**lights._asdict()), lamps=lamps)


def bounds_of(records: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least and greatest world coordinates of all models among instances, (2, 3) float64; ValueError without models."""
    bounds = _around(records, boxes)
    if not np.isfinite(bounds).all():
        raise ValueError("the scene holds no model")
    return bounds


def _around(records: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same as `bounds_of`, but without models the least is inf."""
    boxes = boxes[records[:, KIND] == MODEL]
    return np.stack([boxes[:, :3].min(axis=0, initial=np.inf), boxes[:, 3:].max(axis=0, initial=-np.inf)])


def take_snapshot(
    instances: Instances,
    lights: Lights,
    clips: NDArray[np.float64],
    background: NDArray[np.float64] | None,
    shows_sky: bool,
    baked: BakedLight | None,
) -> Snapshot:
    """The current scene of instances and lights. `instances` detaches from it before it changes."""
    instances = instances.in_parts()
    models, planes, materials, paints = instances.finish()
    lamps = [light for light in lights if not isinstance(light, EnvironmentLight)]
    skies = [light.tables() for light in lights if isinstance(light, EnvironmentLight)]
    sky, sky_colors, sky_rows, sky_columns, sky_mean = skies[0] if skies else no_sky()
    bounds = _around(instances.records, instances.boxes)
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
        int((instances.records[:, KIND] == CATCHER).sum()),
        clip_records(clips),
        np.zeros(0, np.int64),
        np.zeros(0),
    )
    numbers = np.append(instances.numbers, -1).astype(np.int32)
    alone = np.append(np.bincount(instances.numbers)[instances.numbers] == 1, True)
    keys = np.where(alone, numbers, PARTS + np.arange(len(numbers))).astype(np.int32)
    shown, painting = tuple(instances.paints.shown), (instances.paints, instances.paints.coats)
    boxes = instances.boxes
    return Snapshot(
        world, tuple(models), tuple(lamps), numbers, keys, boxes, shown, painting, background, shows_sky, baked
    )


def _light_tables(
    lamps: Sequence[Light], sky: NDArray[np.float64], sky_mean: NDArray[np.float64], bounds: NDArray[np.float64]
) -> LightTables:
    """The light tables that kernels read."""
    records = np.concatenate([*(light.record() for light in lamps), []])
    with_size, suns = light_trees(records)
    shares = light_shares(records, sky, sky_mean, bounds)
    return LightTables(records, shares, with_size, suns)


def _top(instances: Instances, models: list[Model]) -> tuple[NDArray[np.float64], ...]:
    """The tree over the instances of models, around all that rays can hit of them.

    Bounds come from the full models; a coarser level that extends beyond them is clipped. With bounds around the levels
    too, whose supports are large, 10,000 statues took 1.12 times as long, and the picture was the same.
    """
    rows = np.flatnonzero(instances.records[:, KIND] == MODEL)
    return build_top(reach_boxes(instances.records, models, rows), rows)


def reach_boxes(records: NDArray[np.float64], models: Sequence[Model], rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """World boxes around all that rays can hit of some instances, (n, 6). rows : theirs

    A ray enters the box before any of its hits. So the nearest hit does not depend on which instance comes first.
    """
    records = records.reshape(-1, INSTANCE)[rows]
    reaches = [model.reach + [[-model.step], [model.step]] for model in models]
    bounds = np.array(reaches).reshape(-1, 2, 3)[records[:, SHAPE_ROW].astype(int)]
    return boxes_around(records[:, TO_MODEL:].reshape(-1, 3, 4), bounds)
