"""The sketch of a scan before kernels are ready: dots drawn by NumPy."""

import threading

import numpy as np
import pytest

import pointray as pr
from helpers.viewer_client import SECONDS, SIZE, Browser
from pointray.auto_view.framing import Lens, frame_points
from pointray.auto_view.sample import sample_of
from pointray.viewer import loading, sketch as sketch_of
from pointray.viewer.shared_scene import SharedScene
from pointray.viewer.sketch import Sketch
from pointray.viewer.viewer import Viewer

VIEW = (0.5, -1.0, 0.4)


def sphere(count, **parts):
    points = pr.procedural("sphere", count)
    return pr.Points(points.positions, points.normals if parts.pop("with_normals", True) else None, **parts)


@pytest.mark.parametrize("with_normals", [True, False])
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_a_ball_is_a_disc_without_gaps_lit_from_above_left(with_normals, projection):
    cloud = sphere(20_000, with_normals=with_normals)
    camera = frame_points(sample_of(cloud), VIEW, lens=Lens(40, (300, 200), projection))
    image = Sketch([cloud]).draw(camera)
    height, width = image.shape[:2]
    assert abs(width / height - 1.5) < 0.02
    rows, columns = np.nonzero(image[..., 3])
    middle = (rows.mean() + 0.5) / height, (columns.mean() + 0.5) / width
    assert middle == pytest.approx((0.5, 0.5), abs=0.02)
    y, x = (np.mgrid[:height, :width] + 0.5) - np.array([height / 2, width / 2])[:, None, None]
    distance = np.hypot(x, y) / height
    assert image[distance < 0.43, 3].all() and not image[distance > 0.48, 3].any()
    bright = image[..., 0]
    inner = distance < 0.4
    assert bright[inner & (x < 0) & (y < 0)].mean() > 2 * bright[inner & (x > 0) & (y > 0)].mean()


@pytest.mark.long
def test_what_is_near_hides_what_is_behind(rng):
    """A red wall hides a green one, and colours are linear."""
    positions = rng.random((20_000, 3)) * (1, 0, 1)
    red, green = np.tile([188, 0, 0], (20_000, 1)), np.tile([0, 188, 0], (20_000, 1))
    colors = np.concatenate([green, red]).astype(np.uint8)
    cloud = pr.Points(np.concatenate([positions + (0, 1, 0), positions]), colors=colors)
    camera = pr.Camera.look_at((0.5, -2, 0.5), (0.5, 0, 0.5), size=(200, 200))
    image = Sketch([cloud]).draw(camera)
    inner = image[image.shape[0] // 3 : -image.shape[0] // 3, image.shape[1] // 3 : -image.shape[1] // 3]
    assert (inner[..., 0] > 0.3).mean() > 0.9  # random points leave some gaps
    behind = Sketch([cloud]).draw(pr.Camera.look_at((0.5, 3, 0.5), (0.5, 0, 0.5), size=(200, 200)))
    inner = behind[behind.shape[0] // 3 : -behind.shape[0] // 3, behind.shape[1] // 3 : -behind.shape[1] // 3]
    assert (inner[..., 1] > 0.3).mean() > 0.9
    facing = 0.47 / np.linalg.norm((0.7, 0.72, 0.47))  # the key light, in addition to the sky's 0.21
    assert inner[..., 1].max() == pytest.approx(0.5029 * (0.21 + 1.0 * facing), rel=0.01)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_points_or_none_in_view_are_drawn(count):
    cloud = pr.Points(np.eye(3)[[0, 1, 2, 0, 1]][:count] + 1e6)
    sketch = Sketch([cloud])
    camera = pr.Camera.look_at((1e6, 1e6 - 5, 1e6), (1e6, 1e6, 1e6), size=(64, 48))
    assert sketch.draw(camera)[..., 3].any()
    away = pr.Camera.look_at((1e6, 1e6 - 5, 1e6), (1e6, 1e6 - 10, 1e6), size=(64, 48))
    assert not sketch.draw(away).any()


def test_sketches_of_large_and_several_clouds_are_subsampled(monkeypatch):
    most = 4_000
    monkeypatch.setattr(sketch_of, "MAX_POINTS", most)
    far = pr.procedural("sphere", 2 * most)
    hole = far.positions.copy()
    hole[::3] = np.nan
    parts = [pr.Points(hole, far.normals), pr.Points(far.positions + (3, 0, 0))]
    sketch = Sketch(parts)
    assert sketch.count == 4 * most and 0.8 * most < len(sketch.points) < most
    assert np.isfinite(sketch.points.positions).all()
    assert sketch.points.bounds[1][0] == pytest.approx(4, abs=0.01)


@pytest.fixture
def cold(monkeypatch):
    """Pretend that kernels of pictures are not compiled until `release` is set."""
    ready = {"warm": False, "waits": []}

    def wait(settings):
        ready["waits"].append(True)
        ready["release"].wait(SECONDS)
        ready["warm"] = True

    ready["release"] = threading.Event()
    monkeypatch.setattr(loading, "is_warm", lambda settings: ready["warm"])
    monkeypatch.setattr(loading, "wait_until_warm", wait)
    return ready


@pytest.fixture
def opened(tmp_path, cold):
    """A loader of a ball with an up direction, its scene, and a browser that waits for it."""
    path = tmp_path / "ball.ply"
    pr.write(path, sphere(8_000))
    shared = SharedScene("ball.ply")
    viewer = Viewer(shared)
    browser = Browser(viewer.url, SIZE)
    yield lambda up: shared.load(loading.FileLoader([path], {}, lambda scene: up)), shared, browser
    cold["release"].set()
    browser.close()
    viewer.close()


def test_a_sketch_is_shown_and_rotates_until_pictures_can_be_traced(opened, cold):
    load, shared, browser = opened
    thread = load((0.0, 0.0, 1.0))
    camera = browser.arrive()
    browser.listen(lambda: browser.frames)
    place, first = browser.last("place"), browser.frames[-1][0]
    assert np.allclose(place["bounds"], [[-1] * 3, [1] * 3], atol=0.01)
    assert first["stage"] == "still" and first["camera"]["eye"] == camera["eye"]
    status = browser.listen(lambda: browser.last("status"))
    assert status["lines"] == ["preview: 8,000 of 8,000 points"]
    browser.say(type="pick", x=0.5, y=0.5, purpose="query", extend=False)  # nothing to trace yet
    browser.say(type="press", name="save.picture")
    camera["eye"] = [0, -6, 0]
    browser.go(camera)
    browser.listen(lambda: browser.frames[-1][0]["camera"]["eye"] == [0, -6, 0])
    assert shared.scene is None
    cold["release"].set()
    thread.join(SECONDS)
    browser.refined(64)
    assert shared.scene is not None and shared.sketch is None
    assert browser.frames[-1][0]["camera"]["eye"] == [0, -6, 0]  # the user had moved it
    browser.listen(lambda: "million" in " ".join(browser.last("status")["lines"]))


def test_an_unmoved_view_is_framed_again_when_the_scene_arrives(opened, cold):
    load, _, browser = opened
    load((1.0, 0.0, 0.0))
    first = browser.listen(lambda: browser.last("camera"))
    browser.listen(lambda: browser.frames)
    cold["release"].set()
    second = browser.listen(lambda: next((m for m in [browser.last("camera")] if m["up"] != first["up"]), None))
    assert first["up"] == [0, 0, 1] and second["up"] == [1, 0, 0]


def test_no_sketch_is_drawn_if_all_kernels_are_compiled(tmp_path, monkeypatch):
    path = tmp_path / "ball.ply"
    pr.write(path, sphere(3_000))
    seen, shared = [], SharedScene("ball.ply")
    monkeypatch.setattr(loading, "is_warm", lambda settings: True)
    shared.subscribe(lambda: seen.append(shared.sketch))
    shared.load(loading.FileLoader([path], {}, lambda scene: (0.0, 0.0, 1.0))).join(SECONDS)
    assert seen and not any(seen) and shared.scene is not None
