"""Workers that are killed, do not respond, or have another version; they are local processes."""

import os
import re
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pointray as pr
from helpers.dask_clusters import ball, camera_of, cluster_of, scene_of
from pointray.cluster import client as client_module, worker_pool as pool
from pointray.cluster.dispatch import Job
from pointray.cluster.worker_pool import WorkerPool
from pointray.rendering.sequence import render_each

pytestmark = pytest.mark.long  # each starts processes
HARD = pr.Settings("path", spp=24, max_depth=2)


@pytest.fixture
def client() -> Iterator[Any]:
    with cluster_of(2, processes=True) as client:
        yield client


def kill_one(client: Any) -> None:
    """Kill a worker as `kill -9` does."""
    os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)


def test_pictures_of_other_processes_are_the_same(client: Any, tmp_path: Path) -> None:
    sent, saved = ball(5000), ball(3000)
    saved.save(tmp_path / "ball.pointray")
    for model in (sent, saved):
        scene, camera = scene_of(model), camera_of()
        for settings in (pr.Settings(), pr.Settings("path", spp=3, max_depth=2), pr.Settings("path", noise=0.3)):
            image = pr.render(scene, camera, settings, client=client)
            np.testing.assert_array_equal(image, pr.render(scene, camera, settings))
    assert [str(key).rpartition("-")[0] for key in client.who_has()].count("model of 5000 points") == 1


def test_a_picture_is_the_same_when_a_worker_is_killed(client: Any) -> None:
    scene, camera, killed = scene_of(ball()), camera_of(400, 300), []

    def kill(stage: str, share: float) -> None:
        if share > 0.2 and not killed:
            killed.append(share)
            kill_one(client)

    image = pr.render(scene, camera, HARD, kill, client=client)
    assert killed
    np.testing.assert_array_equal(image, pr.render(scene, camera, HARD))


def test_a_film_is_the_same_when_a_worker_is_killed(client: Any) -> None:
    scene, cameras = scene_of(ball()), [camera_of(120, 90, turn) for turn in np.linspace(0, 6, 16)]
    images: list[Any] = []
    for image in render_each(scene, cameras, HARD, client, lambda share: None):
        if len(images) == 3:
            kill_one(client)
        images.append(image)
    assert len(images) == len(cameras)
    for camera, image in zip(cameras, images, strict=True):
        np.testing.assert_array_equal(image, pr.render(scene, camera, HARD))


def test_all_workers_may_be_replaced(client: Any) -> None:
    """The model that only they held is sent again."""
    scene, camera = scene_of(ball()), camera_of(300, 200)
    pr.render(scene, camera, client=client)
    before = set(client.nthreads())
    for pid in client.run(os.getpid).values():
        os.kill(pid, signal.SIGKILL)
    while set(client.nthreads()) & before or not client.nthreads():
        time.sleep(0.1)
    np.testing.assert_array_equal(pr.render(scene, camera, client=client), pr.render(scene, camera))


def wait_for_copies(client: Any) -> None:
    """Wait until each worker has the data: a stopped worker with the only copy would block all others."""
    sent = ("scene-", "model of ", "baked light-")
    while any(len(held) < 2 for key, held in client.who_has().items() if str(key).startswith(sent)):
        time.sleep(0.05)


@contextmanager
def stopped_worker(client: Any, is_listed: bool = True) -> Iterator[Callable[..., None]]:
    """Yield a function that stops a worker with SIGSTOP once; no call may wait until Dask removes the worker.

    Dask's memory manager would drop copies of the data from workers without jobs, so that only the stopped worker has
    them (docs/known-gaps.md): it is switched off.

    is_listed : whether Dask still lists the worker at the end; a failed fetch of a result may make it drop the worker
    """
    pids, stopped = client.run(os.getpid), []
    client.amm.stop()

    def stop(choose: Callable[[], str] = lambda: next(iter(pids))) -> None:
        if not stopped:
            wait_for_copies(client)
            stopped.append(choose())
            os.kill(pids[stopped[0]], signal.SIGSTOP)

    try:
        yield stop
        if is_listed:  # Dask removes workers that are silent for 5 minutes
            assert stopped[0] in client.scheduler_info()["workers"]
        assert stopped
    finally:
        for address in stopped:
            with suppress(ProcessLookupError):  # if Dask removed it
                os.kill(pids[address], signal.SIGCONT)


def test_a_stopped_worker_is_not_waited_for(client: Any) -> None:
    scene, camera = scene_of(ball()), camera_of(400, 300)
    with stopped_worker(client) as stop:
        image = pr.render(scene, camera, HARD, lambda _, share: share > 0.2 and stop(), client=client)
    np.testing.assert_array_equal(image, pr.render(scene, camera, HARD))


def test_a_worker_may_stop_before_its_result_is_fetched(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    fetch, fetched = WorkerPool.fetch, []
    scene, camera = scene_of(ball()), camera_of(400, 300)
    with stopped_worker(client, is_listed=False) as stop:

        def stop_and_fetch(pool: WorkerPool, future: Any) -> Any:
            fetched.append(future.key)
            if len(fetched) == 3:
                stop(lambda: client.who_has([future])[future.key][0])
            return fetch(pool, future)

        monkeypatch.setattr(WorkerPool, "fetch", stop_and_fetch)
        image = pr.render(scene, camera, HARD, client=client)
    np.testing.assert_array_equal(image, pr.render(scene, camera, HARD))


def die(scene: Any, threads: int, check: Any) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_job_that_kills_workers_is_given_up(client: Any) -> None:
    with pytest.raises(RuntimeError, match="deadly: failed, 4 Dask workers"):
        list(WorkerPool(client, scene_of(ball())).run(deque([Job("deadly", die, ())]), lambda: None))


def render_until_at_work(client: Any, then: Callable[[], Any]) -> None:
    """Start a long rendering; call `then` in another thread when a part of it is done."""
    thread, begun = threading.Thread(target=then), threading.Event()

    def progress(stage: str, share: float) -> None:
        if share > 0 and not begun.is_set():
            begun.set()
            thread.start()

    try:
        pr.render(scene_of(ball()), camera_of(400, 300), pr.Settings("path", spp=20_000), progress, client=client)
    finally:
        if begun.is_set():
            thread.join()


def test_a_pool_without_workers_gives_up(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "NO_WORKERS_TIMEOUT", 1.0)
    with pytest.raises(RuntimeError, match="no Dask worker available"):
        render_until_at_work(client, lambda: client.cluster.scale(0))


def test_the_end_of_the_scheduler_is_reported(client: Any) -> None:
    with pytest.raises(RuntimeError, match="connection to the Dask scheduler lost"):
        render_until_at_work(client, client.cluster.close)


def set_version(version: str = "0.0.9") -> None:
    import pointray.cluster.worker

    pointray.cluster.worker.__version__ = version  # type: ignore[attr-defined]


def where(scene: Any, threads: int, check: Any) -> str:
    import distributed

    return str(distributed.get_worker().address)


def set_missing() -> None:
    import sys

    sys.modules["pointray.cluster.worker"] = None  # type: ignore[assignment]


@pytest.mark.parametrize(("change", "text"), [(set_version, "has pointray 0.0.9, expected"), (set_missing, "has no")])
def test_workers_of_another_version_are_refused_by_name(client: Any, change: Any, text: str) -> None:
    first, second = client.nthreads()
    client.run(change, workers=[second])
    with pytest.raises(ValueError, match=rf"client: worker {second} {text}.* {re.escape(pr.__version__)}"):
        pr.render(scene_of(ball()), camera_of(), client=client)


def test_a_later_worker_of_another_version_is_left_out(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    crew_here = WorkerPool(client, scene_of(ball()))
    first, second = client.nthreads()
    client_module._FIT[client].discard(second)  # as if it joined only now
    del crew_here.workers[second]
    client.run(set_version, "0.0.9", workers=[second])
    monkeypatch.setattr(pool, "REFRESH", 0.0)
    with pytest.warns(UserWarning, match=f"worker ignored: worker {second} has pointray 0.0.9"):
        done = [result for _, result in crew_here.run(deque([Job("job", where, ())]), lambda: None)]
    assert done == [first]
