"""A scene whose models are spread: who holds which instances, and the world of somebody who holds some of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..kernels.records import INSTANCE, KIND, MODEL, PLANE, SHAPE_ROW, World
from ..kernels.tree import model_table
from ..tree.instance_bvh import build_top
from .world import Snapshot, reach_boxes

Rows = NDArray[np.int64]


def held_rows(scene: Snapshot) -> Rows:
    """The rows of the instances that somebody has to hold: those of models."""
    return np.flatnonzero(scene.world.instances.reshape(-1, INSTANCE)[:, KIND] == MODEL)


def held_world(scene: Snapshot, rows: Rows) -> World:
    """What rays meet in some instances, whose rows stay: the models of others are not touched, and planes are left out.

    Rays are cut by the scene's clips.
    """
    world, instances = scene.world, scene.world.instances.reshape(-1, INSTANCE).copy()
    away = np.setdiff1d(held_rows(scene), rows)
    shapes, instances[rows, SHAPE_ROW] = np.unique(instances[rows, SHAPE_ROW].astype(int), return_inverse=True)
    models = [scene.models[k] for k in shapes]
    instances[away, KIND] = PLANE  # no ray is tried with it
    top, top_boxes, top_children = build_top(reach_boxes(scene.world.instances, scene.models, rows), rows)
    return world._replace(
        table=model_table([model.tree for model in models]),
        longest=max([model.longest for model in models], default=16),
        instances=instances.reshape(-1),
        planes=np.zeros(0),
        top=top,
        top_boxes=top_boxes,
        top_children=top_children,
    )


def split_evenly(nbytes: Sequence[int], count: int) -> list[Rows]:
    """Cut a row of things into `count` stretches of about as many bytes; some may be empty."""
    ends = np.cumsum(nbytes, dtype=np.float64)
    middles = ends - np.asarray(nbytes) / 2
    owner = np.minimum((middles * count / max(ends[-1] if len(ends) else 0.0, 1.0)).astype(int), count - 1)
    return [np.flatnonzero(owner == k) for k in range(count)]
