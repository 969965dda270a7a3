"""The default light of a scan: a studio with quickly baked light."""

import re
import threading
import time
from dataclasses import replace
from unittest.mock import MagicMock

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from pointray.auto_view.default_scene import QUICK
from pointray.auto_view.studio import studio
from pointray.base.choices import AUTO
from pointray.cli import execute, serve
from pointray.cli.read_options import Reading
from pointray.cli.scan_lights import ScanLights
from pointray.cli.scan_surface import PLAIN
from pointray.viewer.baker import ROUGH, Baker
from pointray.viewer.display import Display
from pointray.viewer.exports import Exports, _command
from pointray.viewer.painter import FrameRequest, Painter
from pointray.viewer.panel import Output, folders
from pointray.viewer.shared_scene import SharedScene
from pointray.viewer.view_settings import CHANGED, ViewSettings

SMALL = ["--size", "24x18", "--spp", "1"]
UP = (0.0, 0.0, 1.0)


@pytest.fixture
def scan(tmp_path):
    path = tmp_path / "scan.ply"
    points = pr.procedural("torus", 1_000)
    pr.write(path, pr.Points(points.positions, points.normals, points.colors, {"quality": points.positions[:, 2]}))
    return path


@pytest.fixture
def room(tmp_path):
    """A file of a room with floor, walls and ceiling, whose normals point inwards."""
    points = np.random.default_rng(0).uniform(-1, 1, (6_000, 3))
    axes, rows = np.arange(6_000) % 3, np.arange(6_000)
    points[rows, axes] = np.sign(points[rows, axes])
    normals = np.zeros_like(points)
    normals[rows, axes] = -points[rows, axes]
    pr.write(tmp_path / "room.ply", pr.Points(points * [3, 2.5, 1.5], normals))
    return tmp_path / "room.ply"


@pytest.fixture
def bakes(monkeypatch):
    """The settings of all bakes, which run with little work."""
    calls, real = [], pr.bake

    def bake(scene, settings=None, progress=None, client=None):
        calls.append(settings)
        return real(scene, pr.BakeSettings(patches=300, links=8), progress, client)

    monkeypatch.setattr(pr, "bake", bake)
    return calls


def run(capsys, *arguments):
    """Return the messages of a successful command, without the line about kernels."""
    capsys.readouterr()
    assert execute([str(a) for a in arguments]) == 0
    return re.sub(r"^Compiling .* kernels.*\n", "", capsys.readouterr().err, flags=re.MULTILINE)


# ------------------------------------------------------------------------------------------------- the command line


@pytest.mark.parametrize("more", [[], *map(long, (["--light", "studio"], ["--material", "phong"], ["--ground"]))])
def test_light_is_baked_quickly_and_the_headlight_option_is_named(scan, bakes, capsys, more):
    output = run(capsys, "render", scan, "-o", scan.with_name("a.png"), *SMALL, "--seed", "5", *more)
    (settings,) = bakes
    assert (settings.patches, settings.links) == (QUICK["patches"], QUICK["links"])
    assert settings.seed == 5
    assert "--light headlight" in output and output.count("\n") == 1


@pytest.mark.parametrize(
    "more",
    [
        *(["--integrator", name] for name in ("phong", "normal", "depth", "ao", "color", "path")),
        *(["--light", text] for text in ("headlight", "sun:1,1,-2", "sky:1,1,1")),
        ["--color-by", "quality"],
        ["--material", "glass"],
    ],
)
def test_nothing_is_baked_with_other_lights_or_integrators(scan, bakes, capsys, more):
    assert run(capsys, "render", scan, "-o", scan.with_name("a.png"), *SMALL, *more) == ""
    assert bakes == []


def test_requested_baking_has_full_quality(scan, bakes, capsys):
    run(capsys, "render", scan, "-o", scan.with_name("a.png"), *SMALL, "--integrator", "baked")
    assert bakes == [pr.BakeSettings(threads=bakes[0].threads)]


def test_a_film_is_lit_once(scan, bakes, capsys):
    film = ["--seconds", "1", "--fps", "3", *SMALL]
    assert "--light headlight" in run(capsys, "animate", scan, "-o", scan.with_name("film"), *film)
    assert len(bakes) == 1


def test_a_room_keeps_the_camera_light(room, bakes, capsys):
    """Sun and sky do not enter it: baked, it would be black."""
    pictures = [room.with_name(name) for name in ("a.npz", "b.npz")]
    for picture, more in zip(pictures, ([], ["--integrator", "phong"]), strict=True):
        assert "headlight" not in run(capsys, "render", room, "-o", picture, *SMALL, *more)
    assert bakes == []
    a, b = (np.load(picture) for picture in pictures)
    assert all(np.array_equal(a[name], b[name], equal_nan=True) for name in a.files)


def test_a_headlight_is_a_scene_without_lights(scan, capsys):
    picture = scan.with_name("a.npz")
    view = ["--eye", "0,-4,0", "--target", "0,0,0", "--up", "z"]
    run(capsys, "render", scan, "-o", picture, *SMALL, *view, "--light", "headlight", "--background", "none")
    scene = pr.Scene()
    scene.add(pr.Model(pr.read(scan)))
    camera = pr.Camera.look_at((0, -4, 0), (0, 0, 0), size=(24, 18))
    wanted = pr.render(scene, camera, pr.Settings(filter="blackman-harris"))
    assert np.abs(np.load(picture)["radiance"] - wanted).max() < 1e-6


@pytest.mark.parametrize(
    ("texts", "fill", "output"),
    [
        (["studio", "sun:1,1,-1"], None, "--light studio cannot be combined"),
        (["sky:1,1,1", "headlight"], None, "--light headlight cannot be combined"),
        (["headlight"], 0.5, "--fill requires"),
        (["studio"], 0.5, "--fill requires"),
        (["limelight"], None, "studio or headlight"),
    ],
)
def test_a_look_excludes_other_lights(texts, fill, output):
    with pytest.raises(ValueError, match=output):
        ScanLights(texts, fill)


def test_a_headlight_is_not_baked(scan, capsys):
    assert execute(["bake", str(scan), "-o", str(scan.with_name("a.bake")), "--light", "headlight"]) == 2
    assert "moves with the camera cannot be baked" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------------------- the viewer


def viewed(file, *, look=None, quick=True):
    """The shared scene of `pointray view` of a file, loaded."""
    options = {"up": None, "light": look, "fill": None, "background": AUTO, "ground": False, "normals": AUTO}
    options |= {"settings": pr.Settings("baked" if quick else "phong"), "bake": None, "quick": quick}
    options |= {"backfaces": None, "contact_shadow": True}
    shared, loader = serve.shared_scene_of([file], Reading(), {}, options, dict(PLAIN))
    shared.load(loader).join(120)
    assert shared.problem == ""
    return shared


def light_row(view, shared):
    """The panel's choice of the light."""
    rows = [row for folder in folders(view, shared, Output(), shared.scene) for row in folder.controls]
    return next(row for row in rows if row.name == "look")


def test_the_viewer_shows_a_studio_and_the_panel_offers_a_headlight(scan):
    shared = viewed(scan)
    view = ViewSettings.of(shared, shared.scene)
    assert view.integrator == "baked" and not any(lamp.camera for lamp in view.lamps)
    row = light_row(view, shared)
    assert row.value == "studio" and [name for name, _ in row.options] == ["studio", "headlight"]
    moved = view.with_value("lamps.0.azimuth", 5.0)
    assert light_row(moved, shared).value == CHANGED
    lamp = view.lit_by((), UP, "baked")
    assert (lamp.lamps, lamp.integrator, light_row(lamp, shared).value) == ((), "phong", "headlight")
    again = lamp.in_studio(studio(UP, 25.0), UP)
    assert again.integrator == "baked" and light_row(again, shared).value == "studio"


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:most normals point inward")
def test_the_viewer_of_a_headlight_and_of_a_room(scan, room):
    shared = viewed(scan, look=["headlight"], quick=False)
    assert len(shared.scene.lights) == 0 and ViewSettings.of(shared, shared.scene).look == "headlight"
    shared = viewed(room)
    view = ViewSettings.of(shared, shared.scene)
    assert view.integrator == "phong" and view.look == "studio" and view.lamps[0].camera


def test_the_lights_of_a_scene_are_a_separate_choice():
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("sphere", 1_000)))
    scene.add_light(pr.SunLight([1, 1, -1]))
    shared = SharedScene("a", scene)
    view = ViewSettings.of(shared, scene)
    row = light_row(view, shared)
    assert row.value == CHANGED and "own" in dict(row.options)
    assert light_row(view.in_studio(studio(UP), UP), shared).value == "studio"


def ball():
    """Return a scene under a sky, whose model may get levels of detail."""
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("torus", 12_000)), material=pr.Diffuse(0.5))
    scene.add_light(pr.EnvironmentLight())
    return scene


def wait_for(condition):
    end = time.monotonic() + 120
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.01)
    return found


@pytest.mark.long
def test_light_is_rough_while_models_are_built_and_levels_are_lit_later():
    baker = Baker(lambda: None, lambda *output: None)
    first = ball()
    (model,) = first.models
    light = wait_for(lambda: baker.light_for(first, fine=False))
    assert light._settings.links == ROUGH[1]
    wait_for(lambda: not baker.is_baking)
    assert baker.fine_for(first) is None
    model.make_levels()
    second = first.copy()
    second.update(0, material=pr.Diffuse(0.5))  # another snapshot
    shown = baker.light_for(second, fine=False)
    assert shown is light and shown.lacks_levels(second), "there must be light at every moment"
    wait_for(lambda: not baker.light_for(second, fine=False).lacks_levels(second))
    wait_for(lambda: baker.light_for(second, fine=True) is baker.fine_for(second) is not None)
    assert not baker.is_baking
    baker.close()


@pytest.mark.parametrize(
    ("integrator", "lights", "expected"),
    [("baked", studio(UP, 25.0), None), ("phong", (), "--light headlight"), ("phong", studio(UP), "--fill 0")],
)
def test_the_command_of_a_view_includes_its_light(integrator, lights, expected):
    view = replace(ViewSettings().in_studio(lights, UP), integrator=integrator)
    request = FrameRequest(pr.Camera.look_at((0, -4, 0), (0, 0, 0)), view, pr.Scene(), (1, 0), UP, True, 0.0)
    command = _command(request, Output(), "scan.ply")
    assert f"--integrator {integrator} " in command
    assert expected in command if expected else "--light" not in command


@pytest.mark.parametrize("bakes", [False, True])
def test_a_coarse_version_is_not_baked(bakes):
    """Baking would slow down building the full model."""
    scene, frames = ball(), []
    painter = Painter(frames.append, pytest.fail, lambda *output: None)
    view = replace(ViewSettings.of(SharedScene("a", scene), scene), integrator="baked", samples=1)
    camera = pr.frame(scene, size=(16, 12))
    painter.want(FrameRequest(camera, view, scene, (1, 0), UP, False, 0.0, bakes=bakes))
    wait_for(lambda: frames)
    assert (painter._baker._thread is not None) == bakes
    painter.close()


class Page:
    """Collects messages of an export."""

    def __init__(self):
        self.stages, self.made, self.is_local = [], threading.Event(), True

    def progress(self, progress):
        self.stages.append(progress.stage)

    def file(self, path, mime):
        self.made.set()

    def toast(self, level, text):
        pytest.fail(text)


@pytest.mark.long
@pytest.mark.parametrize("known", [False, long(True)])
def test_an_export_bakes_with_progress_unless_light_exists(known):
    scene, page = ball(), Page()
    light = pr.bake(scene, pr.BakeSettings(patches=300, links=8))
    exports = Exports(page, lambda scene: light if known else None)
    view = ViewSettings(integrator="baked", lamps=ViewSettings.of(SharedScene("a", scene), scene).lamps)
    request = FrameRequest(pr.frame(scene, size=(8, 8)), view, scene, (1, 0), UP, True, 0.0)
    exports.start("save.picture", request, Output(16, 12, 1), SharedScene("a", scene))
    assert page.made.wait(120)
    assert ("baking light" in page.stages) != known
    assert "picture" in page.stages


def test_the_lights_of_a_loaded_scan_are_those_of_the_studio():
    """Tested for the coarse version and for all points, with equal or different lights."""
    shared = SharedScene("a")
    shared.look = "studio"
    display = Display(shared, MagicMock(), MagicMock(), MagicMock())
    for azimuth in (25.0, 25.0, 30.0):
        scene = ball()
        scene.lights = studio(UP, azimuth)
        display._set_scene(scene)
        assert display.view.look == "studio" and len(display.view.lamps) == 3
