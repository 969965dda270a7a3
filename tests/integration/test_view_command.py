"""`pointray view` as a program: output, files shown, and how it ends."""

import logging
import signal
import socket
import sys
from contextlib import ExitStack, closing
from urllib.parse import urlsplit

import numpy as np
import pytest

import pointray as pr
from helpers.viewer_client import SECONDS, Browser, expected, levels_in, serve, view
from pointray.cli import execute
from pointray.viewer import loading
from pointray.viewer.shared_scene import SharedScene

SIZE = (160, 120)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "statue.ply"
    pr.write(path, pr.procedural("statue", 2_000))
    return path


@pytest.fixture
def browse():
    """A function that runs `pointray view` in this process and opens its page."""
    with ExitStack() as left:

        def begin(*arguments, size=SIZE):
            return left.enter_context(closing(Browser(left.enter_context(view(*arguments)), size)))

        yield begin


def test_a_scan_is_shown(scan, browse):
    browser = browse(scan, "--light", "sun:1,1,-2", "--ground", size=(40, 30))
    browser.arrive()
    browser.refined(64)
    assert browser.told[0]["title"] == "statue.ply"
    assert "lamps.0.azimuth" in browser.controls() and "copy.command" in browser.controls()


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT")
def test_a_scan_is_shown_until_an_interrupt(scan):
    process, url, _ = serve(scan, "--light", "sun:1,1,-2", "--ground")
    try:
        with closing(Browser(url, (40, 30))) as browser:
            browser.arrive()
            browser.refined(64)
            assert browser.told[0]["title"] == "statue.ply"
            assert "lamps.0.azimuth" in browser.controls() and "copy.command" in browser.controls()
            process.send_signal(signal.SIGINT)
            assert process.wait(SECONDS) == 130
        output = process.stderr.read()
        assert output.startswith("pointray: view: ") and output.count("\n") == 1
    finally:
        process.kill()
        process.communicate()


def test_a_port_in_use_is_reported(scan, capsys):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with view(scan, "--port", port) as url:
            assert urlsplit(url).port != port
            assert f"pointray: port {port} is in use\n" in capsys.readouterr().err


def test_listening_beyond_this_machine_is_reported(scan, capsys):
    with view(scan, "--host", "0.0.0.0") as url:
        assert "note: --host 0.0.0.0: everyone who can reach this computer" in capsys.readouterr().err
        Browser(url, SIZE).close()


def test_several_files_and_saved_models_are_shown_together(scan, browse, tmp_path):
    points = pr.procedural("sphere", 1_000)
    pr.Model(pr.Points(points.positions + np.float32(3), points.normals)).save(tmp_path / "ball.pointray")
    browser = browse(scan, tmp_path / "ball.pointray", "--light", "headlight", size=(40, 30))
    browser.arrive()
    browser.refined(64)
    assert browser.last("hello")["title"] == "2 files"
    assert browser.last("place")["bounds"][1] == pytest.approx([4, 4, 4], abs=0.01)
    assert "copy.command" not in browser.controls()


def test_a_scene_file_is_shown(browse, tmp_path):
    text = """
        exposure = 1.0
        background = [0.2, 0.3, 0.4]
        [models.ball]
        procedural = "sphere"
        points = 3000
        [[instances]]
        model = "ball"
        [[lights]]
        kind = "sphere"
        center = [3, -3, 3]
        radius = 0.5
        radiance = 20
        [camera]
        eye = [0, -5, 1]
        target = [0, 0, 0]
        [settings]
        integrator = "path"
        spp = 128
    """
    (tmp_path / "ball.toml").write_text(text)
    browser = browse(tmp_path / "ball.toml", size=(40, 30))
    camera = browser.arrive()
    assert camera["eye"] == [0, -5, 1]
    browser.refined(128)
    controls = browser.controls()
    assert controls["integrator"]["value"] == "path" and controls["exposure"]["value"] == 1.0
    assert controls["lamps.0.on"]["label"] == "1: SphereLight"


def test_a_sample_of_large_scans_is_shown_first(tmp_path, monkeypatch):
    path = tmp_path / "statue.ply"
    pr.write(path, pr.procedural("statue", 5_000))
    monkeypatch.setattr(loading, "COARSE", 1_000)
    monkeypatch.setattr(loading, "LARGE_FROM", 4_000)
    shown, stages = [], []
    shared = SharedScene("statue.ply")
    shared.subscribe(lambda: (shown.append(shared.scene), stages.append(shared.progress.stage)))
    shared.load(loading.FileLoader([path], {}, lambda scene: None)).join(SECONDS)
    models = list(dict.fromkeys(scene.models[0] for scene in shown if scene is not None))
    assert [len(model.points) > 4_000 for model in models] == [False, True]
    assert stages[0] == "reading statue.ply" and stages[-1] == "" and "building: tree" in stages
    assert models[0].bounds == pytest.approx(models[1].bounds, abs=0.1)


def is_rather(frame, wanted, other):
    """Return whether a full-size frame is closer to one picture than to the other, up to JPEG errors."""
    seen = levels_in(frame[1])
    if seen.shape != wanted.shape:
        return False
    nearer = np.abs(seen - other).mean() - np.abs(seen - wanted).mean()
    return nearer > 0.5 * np.abs(wanted - other).mean()


@pytest.mark.long
@pytest.mark.parametrize("leveled", [True, False])
def test_large_scans_get_levels_of_detail_last(tmp_path, monkeypatch, leveled):
    path = tmp_path / "statue.ply"
    pr.write(path, pr.procedural("statue", 40_000))
    monkeypatch.setattr(loading, "COARSE", 1_000)
    monkeypatch.setattr(loading, "LARGE_FROM", 4_000)
    shown, shared = [], SharedScene("statue.ply")
    shared.subscribe(lambda: shown.append((shared.scene, len(shared.scene.models[0].levels) if shared.scene else 0)))
    shared.load(loading.FileLoader([path], {}, lambda scene: None, leveled)).join(SECONDS)
    counts = [count for _, count in shown]
    assert counts == sorted(counts) and (counts[-1] >= 2) == leveled
    if leveled:  # a separate scene, because colouring counts the levels
        scenes = list(dict.fromkeys(scene for scene, _ in shown if scene is not None))
        assert len(scenes) == 3 and scenes[1].models == scenes[2].models


@pytest.mark.long
def test_levels_are_switched_in_the_panel(tmp_path, browse):
    """The picture is that of `render` with levels, or with all points when levels are switched off."""
    model = pr.Model(pr.procedural("statue", 40_000))
    model.make_levels()
    model.save(tmp_path / "a.pointray")
    browser = browse(tmp_path / "a.pointray")
    camera = browser.arrive()
    browser.set("samples", 1)
    browser.set("integrator", "normal")
    scene = pr.Scene()
    scene.add(model)
    shown = [expected(scene, camera, 1, integrator="normal", levels=levels) for levels in (True, False)]
    with_levels, without = shown
    for levels, pictures in ((True, (with_levels, without)), (False, (without, with_levels))):
        browser.set("levels", levels)
        browser.listen(lambda two=pictures: browser.frames and is_rather(browser.frames[-1], *two))
    browser.say(type="press", name="copy.command")
    assert " --no-levels" in browser.listen(lambda: browser.last("copy"))["text"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("nothing.ply", "nothing.ply: No such file or directory"),
        ("note.txt", "note.txt: "),
        ("cut.ply --strict", "cut.ply: is cut off: "),
        ("empty", "empty: contains no readable file"),
        ("scan.ply a.toml", "a.toml: a scene file cannot be combined with other files"),
        ("scan.ply --up 0,0,0", "--up must not be zero"),
        ("scan.ply --light moon:1,2,3", "--light must be like"),
        ("scan.ply --background blue", "--background must be three numbers"),
        ("scan.ply --radius-scale 0", "--radius-scale must be a positive number"),
        ("scan.ply --port 99999", "Invalid value for '--port'"),
        ("scan.ply --host 203.0.113.7 --no-open", "203.0.113.7"),
        ("scan.ply --host no.such.host.invalid --no-open", "no.such.host.invalid"),
    ],
)
def test_bad_input_of_view_is_refused(arguments, message, scan, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scan.ply").write_bytes(scan.read_bytes())
    (tmp_path / "note.txt").write_text("x")
    (tmp_path / "cut.ply").write_bytes(scan.read_bytes()[:20_000])
    (tmp_path / "empty").mkdir()
    (tmp_path / "a.toml").write_text("")
    assert execute(["view", *arguments.split()]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1, error
    assert logging.getLogger("pointray.view").handlers == []  # a caller's process is left as it was


def test_a_damaged_file_is_reported_on_the_page(browse, tmp_path):
    path = tmp_path / "cut.ply"
    rows = ["ply", "format ascii 1.0", "element vertex 3", *(f"property float {x}" for x in "xyz"), "end_header"]
    path.write_text("\n".join([*rows, "0 0 0", "1 0 zero", "0 1 0", ""]))
    browser = browse(path)
    toast = browser.listen(lambda: browser.last("toast"))
    assert toast["level"] == "error" and toast["stay"] and "cut.ply" in toast["text"]
