"""Light baked on workers equals light baked in this process, to the last bit."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import numpy as np
import pytest

import pointray as pr
from helpers.dask_clusters import ball, camera_of, cluster_of, scene_of
from helpers.marks import long
from pointray.baking import tile_ranges as stretches
from pointray.baking.gather import ONE_TILE
from pointray.cli import execute
from pointray.cluster import worker
from pointray.cluster.client import UNPROFILED
from pointray.cluster.worker_pool import WorkerPool

FEW = pr.BakeSettings(links=8, patches=512, noise=0.05, seed=3)


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with cluster_of(2, processes=False) as client:
        yield client


@pytest.fixture(autouse=True)
def _many_ranges(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stretches, "FEWEST_TILES", 1)


def matt() -> pr.Scene:
    """Return two balls over a plane, one coloured by an attribute, with a lamp, a sky and a camera light."""
    scene = scene_of(ball())
    scene.add_light(pr.SphereLight((2, -2, 2), 0.3, 8.0))
    return scene


def shiny() -> pr.Scene:
    """Return a mirror, coloured glass, a light that their rays can hit, and clip planes."""
    scene, model = pr.Scene(), ball(2000)
    scene.add(model, material=pr.Mirror())
    scene.add(model, pr.transform(translate=(2, 0, 0)), pr.Dielectric())
    scene.add(model, pr.transform(translate=(0, 2, 0)), pr.Emissive(2.0))
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1)))
    scene.add_light(pr.RectLight((0, 0, 4), (1, 0, 0), (0, -1, 0), 3.0))
    scene.add_light(pr.EnvironmentLight(image=sky_with_a_sun()))
    scene.clips = [((0, 0, 0.6), (0, 0, 1))]
    return scene


def sky_with_a_sun() -> Any:
    sky = np.full((32, 64, 3), 0.2, np.float32)
    sky[6, 9] = 3000.0
    return sky


def assert_same(found: pr.Baked, wanted: pr.Baked) -> None:
    """Check all data that pictures read, and all public results."""
    kept, other = found._kept, wanted._kept
    assert kept.records.keys() == other.records.keys() and kept.unit == other.unit
    for key, records in other.records.items():
        np.testing.assert_array_equal(kept.records[key], records)
    a, b = found._exchange.transport, wanted._exchange.transport
    assert len(a.links) == len(b.links)
    for mine, theirs in zip(a.links, b.links, strict=True):
        for name in ("links", "tints", "rows"):
            np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))
    np.testing.assert_array_equal(a.nearness, b.nearness)
    for name in ("direct", "indirect", "facts"):
        np.testing.assert_array_equal(getattr(found._exchange.arrived, name), getattr(wanted._exchange.arrived, name))


@pytest.mark.parametrize("make", [matt, long(shiny)])
def test_light_is_the_same(client: Any, make: Any) -> None:
    scene, told = make(), list[float]()
    found, wanted = pr.bake(scene, FEW, lambda _, share: told.append(share), client), pr.bake(scene, FEW)
    assert_same(found, wanted)
    transport = wanted._exchange.transport
    assert len(transport.links) > 1  # there was noise
    assert (transport.links[0].tints.size > 0) == (make is shiny)
    assert told == sorted(told) and told[-1] == 1.0 and len(told) > 3
    assert found.stale is None


@pytest.mark.long
def test_light_baked_on_workers_is_updated_here(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = matt()
    found, wanted = pr.bake(scene, FEW, client=client), pr.bake(scene, FEW)
    scene.lights = [*scene.lights[:-1], pr.SphereLight((2, -2, 2), 0.3, 9.0)]
    monkeypatch.setattr(WorkerPool, "submit", None)
    found.update()
    wanted.update()
    assert_same(found, wanted)


@pytest.mark.long
def test_earlier_light_is_not_sent(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = matt()
    scene.baked = pr.bake(scene, pr.BakeSettings(links=4, patches=64))
    sent: list[str] = []
    scatter = client.scatter
    monkeypatch.setattr(client, "scatter", lambda data, **rest: sent.extend(data) or scatter(data, **rest))
    pr.bake(scene, FEW, client=client)
    assert not any(name.startswith("baked light") for name in sent)
    assert sum(name.startswith("patches of a bake") for name in sent) == 2  # the few, and all
    assert scene.baked is not None


def test_ranges_cover_all_tiles_and_are_small_enough_to_be_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    transport = pr.bake(matt(), FEW)._exchange.transport
    rows = np.arange(0, len(transport), 3, dtype=np.int32)
    patches = transport.patches(rows)
    whole = patches.tiles.reshape(-1, ONE_TILE)
    empty = np.zeros(0, np.int32)
    found = stretches.Found(np.zeros(8 * len(rows), np.int32), empty, np.zeros(len(rows), np.float32), empty)
    for workers, most in (({"a": 1}, 1 << 30), ({"a": 2, "b": 3}, 1 << 30), ({"a": 64}, 3000), ({}, 1)):
        monkeypatch.setattr(stretches, "MOST_BYTES", most)
        cut = stretches.cut(patches, None, found, workers)  # type: ignore[arg-type]
        np.testing.assert_array_equal(np.concatenate([one.tiles for one in cut]).reshape(-1, ONE_TILE), whole)
        np.testing.assert_array_equal(np.concatenate([one.rows for one in cut]), rows)
        assert [one.begin for one in cut] == np.cumsum([0, *(len(one.rows) for one in cut[:-1])]).tolist()
        assert all(one.spans[1] == slice(0, 0) for one in cut)
        assert most > 1 << 20 or len(cut) > 2
    assert len(cut) == len(whole)


@pytest.mark.long
def test_an_error_in_progress_ends_the_bake(client: Any) -> None:
    def stop(stage: str, share: float) -> None:
        if share > 0.15:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        pr.bake(matt(), pr.BakeSettings(links=1024, patches=2048), stop, client)
    end = time.monotonic() + 300  # it only bounds a hang
    while any(client.processing().values()) or any(bench.lock.locked() for bench in worker._CACHES.values()):
        assert time.monotonic() < end
        time.sleep(0.02)


def test_clients_that_cannot_bake_are_refused() -> None:
    with pytest.raises(ValueError, match="client must be a dask"):
        pr.bake(matt(), FEW, client="tcp://a:1")


SCENE = """
[models.ball]
procedural = "sphere"
points = 1500
[[instances]]
model = "ball"
[[lights]]
kind = "sun"
direction = [1, 1, -1]
"""


@pytest.mark.long
def test_the_command_bakes_the_same_on_a_cluster(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from distributed import LocalCluster

    (tmp_path / "scene.toml").write_text(SCENE)
    model = ball(2000)
    pr.write(tmp_path / "scan.ply", model.points)
    options: dict[str, Any] = {"processes": False, "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}
    with (
        dask.config.set(UNPROFILED),
        LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=0, **options) as cluster,
    ):
        for subject in ("scan.ply", "scene.toml"):
            for name, where in (("here", []), ("there", ["--cluster", cluster.scheduler_address])):
                command = ["bake", str(tmp_path / subject), "-o", str(tmp_path / f"{name}.bake"), "--links", "8"]
                assert execute([*command, "--patches", "256", *where]) == 0
            assert (tmp_path / "here.bake").read_bytes() == (tmp_path / "there.bake").read_bytes()
    capsys.readouterr()
    command = ["bake", str(tmp_path / "scan.ply"), "-o", str(tmp_path / "x.ply")]
    assert execute([*command, "--cluster", "tcp://127.0.0.1:1", "--workers", "2"]) == 2
    assert capsys.readouterr().err == "pointray: --cluster and --workers exclude each other\n"
    assert not (tmp_path / "x.ply").exists()


@pytest.mark.long
def test_other_processes_bake_the_same_and_may_be_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    import os
    import signal

    monkeypatch.undo()
    many = pr.BakeSettings(links=32, patches=8192, seed=3)
    killed: list[float] = []
    with cluster_of(2, processes=True) as client:

        def kill(stage: str, share: float) -> None:
            if share > 0.3 and not killed:
                killed.append(share)
                os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)

        for make, progress in ((matt, None), (shiny, None), (matt, kill)):
            scene = make()
            assert_same(pr.bake(scene, many, progress, client), pr.bake(scene, many))
        image = pr.render(matt(), camera_of(), client=client)
        np.testing.assert_array_equal(image, pr.render(matt(), camera_of()))
    assert killed
