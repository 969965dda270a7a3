"""Many instances: the tree over them, hits compared with those of each instance alone, moves, and memory."""

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from pointray.engine.kernels.records import MATERIAL_SIZE, TOP_BOUNDS, TOP_CENTER, TOP_NODE
from pointray.engine.kernels.tree import ROW
from pointray.surface.tree.instance_bvh import DEEP, FEW, build_top


@pytest.fixture(scope="module")
def models():
    return pr.Model(pr.procedural("sphere", 3000)), pr.Model(pr.procedural("torus", 5000))


def random_transform(rng, spread):
    out = np.eye(4)
    out[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] @ np.diag(rng.uniform(0.3, 1.5, 3))
    out[:3, 3] = rng.uniform(-spread, spread, 3)
    return out


def scene_of(models, transforms):
    scene = pr.Scene()
    for k, transform in enumerate(transforms):
        scene.add(models[k % 2], transform)
    return scene


def random_rays(rng, count, spread):
    origins, towards = rng.uniform(-2 * spread, 2 * spread, (count, 3)), rng.uniform(-spread, spread, (count, 3))
    return origins, (towards - origins) * rng.uniform(0.3, 3, (count, 1))


@pytest.mark.parametrize("shift", [long(0), 4e6])
def test_many_are_as_the_nearest_of_each(rng, models, shift):
    """Rays of a picture and random rays, in tiles and in small batches, near and far from the origin."""
    transforms = [random_transform(rng, 5) for _ in range(60)]
    for transform in transforms:
        transform[:3, 3] += shift
    scene = scene_of(models, transforms)
    camera = pr.Camera.frame(scene.bounds, size=(80, 60))
    origins, directions = random_rays(rng, 3000, 6)
    rays = [camera.rays(), (origins + shift, directions)]
    for origins, directions in rays:
        hits = scene.intersect(origins, directions)
        t, instance = np.full(hits.t.shape, np.inf), np.full(hits.t.shape, -1)
        normal = np.zeros((*t.shape, 3))
        for k, transform in enumerate(transforms):
            alone = scene_of(models[k % 2 :], [transform]).intersect(origins, directions)
            nearer = alone.t < t
            t[nearer], instance[nearer], normal[nearer] = alone.t[nearer], k, alone.normal[nearer]
        assert 0.1 < np.isfinite(t).mean() < 0.9
        assert np.array_equal(hits.instance, instance)
        hit = instance >= 0
        assert np.allclose(hits.t[hit], t[hit], rtol=1e-6)  # singly or in a tile: the last bit may differ
        assert np.abs(hits.normal - normal).max() < 1e-5
        assert np.array_equal(scene.occluded(origins, directions), hit)


def ruffled(rng, count):
    """A sheet of few points with open borders, whose surface extends beyond the points' bounds."""
    x, y = rng.uniform(-1, 1, (2, count))
    normals = np.stack([-1.2 * np.cos(4 * x), 0 * x, 0 * x + 1], axis=1)
    points = np.stack([x, y, 0.3 * np.sin(4 * x)], axis=1)
    return pr.Model(pr.Points(points, normals / np.linalg.norm(normals, axis=1, keepdims=True)))


@pytest.mark.parametrize("scale", [(1, 1, 1), (2, 0.5, -1)])
def test_the_surface_goes_on_beyond_the_points(rng, scale):
    model, transform = ruffled(rng, 400), np.diag([*scale, 1.0])
    camera = pr.Camera.look_at((0, -0.1, 9), (0, 0, 0), fov=30, size=(200, 200))
    alone, among = pr.Scene(), pr.Scene()
    for k in range(6):
        among.add(model, moved_off(transform) if k else transform)
    alone.add(model, transform)
    hits = alone.intersect(*camera.rays())
    assert np.allclose(among.intersect(*camera.rays()).t, hits.t, rtol=1e-6)
    beyond = np.abs(hits.position[..., :2]) > np.abs(alone.bounds[:, :2]).max(axis=0) + 0.01
    assert beyond.any(axis=-1).sum() > 15  # 97 to 1115 of 60 seeds; a surface that ends at its points has none


def moved_off(transform):
    """A transform that moves away from all rays of a test."""
    out = transform.copy()
    out[:3, 3] += 10.0
    return out


def test_the_interval_of_a_ray_counts(rng, models):
    scene = scene_of(models, [random_transform(rng, 9) for _ in range(40)])
    origins, directions = random_rays(rng, 2000, 12)
    first = scene.intersect(origins, directions)
    hit = np.flatnonzero(first.instance >= 0)
    before, behind = first.t[hit] * 0.999, first.t[hit] * 1.001
    assert not scene.occluded(origins[hit], directions[hit], t_max=before).any()
    assert scene.occluded(origins[hit], directions[hit], t_max=behind).all()
    second = scene.intersect(origins[hit], directions[hit], t_min=behind)
    assert (second.t > behind).all() and np.isfinite(second.t).mean() > 0.7


@pytest.mark.parametrize("count", range(FEW - 1, FEW + 4))
def test_any_number_of_instances_is_hit(models, count):
    transforms = [np.eye(4) for _ in range(count)]
    for k, transform in enumerate(transforms):
        transform[0, 3] = 4 * k
    scene = scene_of(models[:1] * 2, transforms)
    hits = scene.intersect(np.array([[4 * k, -5, 0] for k in range(-1, count + 1)]), [0, 1, 0])
    assert hits.instance.tolist() == [-1, *range(count), -1]


def test_one_of_many_instances_can_be_moved(models):
    scene = scene_of(models[:1] * 2, [np.eye(4)] * 10)
    away = np.eye(4)
    for number in range(10):
        away[0, 3] = 5 * (number + 1)
        scene.update(number, away)
    origins = np.array([[5 * k, -9, 0] for k in range(11)])
    assert scene.intersect(origins, [0, 1, 0]).instance.tolist() == [-1, *range(10)]
    scene.remove(4)
    scene.add(models[0])
    assert scene.intersect(origins, [0, 1, 0]).instance.tolist() == [10, 0, 1, 2, 3, -1, 5, 6, 7, 8, 9]


def test_a_picture_under_way_keeps_its_scene(rng, models):
    """Changes while kernels read a scene go to a copy."""
    scene = scene_of(models, [np.eye(4)] * 5)
    world = scene.snapshot().world
    before = world.instances.copy()
    scene.update(2, random_transform(rng, 3))
    scene.remove(0)
    scene.add(models[0], random_transform(rng, 3))
    scene.snapshot()
    assert np.array_equal(world.instances, before)


def leaves_of(boxes, children, node, low, high, seen, depth=0):
    """Check recursively that each child's box contains its descendants, and return the depth."""
    deepest = depth
    for half in range(2):
        at = node * TOP_NODE + half * 6
        box = boxes[at : at + 6]
        child = children[2 * node + half]
        assert (box[:3] >= low).all() and (box[3:] <= high).all()
        if child < 0:
            seen[~child] = box
        else:
            deepest = max(deepest, leaves_of(boxes, children, child, box[:3], box[3:], seen, depth + 1))
    return deepest


CLOUDS = {
    "random": np.random.default_rng(11).uniform(-1, 1, (500, 3)),
    "one place": np.zeros((200, 3)),
    "a line": np.linspace(0, 1, 300)[:, None] * [1, 0, 0],
    "ever farther": 1.5 ** np.arange(120)[:, None] * [1.0, 1, 0],
}


@pytest.mark.parametrize("name", CLOUDS)
def test_the_tree_over_instances(rng, name):
    middles = CLOUDS[name]
    n = len(middles)
    half = rng.uniform(0, 0.2, (n, 3))
    given = np.concatenate([middles - half, middles + half], axis=1)
    top, boxes, children = build_top(given, np.arange(7, 7 + n))
    seen = {}
    low, high = top[TOP_BOUNDS : TOP_BOUNDS + 3], top[TOP_BOUNDS + 3 : TOP_BOUNDS + 6]
    deepest = leaves_of(boxes, children, 0, low, high, seen)
    assert deepest <= DEEP + np.log2(n) + 1
    assert sorted(seen) == list(range(7, 7 + n))
    held = np.array([seen[k] for k in range(7, 7 + n)]) + np.tile(top[TOP_CENTER : TOP_CENTER + 3], 2)
    assert (held[:, :3] <= given[:, :3]).all() and (held[:, 3:] >= given[:, 3:]).all()


def test_an_instance_takes_at_most_300_bytes(models):
    """The target is at most 300 bytes an instance of one model, including what kernels read."""
    scene, transform = pr.Scene(), np.eye(4)
    count = 512
    for k in range(count):
        transform[:3, 3] = k % 40 * 3, k // 40 * 3, 0
        scene.add(models[0], transform)
    world, instances = scene.snapshot().world, scene._instances
    held = [world.instances, world.top_boxes, world.top_children, instances._boxes, instances._numbers]
    pointers = 2 * 8 * count
    assert (sum(array.nbytes for array in held) + pointers) / count <= 300
    assert world.table.size == ROW and world.materials.size == MATERIAL_SIZE


def test_equal_materials_are_stored_once_and_only_while_used(models):
    scene = pr.Scene()
    for _ in range(3):
        scene.add(models[0], material=pr.Diffuse(0.25))
    assert len({id(material) for material in scene._instances.materials}) == 1
    for k in range(50):
        scene.update(0, material=pr.Diffuse(k / 50))
    assert len(scene._instances._equal_materials) == 2
