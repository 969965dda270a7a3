"""Table of the trees that kernels read, of models, levels of detail and parts. Models on disk are opened for it."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles
from ..engine.kernels.records import BY_COORDINATE, INSTANCE, PAINT, PAINT_KIND, PAINT_SIZE, SHAPE_ROW, World
from ..engine.kernels.tree import Tree, model_table, no_tree
from ..model.model import Model
from ..shade.attributes import Attribute
from .paints import Paints

DEFAULT_LONGEST = 16  # blocks in the longest leaf, for a scene without trees
EMPTY_TREE = no_tree(np.zeros(6, np.float32))  # in place of a model that is not open

PaintSources = Sequence[tuple[Attribute, Model | None]]


def table_of(models: Sequence[Model], used: Collection[int] = ()) -> tuple[NDArray[np.int64], int]:
    """Return the table by which kernels find the trees of models, and the number of blocks in the longest leaf.

    The table, (models * ROW,) int64, holds the addresses of the trees' arrays and keeps them alive.

    used : indices of the models on disk to open; rays miss other models on disk
    """
    there = [model.source is None or k in used for k, model in enumerate(models)]
    trees: list[Tree] = [model.tree if is_there else EMPTY_TREE for model, is_there in zip(models, there, strict=True)]
    longest = [model.longest for model, is_there in zip(models, there, strict=True) if is_there]
    return model_table(trees), max(longest, default=DEFAULT_LONGEST)


def world_showing(
    world: World,
    records: Doubles,
    models: Sequence[Model],
    used: Collection[int],
    painting: tuple[Paints, PaintSources],
) -> World:
    """Return a world whose instances show other models: levels of detail instead of all points, or parts just opened.

    Parameters
    ----------
    records : (n, INSTANCE) float64
        The instances of the returned world, which refer to models by indices of `models`.
    models : sequence of Model
        All models that instances may show.
    used : collection of int
        Indices of the models on disk to open; rays miss other models on disk.
    painting : (Paints, sequence of (Attribute, Model or None))
        The world's paints (tables that turn attribute values into colours), and the attribute and model of each paint.
    """
    table, longest = table_of(models, used)
    world = world._replace(table=table, longest=longest, instances=np.ascontiguousarray(records).reshape(-1))
    paints, paint_sources = painting
    kinds = world.paints[PAINT_KIND::PAINT_SIZE]
    if all(model is None or model.source is None for _, model in paint_sources):
        return world
    rows = [row for row in np.flatnonzero(records[:, PAINT] >= 0) if kinds[int(records[row, PAINT])] != BY_COORDINATE]
    shown = {int(records[row, PAINT]) for row in rows if int(records[row, SHAPE_ROW]) in used}
    painted = [
        (attribute, model)
        for k, (attribute, model) in enumerate(paint_sources)
        if model is not None and (model.source is None or k in shown)
    ]
    placed, positions = paints.place(world.paints, paint_sources, painted)
    return world._replace(paints=placed, map_positions=positions)


def instances_of(world: World) -> Doubles:
    """Return the records of a world's instances, (n, INSTANCE) float64, as a view of its flat array."""
    return world.instances.reshape(-1, INSTANCE)
