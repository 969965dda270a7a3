"""Models in parts spread over Dask workers: each opens only its own parts, and rays are forwarded."""

from __future__ import annotations

import os
import shutil
import signal
import threading
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import dask.array as da
import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.dask_clusters import assert_alike, ball, camera_of, cluster_of, scene_of
from helpers.marks import long
from pointray.cli import execute
from pointray.cluster import worker as worker_module
from pointray.cluster.dispatch import SLOW_AT_HOME, Dispatch, Job
from pointray.model.out_of_core.split import split
from pointray.rendering.ray_forwarding.ray_exchange import traffic

MAIN = threading.main_thread()
PATHS = pr.Settings("path", spp=3, max_depth=3, levels=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    points = pr.procedural("statue", 60_000)
    heights = {"height": points.positions[:, 2], "class": (points.positions[:, 0] > 0).astype(np.uint8)}
    folder = tmp_path_factory.mktemp("parts") / "a.pointray"
    split(pr.Model(pr.Points(points.positions, points.normals, attributes=heights)), folder, 16_384)
    return folder


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    # Otherwise an idle worker would take over chunks of rays and open parts that another one holds.
    with dask.config.set({"distributed.scheduler.work-stealing": False}), cluster_of(2, processes=False) as client:
        yield client


def scene_with(folder: Path) -> pr.Scene:
    scene = scene_of(ball())
    scene.add(pr.Model.load(folder), pr.transform(translate=(0.5, -1.2, 0)), pr.Phong(pr.Attribute("height")))
    return scene


def opened_by_workers(folder: Path) -> list[list[int]]:
    """Return the parts that each worker in this process has opened."""
    found = [
        [k for k, part in enumerate(model.parts) if part.source.is_open]
        for bench in worker_module._CACHES.values()
        for place, model in bench.files.items()
        if place.path == str(folder)
    ]
    return sorted(found)


@pytest.mark.parametrize(
    "settings",
    [pr.Settings(spp=2, levels=False), pr.Settings("ao", spp=2, levels=False), PATHS],
    ids=lambda s: s.integrator,
)
def test_pictures_are_the_same(client: Any, folder: Path, settings: pr.Settings) -> None:
    scene, camera, before, shares = scene_with(folder), camera_of(100, 60), traffic(), []
    image = pr.render(scene, camera, settings, lambda _, share: shares.append(share), client=client, spread=True)
    wanted = pr.render(scene_with(folder), camera, settings)
    assert_alike(image, wanted)
    assert opened_by_workers(folder) == [[0, 1], [2, 3]]
    assert not any(part.source.is_open for model in scene.models for part in model.parts)
    gone = traffic().since(before)
    assert gone.asked > camera.size[0] * camera.size[1] and 0 < gone.rays < 2 * gone.asked
    assert gone.sent == 65 * gone.rays and 0 < gone.received < gone.sent
    assert shares == sorted(shares) and shares[-1] == 1.0


@pytest.mark.long
def test_parts_of_scattered_points(client: Any, tmp_path: Path, rng: np.random.Generator) -> None:
    """One worker holds a surface, the other one spheres."""
    points = pr.procedural("statue", 16_384)
    low, high = points.bounds
    positions = np.concatenate([points.world, rng.uniform(low, high, (12_000, 3))])
    both = pr.Points(positions, attributes={"height": positions[:, 2]})
    split(pr.Model(both, scatter="spheres", _scattered=np.arange(28_384) >= 16_384), tmp_path / "a", 16_384)
    camera = camera_of(100, 60)
    image = pr.render(scene_with(tmp_path / "a"), camera, PATHS, client=client, spread=True)
    assert_alike(image, pr.render(scene_with(tmp_path / "a"), camera, PATHS))
    assert opened_by_workers(tmp_path / "a") == [[0], [1]]


@pytest.mark.long
@pytest.mark.parametrize("settings", [pr.Settings("path", noise=0.3, spp=64, max_depth=2), long(pr.Settings(spp=70))])
def test_passes_are_the_same(client: Any, folder: Path, settings: pr.Settings) -> None:
    scene, camera = scene_with(folder), camera_of(32, 24)
    image = pr.render(scene, camera, settings, client=client, spread=True)
    assert_alike(image, pr.render(scene, camera, settings))


def test_films_are_the_same(client: Any, folder: Path) -> None:
    scene = scene_with(folder)
    cameras = [camera_of(32, 24, turn) for turn in (0.0, 0.5)]
    for camera, image in zip(cameras, pr.animate(scene, cameras, client=client, spread=True), strict=True):
        assert_alike(image, pr.render(scene, camera))


def test_rays_in_dask_arrays_hit_the_same(client: Any, folder: Path) -> None:
    scene = scene_with(folder)
    origins, directions = camera_of(30, 24).rays()
    names = ["height", "class"]
    wanted, shaded = scene.intersect(origins, directions, attributes=names), scene.occluded(origins, directions, 0, 4.5)
    chunked = da.from_array(origins, chunks=(12, 30, 3)), da.from_array(directions, chunks=(12, 30, 3))
    with client.as_current():
        found = scene.intersect(*chunked, attributes=names, spread=True)
        dark = scene.occluded(*chunked, 0, 4.5, spread=True)
        for name in ("t", "position", "normal", "color", "point", "instance"):
            np.testing.assert_array_equal(getattr(found, name).compute(), getattr(wanted, name))
        for name in names:
            np.testing.assert_array_equal(found.attributes[name].compute(), wanted.attributes[name])
        np.testing.assert_array_equal(dark.compute(), shaded)
    assert (wanted.instance == 3).sum() > 20
    assert opened_by_workers(folder) == [[0, 1], [2, 3]]


def test_models_that_cannot_be_spread_are_reported(
    client: Any, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, camera, rays = scene_with(folder), camera_of(16, 16), da.zeros((4, 3))
    with pytest.raises(ValueError, match="spread needs a Dask client"):
        pr.render(scene, camera, spread=True)
    with pytest.raises(ValueError, match="spread: the integrator 'cost' needs all models"):
        pr.render(scene, camera, pr.Settings("cost"), client=client, spread=True)
    with pytest.raises(ValueError, match="spread must be True or False"):
        pr.render(scene, camera, client=client, spread="yes")
    with pytest.raises(ValueError, match="spread: requires rays in Dask arrays"):
        scene.intersect((0, 0, 0), (0, 0, 1), spread=True)
    with monkeypatch.context() as alone, pytest.raises(ValueError, match="spread: no Dask client found"):
        alone.setattr(
            "pointray.cluster.serialized_scene.current_client", lambda: None
        )  # workers in this process leave theirs
        scene.occluded(rays, (0, 0, 1), spread=True)
    other = tmp_path / "b.pointray"
    split(pr.Model(pr.procedural("statue", 20_000)), other, 16_384)
    scene.add(pr.Model.load(other))
    os.utime(other / "index.json", (1, 1))
    with pytest.raises(ValueError, match="spread: the folder of a model in parts is missing or has changed"):
        pr.render(scene, camera, client=client, spread=True)
    with client.as_current(), pytest.raises(ValueError, match="spread: the folder"):
        scene.intersect(rays, (0, 0, 1), spread=True)


def test_models_larger_than_a_worker_are_spread(client: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, camera, before = scene_with(folder), camera_of(32, 24), traffic()
    pr.render(scene, camera, client=client)
    assert traffic() == before
    monkeypatch.setattr("pointray.cluster.client.available_memory", lambda: 1000)
    image = pr.render(scene, camera, client=client)
    assert traffic().since(before).waves > 0
    assert_alike(image, pr.render(scene, camera))


def test_an_error_in_progress_ends_the_work(client: Any, folder: Path) -> None:
    def stop(stage: str, share: float) -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        pr.render(scene_with(folder), camera_of(), PATHS, stop, client=client, spread=True)


@pytest.mark.long
def test_a_picture_is_the_same_when_a_worker_is_killed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its parts are taken over by the others."""
    monkeypatch.setattr("pointray.rendering.ray_forwarding.wave.RAYS", 1 << 13)
    scene, camera, killed = scene_with(folder), camera_of(), []
    with cluster_of(3, processes=True) as client:

        def kill(stage: str, share: float) -> None:
            if share > 0.2 and not killed:
                killed.append(share)
                os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)

        image = pr.render(scene, camera, PATHS, kill, client=client, spread=True)
    assert killed
    assert_alike(image, pr.render(scene, camera, PATHS))


@pytest.mark.long
def test_the_command_line_spreads(folder: Path, tmp_path: Path) -> None:
    picture, other = tmp_path / "a.png", tmp_path / "b.png"
    options = ["--size", "80x60", "--integrator", "ao", "--spp", "2"]
    assert execute(["render", str(folder), "-o", str(picture), *options, "--workers", "2", "--spread"]) == 0
    assert execute(["render", str(folder), "-o", str(other), *options]) == 0
    one, two = (np.asarray(Image.open(path)).astype(int) for path in (picture, other))
    assert np.abs(one - two).max() <= 1
    assert execute(["render", str(folder), "-o", str(picture), *options, "--spread"]) == 2


class WorkerBackend:
    """Workers whose jobs end when the test decides."""

    def __init__(self, *workers: str) -> None:
        self.workers = dict.fromkeys(workers, 1)
        self.given: list[tuple[str, str]] = []

    def submit(self, job: Job, worker: str) -> Any:
        self.given.append((job.name, worker))
        return Future()

    def fetch(self, future: Any) -> Any:
        raise NotImplementedError

    def mark_unseen(self, place: Any) -> None:
        raise AssertionError


class Future:
    """A future that is never done."""

    status = "pending"

    def add_done_callback(self, function: Any) -> None:
        pass

    def release(self) -> None:
        pass


def test_a_job_runs_at_its_home_worker_as_long_as_it_exists() -> None:
    hands = WorkerBackend("a", "b")
    jobs = deque(Job(name, print, (), home=home) for name, home in (("1", "a"), ("2", "a"), ("3", "a"), ("4", "b")))
    work = Dispatch(hands, jobs)
    work.assign_jobs()
    assert hands.given == [("1", "a"), ("4", "b"), ("2", "a")]  # b waits: it has no other jobs of its own
    work.assign_jobs()
    assert len(hands.given) == 3
    del hands.workers["a"]
    work.drop_lost()
    work.assign_jobs()
    assert hands.given[3:] == [("1", "b")]  # it has two
    hands.workers["c"] = 1
    work.assign_jobs()
    assert hands.given[4:] == [("2", "c"), ("3", "c")]


def test_very_slow_jobs_are_repeated_on_other_workers() -> None:
    hands = WorkerBackend("a", "b")
    work = Dispatch(hands, deque([Job("1", print, (), home="a"), Job("2", print, (), home="a")]))
    work.assign_jobs()
    work._times.append(0.1)
    work.assignments[0].begun -= SLOW_AT_HOME / 2
    work.assign_jobs()
    assert hands.given == [("1", "a"), ("2", "a")]
    work.assignments[0].begun -= SLOW_AT_HOME
    work.assign_jobs()
    assert hands.given == [("1", "a"), ("2", "a"), ("1", "b")]


def test_a_folder_that_a_worker_does_not_see_is_reported(
    client: Any, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = scene_with(Path(shutil.copytree(folder, tmp_path / "b.pointray")))
    monkeypatch.setattr(
        "pointray.model.model_file.Place.is_there", property(lambda self: threading.current_thread() is MAIN)
    )
    with pytest.raises(ValueError, match=r"a worker does not see .*b\.pointray"):
        pr.render(scene, camera_of(16, 16), client=client, spread=True)
    with client.as_current(), pytest.raises(ValueError, match=r"spread: a worker does not see .*b\.pointray"):
        scene.intersect(da.zeros((4, 3)), (0, 0, 1), spread=True)
