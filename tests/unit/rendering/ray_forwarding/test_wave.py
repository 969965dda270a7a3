"""Pictures whose rays are forwarded to the holders of models are bit-identical to those with all models local."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from helpers.dask_clusters import assert_alike, ball, camera_of, scene_of
from helpers.marks import long
from pointray.model.out_of_core.split import split
from pointray.rendering.picture import kernel_for
from pointray.rendering.plan import plan
from pointray.rendering.ray_forwarding.ray_exchange import View, held_world
from pointray.rendering.ray_forwarding.replay import ReplayWorld, recalled_quick, recalled_sampled, replay_kernel_for
from pointray.rendering.ray_forwarding.route import route
from pointray.rendering.ray_forwarding.spread import NOTHING
from pointray.rendering.ray_forwarding.wave import KernelArguments, Waves, answer_query, passes_of, pieces_of
from pointray.scene.ownership import Shares, boxes_of
from pointray.surface.trace.world import occlude_tile, trace_tile


def by_waves(scene: pr.Scene, camera: pr.Camera, settings: pr.Settings, holders: int) -> tuple[Any, list[int]]:
    """Return a picture of models split over holders in this process, and the number of rays sent to each."""
    now = scene.snapshot().for_camera(camera.record())
    world, job = plan(now, camera, settings, held=NOTHING)
    names = [str(k) for k in range(holders)]
    shares = Shares(now, names)
    view = View(camera, settings.most if settings.levels else None)
    worlds = [held_world(now, view, shares.of(name)) for name in names]
    boxes = boxes_of(now, shares.rows)
    film = np.zeros((camera.size[1], camera.size[0], 8), np.float32)
    image = np.empty((camera.size[1], camera.size[0], 4), np.float32)
    kernel = replay_kernel_for(kernel_for(settings))
    picture = KernelArguments(kernel, world, camera.record(), job, film, image, None)
    asked = [0] * holders
    for piece in pieces_of(camera.size, (0, settings.spp)):
        for samples in passes_of((0, settings.spp)):
            waves = Waves(picture, piece, samples)
            while (question := waves.ask()) is not None:
                meets = route(question.rays, boxes, shares.owners, holders, None)
                for k in reversed(range(holders)):
                    some = np.flatnonzero(meets[:, k])
                    waves.take(some, answer_query(worlds[k], question.of(some)))
                    asked[k] += len(some)
    return image, asked


@pytest.fixture(scope="module")
def parted(tmp_path_factory: pytest.TempPathFactory) -> pr.Model:
    rng = np.random.default_rng(2)
    points = pr.procedural("statue", 60_000)
    colors = rng.integers(0, 256, points.positions.shape).astype(np.uint8)
    attributes = {"height": points.positions[:, 2], "class": rng.integers(0, 5, len(points)).astype(np.uint8)}
    model = pr.Model(pr.Points(points.positions, points.normals, colors, attributes))
    folder = tmp_path_factory.mktemp("parts") / "a.pointray"
    split(model, folder, 16_384)
    return pr.Model.load(folder)


SETTINGS = [
    pr.Settings(levels=False),
    long(pr.Settings(spp=3, sky_rays=2, levels=False)),
    pr.Settings("ao", spp=2, levels=False),
    long(pr.Settings("path", spp=5, levels=False)),
    pr.Settings("path", max_depth=8, levels=False),
    pr.Settings("color", levels=False),
    pr.Settings("normal", levels=False),
    pr.Settings("depth", levels=False),
]


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: f"{settings.integrator}-{settings.spp}")
def test_a_picture_of_forwarded_rays_is_the_same(parted: pr.Model, settings: pr.Settings) -> None:
    scene = scene_of(ball())
    scene.add(parted, pr.transform(translate=(0.6, -1.2, 0), scale=0.8))
    scene.add(parted, pr.transform(translate=(-1, -1, 0), scale=0.5, rotate=70), pr.Phong(pr.Attribute("height")))
    scene.add(pr.Plane((0, 2, 0), (0, -1, 0)), material=pr.Mirror())
    scene.add(ball(), pr.transform(translate=(-1.4, -0.5, 0.3), scale=0.4), pr.Dielectric())
    camera = camera_of()
    image, asked = by_waves(scene, camera, settings, 3)
    assert_alike(image, pr.render(scene, camera, settings))
    assert min(asked) > 1000


@pytest.mark.long
def test_noise_clips_levels_and_lenses_are_the_same(parted: pr.Model) -> None:
    """Checks data of hits, and options that decide where rays start and end."""
    rng = np.random.default_rng(3)
    rows = sphere_points(20_000)
    noisy = pr.Model(pr.Points(rows + rng.normal(0, 0.01, rows.shape), rows))
    assert noisy.tree.noise.size
    noisy.make_levels()
    scene = pr.Scene()
    scene.add(noisy, material=pr.Mirror())
    scene.add(noisy, pr.transform(translate=(60, 40, 0), scale=12), pr.Principled((0.3, 0.5, 0.9)))
    scene.add(parted, pr.transform(translate=(1, -1.6, -0.2)))
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1), checker=0.5))
    scene.clips = [((0, -1.6, 0.9), (0.2, 0.1, 1)), ((0, 0, 0), (-1, -0.4, 0))]
    scene.lights = [pr.SphereLight((2, -3, 3), 0.4, 6), pr.SunLight((1, 1, -2), 0.5), pr.EnvironmentLight(0.2)]
    scene.background = "environment"
    for camera in (
        pr.Camera.look_at((3, -5, 1.5), (0.5, 0, 0), size=(90, 70), aperture=0.1),
        pr.Camera.look_at((0.5, -3, 0.5), (0.5, 0, 0), size=(90, 40), projection="panorama"),
    ):
        for settings in (pr.Settings(spp=2, filter="tent"), pr.Settings("path", spp=2), pr.Settings("ao", spp=65)):
            image, asked = by_waves(scene, camera, settings, 2)
            assert_alike(image, pr.render(scene, camera, settings))
            assert min(asked) > 100


def test_rays_are_sent_only_where_they_may_hit_something() -> None:
    rng = np.random.default_rng(4)
    boxes = rng.uniform(-1, 1, (40, 3))
    boxes = np.concatenate([boxes, boxes + rng.uniform(0, 0.4, (40, 3))], axis=1)
    rays = np.zeros((1000, 8))
    rays[:, :6], rays[:, 6] = rng.uniform(-1.5, 1.5, (1000, 6)), rng.choice([0.3, np.inf], 1000)
    rays[:200, 3 + rng.integers(3)] = 0.0
    owners = rng.integers(0, 3, 40)
    steps = np.linspace(0, 1, 400)[:, None, None]
    places = rays[:, :3] + np.minimum(rays[:, 6:7], 20) * steps * rays[:, 3:6]
    found = route(rays, boxes, owners, 3, 1)
    for k in range(3):
        low, high = boxes[owners == k, :3], boxes[owners == k, 3:]
        inside = [((places >= a) & (places <= b)).all(axis=2).any(axis=0) for a, b in zip(low, high, strict=True)]
        sampled = np.logical_or.reduce(inside)
        assert not (sampled & ~found[:, k]).any()
        assert (found[:, k] & ~sampled).mean() < 0.02  # there are gaps between the sampled positions


def test_models_of_a_lost_holder_are_taken_over_by_others(parted: pr.Model) -> None:
    scene = pr.Scene()
    scene.add(parted)
    scene.add(ball())
    shares = Shares(scene.snapshot(), ["a", "b", "c"])
    held = {name: set(shares.of(name).tolist()) for name in "abc"}
    assert set.union(*held.values()) == set(range(5)) and sum(map(len, held.values())) == 5
    assert not shares.pass_on(["c", "a", "b", "d"]) and not shares.pass_on([])
    assert shares.pass_on(["c", "a"])
    assert set(shares.of("a").tolist()) >= held["a"] and set(shares.of("c").tolist()) >= held["c"]
    assert sorted([*shares.of("a"), *shares.of("c")]) == [0, 1, 2, 3, 4]
    assert shares.pass_on(["d"]) and len(shares.of("d")) == 5


def test_a_worker_without_models_traces_no_rays() -> None:
    """All functions that trace rays have a version for the world, whoever calls them."""
    waiting: list[Any] = [recalled_quick, recalled_sampled]
    reached: dict[Any, str] = {}
    while waiting:
        piece = waiting.pop()
        if piece not in reached:
            reached[piece] = piece.py_func.__name__
            names = piece.py_func.__code__.co_names
            called = [one for name in names if hasattr(one := piece.py_func.__globals__.get(name), "py_func")]
            waiting += [one.versions.get(ReplayWorld, one) for one in called]
    found = set(reached.values())
    assert found >= {"trace_paths", "light_tile", "catch_paths", "see_sky", "_recall_tile", "tile_on_plane"}
    assert not found & {"through_instance", "closest_of_tile", "closest", "describe_tile", "paint_four"}
    assert trace_tile not in reached and occlude_tile not in reached
