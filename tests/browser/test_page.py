"""The viewer's page in a browser, driven by mouse and keys; its pictures are compared with those of `render`."""

import http.server
import json
import re
import shlex
import threading
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from math import radians, tan

import numpy as np
import pytest

import pointray as pr
from helpers.browser_page import Page, chromium
from helpers.viewer_client import CLOSE, compile_kernels, expected, levels_in, scene_of, shown_levels, socket_of
from pointray.cli import execute
from pointray.viewer.light_control import light_controls_of
from pointray.viewer.loading import FileLoader
from pointray.viewer.shared_scene import SharedScene
from pointray.viewer.viewer import Viewer

SIZE = (640, 360)
SAMPLES = 4  # of finished pictures; tests set it in the panel, as a user would
MODEL = (182, 180)  # its position in the first view, beside the panel
NAMES = ("eye", "target", "up")


@pytest.fixture(scope="module")
def browser():
    with chromium() as launch, launch() as browser:
        yield browser


@pytest.fixture(scope="module")
def model():
    model = pr.Model(pr.procedural("statue", 5_000))
    compile_kernels(scene_of(model))
    return model


@pytest.fixture
def scene(model):
    return scene_of(model)


@pytest.fixture
def viewer(scene):
    viewer = Viewer(SharedScene("statue.ply", scene, source="statue.ply"))
    yield viewer
    viewer.close()


@contextmanager
def shown(browser, viewer, **options):
    """The page of a viewer with a finished picture. The page must not report any problem."""
    page = Page(browser, viewer.url, SIZE, **options)
    page.until("pointray.last")
    page.choose("samples", f"{SAMPLES}")
    page.finished(SAMPLES)
    yield page
    page.close()
    assert page.problems == []


@contextmanager
def serving(folder):
    """The address of another site, which serves a folder's files."""

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *words):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=folder)) as server:
        threading.Thread(target=server.serve_forever, name="elsewhere").start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()


@pytest.fixture
def page(browser, viewer):
    with shown(browser, viewer) as page:
        yield page


def apart(page, scene, camera, exposure=0.0, **settings):
    """Mean difference of the picture from that of `render` with a camera, in levels."""
    picture, image = page.picture(), expected(scene, camera, SAMPLES, SIZE, exposure, **settings)
    return np.abs(picture - image).mean() if picture.shape == image.shape else np.inf  # smaller while moving


def shows(page, scene, **settings):
    """Whether the picture is that of `render` with the page's camera."""
    return apart(page, scene, page.camera, **settings) < CLOSE


def becomes(page, scene, **settings):
    """Wait until the picture equals it, because a slider draws pictures while it moves."""
    number = page.finished(SAMPLES)["number"]
    while not shows(page, scene, **settings):
        number = page.finished(SAMPLES, number)["number"]
    return True


def away(camera):
    """The vector from the target to the eye."""
    return np.subtract(camera["eye"], camera["target"])


def surface_at(scene, camera, x, y):
    """The point of the surface under a pixel's upper left corner, and the size of a pixel there."""
    view = pr.Camera.look_at(*(camera[name] for name in (*NAMES, "fov")), SIZE)
    origins, directions = view.rays()
    corner = np.s_[y - 1 : y + 1, x - 1 : x + 1]
    hits = scene.intersect(origins[corner].mean(axis=(0, 1)), directions[corner].mean(axis=(0, 1)))
    assert hits.instance == 0
    return hits.position, float(hits.t) * 2 * tan(radians(camera["fov"] / 2)) / SIZE[1]


def coordinates(page):
    """Return the point shown in the box of a click."""
    text = page.tab.locator("#picked").inner_text()
    return np.array([float(re.search(rf"^{axis} (\S+)", text, re.MULTILINE)[1]) for axis in "xyz"])


def test_the_model_is_shown_and_a_drag_rotates_it(page, scene, model):
    assert page.tab.title() == "statue.ply - pointray"
    assert becomes(page, scene)
    assert f"{len(model.points):,} points" in page.tab.locator("#status").inner_text()
    icon = page.tab.evaluate("document.querySelector('link[rel=icon]').href")
    assert icon.startswith("data:") or page.tab.request.get(icon).ok
    first = page.camera
    with page.another(SAMPLES):
        page.drag(MODEL, (60, 20))
    assert away(page.camera) @ away(first) < 0.95 * (away(first) @ away(first))
    assert np.linalg.norm(away(page.camera)) == pytest.approx(np.linalg.norm(away(first)))
    assert becomes(page, scene)
    assert apart(page, scene, first) > 3.0


@pytest.mark.long
def test_wheel_right_drag_and_flight_move_the_camera(page, scene):
    for act, check in (
        (lambda: page.tab.mouse.wheel(0, -120), lambda a, b: np.allclose(away(b), 0.9 * away(a))),
        (lambda: page.drag(MODEL, (30, 10), button="right"), lambda a, b: np.allclose(away(b), away(a))),
        (lambda: page.tab.keyboard.press("d", delay=50), lambda a, b: np.allclose(away(b), away(a))),
    ):
        before = page.camera
        with page.another(SAMPLES):
            act()
        assert page.camera != before and check(before, page.camera)
        assert shows(page, scene)


@pytest.mark.long
def test_the_picture_is_refined_while_nothing_moves(page, scene):
    page.choose("samples", "64")
    page.finished(64)
    count = len(page.headers)
    with page.another(64):
        page.drag(MODEL, (-50, 10))
    page.wait(lambda: page.headers[-1]["samples"] == 64)
    stages = [(header["stage"], header["samples"]) for header in page.headers[count:]]
    assert stages[0][1] == 1 and stages[-1] == ("refined", 64)
    # On a slow machine the mouse may seem to rest during the drag: only the last refinement counts.
    last = stages[max(k for k, stage in enumerate(stages) if stage == ("still", 1)) + 1 :]
    assert {stage for stage, _ in last} == {"refined"}
    assert [samples for _, samples in last] == sorted(samples for _, samples in last)
    assert np.abs(page.picture() - expected(scene, page.camera, 64, SIZE)).mean() < CLOSE


@pytest.mark.long
def test_mouse_moves_without_buttons_change_nothing(page):
    count, before = len(page.said), page.frames
    page.tab.mouse.move(MODEL[0] - 40, MODEL[1] - 20)
    page.tab.mouse.move(*MODEL, steps=20)
    page.tab.mouse.click(*MODEL)  # answered after all earlier messages
    page.tab.locator("#picked").wait_for()
    assert [json.loads(text)["type"] for text in page.said[count:]] == ["pick"]
    assert page.frames == before and page.last["samples"] == SAMPLES


@pytest.mark.long
def test_the_panel_changes_the_picture(page, scene):
    with page.another(SAMPLES):
        page.choose("integrator", "Normals")
    assert shows(page, scene, integrator="normal")
    with page.another(SAMPLES):
        page.choose("integrator", "Phong: direct light, shadows")
    assert shows(page, scene)
    with page.another(SAMPLES):
        page.row("shadows").locator("input").uncheck()
    assert shows(page, scene, shadows=False)
    with page.another(SAMPLES):
        page.row("shadows").locator("input").check()
    page.slide("exposure", 0.6)
    exposure = page.number("exposure")
    assert 0.5 < exposure < 2.0
    assert becomes(page, scene, exposure=exposure)
    page.row("exposure").locator("input").fill("-1")
    page.row("exposure").locator("input").press("Enter")
    assert becomes(page, scene, exposure=-1.0)


@pytest.mark.long
def test_the_panel_sets_the_material_of_the_model(page, scene, model):
    page.open_folder("Material")
    with page.another(SAMPLES):
        page.choose("color_by", "z")
    page.tab.locator("#legend").wait_for()
    painted = scene_of(model)
    painted.update(0, material=pr.Diffuse(pr.Attribute("z")))
    assert shows(page, painted)


@pytest.mark.long
def test_each_page_has_a_camera_of_its_own(browser, viewer, page, scene):
    with shown(browser, viewer) as other:
        first = page.camera
        with other.another(SAMPLES):
            other.drag(MODEL, (80, 0))
        with page.another(SAMPLES):
            page.tab.mouse.wheel(0, -240)
        with page.another(SAMPLES), other.another(SAMPLES):
            scene.add(pr.Plane([0, 0, 0], [0, 0, 1]))
        assert shows(page, scene) and shows(other, scene)
        assert np.allclose(away(page.camera), 0.81 * away(first))
        assert apart(other, scene, page.camera) > 3.0


@pytest.mark.long
def test_a_double_click_sets_the_target(page, scene):
    before = page.camera
    point, pixel = surface_at(scene, before, *MODEL)
    with page.another(SAMPLES):
        page.tab.mouse.dblclick(*MODEL)
        page.until("target => pointray.camera().target.every((x, k) => x !== target[k])", before["target"])
    assert np.linalg.norm(page.camera["target"] - point) < 2 * pixel
    assert np.allclose(away(page.camera), away(before))
    assert shows(page, scene)
    assert page.tab.locator("#picked").is_hidden()


@pytest.mark.long
def test_clicks_show_coordinates_and_measure(page, scene):
    box, line = page.tab.locator("#picked"), page.tab.locator("#line-text")
    point, pixel = surface_at(scene, page.camera, *MODEL)
    page.tab.mouse.click(*MODEL)
    box.wait_for()
    assert np.linalg.norm(coordinates(page) - point) < pixel
    marker = page.tab.locator("#first").get_attribute("transform")
    assert [float(x) for x in re.findall(r"[\d.]+", marker)] == pytest.approx(MODEL, abs=1.0)
    second = MODEL[0] + 10, MODEL[1] + 60
    with page.holding("Shift"):
        page.tab.mouse.click(*second)
    line.wait_for()
    length = np.linalg.norm(surface_at(scene, page.camera, *second)[0] - point)
    assert float(line.text_content()) == pytest.approx(length, abs=2 * pixel)
    parts = page.tab.locator("#line-parts").text_content()
    assert re.findall(r"d([xyz]) ", parts) == ["x", "y", "z"]
    difference = [float(part) for part in re.findall(r"d[xyz] (\S+)", parts)]
    assert difference == pytest.approx(surface_at(scene, page.camera, *second)[0] - point, abs=2 * pixel)
    page.tab.keyboard.press("Escape")
    box.wait_for(state="hidden")
    line.wait_for(state="hidden")


@pytest.mark.long
def test_quick_clicks_at_two_places_are_separate(page):
    page.tab.mouse.click(*MODEL)
    with page.holding("Shift"):
        page.tab.mouse.click(MODEL[0] + 10, MODEL[1] + 60)
    page.tab.locator("#line-text").wait_for()


@pytest.mark.long
def test_a_saved_picture_equals_that_of_render(page, scene, tmp_path):
    page.open_folder("Picture")
    for name, value in (("width", 90), ("height", 70), ("samples", SAMPLES)):
        page.row(f"output.{name}").locator("input").fill(str(value))
    with page.tab.expect_download() as download:
        page.row("save.picture").locator("button").click()
    assert download.value.suggested_filename == "statue.png"
    download.value.save_as(tmp_path / "saved.png")
    image = levels_in((tmp_path / "saved.png").read_bytes())
    assert np.abs(image - expected(scene, page.camera, SAMPLES, (90, 70))).max() <= 1


@pytest.mark.long
def test_the_camera_is_copied_as_a_command(browser, viewer, model, tmp_path, monkeypatch):
    with shown(browser, viewer, permissions=["clipboard-read", "clipboard-write"]) as page:
        with page.another(SAMPLES):
            page.drag(MODEL, (30, -20))
        page.open_folder("Picture")
        page.row("copy.command").locator("button").click()
        page.tab.locator("#copy-state", has_text="Copied").wait_for()
        text = page.tab.locator("#copy-text").input_value()
        assert page.tab.evaluate("navigator.clipboard.readText()") == text
        program, *words = shlex.split(text)
        for name in NAMES:
            (output,) = (word.partition("=")[2] for word in words if word.startswith(f"--{name}="))
            assert [float(x) for x in output.split(",")] == pytest.approx(page.camera[name], rel=1e-6)
        page.tab.locator("#copy .dismiss").click()
    monkeypatch.chdir(tmp_path)
    pr.write(tmp_path / "statue.ply", model.points)
    assert program == "pointray" and execute([*words, "--size", "32x32"]) == 0
    assert (tmp_path / "picture.png").exists()


@pytest.mark.long
def test_keys_select_the_standard_views(page, scene):
    middle = scene.bounds.mean(axis=0)
    for key, axis, sign in (("1", 1, -1), ("2", 1, 1), ("3", 0, -1), ("4", 0, 1), ("5", 2, 1), ("6", 2, -1)):
        with page.another(SAMPLES):
            page.tab.keyboard.press(key)
            condition = "([middle, axis, sign]) => sign * (pointray.camera().eye[axis] - middle[axis]) > 0"
            page.until(condition, [middle.tolist(), axis, sign])
        offset = np.array(page.camera["eye"]) - middle
        assert np.abs(offset).argmax() == axis and np.sign(offset[axis]) == sign, key
    assert shows(page, scene)
    count = len(page.said)
    field = page.row("exposure").locator("input")
    field.press("1")
    field.press("Escape")
    assert not [text for text in page.said[count:] if json.loads(text)["type"] == "view"]


def free_area(page):
    """The free area of the view that the page sent last: left, top, right, bottom."""
    sizes = [message for message in map(json.loads, page.said) if message["type"] == "size"]
    return sizes[-1]["free"] if sizes else None


def waits_for_free(page, wanted):
    """Wait until the page has sent an area that meets a condition."""
    page.wait(lambda: (free := free_area(page)) is not None and wanted(free))
    return free_area(page)


@pytest.mark.long
def test_the_page_sends_the_area_beside_the_panel(page):
    panel = page.tab.locator("#panel").bounding_box()
    sizes = [message for message in map(json.loads, page.said) if message["type"] == "size"]
    assert len(sizes) == 1 and sizes[0]["free"] == [0, 0, round(panel["x"]), SIZE[1]]  # sent once, and right
    page.tab.locator(".lil-title").first.click()  # folded: only its title remains
    title = page.tab.locator(".lil-title").first.bounding_box()
    bottom = round(title["y"] + title["height"])
    assert waits_for_free(page, lambda free: free[2] == SIZE[0]) == [0, bottom, *SIZE]
    page.tab.keyboard.press("p")  # the picture alone
    assert waits_for_free(page, lambda free: free[1] == 0) == [0, 0, *SIZE]


@pytest.mark.long
def test_the_panel_folds_away_on_a_narrow_window(page):
    title, button = page.tab.locator(".lil-title").first, page.row("samples")
    assert button.is_visible()
    page.tab.set_viewport_size({"width": 380, "height": 640})
    button.wait_for(state="hidden")
    free = waits_for_free(page, lambda free: free[2] == 380)
    title.click()
    button.wait_for(state="visible")
    page.tab.mouse.click(60, 400)  # a click on the picture
    button.wait_for(state="hidden")
    assert free_area(page) == free  # an open panel covers the picture only for a moment
    page.tab.set_viewport_size({"width": SIZE[0], "height": SIZE[1]})
    button.wait_for(state="visible")


@pytest.mark.long
def test_orthographic_views_have_a_scale_bar(page, scene):
    bar = page.tab.locator("#scale")
    assert bar.is_hidden()
    for notches in (0, 3, -7):  # the bar's length is round at any scale
        with page.another(SAMPLES):
            if not notches:
                page.tab.keyboard.press("o")
            else:
                page.tab.mouse.move(*MODEL)
                page.tab.mouse.wheel(0, 120 * notches)
        camera = page.camera
        assert camera["orthographic"]
        view = pr.Camera.look_at(*(camera[name] for name in (*NAMES, "fov")), SIZE, projection="orthographic")
        origins, _ = view.rays()
        pixel = np.linalg.norm(origins[0, 1] - origins[0, 0])
        length = float(bar.text_content())
        assert float(f"{length:e}"[0]) in (1, 2, 5) and length == float(f"{length:.0e}")
        assert bar.bounding_box()["width"] == pytest.approx(length / pixel, abs=1.5)
        assert 60 < bar.bounding_box()["width"] <= 162
        assert np.abs(page.picture() - expected_of(scene, view)).mean() < CLOSE
    with page.another(SAMPLES):
        page.tab.keyboard.press("o")
    assert not page.camera["orthographic"] and bar.is_hidden() and shows(page, scene)


def expected_of(scene, view):
    """The picture that the page should show of any camera."""
    return shown_levels(pr.render(scene, view, pr.Settings(spp=SAMPLES)))


def north_of(page):
    """The arrow's direction in degrees to the right of upwards, None without an arrow."""
    if page.tab.locator("#north").is_hidden():
        return None
    return float(re.fullmatch(r"rotate\((\S+)\)", page.tab.locator("#needle").get_attribute("transform"))[1])


@pytest.mark.long
def test_a_georeferenced_scan_has_a_north_arrow(browser, page, model):
    assert north_of(page) is None  # coordinates around zero have no known north
    points = model.points
    far = scene_of(pr.Model(pr.Points(points.positions + (4.5e5, 5.4e6, 300.0), points.normals)))
    with closing(Viewer(SharedScene("far.ply", far))) as viewer, shown(browser, viewer) as other:
        for key in ("5", "2"):
            with other.another(SAMPLES):
                other.tab.keyboard.press(key)
            camera = other.camera
            forward = np.subtract(camera["target"], camera["eye"])
            right = np.cross(forward / np.linalg.norm(forward), camera["up"])
            right /= np.linalg.norm(right)
            top = np.cross(right, forward / np.linalg.norm(forward))
            if np.hypot(right[1], top[1]) < 0.09:
                assert key == "2" and north_of(other) is None  # the view is along north
            else:
                assert north_of(other) == pytest.approx(np.degrees(np.arctan2(right[1], top[1])), abs=0.1)
        with other.another(SAMPLES):
            other.drag((200, 100), (60, 40))
        assert 1 < abs(north_of(other)) < 179


@pytest.mark.long
def test_ctrl_drag_moves_the_sun(page, scene):
    camera, before = page.camera, page.number("lamps.0.azimuth")
    with page.holding("Control"), page.another(SAMPLES):
        page.drag(MODEL, (72, 0), steps=4)  # a fifth of the height: 36 degrees
        field = "before => Math.abs(document.querySelector(`[data-name='lamps.0.azimuth'] input`).value - before) > 35"
        page.until(field, before)
    assert page.camera == camera
    assert page.number("lamps.0.azimuth") == pytest.approx(before + 36.0, abs=0.5)
    (lamp,) = light_controls_of(scene, (0.0, 0.0, 1.0))
    moved = scene.copy()
    moved.lights = [replace(lamp, azimuth=lamp.azimuth + 36.0).make((0.0, 0.0, 1.0))]
    assert becomes(page, moved)
    assert apart(page, scene, camera) > CLOSE


@pytest.mark.long
def test_a_damaged_file_is_reported(browser, tmp_path):
    path = tmp_path / "cut.ply"
    pr.write(path, pr.procedural("sphere", 100))
    path.write_bytes(path.read_bytes()[:-50])
    shared = SharedScene(path.name)
    viewer = Viewer(shared)
    page = Page(browser, viewer.url, SIZE)
    shared.load(FileLoader((path,), {}, lambda scene: None))
    toast = page.tab.locator("#toasts .toast.error")
    toast.wait_for()
    assert shared.problem and shared.problem in toast.inner_text() and "cut.ply" in shared.problem
    page.tab.locator("#progress").wait_for(state="hidden")
    page.close()
    viewer.close()
    assert page.problems == []


@pytest.mark.long
def test_the_page_reports_the_end_of_the_server_and_reconnects(page, viewer, scene):
    with page.another(SAMPLES):
        page.drag(MODEL, (50, 10))
    camera, picture = page.camera, page.picture()
    viewer.close()
    page.tab.locator("#banner").wait_for()
    assert not page.tab.evaluate("pointray.connected")
    assert np.array_equal(page.picture(), picture)
    token = viewer.url.rstrip("/").rpartition("/")[2]
    stranger = Viewer(SharedScene("statue.ply", scene), port=viewer.port)
    if stranger.port != viewer.port:
        stranger.close()
        pytest.skip("another program has taken the port")
    page.wait(lambda: sum("403" in text for text in page.problems) > 1)  # the page tries to connect each second
    assert page.tab.locator("#banner").is_visible()
    stranger.close()
    again = Viewer(SharedScene("statue.ply", scene), port=viewer.port, token=token)
    if again.url != viewer.url:
        again.close()
        pytest.skip("another program has taken the port")
    page.tab.locator("#banner").wait_for(state="hidden")
    page.finished(64)
    assert page.camera == camera
    assert np.abs(page.picture() - expected(scene, camera, 64, SIZE)).mean() < CLOSE
    with page.another(64):
        page.tab.mouse.wheel(0, -120)
    again.close()
    page.problems = [text for text in page.problems if "/socket" not in text]  # except those of its connection


@pytest.mark.long
def test_a_page_of_another_origin_cannot_connect(browser, viewer, page, tmp_path):
    (tmp_path / "index.html").write_text("<!doctype html><link rel=icon href='data:,'><title>elsewhere</title>")
    opens = """url => new Promise((resolve) => {
        const socket = new WebSocket(url);
        socket.onopen = () => resolve("open");
        socket.onerror = () => resolve("refused");
    })"""
    with serving(tmp_path) as address:
        other = Page(browser, address, SIZE)
        socket = socket_of(viewer.url)
        assert other.tab.evaluate(opens, socket) == "refused"
        assert page.tab.evaluate(opens, socket) == "open"
        other.close()
