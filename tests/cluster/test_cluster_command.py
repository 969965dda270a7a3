"""`--cluster` and `--workers` of `pointray render` and `pointray animate`."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from pointray.cli import execute
from pointray.cluster.client import UNPROFILED

SMALL = ["--size", "60x40", "--spp", "2", "--integrator", "phong"]
SCENE = """
[models.ball]
procedural = "sphere"
points = 1500
[[instances]]
model = "ball"
[[lights]]
kind = "sun"
direction = [1, 1, -1]
[camera]
eye = [0, -4, 0]
target = [0, 0, 0]
size = [60, 40]
"""


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    rows = sphere_points(2000)
    pr.write(tmp_path / "scan.ply", pr.Points(rows, rows))
    return tmp_path / "scan.ply"


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """The address of a scheduler, with workers in this process."""
    from distributed import LocalCluster

    options: dict[str, Any] = {"processes": False, "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}
    with (
        dask.config.set(UNPROFILED),
        LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=0, **options) as cluster,
    ):
        yield cluster.scheduler_address


def test_pictures_of_a_cluster_are_the_same(scan: Path, tmp_path: Path, address: str) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE)
    for subject, options in ((scan, SMALL), (scene, ["--spp", "2"])):
        for name, where in (("here.png", []), ("there.png", ["--cluster", address])):
            assert execute(["render", str(subject), "-o", str(tmp_path / name), *options, *where]) == 0
        assert (tmp_path / "here.png").read_bytes() == (tmp_path / "there.png").read_bytes()


@pytest.mark.long
def test_films_of_a_cluster_are_the_same(scan: Path, tmp_path: Path, address: str) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE)
    film = ["--seconds", "1", "--fps", "5"]
    for subject, options in ((scan, SMALL), (scene, ["--spp", "2"])):
        found = []
        for where in ([], ["--cluster", address]):
            folder = tmp_path / f"{subject.stem}{len(where)}"
            assert execute(["animate", str(subject), "-o", str(folder), *options, *film, *where]) == 0
            found.append({path.name: path.read_bytes() for path in folder.iterdir()})
        assert found[0] == found[1] and len(found[0]) == 5


def test_an_interrupted_film_is_resumed(
    scan: Path, tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This works with and without a cluster: it is the same film."""
    from pointray.image.frames import Frames

    keep = Frames.keep

    def stop(self: Frames, k: int, *args: Any, **rest: Any) -> None:
        if k == 3:
            raise KeyboardInterrupt
        keep(self, k, *args, **rest)

    command = ["animate", str(scan), "-o", str(tmp_path / "film"), *SMALL, "--seconds", "1", "--fps", "6"]
    monkeypatch.setattr(Frames, "keep", stop)
    assert execute([*command, "--cluster", address]) == 130
    assert len(list((tmp_path / "film").glob("*.png"))) == 3
    monkeypatch.undo()
    assert execute([*command]) == 0
    assert len(list((tmp_path / "film").glob("*.png"))) == 6


def refused(capsys: pytest.CaptureFixture[str], *options: str, name: str = "absent.ply") -> str:
    """Return the one-line error of a refused command."""
    assert execute(["render", name, "-o", "x.png", *options]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return lines[0]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_a_missing_scheduler_is_reported_before_anything_is_read(
    capsys: pytest.CaptureFixture[str], scan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pointray.cli.scan_scene as scan_scene

    monkeypatch.setattr(scan_scene.ScanScene, "build", None)  # nothing may be read before
    monkeypatch.setattr("pointray.cluster.client.PATIENCE", 0.1)  # without its own limit this would not end
    address = f"tcp://127.0.0.1:{free_port()}"
    line = refused(capsys, "--cluster", address, name=str(scan))
    assert line == f"pointray: --cluster {address}: no Dask scheduler found there"
    with socket.create_server(("127.0.0.1", 0)) as silent:  # accepts the connection and sends nothing
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        assert "no Dask scheduler found there" in refused(capsys, "--cluster", address, name=str(scan))
    assert "no Dask scheduler found there" in refused(capsys, "--cluster", "what:is:this", name=str(scan))


def test_a_scheduler_without_workers_is_refused(
    capsys: pytest.CaptureFixture[str], scan: Path, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("distributed.Client.nthreads", lambda self: {})
    line = refused(capsys, "--cluster", address, name=str(scan))
    start = f"start some with `dask worker {address}`"
    assert line == f"pointray: --cluster {address}: the scheduler has no workers; {start}"


def test_only_one_of_the_two_options_is_accepted(capsys: pytest.CaptureFixture[str], scan: Path) -> None:
    line = refused(capsys, "--cluster", "tcp://127.0.0.1:1", "--workers", "2", name=str(scan))
    assert line == "pointray: --cluster and --workers exclude each other"
    assert "--workers" in refused(capsys, "--workers", "0", name=str(scan))


def test_without_dask_the_message_says_how_to_install_it(
    capsys: pytest.CaptureFixture[str], scan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    line = refused(capsys, "--workers", "2", name=str(scan))
    assert line.startswith("pointray: --workers needs distributed: pip install 'pointray[cluster]'; see http")


@pytest.mark.long
def test_local_workers_give_the_same_results(scan: Path, tmp_path: Path) -> None:
    for name, where in (("here.png", []), ("there.png", ["--workers", "2"])):
        command = [sys.executable, "-m", "pointray", "render", str(scan), "-o", str(tmp_path / name), *SMALL, *where]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0 and done.stderr == ""
    assert (tmp_path / "here.png").read_bytes() == (tmp_path / "there.png").read_bytes()


@pytest.mark.long
def test_ctrl_c_ends_all_workers_and_writes_nothing(scan: Path, tmp_path: Path) -> None:
    import psutil

    options = ["--size", "800x600", "--spp", "60000", "--integrator", "path", "--workers", "2"]
    command = [sys.executable, "-m", "pointray", "render", str(scan), "-o", str(tmp_path / "x.png"), *options]
    log = tmp_path / "log.txt"
    with log.open("w") as errors:
        process = subprocess.Popen(command, stderr=errors)
    end = time.monotonic() + 300
    parent = psutil.Process(process.pid)
    while len(found := parent.children(recursive=True)) < 3 and time.monotonic() < end:  # a tracker, and the workers
        time.sleep(0.2)
    time.sleep(5)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=300) == 130
    assert log.read_text() == ""
    assert not (tmp_path / "x.png").exists()
    _, alive = psutil.wait_procs(found, timeout=300)
    assert alive == []


@pytest.mark.long
def test_workers_of_a_command_share_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    from pointray.cluster.client import local_workers

    monkeypatch.setenv("POINTRAY_THREADS", "5")
    with local_workers(2) as client:
        assert list(client.nthreads().values()) == [2, 2]
        assert len(set(client.run(os.getpid).values()) | {os.getpid()}) == 3
