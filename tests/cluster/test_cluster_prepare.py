"""Models in parts that workers make are those that are made here, file by file and byte by byte."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from helpers.dask_clusters import cluster_of
from pointray.base.disk_columns import Columns
from pointray.cli import execute
from pointray.cluster import client as client_module, shared_folder, task_pool as tasks, worker
from pointray.cluster.client import UNPROFILED
from pointray.cluster.recipe import pack, unpack
from pointray.cluster.task_pool import THREADS, _Task, _thread_limit, stoppable
from pointray.cluster.worker import DroppedError
from pointray.cluster.worker_pool import WorkerPool
from pointray.engine.jit import run
from pointray.engine.jit.threads import CANCEL
from pointray.io.files import request_of
from pointray.io.selection import Selection
from pointray.model.out_of_core import prepare as prepare_module
from pointray.model.out_of_core.prepare import part_points_for, part_points_within, prepare
from pointray.model.out_of_core.work import Work, _do_once
from pointray.surface.splats.scattered.spheres import Drawing
from pointray.surface.tree.settings import check_settings

SIZE = 1 << 14  # of a part: the least there is for so few points
FEW = 20_000  # points of two parts


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with cluster_of(2, processes=False) as client:
        yield client


def prepared(
    file: Path, folder: Path, client: Any = None, progress: Any = None, drawing: Drawing | None = None
) -> dict[str, bytes]:
    """Return the files of a model built in parts from a file."""
    reading, settings = (request_of(), Selection(1, None, None, None, None)), check_settings("apss", 4, 1, "auto")
    prepare([file], reading, folder, (settings, "auto", drawing), SIZE, progress, client)
    return files_of(folder)


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def statue(file: Path, rng: Any = None) -> None:
    """Write distinct points with normals and colours."""
    points = pr.procedural("statue", 50_000)
    pr.write(file, points.changed(attributes={"number": np.arange(len(points), dtype=np.int32)}))


def rough(file: Path, rng: np.random.Generator, n: int = 50_000) -> None:
    """Write a noisy sphere over ground with borders, without normals."""
    ground = rng.random((n // 2, 2)) * 4 - 2
    rows = np.concatenate([sphere_points(n // 2), np.column_stack([ground, np.full(n // 2, -1.2)])])
    pr.write(file, pr.Points((rows + rng.normal(size=rows.shape) * 0.004).astype(np.float32)))


def some_signs(file: Path, rng: np.random.Generator) -> None:
    """Write points with normals of random sign."""
    rows = sphere_points(40_000)
    pr.write(file, pr.Points(rows, rows * rng.choice([-1, 1], (len(rows), 1)).astype(np.float32)))


def given_radii(file: Path, rng: Any = None) -> None:
    rows = sphere_points(40_000)
    pr.write(file, pr.Points(rows, rows, attributes={"radius": np.full(len(rows), 0.03, np.float32)}))


def seen(file: Path, rng: Any = None) -> None:
    """Write two scans of a sphere, each from its own station."""
    rows = sphere_points(40_000)
    with file.open("w") as out:
        for x in (-4, 4):
            some = rows[rows[:, 0] * x > 0] - [x, 0, 0]
            out.write(f"{len(some)}\n1\n{x} 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n{x} 0 0 1\n")
            out.writelines(f"{a:.6f} {b:.6f} {c:.6f} 0.5\n" for a, b, c in some)


def wood(file: Path, rng: np.random.Generator) -> None:
    """Ground, and points scattered above it, in colours."""
    rows = rng.uniform(-1, 1, (50_000, 3))
    rows[:25_000, 2] = -1.1
    colors = rng.integers(0, 256, rows.shape).astype(np.uint8)
    pr.write(file, pr.Points(rows.astype(np.float32), colors=colors))


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, bytes]]:
    """A scan of two parts without normals, and the files of its model."""
    folder = tmp_path_factory.mktemp("few")
    rough(folder / "scan.ply", np.random.default_rng(0), FEW)
    return folder / "scan.ply", prepared(folder / "scan.ply", folder / "here")


def test_workers_write_the_same_files_and_each_part_of_a_stage_is_a_job(
    client: Any, few: tuple[Path, dict[str, bytes]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, wanted = few
    names, told, submit = list[str](), list[float](), WorkerPool.submit
    monkeypatch.setattr(WorkerPool, "submit", lambda self, job, to: names.append(job.name) or submit(self, job, to))
    assert prepared(file, tmp_path / "there", client, told.append) == wanted
    assert told == sorted(told) and told[-1] == 1.0
    for stage in ("sort", "merge", "noise", "place", "signs", "support", "boxes", "tree", "level-1-points"):
        assert {f"{stage} 1/2", f"{stage} 2/2"} <= set(names)


@pytest.mark.long
@pytest.mark.parametrize("make", [statue, rough, some_signs, given_radii, seen, wood])
@pytest.mark.filterwarnings("ignore:.*normals")
def test_workers_make_the_same_files(client: Any, make: Any, tmp_path: Path, rng: np.random.Generator) -> None:
    file = tmp_path / ("scan.ptx" if make is seen else "scan.ply")
    make(file, rng)
    told: list[float] = []
    drawing = Drawing("spheres") if make is wood else None
    found = prepared(file, tmp_path / "there", client, told.append, drawing)
    wanted = prepared(file, tmp_path / "here", drawing=drawing)
    assert found == wanted and len(wanted) >= 5
    assert told == sorted(told) and told[-1] == 1.0


@pytest.mark.long
def test_an_error_in_progress_ends_the_work_which_can_be_resumed(
    client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    statue(tmp_path / "a.ply")

    def stop(share: float) -> None:
        if share > 0.8:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        prepared(tmp_path / "a.ply", tmp_path / "a", client, stop)
    end = time.monotonic() + 300  # it only ends a wait in vain
    while any(client.processing().values()) or any(bench.lock.locked() for bench in worker._CACHES.values()):
        assert time.monotonic() < end
        time.sleep(0.02)
    names: list[str] = []
    submit = WorkerPool.submit
    monkeypatch.setattr(prepare_module, "spool", None)
    monkeypatch.setattr(WorkerPool, "submit", lambda self, job, to: names.append(job.name) or submit(self, job, to))
    found = prepared(tmp_path / "a.ply", tmp_path / "a", client)
    monkeypatch.undo()
    assert not any(name.startswith(("sort", "place")) for name in names)
    assert found == prepared(tmp_path / "a.ply", tmp_path / "b")


@pytest.mark.long
def test_work_of_workers_can_be_resumed_here(client: Any, tmp_path: Path) -> None:
    statue(tmp_path / "a.ply")

    def stop(share: float) -> None:
        if share > 0.6:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        prepared(tmp_path / "a.ply", tmp_path / "a", client, stop)
    assert prepared(tmp_path / "a.ply", tmp_path / "a") == prepared(tmp_path / "a.ply", tmp_path / "b")


def test_workers_that_do_not_see_the_folder_are_named(
    client: Any, few: tuple[Path, dict[str, bytes]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shared_folder, "_is_seen", lambda place: False)
    with pytest.raises(ValueError, match=r"worker \S+ cannot read and write the folder \S+/a"):
        prepared(few[0], tmp_path / "a", client)
    assert not (tmp_path / "a").exists()


def test_a_different_file_counts_as_not_visible(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "task.json").write_text("{}")
    place = shared_folder.place_of(tmp_path / "a" / "task.json")
    assert shared_folder._is_seen(place)
    (tmp_path / "a" / "task.json").write_text("{ }")
    assert not shared_folder._is_seen(place)


def test_a_folder_that_is_not_writable_counts_as_not_visible(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "task.json").write_text("{}")
    place, make = shared_folder.place_of(tmp_path / "a" / "task.json"), os.open

    def refuse(path: Any, *rest: Any) -> int:
        if Path(path).parent == tmp_path:
            raise PermissionError(13, "Permission denied", str(path))
        return make(path, *rest)

    monkeypatch.setattr(os, "open", refuse)
    assert not shared_folder._is_seen(place)


def test_each_job_checks_the_folder_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file is created there, so that NFS does not show a cached listing."""
    work = Work(Columns(tmp_path), 10_000, 1 << 12)
    sent = unpack(pack(partial(_do_once, work, "count", partial(count_names, work))))
    made: list[str] = []
    make = os.open
    monkeypatch.setattr(os, "open", lambda path, *rest: made.append(Path(path).name) or make(path, *rest))
    work.columns.put("found", {})
    before = len(made)
    assert sent(2) == {"names": 1} and made[before].startswith(".")
    assert work.columns.get("count-0002") == {"names": 1}
    del made[before:]
    assert _do_once(work, "count", partial(count_names, work), 1) == {"names": 2}
    assert not any(name.startswith(".") and "pointray" not in name for name in made)


def count_names(work: Work, part: int) -> dict[str, int]:
    return {"names": len(list(work.columns.folder.glob("*.json")))}


def test_a_later_worker_that_does_not_see_the_folder_is_not_used(client: Any) -> None:
    first, second = client.nthreads()

    def ask(client: Any, workers: list[str]) -> dict[str, str]:
        return {worker: f"{worker} is blind" for worker in workers if worker == second}

    from pointray.cluster.task_pool import TaskPool

    with pytest.warns(UserWarning, match=f"worker ignored: {second} is blind"):
        team = TaskPool(client, ask)
    assert dict(team.share("squares", square, range(5), lambda: None)) == {k: k * k for k in range(5)}
    assert list(team._pool.workers) == [first]


def square(k: int) -> int:
    return k * k


@pytest.mark.long
def test_an_error_of_a_worker_is_raised_here(client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    statue(tmp_path / "a.ply")
    monkeypatch.setattr("pointray.model.out_of_core.tasks.check_size", full)
    text = "a.ply: No space left on device: free some space and run the same command again to resume"
    with pytest.raises(OSError, match="No space left") as told:
        prepared(tmp_path / "a.ply", tmp_path / "a", client)
    assert f"{told.value.filename}: {told.value.strerror}" == text
    monkeypatch.undo()
    assert prepared(tmp_path / "a.ply", tmp_path / "a", client) == prepared(tmp_path / "a.ply", tmp_path / "b")


def full(radii: Any) -> None:
    raise OSError(28, "No space left on device", "a.ply")


# ------------------------------------------------------------------------------------------------------------- tasks


def test_a_cancelled_task_ends() -> None:
    begun, ended, is_wanted = threading.Event(), threading.Event(), [True]

    def until_cancelled(work: Any) -> None:
        begun.set()
        while not work[CANCEL]:
            time.sleep(0.01)
        ended.set()

    def check(share: float) -> None:
        if not is_wanted[0]:
            raise DroppedError

    errors: list[BaseException] = []

    def work() -> None:
        try:
            stoppable(lambda: run(until_cancelled, 1), check)
        except DroppedError as error:
            errors.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    assert begun.wait(300)
    is_wanted[0] = False
    thread.join(300)
    assert not thread.is_alive() and len(errors) == 1
    assert ended.wait(300)


def test_a_task_is_not_interrupted_where_it_may_hold_a_lock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tasks, "POLL", 0.01)
    lock, checks, ended = threading.Lock(), [0], [False]

    def work() -> None:
        with lock:
            while checks[0] < 3:  # it could have been ended twice
                pass
        ended[0] = True

    def check(share: float) -> None:
        checks[0] += 1
        raise DroppedError

    with pytest.raises(DroppedError):
        stoppable(work, check)
    assert ended[0] and not lock.locked()


def test_a_finished_task_is_not_interrupted() -> None:
    """Its thread id may have been reused."""
    task = _Task(lambda: 7)
    task.start()
    task.join()
    assert task.result == 7 and not task.end()


def test_a_task_that_exits_does_not_end_its_worker() -> None:
    with pytest.raises(RuntimeError, match="a task was ended"):
        stoppable(sys.exit, lambda share: None)


def test_a_task_returns_its_result_or_raises_its_error() -> None:
    assert stoppable(lambda: 7, lambda share: None) == 7
    with pytest.raises(ZeroDivisionError):
        stoppable(lambda: 1 / 0, lambda share: None)


def test_tasks_use_the_threads_of_their_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, "9")
    one, two = _thread_limit(1), _thread_limit(2)
    with _thread_limit(None):
        assert os.environ[THREADS] == "9"
    one.__enter__()
    two.__enter__()
    assert os.environ[THREADS] == "2"
    one.__exit__(None, None, None)
    two.__exit__(None, None, None)
    assert os.environ[THREADS] == "9"
    monkeypatch.delenv(THREADS)
    with _thread_limit(3):
        assert os.environ[THREADS] == "3"
    assert THREADS not in os.environ


# ------------------------------------------------------------------------------------------------------------- memory


def test_memory_is_that_of_all_processes(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert part_points_within(4 << 30, 1) == 1 << 22
    assert part_points_within(4 << 30, 2) == part_points_within(8 << 30, 4) == 1 << 21
    with pytest.raises(ValueError, match=r"memory: 1\.00 GiB, but 1\.5 GiB are needed with 2 workers on one machine"):
        part_points_within(1 << 30, 2)
    assert part_points_for(client, 4 << 30) == 1 << 21  # both are on this machine
    assert part_points_for(None, 4 << 30) == part_points_within(4 << 30)
    monkeypatch.setattr(client_module, "available_memory", lambda: 3 << 30)
    assert part_points_for(client, None) == part_points_within(3 << 30, 2)


# ------------------------------------------------------------------------------------------------------- command line


@pytest.fixture
def scan(few: tuple[Path, dict[str, bytes]]) -> Path:
    return few[0]


def refused(capsys: pytest.CaptureFixture[str], *words: Any) -> str:
    """Return the one-line error of the refused command."""
    assert execute(["prepare", *map(str, words)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return lines[0]


@pytest.mark.long
def test_the_command_prepares_on_a_cluster(
    few: tuple[Path, dict[str, bytes]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import dask
    from distributed import LocalCluster

    file, wanted = few
    options: dict[str, Any] = {"processes": False, "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}
    out = tmp_path / "a.pointray"
    options |= {"n_workers": 2, "threads_per_worker": 1, "memory_limit": 0}
    with dask.config.set(UNPROFILED), LocalCluster(**options) as cluster:
        words = ["prepare", str(file), "-o", f"{out}/", "--part-points", str(SIZE)]
        assert execute([*words, "--cluster", cluster.scheduler_address]) == 0
    assert capsys.readouterr().out == f"{out}: a model of 20,000 points in 2 parts\n"
    # Without a cluster, such a scan is built at once unless parts are requested.
    assert files_of(out) == wanted


def test_a_missing_scheduler_is_reported_before_anything_is_read(
    scan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pointray.cluster.client.PATIENCE", 0.1)
    monkeypatch.setattr(prepare_module, "spool", None)
    line = refused(capsys, scan, "-o", f"{tmp_path / 'a.pointray'}/", "--cluster", "tcp://127.0.0.1:1")
    assert line == "pointray: --cluster tcp://127.0.0.1:1: no Dask scheduler found there"
    assert not (tmp_path / "a.pointray").exists()


def test_invalid_worker_options_are_refused(scan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parts = "-o", f"{tmp_path / 'a.pointray'}/", "--workers", 2
    assert "exclude each other" in refused(capsys, scan, *parts, "--cluster", "tcp://127.0.0.1:1")
    line = refused(capsys, scan, "-o", tmp_path / "b.ply", "--workers", 2)
    assert line == f"pointray: --workers requires a model in parts: -o {tmp_path / 'b.pointray'}/"
    line = refused(capsys, scan, *parts, "--tolerance", "0.1")
    assert line == "pointray: --tolerance requires a scan that fits into memory: omit it, or omit --workers"
    pr.Model(pr.procedural("sphere", 1000)).save(tmp_path / "m.pointray")
    line = refused(capsys, tmp_path / "m.pointray", *parts)
    assert line == "pointray: --workers requires a scan; saved models are split in this process"
    assert not (tmp_path / "a.pointray").exists()


# ------------------------------------------------------------------------------------------------- processes of others


@pytest.mark.long
@pytest.mark.parametrize("share", [0.4, 0.8])
def test_the_files_are_the_same_when_a_worker_is_killed(share: float, tmp_path: Path, rng: np.random.Generator) -> None:
    rough(tmp_path / "a.ply", rng)
    killed: list[float] = []
    with cluster_of(2, processes=True) as client:

        def kill(done: float) -> None:
            if done > share and not killed:
                killed.append(done)
                os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)

        found = prepared(tmp_path / "a.ply", tmp_path / "there", client, kill)
    assert killed
    assert found == prepared(tmp_path / "a.ply", tmp_path / "here")


@pytest.mark.long
def test_ctrl_c_ends_all_workers_and_the_work_can_be_resumed(tmp_path: Path) -> None:
    import subprocess

    import psutil

    statue(tmp_path / "a.ply")
    out = tmp_path / "a.pointray"
    command = [sys.executable, "-m", "pointray", "prepare", str(tmp_path / "a.ply"), "-o", f"{out}/"]
    command += ["--part-points", str(SIZE), "--workers", "2"]
    with (tmp_path / "log.txt").open("w") as errors:
        process = subprocess.Popen(command, stderr=errors)
    end = time.monotonic() + 300
    while not list((out / "unfinished").glob("place-*.json")) and process.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    found = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=300) == 130
    assert (tmp_path / "log.txt").read_text() == ""
    _, alive = psutil.wait_procs(found, timeout=300)
    assert alive == [] and len(found) >= 3
    assert not (out / "index.json").exists()
    done = subprocess.run(command, capture_output=True, check=False, timeout=300)
    assert done.returncode == 0 and done.stderr == b""
    assert files_of(out) == prepared(tmp_path / "a.ply", tmp_path / "b")
