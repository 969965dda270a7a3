"""Groups of instances with disjoint bounds, so that rays cross the surfaces of each group one after the other."""

from __future__ import annotations

import numpy as np

from ..base.arrays import Doubles, Flags, Rows
from ..engine.kernels import records as rec
from ..surface.tree.instance_bvh import build_top
from .visible_trees import instances_of
from .world import Snapshot, surface_boxes


def separate_instances(scene: Snapshot) -> list[Snapshot]:
    """Return scenes which together have the models and planes of a scene, and in which no bounds of models overlap.

    All parts of one model are in the same scene, and all planes are in one without models. Numbers and rows of
    instances stay the same.
    """
    rows = np.flatnonzero(instances_of(scene.world)[:, rec.KIND] == rec.MODEL)
    numbers, which = np.unique(scene.numbers[rows], return_inverse=True)
    has_planes = scene.world.planes.size > 0
    if len(numbers) + has_planes < 2:
        return [scene]
    boxes = surface_boxes(scene.world.instances, scene.models, rows)
    bounds = np.tile([np.inf] * 3 + [-np.inf] * 3, (len(numbers), 1))
    np.minimum.at(bounds[:, :3], which, boxes[:, :3])
    np.maximum.at(bounds[:, 3:], which, boxes[:, 3:])
    group = _groups(bounds)[which]
    if not has_planes and not group.any():
        return [scene]
    separate = [_only(scene, rows, boxes, group == k) for k in range(int(group.max(initial=-1)) + 1)]
    no_planes = [one._replace(world=one.world._replace(planes=one.world.planes[:0])) for one in separate]
    return [*no_planes, _only(scene, rows, boxes, group < 0)] if has_planes else no_planes


def _only(scene: Snapshot, rows: Rows, boxes: Doubles, some: Flags) -> Snapshot:
    """Return a scene in which rays miss all models except some; their records count as those of planes.

    rows : (n,), rows of all instances of models; boxes : (n, 6), their bounds; some : (n,), which ones stay
    """
    records = instances_of(scene.world).copy()
    records[rows[~some], rec.KIND] = rec.PLANE
    top, top_boxes, top_children = build_top(boxes[some], rows[some])
    world = scene.world._replace(instances=records.reshape(-1), top=top, top_boxes=top_boxes, top_children=top_children)
    return scene._replace(world=world)


def _groups(bounds: Doubles) -> Rows:
    """Return a group of each box, (n,), from 0: the first one that has no other box with which it overlaps.

    bounds : (n, 6), min x y z, max x y z
    """
    axis = int(np.argmax(bounds[:, 3:].max(axis=0) - bounds[:, :3].min(axis=0)))
    order = np.argsort(bounds[:, axis], kind="stable")
    group = np.zeros(len(bounds), np.int64)
    near = order[:0]  # boxes before that do not end before the next one begins
    for k in order:
        near = near[bounds[near, 3 + axis] >= bounds[k, axis]]
        others = bounds[near]
        overlaps = ((others[:, :3] <= bounds[k, 3:]) & (others[:, 3:] >= bounds[k, :3])).all(axis=1)
        taken = np.unique(group[near[overlaps]])
        free = np.flatnonzero(taken != np.arange(len(taken)))
        group[k] = free[0] if len(free) else len(taken)
        near = np.append(near, k)
    return group
