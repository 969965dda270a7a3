"""Pictures and films on Dask equal those without it to the last bit, and data is sent only once."""

import copy
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pointray as pr
from helpers.dask_clusters import ball, camera_of, cluster_of, scene_of
from helpers.marks import long
from pointray.cluster import dispatch, worker
from pointray.cluster.client import check_client, is_fit, unfit
from pointray.cluster.dispatch import Job
from pointray.cluster.scattered_objects import scattered_objects_of
from pointray.cluster.worker_pool import WorkerPool
from pointray.model.model import PrebuiltModel
from pointray.model.out_of_core.split import split
from pointray.rendering import sequence
from pointray.rendering.pieces import MOST_PIXELS, cut, in_order, pieces_for
from pointray.rendering.sequence import render_each

MODEL = ball()
PATH = {"integrator": "path", "max_depth": 2}


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with cluster_of(2, processes=False) as client:
        yield client


def keys_of(client: Any) -> set[str]:
    """Return the keys of data that Dask keeps on workers."""
    return {str(key).rpartition("-")[0] for key in client.who_has()}


def bakeable_scene(model: pr.Model) -> pr.Scene:
    """Return a scene whose lights can be baked: none follows the camera."""
    scene = scene_of(model)
    scene.lights = [light for light in scene.lights if not getattr(light, "camera", False)]
    return scene


def wait_until(true: Any) -> None:
    """Wait until a condition holds; the limit only bounds a hang."""
    end = time.monotonic() + 300
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize(
    "settings",
    [
        pr.Settings(),
        pr.Settings("phong", spp=3, filter="tent", sky_rays=2),
        pr.Settings("normal"),
        pr.Settings(**PATH, spp=3),
        long(pr.Settings(**PATH, spp=66)),
        pr.Settings(**PATH, spp=40, noise=0.05),
        pr.Settings("ao", spp=2, denoise=True),
    ],
    ids=lambda s: f"{s.integrator} {s.spp} {s.noise} {s.denoise}",
)
def test_a_picture_is_the_same(client: Any, settings: pr.Settings) -> None:
    scene, camera = scene_of(MODEL), camera_of(80, 48)
    told: list[float] = []
    image = pr.render(scene, camera, settings, lambda _, share: told.append(share), client=client)
    np.testing.assert_array_equal(image, pr.render(scene, camera, settings))
    assert told == sorted(told) or settings.denoise
    assert told[-1] == 1.0
    wait_until(lambda: not any(client.processing().values()))


def test_pictures_with_baked_light_and_levels_of_detail_are_the_same(client: Any) -> None:
    model = ball(10_000)
    model.make_levels()
    scene, camera = bakeable_scene(model), camera_of(90, 60)
    scene.baked = pr.bake(scene, pr.BakeSettings(links=8, patches=256))
    settings = pr.Settings("baked")
    image = pr.render(scene, camera, settings, client=client)
    np.testing.assert_array_equal(image, pr.render(scene, camera, settings))
    assert "baked light" in keys_of(client)
    scene.baked.update()  # changed light is sent again
    np.testing.assert_array_equal(pr.render(scene, camera, settings, client=client), image)


def test_stale_light_warns_here(client: Any) -> None:
    scene = bakeable_scene(MODEL)
    scene.baked = pr.bake(scene, pr.BakeSettings(links=4, patches=64))
    scene.add_light(pr.PointLight((0, 0, 5), 1))
    with pytest.warns(pr.StaleLightWarning, match="call update"):
        pr.render(scene, camera_of(40, 30), pr.Settings("baked"), client=client)


def test_layers_are_the_same(client: Any) -> None:
    scene, camera = scene_of(MODEL), camera_of(60, 40)
    here, there = (pr.render_layers(scene, camera, client=each) for each in (None, client))
    for name in here:
        np.testing.assert_array_equal(here[name], there[name])


def test_a_time_limit_ends_a_picture(client: Any) -> None:
    image = pr.render(scene_of(MODEL), camera_of(60, 40), pr.Settings(**PATH, time_limit=0.1), client=client)
    assert np.isfinite(image).all()


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 16), (200, 120), (33, 900), (900, 33)])
@pytest.mark.parametrize("wanted", [1, 3, 16, 200])
def test_pieces_cover_a_picture(size: tuple[int, int], wanted: int) -> None:
    pieces = cut(size, wanted)
    seen = np.zeros((size[1], size[0]), int)
    across = -(-size[0] // 16)
    blocks = []
    for piece in pieces:
        piece.of(seen)[:] += 1
        mine = range(piece.block, piece.block + piece.blocks)
        blocks += mine
        rows, columns = [16 * (k // across) for k in mine], [16 * (k % across) for k in mine]
        assert (min(rows), min(columns)) == (piece.rows[0], piece.columns[0])
        assert max(rows) < piece.rows[1] <= max(rows) + 16 and max(columns) < piece.columns[1] <= max(columns) + 16
    assert (seen == 1).all()
    assert sorted(blocks) == list(range(across * -(-size[1] // 16)))
    assert len(pieces) <= 2 * wanted


def test_pieces_of_large_pictures_are_small_enough_to_be_sent() -> None:
    pieces = pieces_for((8000, 4000), {"a": 64})
    assert max(np.diff(piece.rows)[0] * np.diff(piece.columns)[0] for piece in pieces) <= 2 * MOST_PIXELS


@pytest.mark.parametrize(
    ("settings", "count"), [(pr.Settings(spp=2), 12), (pr.Settings("ao", spp=2, denoise=True), 4)], ids=["", "denoise"]
)
def test_a_films_pictures_are_the_same_and_come_in_order(client: Any, settings: pr.Settings, count: int) -> None:
    scene, cameras = scene_of(MODEL), [camera_of(48, 32, turn) for turn in np.linspace(0, 6, count)]
    told: list[float] = []
    images = list(render_each(scene, cameras, settings, client, told.append))
    assert len(images) == count and 0 <= told[0] <= told[-1] <= 1
    for camera, image in zip(cameras, images, strict=True):
        np.testing.assert_array_equal(image, pr.render(scene, camera, settings))


FIRST_MAY_END = threading.Event()


def wait_for_the_first(scene: Any, camera: pr.Camera, settings: pr.Settings, threads: int, check: Any) -> int:
    """Delay the first picture until released; return the others at once."""
    while camera.size[0] == 1 and not FIRST_MAY_END.wait(0.02):
        check()
    return camera.size[0]


def test_few_pictures_are_started_before_the_first_is_done(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[str] = []
    submit = WorkerPool.submit
    monkeypatch.setattr(WorkerPool, "submit", lambda self, job, at: begun.append(job.name) or submit(self, job, at))
    monkeypatch.setattr(sequence, "render_whole", wait_for_the_first)
    cameras = [camera_of(k + 1, 1) for k in range(40)]
    images = sequence.render_each(scene_of(MODEL), cameras, pr.Settings(), client, lambda share: None)
    first = {f"frame {k}" for k in range(2 * sequence.AHEAD)}

    def end_the_first() -> None:
        try:
            wait_until(lambda: first <= set(begun))
            time.sleep(0.2)  # others, which must not begin, could do so now
        finally:
            FIRST_MAY_END.set()

    threading.Thread(target=end_the_first).start()
    assert next(images) == 1
    assert set(begun) == first
    assert list(images) == list(range(2, 41))


def test_results_are_put_in_order() -> None:
    assert list(in_order(iter([(2, "c"), (0, "a"), (1, "b"), (3, "d")]))) == ["a", "b", "c", "d"]


def test_tasks_have_descriptive_names(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    names: list[str] = []
    submit = client.submit
    monkeypatch.setattr(
        client, "submit", lambda *args, key, **rest: names.append(key) or submit(*args, key=key, **rest)
    )
    pr.render(scene_of(MODEL), camera_of(), client=client)
    assert all(name.startswith("render ") for name in names)
    assert {name.split("-")[0] for name in names} == {f"render {k}/16" for k in range(1, 17)}


def test_a_model_is_sent_once_and_kept_while_it_lives(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[str] = []
    scatter = client.scatter
    monkeypatch.setattr(client, "scatter", lambda data, **rest: sent.extend(data) or scatter(data, **rest))
    model = ball(1000)
    scene = scene_of(model)
    for k in range(3):
        scene.update(0, pr.transform(translate=(0, 0, 0.1 * k)))
        image = pr.render(scene, camera_of(60, 40), client=client)
        np.testing.assert_array_equal(image, pr.render(scene, camera_of(60, 40)))
    assert sum(name.startswith("model of 1000 points") for name in sent) == 1
    assert "model of 1000 points" in keys_of(client)
    del scene, model
    wait_until(lambda: "model of 1000 points" not in keys_of(client))


def test_the_data_sent_for_a_scene_is_small(client: Any) -> None:
    pool = WorkerPool(client, scene_of(ball(20_000)))
    assert len(pool._recipe.value) < 20_000


@pytest.mark.long
def test_levels_made_later_are_sent(client: Any) -> None:
    model = ball(20_000)
    scene, camera = scene_of(model), camera_of(40, 30)
    before = pr.render(scene, camera, client=client)
    model.make_levels()
    after = pr.render(scene, camera, client=client)
    np.testing.assert_array_equal(after, pr.render(scene, camera))
    assert (before != after).any()


def test_a_saved_model_is_sent_as_its_path(client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = ball(1500)
    made.save(tmp_path / "ball.pointray")
    camera = camera_of(60, 40)
    for model in (made, pr.Model.load(tmp_path / "ball.pointray")):
        image = pr.render(scene_of(model), camera, client=client)
        assert "model of 1500 points" not in keys_of(client)
        np.testing.assert_array_equal(image, pr.render(scene_of(model), camera))

    def unseen(place: Any) -> Any:
        raise worker.UnseenFileError(place)

    other = ball(1600)
    other.save(tmp_path / "other.pointray")
    monkeypatch.setattr(worker, "_load", unseen)
    image = pr.render(scene_of(other), camera, client=client)
    assert "model of 1600 points" in keys_of(client)
    np.testing.assert_array_equal(image, pr.render(scene_of(other), camera))


def test_a_model_in_parts_is_sent_as_its_folder_or_as_data(client: Any, tmp_path: Path) -> None:
    folder = tmp_path / "parts.pointray"
    split(ball(9_000), folder, 4_500)
    model = pr.Model.load(folder)
    scene, camera = scene_of(model), camera_of(60, 40)
    assert model.place is not None and model.place.path == str(folder)
    image = pr.render(scene, camera)
    np.testing.assert_array_equal(pr.render(scene, camera, client=client), image)
    assert "model of 9000 points" not in keys_of(client)
    (folder / "index.json").rename(folder / "moved.json")
    assert model.place is None
    np.testing.assert_array_equal(pr.render(scene, camera, client=client), image)
    assert "model of 9000 points" in keys_of(client)


def test_a_file_is_used_only_while_it_contains_the_model(tmp_path: Path) -> None:
    path = tmp_path / "ball.pointray"
    model = ball(10_000)
    assert model.place is None
    model.make_levels()
    model.save(path)
    assert model.place is not None and model.place.leveled and model.place.path == str(path)
    assert copy.copy(model).place == model.place
    bare = pr.Model.load(path)
    bare.levels = ()
    assert bare.place is not None and not bare.place.leveled
    assert worker._load(bare.place).levels == ()
    assert len(worker._load(model.place).levels) == len(model.levels) > 0
    bare.make_levels()
    assert bare.place is None
    ball(500).save(path)
    assert model.place is None
    with pytest.raises(worker.UnseenFileError):
        worker._load(pr.Model.load(path).place.__class__(str(path), 1, 1))  # type: ignore[union-attr]


def test_unaligned_arrays_are_copied() -> None:
    model = ball(500)
    tree = model.tree
    odd = np.frombuffer(b"a" + tree.boxes.tobytes(), np.uint8)[1:].view(np.float32)
    assert not odd.flags.aligned
    model = PrebuiltModel(model.data._replace(tree=tree._replace(boxes=odd)))
    worker._aligned(model)
    assert all(array.flags.aligned and array.flags.writeable for array in model.tree)
    np.testing.assert_array_equal(model.tree.boxes, tree.boxes)


def stall(scene: Any, slow: str, threads: int, check: Any) -> str:
    """Run on one worker until cancelled."""
    import distributed

    while distributed.get_worker().address == slow:
        time.sleep(0.02)
        check()
    return distributed.get_worker().address


def test_jobs_of_a_slow_worker_are_repeated_elsewhere(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dispatch, "LEAST_SLOW", 0.2)
    pool = WorkerPool(client, scene_of(MODEL))
    slow = next(iter(pool.workers))
    done = [where for _, where in pool.run(deque(Job(f"job {k}", stall, (slow,)) for k in range(6)), lambda: None)]
    assert len(done) == 6 and slow not in done
    wait_until(lambda: not any(bench.lock.locked() for bench in worker._CACHES.values()))  # the slow one has stopped


def fail(scene: Any, text: str, threads: int, check: Any) -> None:
    raise ValueError(text)


def test_an_error_of_a_job_is_raised_here(client: Any) -> None:
    with pytest.raises(ValueError, match="wrong there"):
        list(WorkerPool(client, scene_of(MODEL)).run(deque([Job("job", fail, ("wrong there",))]), lambda: None))


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_an_error_in_progress_ends_all_jobs(client: Any, error: type[BaseException]) -> None:
    def stop(stage: str, share: float) -> None:
        if any(bench.lock.locked() for bench in worker._CACHES.values()):  # a kernel is running
            raise error

    with pytest.raises(error):
        pr.render(scene_of(MODEL), camera_of(400, 300), pr.Settings(**PATH, spp=20_000), stop, client=client)
    wait_until(lambda: not any(client.processing().values()))
    wait_until(lambda: not any(bench.lock.locked() for bench in worker._CACHES.values()))  # no kernel is running


AT_WORK: list[int] = []


def count(scene: Any, threads: int, check: Any) -> tuple[int, int]:
    """Return the number of threads and of running jobs."""
    AT_WORK.append(1)
    time.sleep(0.05)
    seen = len(AT_WORK)
    AT_WORK.pop()
    return threads, seen


def test_a_worker_does_one_job_at_a_time_with_all_its_threads() -> None:
    with cluster_of(1, processes=False, threads=3) as client:
        jobs = deque(Job(f"job {k}", count, ()) for k in range(5))
        assert [result for _, result in WorkerPool(client, scene_of(MODEL)).run(jobs, lambda: None)] == [(3, 1)] * 5


@pytest.mark.long
def test_no_dask_is_imported_without_a_client_or_an_array_of_it() -> None:
    import subprocess
    import sys

    code = (
        "import sys, pointray as pr; s = pr.Scene(); s.add(pr.Plane((0, 0, 0), (0, 0, 1)));"
        "pr.render(s, pr.Camera.look_at((0, -4, 1), (0, 0, 0), size=(8, 8)));"
        "s.intersect((0, 0, 1), (0, 0, -1)); s.occluded((0, 0, 1), (0, 0, -1));"
        "print([m for m in ('dask', 'distributed') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_without_dask_the_message_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"client needs distributed: pip install 'pointray\[cluster\]'"):
        check_client(object())


def test_clients_that_cannot_render_are_refused() -> None:
    with cluster_of(0, processes=False) as client, pytest.raises(ValueError, match="no workers; start some with `dask"):
        pr.render(scene_of(MODEL), camera_of(), client=client)
    with pytest.raises(ValueError, match="client must be a connected client"):
        pr.render(scene_of(MODEL), camera_of(), client=client)
    with pytest.raises(ValueError, match="client must be a dask"):
        pr.render(scene_of(MODEL), camera_of(), client="tcp://a:1")


def test_several_threads_may_use_a_client(client: Any) -> None:
    scene, images = scene_of(MODEL), []
    cameras = [camera_of(60, 40, turn) for turn in (0, 1, 2)]
    threads = [
        threading.Thread(target=lambda c=camera: images.append((c, pr.render(scene, c, client=client))))
        for camera in cameras
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(images) == 3
    for camera, image in images:
        np.testing.assert_array_equal(image, pr.render(scene, camera))
    assert scattered_objects_of(client).client is client


class LosesOne:
    """A client that loses a worker during a call."""

    def run(self, function: Any, workers: list[str], on_error: str) -> dict[str, Any]:
        return dict(zip(workers, [function(), OSError("connection closed")], strict=True))


def test_a_worker_lost_during_its_check_is_ignored() -> None:
    client = LosesOne()
    assert unfit(client, ["there", "lost"]) == {}
    assert is_fit(client, "there") and not is_fit(client, "lost")
