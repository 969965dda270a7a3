"""Views of a widget: sessions that begin, continue and end with the pages in a notebook."""

import threading
import time

import numpy as np
import pytest

import pointray as pr
from helpers.viewer_client import CLOSE, SECONDS, compile_kernels, expected, levels_in, scene_of
from helpers.widget_page import WidgetPage
from pointray.viewer.notebook.page_views import LARGEST_MESSAGE, MAX_LOGGED, MAX_VIEWS, PageViews
from pointray.viewer.shared_scene import SharedScene

SAMPLES = 4


@pytest.fixture(scope="module")
def model():
    model = pr.Model(pr.procedural("statue", 2_000))
    compile_kernels(scene_of(model))
    return model


@pytest.fixture
def scene(model):
    return scene_of(model)


@pytest.fixture
def pages():
    pages = []
    yield pages
    for page in pages:
        page.close()


@pytest.fixture
def alive():
    return threading.Event()


@pytest.fixture
def views(scene, pages, alive):
    def post(content, buffers):
        for page in list(pages):
            page.post(content, buffers)

    alive.set()
    views = PageViews(SharedScene("statue", scene), post, alive.is_set)
    yield views
    views.close()


@pytest.fixture
def visit(views, pages):
    """Opens a view whose finished pictures have few samples."""

    def visit(name="one"):
        page = WidgetPage(views.receive, name)
        pages.append(page)
        page.open()
        page.say(type="set", name="samples", value=SAMPLES)
        page.wait(lambda: page.last("camera"))
        return page

    return visit


def wait(condition):
    end = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.01)


def threads():
    """The threads of sessions."""
    names = ("pointray-visitor", "pointray-painter", "pointray-follower", "pointray-watcher")
    return {thread for thread in threading.enumerate() if thread.name.startswith(names)}


def go(page, camera, **changes):
    page.finished(SAMPLES)  # the view has opened completely
    names = ("eye", "target", "up", "fov")
    page.say(**{"type": "camera", **{name: camera[name] for name in names}, "time": 1.0, **changes})


def test_pictures_equal_those_of_render(visit, scene):
    page = visit()
    assert page.states == ["opened"] and page.told[0]["type"] == "hello"
    _, picture = page.finished(SAMPLES)
    assert np.abs(levels_in(picture) - expected(scene, page.last("camera"), SAMPLES)).mean() < CLOSE


def test_a_change_of_the_scene_appears(visit, scene):
    page = visit()
    page.finished(SAMPLES)
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1)))
    wanted = expected(scene, page.last("camera"), SAMPLES)

    def shows_it():
        header, picture = page.frames[-1]
        return header["samples"] == SAMPLES and np.abs(levels_in(picture) - wanted).mean() < CLOSE

    page.wait(shows_it)


def test_views_have_cameras_of_their_own_and_python_moves_all(visit, views):
    one, two = visit("one"), visit("two")
    camera = one.last("camera")
    go(one, camera, eye=[5, 5, 5])
    wait(lambda: views.current.camera.eye == (5, 5, 5))
    used = views.current
    views._views["two"].session.receive('{"type": "seen", "number": 0}')  # not by the user
    assert views.current is used
    two.say(type="clear")
    wait(lambda: views.current.camera.eye == pytest.approx(camera["eye"]))
    views.move(pr.Camera((1, 2, 3), (0, 0, 0)))
    for page in (one, two):
        page.wait(lambda page=page: page.last("camera")["eye"] == [1, 2, 3])
        page.wait(lambda page=page: page.frames[-1][0]["camera"]["eye"] == [1, 2, 3])


def test_the_next_view_continues_with_camera_and_panel(visit, views, pages):
    page = visit()
    go(page, page.last("camera"), eye=[5, 5, 5])
    page.say(type="set", name="exposure", value=1.5)
    wait(lambda: views.state[0] is not None and views.state[1].exposure == 1.5)
    views.receive({"view": "one", "state": "closed"})
    assert views.current is None
    page.wait(lambda: "gone" in page.states)  # once more for each message that the page was sending
    again = WidgetPage(views.receive, "again")
    pages.append(again)
    again.open()
    again.wait(lambda: again.last("camera"))
    assert again.last("camera")["eye"] == [5, 5, 5]
    values = {c["name"]: c["value"] for folder in again.last("panel")["folders"] for c in folder["controls"]}
    assert values["exposure"] == 1.5 and values["samples"] == SAMPLES


def test_a_view_that_was_not_moved_frames_the_model_again(visit, views):
    first = visit().last("camera")
    views.receive({"view": "one", "state": "closed"})
    assert views.state[0] is None
    again = visit("again").last("camera")
    assert again["eye"] == pytest.approx(first["eye"])


def test_the_threads_of_a_view_end_with_it(visit, views):
    before = threads()
    page = visit()
    page.finished(SAMPLES)
    assert len(threads() - before) >= 3
    views.receive({"view": "one", "state": "closed"})
    wait(lambda: threads() <= before)


def test_the_threads_of_a_view_end_when_the_notebook_drops_the_widget(visit, alive):
    before = threads()
    visit().finished(SAMPLES)
    alive.clear()
    wait(lambda: threads() <= before)


def use(page, views):
    """Send an input of the user, and wait until its session has processed it."""
    session = views._views[page.view].session
    before = session.used
    page.say(type="clear")
    wait(lambda: session.used > before)


def test_the_view_that_was_unused_longest_is_disconnected(visit, views):
    pages = [visit(f"{number}") for number in range(MAX_VIEWS)]
    for page in pages:
        page.finished(SAMPLES)  # the inputs of `visit` are processed
    for page in (*pages[1:], pages[0]):
        use(page, views)
    for automatic in ({"read": 0}, {"text": '{"type": "seen", "number": 0}'}):
        views.receive({"view": "1", **automatic})
    visit("more")
    pages[1].wait(lambda: pages[1].states[1:])
    assert pages[1].states[1] == "replaced"  # it must not connect again by itself
    before = len(pages[1].states)
    pages[1].say(type="clear")  # the answer is again that it must connect
    pages[1].wait(lambda: pages[1].states[before:])
    assert set(pages[1].states[2:]) == {"gone"}
    assert all(page.states == ["opened"] for page in (pages[0], *pages[2:]))


@pytest.mark.parametrize(
    "content",
    [
        *(None, 1, [], "text", {}, {"view": 5}, {"view": ""}, {"view": "x" * 101, "state": "open"}),
        *({"view": "one"}, {"view": "one", "text": 5}, {"view": "one", "text": "x" * (LARGEST_MESSAGE + 1)}),
        *({"view": "one", "read": True}, {"view": "one", "read": 0.5}, {"view": "one", "read": "1"}),
        *({"view": "one", "state": "opened"}, {"view": "one", "state": ["open"]}),
    ],
    ids=str,
)
def test_invalid_messages_are_ignored_and_logged(visit, views, caplog, content):
    page = visit()
    views.receive(content)
    assert "ignored a message of a notebook's page" in caplog.text
    page.finished(SAMPLES)
    for _ in range(3 * MAX_LOGGED):
        views.receive(content)
    assert len(caplog.records) == MAX_LOGGED


@pytest.mark.parametrize("text", ["", "[]", "{", '{"type": "camera"}', '{"type": "size", "width": -1, "height": NaN}'])
def test_invalid_texts_are_ignored(visit, views, text):
    page = visit()
    views.receive({"view": "one", "text": text})
    page.finished(SAMPLES)


def test_messages_after_the_end_are_ignored(visit, views):
    page = visit()
    views.close()
    page.wait(lambda: page.states == ["opened", "ended"])
    views.receive({"view": "one", "state": "open"})
    assert page.states == ["opened", "ended"] and views.current is None
