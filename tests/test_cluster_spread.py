"""Models in parts that are spread over Dask's workers: each opens its own parts only, and rays travel."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask.array as da
import numpy as np
import pytest
from PIL import Image

import pointray as pr
from clusters import ball, camera_of, cluster_of, scene_of
from pointray.cli import execute
from pointray.cluster import worker as worker_module
from pointray.parts.split import split
from pointray.rendering.waves.travel import traffic

PATHS = pr.Settings("path", spp=3, max_depth=3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    points = pr.procedural("statue", 60_000)
    heights = {"height": points.positions[:, 2], "class": (points.positions[:, 0] > 0).astype(np.uint8)}
    folder = tmp_path_factory.mktemp("parts") / "a.pointray"
    split(pr.Model(pr.Points(points.positions, points.normals, attributes=heights)), folder, 8_192)
    return folder


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with cluster_of(2, processes=False) as client:
        yield client


def scene_with(folder: Path) -> pr.Scene:
    scene = scene_of(ball())
    scene.add(pr.Model.load(folder), pr.transform(translate=(0.5, -1.2, 0)), pr.Phong(pr.Attribute("height")))
    return scene


def opened_by_workers() -> list[set[int]]:
    """The parts that each worker has opened."""
    models = [model for bench in worker_module._BENCHES.values() for model in bench.files.values()]
    return [{k for k, part in enumerate(model.parts) if part.source.is_open} for model in models if model.parts]


@pytest.mark.parametrize("settings", [pr.Settings(spp=2), pr.Settings("ao", spp=2), PATHS], ids=lambda s: s.integrator)
def test_pictures_are_the_same(client: Any, folder: Path, settings: pr.Settings) -> None:
    scene, camera, before, shares = scene_with(folder), camera_of(), traffic(), []
    image = pr.render(scene, camera, settings, shares.append, client=client, spread=True)
    wanted = pr.render(scene_with(folder), camera, settings)
    np.testing.assert_array_equal(image, wanted)
    opened = opened_by_workers()
    assert len(opened) == 2 and all(len(parts) >= 3 for parts in opened)
    assert not set.intersection(*opened) and set.union(*opened) == set(range(8))
    assert not any(part.source.is_open for model in scene.models for part in model.parts)
    gone = traffic().since(before)
    assert gone.asked > camera.size[0] * camera.size[1] and 0 < gone.rays < 2 * gone.asked
    assert gone.sent == 64 * gone.rays and 0 < gone.received < gone.sent
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_passes_and_films_are_the_same(client: Any, folder: Path) -> None:
    scene, camera = scene_with(folder), camera_of(64, 48)
    for settings in (pr.Settings("path", noise=0.3, spp=64), pr.Settings(spp=70)):
        image = pr.render(scene, camera, settings, client=client, spread=True)
        np.testing.assert_array_equal(image, pr.render(scene, camera, settings))
    cameras = [camera_of(64, 48, turn) for turn in (0.0, 0.5)]
    for camera, image in zip(cameras, pr.animate(scene, cameras, client=client, spread=True), strict=True):
        np.testing.assert_array_equal(image, pr.render(scene, camera))


def test_rays_in_arrays_meet_the_same(client: Any, folder: Path) -> None:
    scene = scene_with(folder)
    origins, directions = camera_of(60, 50).rays()
    names = ["height", "class"]
    wanted, shaded = scene.intersect(origins, directions, attributes=names), scene.occluded(origins, directions, 0, 4.5)
    chunked = da.from_array(origins, chunks=(20, 60, 3)), da.from_array(directions, chunks=(20, 60, 3))
    with client.as_current():
        found = scene.intersect(*chunked, attributes=names, spread=True)
        dark = scene.occluded(*chunked, 0, 4.5, spread=True)
        for name in ("t", "position", "normal", "color", "point", "instance"):
            np.testing.assert_array_equal(getattr(found, name).compute(), getattr(wanted, name))
        for name in names:
            np.testing.assert_array_equal(found.attributes[name].compute(), wanted.attributes[name])
        np.testing.assert_array_equal(dark.compute(), shaded)
    assert (wanted.instance == 3).sum() > 100
    opened = opened_by_workers()
    assert len(opened) == 2 and not set.intersection(*opened)


def test_what_cannot_be_spread_is_told(client: Any, folder: Path, tmp_path: Path) -> None:
    scene, camera, rays = scene_with(folder), camera_of(16, 16), da.zeros((4, 3))
    with pytest.raises(ValueError, match="spread: it takes a client of Dask"):
        pr.render(scene, camera, spread=True)
    with pytest.raises(ValueError, match="spread: the integrator 'cost' needs all models"):
        pr.render(scene, camera, pr.Settings("cost"), client=client, spread=True)
    with pytest.raises(ValueError, match="spread must be True or False"):
        pr.render(scene, camera, client=client, spread="yes")
    with pytest.raises(ValueError, match="spread: it takes rays in arrays of Dask"):
        scene.intersect((0, 0, 0), (0, 0, 1), spread=True)
    with pytest.raises(ValueError, match="spread: there is no client"):
        scene.occluded(rays, (0, 0, 1), spread=True)
    other = tmp_path / "b.pointray"
    split(pr.Model(pr.procedural("statue", 20_000)), other, 16_384)
    scene.add(pr.Model.load(other))
    os.utime(other / "index.json", (1, 1))
    with pytest.raises(ValueError, match="spread: the folder of a model in parts is gone, or has changed"):
        pr.render(scene, camera, client=client, spread=True)
    with client.as_current(), pytest.raises(ValueError, match="spread: the folder"):
        scene.intersect(rays, (0, 0, 1), spread=True)


def test_what_no_worker_could_hold_is_spread(client: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, camera, before = scene_with(folder), camera_of(64, 48), traffic()
    pr.render(scene, camera, client=client)
    assert traffic() == before
    monkeypatch.setattr("pointray.cluster.client.available_memory", lambda: 1000)
    image = pr.render(scene, camera, client=client)
    assert traffic().since(before).waves > 0
    np.testing.assert_array_equal(image, pr.render(scene, camera))


def test_an_error_in_progress_ends_the_work(client: Any, folder: Path) -> None:
    def stop(share: float) -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        pr.render(scene_with(folder), camera_of(), PATHS, stop, client=client, spread=True)


@pytest.mark.slow
def test_a_picture_is_the_same_when_a_worker_is_killed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its parts go to the others."""
    monkeypatch.setattr("pointray.rendering.waves.wave.RAYS", 1 << 13)
    scene, camera, killed = scene_with(folder), camera_of(), []
    with cluster_of(3, processes=True) as client:

        def kill(share: float) -> None:
            if share > 0.2 and not killed:
                killed.append(share)
                os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)

        image = pr.render(scene, camera, PATHS, kill, client=client, spread=True)
    assert killed
    np.testing.assert_array_equal(image, pr.render(scene, camera, PATHS))


@pytest.mark.slow
def test_the_command_line_spreads(folder: Path, tmp_path: Path) -> None:
    picture, other = tmp_path / "a.png", tmp_path / "b.png"
    options = ["--size", "80x60", "--integrator", "ao", "--spp", "2"]
    assert execute(["render", str(folder), "-o", str(picture), *options, "--workers", "2", "--spread"]) == 0
    assert execute(["render", str(folder), "-o", str(other), *options]) == 0
    np.testing.assert_array_equal(np.asarray(Image.open(picture)), np.asarray(Image.open(other)))
    assert execute(["render", str(folder), "-o", str(picture), *options, "--spread"]) == 2
