"""Commands that read files from a server: results, errors, temporary copies, the cache, and the coarse first view."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import pointray as pr
from helpers.copc_files import write_copc
from helpers.file_server import file_server, no_proxies  # noqa: F401
from helpers.viewer_client import SECONDS
from pointray.cli import execute
from pointray.io.remote import transport
from pointray.io.remote.remote_file import RemoteFile, location_of
from pointray.model import model_cache
from pointray.viewer import loading
from pointray.viewer.shared_scene import SharedScene

pytest.importorskip("fsspec")
pytest.importorskip("aiohttp")
pytestmark = pytest.mark.usefixtures("no_proxies")


@pytest.fixture
def server(tmp_path, monkeypatch):
    """A web server; temporary copies are in an empty folder, which must be empty in the end."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    with file_server() as server:
        yield server
        assert list(folder.iterdir()) == []


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("remote") / "statue.ply"
    pr.write(path, pr.procedural("statue", 2000))
    return path


@pytest.fixture(scope="module")
def copc(tmp_path_factory):
    """A half sphere of 6000 points in the cube from 0 to 1024."""
    rows = pr.procedural("sphere", 6000).world
    rows = 512 + 400 * rows / np.abs(rows).max()
    return write_copc(tmp_path_factory.mktemp("copc") / "a.copc.laz", rows, 4, np.random.default_rng(1))


def test_a_scan_is_converted(server, scan, tmp_path, capsys):
    url, out = server.add("statue.ply", scan.read_bytes()), tmp_path / "out.ply"
    assert execute(["convert", url, str(out)]) == 0
    assert capsys.readouterr().out == f"{out}: 2,000 points\n"
    assert np.array_equal(pr.read(out).positions, pr.read(scan).positions)


def test_a_scan_is_described_by_its_url(server, scan, capsys):
    url = server.add("statue.ply", scan.read_bytes())
    assert execute(["info", url.replace("http://", "http://me:secret@"), "--json"]) == 0
    output = capsys.readouterr().out
    facts = json.loads(output)
    assert facts["file"] == url and facts["points"] == 2000 and facts["files"][0]["bytes"] == scan.stat().st_size
    assert "secret" not in output
    assert [size for _, size in server.sent] == [transport.HEAD, scan.stat().st_size]  # downloaded once


def test_copc_is_converted_from_the_needed_chunks(server, copc, tmp_path):
    url, out = server.add("a.copc.laz", copc.path.read_bytes()), tmp_path / "out.ply"
    assert execute(["convert", url, str(out), "--resolution", "16"]) == 0
    assert len(pr.read(out)) == len(pr.read(copc.path, resolution=16))
    assert server.bytes <= 1.3 * copc.bytes_of(0) + transport.HEAD + 60 + copc.pages[0][1]


def test_a_scan_is_prepared(server, scan, tmp_path, capsys):
    url = server.add("statue.ply", scan.read_bytes())
    assert execute(["prepare", url, "-o", str(tmp_path / "a.pointray")]) == 0
    model = pr.Model.load(tmp_path / "a.pointray")
    assert len(model.points) == 2000
    seen = []
    prepared = pr.prepare(url, tmp_path / "b.ply", count=500, progress=lambda *state: seen.append(state))
    assert prepared.points == 500 and ("downloading statue.ply", 1.0) in seen
    saved = server.add("a.pointray", (tmp_path / "a.pointray").read_bytes())
    assert execute(["convert", saved, str(tmp_path / "c.ply")]) == 0
    assert len(pr.read(tmp_path / "c.ply")) == 2000
    server.add("a.pointray", b"no model")
    assert execute(["convert", saved, str(tmp_path / "d.ply")]) == 2
    assert f"pointray: {saved}: " in capsys.readouterr().err


@pytest.mark.long
def test_a_model_in_parts_is_made(server, scan, tmp_path):
    url = server.add("statue.ply", scan.read_bytes())
    assert execute(["prepare", url, "-o", f"{tmp_path}/a.pointray/", "--memory", "2GiB"]) == 0
    assert len(pr.Model.load(tmp_path / "a.pointray").points) == 2000
    assert [size for _, size in server.sent] == [transport.HEAD, scan.stat().st_size]


@pytest.mark.long
def test_a_picture_is_that_of_the_local_file(server, scan, tmp_path):
    url, size = server.add("statue.ply", scan.read_bytes()), ["--size", "40x30", "--light", "headlight"]
    assert execute(["render", url, "-o", str(tmp_path / "a.png"), *size]) == 0
    assert execute(["render", str(scan), "-o", str(tmp_path / "b.png"), *size]) == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert execute(["bake", url, "-o", str(tmp_path / "a.bake")]) == 0
    film = ["--seconds", "0.1", "--fps", "10", *size]
    assert execute(["animate", url, "-o", f"{tmp_path}/film/", *film]) == 0
    assert len(list((tmp_path / "film").glob("*.png"))) == 1


@pytest.mark.parametrize("fault", ["404", "403", "500", "html", "loop", "cut", "stall", "longer", "changing"])
@pytest.mark.parametrize("command", ["convert", "prepare"])
def test_faults_are_one_line_and_write_nothing(server, scan, tmp_path, capsys, monkeypatch, fault, command):
    monkeypatch.setattr(transport, "READ", 0.3)
    url, out = server.add("statue.ply", scan.read_bytes(), fault), tmp_path / "out.ply"
    secret = url.replace("http://", "http://me:secret@") + "?signature=secret"
    words = {"convert": [secret, str(out)], "prepare": [secret, "-o", str(out)]}
    assert execute([command, *words[command]]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith(f"pointray: {url}?...: ") and "secret" not in lines[0]
    assert not out.exists() and {path.name for path in tmp_path.iterdir()} == {"temporary"}


def test_scene_files_must_be_local(server, capsys):
    url = server.add("a.toml", b"[camera]")
    assert execute(["render", url, "-o", "a.png"]) == 2
    assert "a scene file must be on this computer" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT")
def test_an_interrupt_removes_the_unfinished_download(server, scan, tmp_path):
    url, folder = server.add("statue.ply", scan.read_bytes(), "stall whole"), Path(tempfile.gettempdir())
    words = [sys.executable, "-m", "pointray", "convert", url, str(tmp_path / "out.ply")]
    environment = {**os.environ, "TMPDIR": str(folder)}
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env=environment)
    try:
        end = time.monotonic() + SECONDS
        while not any(path.stat().st_size for path in folder.glob("*/statue.ply")) and time.monotonic() < end:
            time.sleep(0.02)
            assert process.poll() is None, process.stderr.read()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=SECONDS)
    finally:
        process.kill()  # nothing if it has ended
        process.wait()
        process.stderr.close()
    assert process.returncode == 130 and errors == ""
    assert not (tmp_path / "out.ply").exists() and list(folder.iterdir()) == []


# -------------------------------------------------------------------------------------------------------- cache


def test_a_model_is_cached_if_its_version_is_known(server, scan, monkeypatch):
    monkeypatch.setattr(model_cache, "WORTH", 100)
    url = server.add("statue.ply", scan.read_bytes())
    entry = model_cache.entry_of([location_of(f"{url}?signature=secret")], {})
    model = pr.Model(pr.read(scan))
    assert entry.store(model)
    assert "secret" not in entry.path.with_suffix(".json").read_text()
    again = model_cache.entry_of([location_of(f"{url}?signature=secret")], {})
    assert again.path == entry.path and len(again.load().points) == 2000
    assert model_cache.entry_of([location_of(f"{url}?other")], {}).path != entry.path
    server.add("statue.ply", scan.read_bytes() + b" ")  # another size and tag
    assert model_cache.entry_of([location_of(f"{url}?signature=secret")], {}).path != entry.path
    server.add("statue.ply", scan.read_bytes(), "untagged")
    assert model_cache.entry_of([location_of(url)], {}) is None
    model_cache.clear()


# --------------------------------------------------------------------------------------------------------- view


@pytest.fixture
def small_sizes(monkeypatch):
    monkeypatch.setattr(loading, "COARSE", 300)
    monkeypatch.setattr(loading, "LARGE_FROM", 1200)


def load(loader, shared):
    """Load a scene; return the thread, the numbers of points shown with whether more will follow, and the stages."""
    shown, stages = [], []

    def notice():
        if shared.scene is not None:
            shown.append((len(shared.scene.models[0].points), shared.is_coarse))
        stages.append(shared.progress.stage)

    shared.subscribe(notice)
    return shared.load(loader), shown, stages


def test_a_coarse_version_of_copc_is_shown_before_the_download(server, copc, small_sizes):
    url = server.add("a.copc.laz", copc.path.read_bytes(), "stall whole")
    shared, arrived = SharedScene("a"), threading.Event()
    shared.subscribe(lambda: arrived.set() if shared.scene is not None else None)
    file = RemoteFile(url)
    thread, shown, stages = load(loading.FileLoader([file], {}, lambda scene: (0.0, 0.0, 1.0)), shared)
    assert arrived.wait(SECONDS)
    count = len(pr.read(copc.path, resolution=8))
    assert shown[0] == (min(count, 300), True) and set(shown) == {shown[0]}
    half = copc.path.stat().st_size // 2  # of the download, which stalls
    listing = sum(size for _, size in copc.pages)
    fetched = sum(size for _, size in server.sent if size != half)
    assert fetched <= 1.3 * copc.bytes_of(0, 1) + transport.HEAD + 60 + listing
    server.released.set()  # the connection of the download is closed: an error that the page shows
    thread.join(SECONDS)
    assert shared.problem == f"{url}: connection lost before all bytes were received: try again"


def test_all_points_of_copc_follow(server, copc, small_sizes):
    url, shared = server.add("a.copc.laz", copc.path.read_bytes()), SharedScene("a")
    loader = loading.FileLoader([RemoteFile(url)], {}, lambda scene: (0.0, 0.0, 1.0), leveled=False)
    thread, shown, stages = load(loader, shared)
    thread.join(SECONDS)
    assert shown[0][1] and shown[0][0] <= 300 and shown[-1] == (6000, False)
    assert list(dict.fromkeys(shown)) == [shown[0], shown[-1]]
    assert "building a coarse version" not in stages  # not a second one
    assert "reading a coarse version" in stages and "downloading a.copc.laz" in stages
    assert list(Path(tempfile.gettempdir()).iterdir()) == []  # removed as soon as the points are in memory


def test_other_remote_scans_are_shown_after_the_download(server, scan):
    shared = SharedScene("a")
    url = server.add("statue.ply", scan.read_bytes())
    thread, shown, stages = load(loading.FileLoader([RemoteFile(url)], {}, lambda scene: (0.0, 0.0, 1.0)), shared)
    thread.join(SECONDS)
    assert set(shown) == {(2000, False)} and "downloading statue.ply" in stages
