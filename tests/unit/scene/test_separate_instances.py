"""Groups of models whose bounds do not overlap: which ones, and models in parts."""

import numpy as np
import pytest

import pointray as pr
from pointray.scene.crossings import find_crossings
from pointray.scene.rays import check_rays
from pointray.scene.separate_instances import separate_instances


def groups_of(scene, count):
    """The instances that rays towards places on the x axis hit, for each group. count : number of places"""
    rays = np.column_stack([3.0 * np.arange(count), np.full(count, -9), np.zeros(count)]), [0, 1, 0]
    found = [find_crossings(one, *check_rays(*rays, 0, np.inf)) for one in separate_instances(scene.snapshot())]
    return [set(one.instance.tolist()) for one in found]


def test_models_apart_are_one_group_and_overlapping_ones_are_several():
    model, scene = pr.Model(pr.procedural("sphere", 500)), pr.Scene()
    for k in range(5):
        scene.add(model, pr.transform(translate=(3 * k, 0, 0)))
    assert groups_of(scene, 5) == [{0, 1, 2, 3, 4}]
    scene.add(model, pr.transform(translate=(3.1, 0, 0)))
    scene.add(model, pr.transform(translate=(3.2, 0, 0)))
    groups = groups_of(scene, 5)
    assert len(groups) == 3 and sum(len(group) for group in groups) == 7
    assert not any({1, 5} <= group or {1, 6} <= group or {5, 6} <= group for group in groups)
    scene.add(pr.Plane((0, 2, 0), (0, 1, 0)))
    assert groups_of(scene, 5) == [*groups, {7}]


@pytest.mark.long
def test_models_in_parts_stay_together(rng, tmp_path):
    ball = pr.procedural("sphere", 20_000)
    pr.prepare(ball, tmp_path / "ball.pointray", in_parts=True, part_points=5000)
    scene = pr.Scene()
    scene.add(pr.Model.load(tmp_path / "ball.pointray"))
    scene.add(pr.Model(ball), pr.transform(scale=1.0001))
    snapshot = scene.snapshot()
    assert len(snapshot.on_disk) > 1 and len(separate_instances(snapshot)) == 2
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = find_crossings(snapshot, *check_rays(-5 * directions, directions, 0, np.inf))
    assert (np.bincount(found.ray, minlength=200) == 4).all() and (np.bincount(found.instance) == 400).all()
