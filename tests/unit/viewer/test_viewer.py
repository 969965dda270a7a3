"""The viewer's server without a browser page: what it sends, draws and refuses."""

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus

import pointray as pr
from helpers.viewer_client import CLOSE, SECONDS, SIZE, Browser, compile_kernels, expected, levels_in, scene_of
from pointray.auto_view.direction import axes_of
from pointray.engine.kernels.records import ACROSS, FORWARD, UPWARD
from pointray.viewer import queries as lookups, session
from pointray.viewer.controls import Control
from pointray.viewer.light_control import SUN, LightControl, light_controls_of
from pointray.viewer.messages import camera_of, free_of, parse, size_of
from pointray.viewer.pace import HEADROOM, MOVING, REFINED, SCALES, STILL, Pace, next_pass
from pointray.viewer.painter import FrameRequest, Painter
from pointray.viewer.pick import pick
from pointray.viewer.session import MAX_LOGGED
from pointray.viewer.shared_scene import Build, SharedScene
from pointray.viewer.view_settings import ViewSettings
from pointray.viewer.viewer import Viewer

SAMPLES = 4  # per pixel of finished pictures; the viewer's default is 64


@pytest.fixture(scope="module")
def model():
    points = pr.procedural("statue", 5_000)
    grey = np.full((len(points), 3), 180, np.uint8)
    high = points.positions[:, 2].astype(np.float32)
    model = pr.Model(pr.Points(points.positions, points.normals, grey, {"height": high}))
    compile_kernels(scene_of(model))
    return model


@pytest.fixture
def scene(model):
    return scene_of(model)


@pytest.fixture
def viewer(scene):
    viewer = Viewer(SharedScene("statue", scene, source="my scans/statue.ply"))
    yield viewer
    viewer.close()


def visit(viewer, size=SIZE):
    """Return a browser whose finished pictures have few samples."""
    browser = Browser(viewer.url, size)
    browser.set("samples", SAMPLES)
    return browser


@pytest.fixture
def browser(viewer):
    browser = visit(viewer)
    yield browser
    browser.close()


def test_pictures_equal_those_of_render(viewer, scene):
    browser = Browser(viewer.url, SIZE)
    camera = browser.arrive()
    header, _ = frame = browser.refined(64)
    assert (header["width"], header["height"]) == SIZE
    assert np.abs(levels_in(frame[1]) - expected(scene, camera, 64)).mean() < CLOSE
    assert [f[0]["stage"] for f in browser.frames][-1] == "refined"
    browser.close()


def test_a_still_picture_is_complete_before_it_is_refined(browser):
    browser.arrive()
    browser.refined(SAMPLES)
    stages = [(f[0]["stage"], f[0]["samples"]) for f in browser.frames]
    assert ("still", 1) in stages
    samples = [s for _, s in stages[stages.index(("still", 1)) :]]
    assert samples == sorted(samples)


def test_the_model_fits_into_views_of_any_shape(viewer, scene):
    points = scene.models[0].points.positions
    for size in ((300, 60), (60, 300)):
        browser = visit(viewer, size)
        camera = browser.arrive()
        view = pr.Camera.look_at(camera["eye"], camera["target"], camera["up"], camera["fov"], size).record()
        forward, across, upward = (view[k : k + 3] for k in (FORWARD, ACROSS, UPWARD))
        away = points - camera["eye"]
        positions = np.stack([away @ axis / (axis @ axis) / (away @ forward) for axis in (across, upward)])
        assert 0.8 < np.abs(positions).max() < 1.0
        browser.close()


def test_sending_the_same_camera_again_changes_nothing(browser):
    camera = browser.arrive()
    browser.refined(SAMPLES)
    count = len(browser.frames)
    browser.go(camera, time=5.0)
    browser.say(type="pick", purpose="query", extend=False, x=0.5, y=0.5)
    browser.listen(lambda: browser.last("picked"))  # the answer to a later message
    assert len(browser.frames) == count
    browser.go(camera, fov=30.0, time=6.0)
    browser.refined(SAMPLES)
    assert {header["time"] for header, _ in browser.frames[count:]} == {6.0}


def test_another_camera_gives_another_picture(browser, scene):
    camera = browser.arrive()
    browser.refined(SAMPLES)
    eye, target = np.array(camera["eye"]), np.array(camera["target"])
    other = {**camera, "eye": (target + (eye - target)[[1, 0, 2]] * [1, -1, 1]).tolist()}
    browser.go(other)
    assert browser.shows(SAMPLES, expected(scene, other, SAMPLES))
    assert np.abs(levels_in(browser.frames[-1][1]) - expected(scene, camera, SAMPLES)).mean() > 3.0


@pytest.mark.long
def test_two_browsers_have_cameras_of_their_own(viewer, scene):
    one, two = visit(viewer), visit(viewer, (100, 100))
    first, second = one.arrive(), two.listen(lambda: two.last("camera"))
    nearer = {**second, "eye": (np.array(second["eye"]) * 0.6 + np.array(second["target"]) * 0.4).tolist()}
    two.go(nearer)
    frames = one.refined(SAMPLES), two.refined(SAMPLES)
    assert np.abs(levels_in(frames[0][1]) - expected(scene, first, SAMPLES)).mean() < CLOSE
    assert np.abs(levels_in(frames[1][1]) - expected(scene, nearer, SAMPLES, (100, 100))).mean() < CLOSE
    one.close()
    two.close()


def test_panel_changes_the_picture(browser, scene):
    camera = browser.arrive()
    browser.refined(SAMPLES)
    for name, value, settings in (
        ("integrator", "normal", {"integrator": "normal"}),
        ("integrator", "phong", {}),
        ("shadows", False, {"shadows": False}),
    ):
        browser.set(name, value)
        assert browser.shows(SAMPLES, expected(scene, camera, SAMPLES, **settings)), name


def test_lights_are_added_and_removed(browser, scene):
    browser.arrive()
    lit = levels_in(browser.refined(SAMPLES)[1])
    browser.set("lamps.0.on", False)
    head = levels_in(browser.refined(SAMPLES)[1])
    assert np.abs(lit - head).mean() > 3.0
    browser.say(type="press", name="lamps.add.sun")
    browser.listen(lambda: "lamps.1.azimuth" in browser.controls())
    browser.say(type="press", name="lamps.1.remove")
    browser.say(type="press", name="lamps.0.remove")
    browser.listen(lambda: "no_lamps" in browser.controls())
    assert np.abs(levels_in(browser.refined(SAMPLES)[1]) - head).mean() < CLOSE
    assert len(scene.lights) == 1  # the scene itself is unchanged


@pytest.mark.long
def test_lights_with_arrays_can_be_removed(browser, scene):
    edges = np.array([0.0, 0, 1]), np.array([1.0, 0, 0])
    scene.lights = [pr.RectLight(np.array([0.0, -3, k]), *edges, np.array([k, 1.0, 1])) for k in (2.0, 3.0)]
    browser.arrive()
    browser.listen(lambda: "lamps.1.on" in browser.controls())
    both = levels_in(browser.refined(SAMPLES)[1])
    browser.say(type="press", name="lamps.0.remove")
    browser.listen(lambda: "lamps.1.on" not in browser.controls())
    assert np.abs(levels_in(browser.refined(SAMPLES)[1]) - both).mean() > CLOSE


def test_dragging_the_sun_updates_the_panel(browser):
    browser.arrive()
    browser.refined(SAMPLES)
    before = browser.controls()["lamps.0.azimuth"]["value"]
    browser.say(type="sun", dx=0.1, dy=0.0)
    values = browser.listen(lambda: browser.last("values"))["values"]  # sent for no other reason
    assert values["lamps.0.azimuth"] == pytest.approx(before + 18.0)


def test_attributes_colour_with_a_legend(browser, scene, model):
    camera = browser.arrive()
    browser.refined(SAMPLES)
    browser.set("color_by", "height")
    painted = pr.Scene()
    painted.add(model, material=pr.Diffuse(pr.Attribute("height")))
    painted.lights = scene.lights
    assert browser.shows(SAMPLES, expected(painted, camera, SAMPLES))
    legend = browser.listen(lambda: (m := browser.last("legend")) and m["image"])
    assert legend.startswith("data:image/png;base64,")
    assert "colormap" in browser.controls()


def test_clipping_opens_the_model(browser, scene):
    camera = browser.arrive()
    browser.refined(SAMPLES)
    browser.set("cuts.2.on", True)
    cut = scene.copy()
    cut.clips = [(scene.bounds.mean(axis=0), (0, 0, 1))]
    assert browser.shows(SAMPLES, expected(cut, camera, SAMPLES))


def test_a_click_shows_coordinates_and_attributes(browser, scene, model):
    camera = browser.arrive()
    view = pr.Camera.look_at(camera["eye"], camera["target"], camera["up"], camera["fov"], SIZE)
    hits = scene.intersect(*view.rays(), attributes=())
    rows, columns = np.nonzero(hits.instance == 0)
    y, x = rows[len(rows) // 2], columns[len(rows) // 2]
    pixel = {"x": (x + 0.5) / SIZE[0], "y": (y + 0.5) / SIZE[1]}
    browser.say(type="pick", purpose="query", extend=False, **pixel)
    picked = browser.listen(lambda: browser.last("picked"))
    assert picked["position"] == pytest.approx(hits.position[y, x].tolist(), abs=1e-6)
    row = int(hits.point[y, x])
    assert f"point {row:,}" in picked["lines"]
    assert "colour 180 180 180" in picked["lines"]
    assert f"height {model.points.attributes['height'][row]!s}" in picked["lines"]
    k = len(rows) // 3
    other = {"x": (columns[k] + 0.5) / SIZE[0], "y": (rows[k] + 0.5) / SIZE[1]}
    browser.say(type="pick", purpose="query", extend=True, **other)
    measured = browser.listen(lambda: browser.last("measured"))
    length = np.linalg.norm(hits.position[rows[k], columns[k]] - hits.position[y, x])
    assert float(measured["text"]) == pytest.approx(length, rel=1e-4)
    browser.say(type="pick", purpose="target", extend=False, **pixel)
    assert browser.listen(lambda: browser.last("target"))["position"] == picked["position"]


def test_the_kernel_of_clicks_is_loaded_after_the_first_picture(viewer, monkeypatch):
    """Clicks must not wait seconds for their kernel while pictures refine."""
    prepared = []
    monkeypatch.setattr(lookups, "prepare", prepared.append)
    with closing(visit(viewer)) as browser:
        browser.arrive()
        browser.listen(lambda: browser.frames)
        browser.refined(2)
    assert len(prepared) == 1


def test_of_clicks_during_another_only_the_last_is_answered(browser, monkeypatch):
    """On a slow machine only the clicks in between are dropped."""
    busy, go, asked = threading.Event(), threading.Event(), []

    def slow(scene, camera, x, y):
        asked.append(x)
        busy.set()
        assert go.wait(SECONDS)
        return pick(scene, camera, x, y)

    monkeypatch.setattr(lookups, "pick", slow)
    browser.arrive()
    browser.say(type="pick", purpose="query", extend=False, x=0.5, y=0.5)
    assert busy.wait(SECONDS)
    for x in (0.1, 0.2, 0.51):
        browser.say(type="pick", purpose="query", extend=True, x=x, y=0.5)
    before = browser.last("camera")
    browser.say(type="view", name="front")  # answered after the clicks
    browser.listen(lambda: browser.last("camera") is not before)
    go.set()
    assert float(browser.listen(lambda: len(asked) > 2 and browser.last("measured"))["text"]) > 0
    assert asked == [0.5, 0.2, 0.51]  # the distance is from the previous click


def test_a_distance_is_measured_from_a_pending_click():
    """Of two quick clicks while the thread is busy, the second does not replace the first."""
    go, found = threading.Event(), []
    with ThreadPoolExecutor(1) as jobs:
        jobs.submit(go.wait, SECONDS)
        newest = lookups.Newest(jobs, found.append, needed_by=lambda question: question > 2)
        for question in (1, 2, 3):
            newest.ask(question)
        go.set()
    assert found == [2, 3]


def test_a_rebuilt_surface_is_shown_in_all_browsers(browser, viewer):
    browser.arrive()
    browser.refined(SAMPLES)
    browser.set("build.surface", "disc")
    browser.listen(lambda: browser.controls()["build.surface"]["value"] == "disc")
    two = visit(viewer)
    two.arrive()
    two.listen(lambda: two.last("panel") and two.controls().get("build.surface", {}).get("value") == "disc")
    two.close()
    browser.set("build.radius_scale", 1.5)
    browser.listen(lambda: browser.controls()["build.radius_scale"]["value"] == 1.5)


@pytest.mark.long
def test_a_rebuilt_model_still_follows_its_scene(browser, scene, model):
    camera = browser.arrive()
    browser.refined(SAMPLES)
    browser.set("build.surface", "disc")
    browser.listen(lambda: browser.controls()["build.surface"]["value"] == "disc")
    browser.refined(SAMPLES)
    scene.add(model, pr.transform((0.3, 0.2, 0)))
    discs, other = pr.Model(model.points, model.radii, surface="disc"), pr.Scene()
    other.add(discs)
    other.add(discs, pr.transform((0.3, 0.2, 0)))
    other.lights = scene.lights
    assert browser.shows(SAMPLES, expected(other, camera, SAMPLES))


def test_of_many_surface_changes_the_newest_is_built(scene, monkeypatch):
    built = []
    whole = pr.Model.rebuild
    monkeypatch.setattr(pr.Model, "rebuild", lambda self, *a, **k: (built.append(k), whole(self, *a, **k))[1])
    shared = SharedScene("x", scene)
    scales = [1.0 + k / 20 for k in range(1, 9)]
    threads = [shared.rebuild(surface="imls"), *(shared.rebuild(radius_scale=scale) for scale in scales)]
    for thread in threads:
        thread.join()
    assert shared.build == Build("imls", 4, scales[-1]) and 1 <= len(built) <= 3 * len(scene.models)
    assert shared.scene.models[0].surface == "imls" and scene.models[0].surface == "apss"


def test_a_given_noise_is_kept_until_another_is_chosen():
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("torus", 500), smooth=0.02))
    shared = SharedScene("x", scene)
    radius = scene.models[0].spacing
    changes = [
        ({"samples": 6}, 0.02),
        ({"noise": 0.0}, 0.0),
        ({"noise": 0.25}, 0.25 * radius),
        ({"measured": True}, "auto"),
    ]
    for change, smooth in changes:
        shared.rebuild(**change).join()
        assert shared.scene.models[0].smooth == smooth
        assert shared.build.measured is (smooth == "auto")
    assert shared.build.noise == 0.0  # as measured


def test_the_panel_shows_the_noise_that_was_measured(rng):
    points = pr.procedural("torus", 2000)
    noise = 0.3 * pr.Model(points).spacing
    scene = pr.Scene()
    scene.add(pr.Model(points.positions + rng.normal(size=(2000, 3)) * noise))
    build = SharedScene("x", scene).build
    assert build.measured
    assert build.noise == pytest.approx(0.3, abs=0.08)


def test_changes_of_the_scene_by_its_owner_are_shown(browser, scene):
    camera = browser.arrive()
    browser.refined(SAMPLES)
    scene.add(pr.Plane([0, 0, 0], [0, 0, 1]))
    assert browser.shows(SAMPLES, expected(scene, camera, SAMPLES))


def test_a_saved_picture_equals_that_of_render(browser, scene):
    camera = browser.arrive()
    for name, value in (("width", 90), ("height", 70), ("samples", 4)):
        browser.set(f"output.{name}", value)
    browser.say(type="press", name="save.picture")
    header, payload = browser.listen(lambda: browser.files and browser.files[0])
    assert header["name"] == "statue.png"
    image = levels_in(payload)
    assert image.shape == (70, 90, 3)
    assert np.abs(image - expected(scene, camera, 4, (90, 70))).max() <= 1


def test_a_recorded_turntable_is_a_film(browser):
    pytest.importorskip("imageio_ffmpeg")
    browser.arrive()
    for name, value in (("width", 32), ("height", 32), ("samples", 1), ("seconds", 0.5), ("fps", 8.0)):
        browser.set(f"output.{name}", value)
    browser.say(type="press", name="save.film")
    header, payload = browser.listen(lambda: browser.files and browser.files[0])
    assert header["name"] == "statue.mp4"
    assert payload[4:8] == b"ftyp"


def test_the_camera_is_copied_as_a_command_and_as_python(browser, scene):
    camera = browser.arrive()
    browser.say(type="press", name="copy.command")
    text = browser.listen(lambda: browser.last("copy"))["text"]
    assert text.startswith("pointray render 'my scans/statue.ply' -o picture.png --eye=")
    assert " --light sun:" in text
    browser.say(type="press", name="copy.python")
    text = browser.listen(lambda: (m := browser.last("copy")) and m["text"].startswith("camera") and m["text"])
    names = {"pr": pr, "scene": scene}
    exec(text.split("image =")[0], names)
    assert names["camera"].eye == pytest.approx(camera["eye"])


def test_views_look_along_their_axes(browser, scene):
    browser.arrive()
    middle = scene.bounds.mean(axis=0)
    for name, axis, sign in (("front", 1, -1), ("back", 1, 1), ("left", 0, -1), ("right", 0, 1), ("top", 2, 1)):
        count = len(browser.told)
        browser.say(type="view", name=name)
        camera = browser.listen(lambda n=count: next((m for m in browser.told[n:] if m["type"] == "camera"), None))
        offset = np.array(camera["eye"]) - middle
        assert np.abs(offset).argmax() == axis and np.sign(offset[axis]) == sign, name


NONSENSE = (
    "",
    "{",
    "[" * 20_000,
    "null",
    '"camera"',
    '{"type": 3}',
    '{"type": "unknown"}',
    '{"type": "camera"}',
    '{"type": "camera", "eye": [1, 2], "target": [0, 0, 0], "up": [0, 0, 1], "fov": 40, "time": 1}',
    '{"type": "camera", "eye": [1, 2, NaN], "target": [0, 0, 0], "up": [0, 0, 1], "fov": 40, "time": 1}',
    '{"type": "camera", "eye": [1, 2, 3], "target": [1, 2, 3], "up": [0, 0, 1], "fov": 40, "time": 1}',
    '{"type": "camera", "eye": [1, 2, 3], "target": [0, 0, 0], "up": [0, 0, 0], "fov": 400, "time": 1}',
    '{"type": "size", "width": 1e400, "height": 0}',
    '{"type": "size", "width": "a", "height": [1]}',
    '{"type": "set", "name": "integrator", "value": "magic"}',
    '{"type": "set", "name": "__class__", "value": 1}',
    '{"type": "set", "name": "lamps.99.on", "value": true}',
    '{"type": "set", "name": "exposure", "value": 1e9}',
    '{"type": "set", "name": "samples", "value": 64.5}',
    '{"type": "press", "name": "save.picture.now"}',
    '{"type": "press", "name": "lamps.-1.remove"}',
    '{"type": "pick", "x": 2, "y": 0, "purpose": "query"}',
    '{"type": "pick", "x": 0.5, "y": 0.5, "purpose": 7}',
    '{"type": "view", "name": "inside"}',
    '{"type": "seen", "number": 1e300}',
    '{"type": "seen", "number": -1}',
    '{"type": "sun", "dx": null, "dy": 0}',
)


def test_invalid_messages_are_ignored(browser, scene, caplog):
    camera = browser.arrive()
    browser.refined(SAMPLES)
    for text in NONSENSE:
        browser.say_text(text)
    browser.go(camera, fov=30.0)
    assert browser.shows(SAMPLES, expected(scene, {**camera, "fov": 30.0}, SAMPLES))
    assert browser.last("toast") is None
    output = [record.message for record in caplog.records if record.name == "pointray.view"]
    assert len(output) == MAX_LOGGED and all(text.startswith("ignored a message of the page: ") for text in output)


def test_pages_of_other_origins_are_refused(viewer):
    for origin in ("http://evil.example", "http://evil.example:8080", "null"):
        with pytest.raises(InvalidStatus, match="403"):
            Browser(viewer.url, origin=origin)
    Browser(viewer.url, origin=f"http://127.0.0.1:{viewer.port}").close()


def test_the_next_free_port_is_taken(scene):
    one = Viewer(SharedScene("one", scene))
    two = Viewer(SharedScene("two", scene), port=one.port)
    assert two.port > one.port
    one.close()
    two.close()


def test_an_address_of_another_machine_is_refused(scene):
    with pytest.raises(OSError):
        Viewer(SharedScene("x", scene), host="203.0.113.7")


def test_closing_ends_all_threads(scene):
    def threads():
        return [t for t in threading.enumerate() if t.name.startswith("pointray")]

    before = set(threads())
    viewer = Viewer(SharedScene("x", scene))
    for _ in range(5):
        browser = visit(viewer)
        browser.arrive()
        browser.listen(lambda b=browser: b.frames)
        browser.close()
    viewer.close()
    end = time.monotonic() + SECONDS
    while set(threads()) - before and time.monotonic() < end:
        time.sleep(0.01)
    assert not set(threads()) - before


def test_an_error_of_the_loader_is_reported():
    def loader(shared):
        shared.report("reading", 0.5)
        raise ValueError("bad.ply: it is truncated")

    shared = SharedScene("bad.ply")
    viewer = Viewer(shared)
    browser = Browser(viewer.url, SIZE)
    shared.load(loader)
    toast = browser.listen(lambda: browser.last("toast"))
    assert toast == {"type": "toast", "level": "error", "text": "bad.ply: it is truncated", "stay": True}
    browser.listen(lambda: (m := browser.last("progress")) and m["stage"] == "")
    browser.close()
    viewer.close()


@pytest.mark.parametrize(
    ("kind", "options", "good", "bad"),
    [
        ("range", {"value": 1.0, "low": 0, "high": 2}, [0, 2, 1.5], [-1, 3, "1", None, True, [1]]),
        ("range", {"value": 4, "low": 2, "high": 16}, [2, 3.0], [2.5, 17]),
        ("switch", {"value": True}, [True, False], [1, "yes", None]),
        ("choice", {"value": "a", "options": [("a", "A"), ("b", "B")]}, ["a", "b"], ["c", 1, None, ["a"]]),
        ("color", {"value": (1, 1, 1)}, [[0, 0.5, 1]], [[2, 0, 0], [0, 0], "red"]),
        ("vector", {"value": (0, 0, 0)}, [[1, 2, -3e6]], [[1, 2], [1, 2, "x"], 4]),
        ("button", {}, [], [1, None, True]),
        ("note", {"value": "x"}, [], ["y"]),
    ],
)
def test_controls_refuse_bad_values(kind, options, good, bad):
    control = Control("it", "it", kind, **options)
    for value in good:
        control.check(value)
    for value in bad:
        with pytest.raises(ValueError, match="it"):
            control.check(value)


def test_messages_are_parsed_and_validated():
    with pytest.raises(ValueError):
        parse("[]")
    assert size_of({"width": 100.7, "height": 50}) == (100, 50)
    assert size_of({"width": 7680, "height": 4320}) == (3840, 2160)
    assert free_of({"width": 100, "height": 50}) == (0, 0, 100, 50)
    assert free_of({"width": 100, "height": 50, "free": [0, 10, 70.2, 50]}) == (0, 10, 70, 50)
    assert free_of({"width": 7680, "height": 4320, "free": [0, 20, 5000, 4320]}) == (0, 10, 2500, 2160)
    for free in (None, [0, 0, 1], [0, 0, "1", 2], [70, 0, 70, 50], [0, 0, 101, 50], [-1, 0, 100, 50], [0, 0, 100, 1e9]):
        with pytest.raises(ValueError, match="free"):
            free_of({"width": 100, "height": 50, "free": free})
    message = {"eye": [1, 2, 3], "target": [0, 0, 0], "up": [0, 0, 1], "fov": 30}
    assert camera_of(message, (4, 3)).size == (4, 3)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 1, 0), (0, 0, -1), (0.3, -0.2, 0.9)])
def test_lamps_reproduce_the_lights_they_are_made_of(up):
    axes = axes_of(up)
    assert np.allclose(axes @ axes.T, np.eye(3)) and np.allclose(axes[2], np.array(up) / np.linalg.norm(up))
    scene = pr.Scene()
    scene.lights = [pr.SunLight([1, 2, -3], (3, 2, 1), 0.7), pr.PointLight([1, 2, 3], 4), pr.EnvironmentLight(2.0)]
    sun, point, sky = light_controls_of(scene, up)
    assert [lamp.make(up) for lamp in (sun, point, sky)] == list(scene.lights)  # nothing has changed: to the last bit
    changed = replace(sun, azimuth=sun.azimuth + 1)
    assert changed.make(up) is not scene.lights[0] and replace(changed, azimuth=sun.azimuth).make(up) is scene.lights[0]
    sun, point = (replace(lamp, original=None) for lamp in (sun, point))
    made = sun.make(up)
    assert np.allclose(made.direction, np.array([1, 2, -3]) / np.sqrt(14))
    assert np.allclose(made.irradiance, (3, 2, 1), rtol=1e-4) and made.angle == 0.7
    assert np.allclose(point.make(up).intensity, 4) and point.make(up).position == (1, 2, 3)
    assert LightControl(SUN, azimuth=0, elevation=90).make(up).direction == pytest.approx(-axes[2])


def test_pace_keeps_the_frame_rate():
    for whole in (0.01, 0.05, 0.2, 1.0, 10.0):
        pace = Pace()
        for _ in range(40):
            scale = pace.scale()
            pace.record(whole * scale * scale, scale)
        assert whole * scale * scale <= SCALES[scale] or scale == min(SCALES)
        finer = min((s for s in SCALES if s > scale), default=None)
        assert finer is None or whole * finer * finer > HEADROOM * SCALES[finer]
    assert next_pass(1, 10.0) == 1
    assert next_pass(8, 0.01) == 16


def test_view_accepts_a_scene(scene, capsys):
    viewer = pr.view(scene, open_browser=False, block=False)
    assert viewer.url in capsys.readouterr().out
    browser = visit(viewer)
    camera = browser.arrive()
    assert browser.shows(SAMPLES, expected(scene, camera, SAMPLES))
    assert f'src="{viewer.url}"' in viewer._repr_html_()
    browser.close()
    viewer.close()
    with pytest.raises(ValueError, match="scene must be a Scene, a Model, Points"):
        pr.view(3)


def test_a_scene_without_models_waits_for_one(model):
    scene = pr.Scene()
    viewer = Viewer(SharedScene("empty", scene))
    browser = Browser(viewer.url, SIZE)
    browser.listen(lambda: browser.last("panel"))
    scene.add(model)
    browser.arrive()
    browser.listen(lambda: "samples" in browser.controls())
    browser.set("samples", SAMPLES)
    browser.refined(SAMPLES)
    browser.close()
    viewer.close()


def test_clip_planes_of_the_scene_are_kept(browser, scene):
    scene.clips = [(scene.bounds.mean(axis=0), (0, 0, 1))]
    camera = browser.arrive()
    browser.set("cuts.0.on", True)
    both = scene.copy()
    both.clips = [*map(tuple, scene.clips), (scene.bounds.mean(axis=0), (1, 0, 0))]
    wanted = expected(both, camera, SAMPLES)
    assert browser.shows(SAMPLES, wanted)


def test_changes_of_lights_are_kept_when_the_full_scan_replaces_the_coarse_one(model, scene):
    shared = SharedScene("x", scene)
    viewer = Viewer(shared)
    browser = visit(viewer)
    browser.arrive()
    browser.say(type="press", name="lamps.add.point")
    browser.listen(lambda: "lamps.1.position" in browser.controls())
    whole = pr.Scene()
    whole.add(pr.Model(model.points))
    whole.lights = scene.lights
    told = len(browser.told)
    shared.show(whole)
    browser.listen(lambda: any(m["type"] == "place" for m in browser.told[told:]))
    told = len(browser.told)
    browser.say(type="view", name="front")  # answered after the panel of the new scene
    browser.listen(lambda: any(m["type"] == "camera" for m in browser.told[told:]))
    assert "lamps.1.position" in browser.controls()
    browser.close()
    viewer.close()


def test_a_surface_that_cannot_be_built_is_reported_and_discarded(browser, monkeypatch):
    whole = pr.Model.rebuild

    def refuse(self, *arguments, **options):
        if options["surface"] == "paper":
            raise ValueError("not this one")
        return whole(self, *arguments, **options)

    browser.arrive()
    monkeypatch.setattr(pr.Model, "rebuild", refuse)
    for _ in range(2):
        told = len(browser.told)
        browser.set("build.surface", "paper")
        browser.listen(
            lambda n=told: any(m["type"] == "toast" and m["text"] == "not this one" for m in browser.told[n:])
        )
    browser.set("build.samples", 8)
    browser.listen(lambda: browser.controls()["build.samples"]["value"] == 8)
    assert browser.controls()["build.surface"]["value"] == "apss"


def test_the_automatic_range_can_be_changed(browser, scene, model):
    camera = browser.arrive()
    browser.set("color_by", "height")
    browser.listen(lambda: "low" in browser.controls())
    browser.set("low", 1.0)
    painted = pr.Scene()
    painted.add(
        model, material=pr.Diffuse(pr.Attribute("height", "viridis", (1.0, browser.controls()["high"]["value"])))
    )
    painted.lights = scene.lights
    wanted = expected(painted, camera, SAMPLES)
    assert browser.shows(SAMPLES, wanted)


class Deaf:
    """A `link.Link` without a client."""

    is_local = True

    def send(self, message):
        pass


def test_a_browser_may_leave_while_it_receives_a_change(scene, caplog):
    shared, sessions = SharedScene("x", scene), []
    shared.subscribe(lambda: sessions[0].leave() if sessions else None)  # this message comes before the session exists
    sessions.append(session.Session(Deaf(), shared, sessions.append))
    sessions[0].receive(json.dumps({"type": "size", "width": 64, "height": 48, "scale": 1}))
    sessions[0].receive(json.dumps({"type": "set", "name": "color_by", "value": "height"}))
    shared.show(scene)
    assert len(sessions) == 2  # the browser has left
    assert not [record.message for record in caplog.records if record.name == "pointray.view"]


def test_the_exposure_does_not_flicker_while_the_camera_moves():
    """It is chosen again if settings change, or if a still picture needs much more or less."""
    painter = Painter(lambda frame: None, lambda text: None, lambda stage, share, seconds: None)
    camera = pr.Camera.look_at((0, -3, 0), (0, 0, 0), size=(8, 8))

    def shown(level, stage, settings):
        image = np.full((8, 8, 4), level, np.float32)
        image[..., 3] = 1
        return painter._tone(
            FrameRequest(camera, settings, pr.Scene(), (1, 0), (0.0, 0.0, 1.0), True, 0.0), image, stage
        )

    settings = ViewSettings(exposes=True)
    first = shown(0.24, MOVING, settings)
    assert first == (0.0, "neutral")
    assert shown(0.06, MOVING, settings) == first and shown(0.23, STILL, settings) == first
    assert shown(0.06, REFINED, settings) == first
    dark = 1.5, "neutral"  # half of the second stop
    assert shown(0.06, STILL, settings) == dark == shown(0.24, MOVING, settings)
    assert shown(0.24, MOVING, settings.with_value("exposure", 1.0)) == (1.0, "neutral")
    assert shown(0.06, STILL, ViewSettings(exposes=False, exposure=0.5)) == (0.5, "srgb")
    painter.close()
