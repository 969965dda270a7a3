"""Scenes used by several threads, copied, or sent to other processes; and the lifetime of their memory."""

import _thread
import copy
import gc
import multiprocessing
import pickle
import threading
import weakref

import numpy as np
import pytest

import pointray as pr
from pointray.cloud.neighbors import NeighborTree
from pointray.engine.kernels.tree import model_table
from pointray.rendering.picture import Picture

CAMERA = pr.Camera.look_at((0, -6, 1.5), (0, 0, 0), size=(32, 24))


def ball(n: int = 2000, seed: int = 0) -> pr.Model:
    return pr.Model(pr.procedural("sphere", n, seed))


def one_ball() -> pr.Scene:
    """Return a scene that holds the only reference to its model."""
    scene = pr.Scene()
    scene.add(ball(), material=pr.Diffuse(pr.Attribute("z", "viridis")))
    scene.add_light(pr.SunLight((1, 1, -1)))
    return scene


def seen(scene: pr.Scene) -> np.ndarray:
    return pr.render(scene, CAMERA, pr.Settings())


@pytest.fixture
def quick_gc():
    """Exclude existing objects from garbage collection: compiled kernels have many."""
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.mark.usefixtures("quick_gc")
@pytest.mark.parametrize("holder", ["table", "snapshot", "picture"])
def test_objects_with_addresses_keep_the_arrays_alive(holder):
    scene = one_ball()
    blocks = weakref.ref(scene.models[0].tree.blocks)
    if holder == "table":
        held = model_table([scene.models[0].tree])[3:]  # a part of it
    elif holder == "snapshot":
        held = scene.snapshot().world
    else:
        held = Picture(scene.snapshot(), CAMERA, pr.Settings(levels=False))
    scene.remove(0)
    gc.collect()
    assert blocks() is not None
    del held
    scene.snapshot()  # forgets the colours
    gc.collect()
    assert blocks() is None


def test_addresses_are_never_copied():
    scene = one_ball()
    for one in (scene.snapshot(), scene.snapshot().world, Picture(scene.snapshot(), CAMERA, pr.Settings())):
        with pytest.raises(TypeError, match="copy or pickle the scene"):
            copy.deepcopy(one)
        with pytest.raises(TypeError, match="copy or pickle the scene"):
            pickle.dumps(one)


COPIES = {
    "copy": lambda scene: scene.copy(),
    "copy.copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda scene: pickle.loads(pickle.dumps(scene)),
}


@pytest.mark.parametrize("built", [False, True])
@pytest.mark.parametrize("method", COPIES)
def test_copies_show_the_same_and_change_independently(method, built):
    scene = one_ball()
    floor = scene.add(pr.Plane((0, 0, -1), (0, 0, 1), checker=0.5))
    scene.background, scene.clips = (0.1, 0.2, 0.3), [((0, 0, 0.5), (0, 0, 1))]
    before = seen(scene) if built else seen(one_ball()) * 0 - 1
    twin = COPIES[method](scene)
    if not built:
        before = seen(scene)
    np.testing.assert_array_equal(seen(twin), before)
    shares = twin.models[0] is scene.models[0]
    assert shares == method.startswith("copy")
    twin.remove(0)
    twin.add(pr.Plane((0, 0, 2), (0, 0, 1)))
    np.testing.assert_array_equal(seen(scene), before)
    scene.update(floor, material=pr.Diffuse((1, 0, 0)))
    assert not np.array_equal(seen(scene), before) and list(twin.shapes) == [floor, floor + 1]


@pytest.mark.usefixtures("quick_gc")
@pytest.mark.parametrize("method", ["deepcopy", "pickle"])
def test_a_copy_outlives_its_original(method):
    scene = one_ball()
    before = seen(scene)
    twin, blocks = COPIES[method](scene), weakref.ref(scene.models[0].tree.blocks)
    del scene
    gc.collect()
    assert blocks() is None
    np.testing.assert_array_equal(seen(twin), before)


def test_models_are_pickled_with_their_levels(tmp_path):
    model = pr.Model(pr.Points(pr.procedural("torus", 20_000).world + 5e6, attributes={"a": np.arange(20_000)}))
    model.make_levels()
    model.save(tmp_path / "m.pointray")
    for one in (model, pr.Model.load(tmp_path / "m.pointray")):
        twin = pickle.loads(pickle.dumps(one))
        assert (twin.nbytes, twin.settings, len(twin.levels)) == (model.nbytes, model.settings, len(model.levels))
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(twin.tree, model.tree, strict=True))
        np.testing.assert_array_equal(twin.points.world, model.points.world)


@pytest.mark.long
def test_a_scene_can_be_sent_to_another_process():
    scene = one_ball()
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        np.testing.assert_array_equal(pool.apply(seen, (scene,)), seen(scene))


def test_all_that_a_scene_holds_can_be_pickled(rng):
    sky = rng.random((4, 8, 3), np.float32)
    for one in (
        *(pr.PointLight((0, 0, 3), 10), pr.SunLight((0, 0, -1), 1), pr.EnvironmentLight(image=sky)),
        *(pr.RectLight((0, 0, 3), (1, 0, 0), (0, 1, 0), 1), pr.DiskLight((0, 0, 3), (0, 0, -1), 1, 1)),
        *(pr.SphereLight((0, 0, 3), 1, 1), pr.Phong(0.5), pr.Mirror(), pr.Dielectric(), pr.Emissive(1)),
        *(pr.Principled((1, 0, 0), 0.5, 1), pr.Plane((0, 0, 0), (0, 0, 1)), CAMERA, pr.Settings("path")),
        pr.Attribute("z", "viridis", (0, 1)),
    ):
        assert repr(pickle.loads(pickle.dumps(one))) == repr(one)


@pytest.mark.long
def test_each_call_sees_one_consistent_state_of_the_scene():
    """A ball moves back and forth while others are added and removed; each call must see it exactly once."""
    scene = pr.Scene()
    jumper = scene.add(ball(), material=pr.Diffuse(pr.Attribute("z", "viridis")))
    transforms = [pr.transform(translate=(x, 0, 0)) for x in (-1.5, 1.5)]
    scene.update(jumper, transforms[0])
    x = np.repeat([-1.5, 1.5], 2000)  # several batches of rays at each position
    origins = np.stack([x, np.full(len(x), -5.0), np.zeros(len(x))], axis=1)
    wrong: list[object] = []
    looks = [0, 0, 0]  # of each thread
    ended = threading.Event()

    def trace(thread: int) -> None:
        try:
            while not ended.is_set():
                looks[thread] += 1
                hits = scene.intersect(origins, [0, 1, 0])
                there = (hits.instance == jumper).reshape(2, -1)
                if sorted(there.mean(axis=1)) != [0, 1] or (hits.point[hits.instance >= 0] < 0).any():
                    wrong.append(there.mean(axis=1))
                layers = pr.render_layers(scene, CAMERA, pr.Settings(seed=1))
                if not ((layers["instance"] >= 0) == (layers["radiance"][..., 3] > 0)).all():
                    wrong.append("the light and the layers of a picture are of two moments")
                scene.copy(), scene.bounds, scene.shapes, scene.models, scene.shown_attributes
        except Exception as error:
            wrong.append(error)

    threads = [threading.Thread(target=trace, args=(k,)) for k in range(3)]
    for thread in threads:
        thread.start()
    k = 0
    while (k < 20 or min(looks) < 20) and not wrong:
        k += 1
        scene.update(jumper, transforms[k % 2])
        number = scene.add(ball(200, k), pr.transform(translate=(0, 9, 0)), pr.Diffuse(pr.Attribute("x", "magma")))
        scene.add_light(pr.PointLight((0, -5, 1), 30))
        scene.clips = [((0, 0, 5), (0, 0, 1))]
        copy.deepcopy(scene)
        scene.remove(number)
        scene.lights = ()
    ended.set()
    for thread in threads:
        thread.join()
    assert not wrong


def test_an_interrupt_ends_a_search_for_neighbours(rng):
    positions = rng.random((50_000, 3), np.float32)
    tree = NeighborTree(positions)
    tree.rows_at(60, positions[:100])
    with pytest.raises(KeyboardInterrupt):  # before the timer begins
        threading.Timer(0.1, _thread.interrupt_main).start()
        while True:
            tree.query(60)
    assert tree.rows_at(1, positions[:5])[:, 0].tolist() == list(range(5))


def test_more_points_than_rows_can_count_are_refused():
    many = np.broadcast_to(np.zeros(3, np.float32), (2**31, 3))
    for make in (pr.Points, pr.Model, lambda x: pr.Points.about(np.zeros(3), x)):
        with pytest.raises(ValueError, match="2,147,483,648 points are too many: at most 2,147,483,647"):
            make(many)
