"""`ViewerWidget` without a notebook: camera, snapshots, outputs of cells, and where `view` returns it."""

import base64
import io
import subprocess
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.viewer_client import CLOSE, SECONDS, compile_kernels, expected, scene_of
from helpers.widget_page import WidgetPage
from pointray.viewer import SharedScene, Viewer, notebook
from pointray.viewer.messages import describe
from pointray.viewer.notebook import detection, widget as module
from pointray.viewer.notebook.embedded_page import page_html, widget_module
from pointray.viewer.server import PAGE

pytest.importorskip("anywidget", exc_type=ImportError)

SMALL = (96, 60)
VIEW = "application/vnd.jupyter.widget-view+json"


@pytest.fixture(scope="module")
def model():
    model = pr.Model(pr.procedural("sphere", 1_000))
    compile_kernels(scene_of(model))
    return model


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    """Saved pictures are small, so that tests are fast."""
    for name, value in (("SIZE", SMALL), ("SAVED_SAMPLES", 1), ("MAX_SAVED", 128)):
        monkeypatch.setattr(module, name, value)


@pytest.fixture
def scene(model):
    return scene_of(model)


@pytest.fixture
def widget(scene):
    widget = pr.ViewerWidget(scene)
    yield widget
    widget.close()


def shell_of(monkeypatch, kind="ZMQInteractiveShell", **message):
    """Let IPython's shell have a class of this name; return it."""
    base = type("ZMQInteractiveShell", (), {}) if kind != "TerminalInteractiveShell" else object
    shell = type(kind, (base,), {})()
    shell.parent_header = {"header": {"msg_id": "1"}, "metadata": {}, **message}
    ipython = ModuleType("IPython")
    ipython.get_ipython = lambda: shell
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    return shell


@pytest.fixture
def cell(monkeypatch):
    """A running cell of Jupyter; returns a function that runs it again, and all that was shown."""
    shell, shown = shell_of(monkeypatch), []
    monkeypatch.setattr(module, "show", lambda bundle, number, update=False: shown.append((bundle, number, update)))
    monkeypatch.setattr(module, "SHOWN", module.ShownWidgets())

    def run(name, execution):
        shell.parent_header = {"header": {"msg_id": execution}, "metadata": {"cellId": name}}

    return SimpleNamespace(run=run, shown=shown)


def test_a_snapshot_equals_the_picture_of_render(widget, scene):
    camera = pr.Camera((3, -3, 2), (0, 0, 0), fov=30, size=(32, 24))
    widget.camera = camera
    picture = widget.snapshot((80, 60), samples=4)
    assert picture.size == (80, 60) and picture.mode == "RGB"
    assert np.abs(np.asarray(picture).astype(int) - expected(scene, describe(camera), 4, (80, 60))).mean() < CLOSE
    assert widget.snapshot().size == camera.size


def test_the_first_camera_shows_the_whole_model(widget):
    corners = np.asarray(widget.snapshot((60, 60), 1)).astype(int)
    assert np.abs(corners[30, 30] - corners[0, 0]).max() > 20
    assert widget.camera.size == SMALL


def test_the_camera_is_that_of_the_page_and_moves_it(widget, monkeypatch):
    page = WidgetPage(widget._views.receive)
    monkeypatch.setattr(widget._views, "_post", page.post)
    page.open()
    first = page.wait(lambda: page.last("camera"))
    assert widget.camera.eye == pytest.approx(first["eye"]) and widget.camera.size == (160, 120)
    widget.camera = pr.Camera((4, 0, 0), (0, 0, 0), aperture=0.1)
    page.wait(lambda: page.last("camera")["eye"] == [4, 0, 0])
    assert widget.camera == pr.Camera((4, 0, 0), (0, 0, 0), size=(160, 120))
    dark = widget.snapshot(samples=1)
    assert dark.size == (160, 120)
    page.say(type="set", name="exposure", value=3.0)
    page.wait(lambda: widget._views.state[1].exposure == 3.0)
    bright = widget.snapshot(samples=1)
    assert np.asarray(bright).mean() > np.asarray(dark).mean() + 3
    widget._views.receive({"view": "one", "state": "closed"})
    assert np.array_equal(widget.snapshot((160, 120), 1), bright)  # the panel's values stay
    page.close()


@pytest.mark.parametrize("camera", [None, (0, 0, 1), "front"])
def test_a_camera_that_is_none_is_refused(widget, camera):
    with pytest.raises(TypeError, match="camera"):
        widget.camera = camera


def test_a_panorama_is_refused(widget):
    with pytest.raises(ValueError, match="camera .*panoramas"):
        widget.camera = pr.Camera((0, 0, 0), (1, 0, 0), projection="panorama")


@pytest.mark.parametrize(
    ("given", "kind"),
    [({"size": "a"}, ValueError), ({"size": (0, 5)}, ValueError), ({"samples": 0}, ValueError)]
    + [({"samples": 1.5}, ValueError), ({"samples": True}, ValueError), ({"size": (1 << 20, 5)}, ValueError)],
)
def test_wrong_arguments_of_snapshots_are_refused(widget, given, kind):
    with pytest.raises(kind, match=next(iter(given))):
        widget.snapshot(**given)


def test_without_a_model_there_is_nothing_to_show():
    widget = pr.ViewerWidget(pr.Scene())
    for act in (lambda: widget.camera, widget.snapshot):
        with pytest.raises(ValueError, match="nothing to show"):
            act()
    assert set(widget._repr_mimebundle_()[0]) == {"text/plain", VIEW}
    widget.close()


def test_a_scene_that_failed_to_load_says_why():
    shared = SharedScene("a.ply")
    shared.problem = "a.ply: not found"
    with pytest.raises(ValueError, match=r"a\.ply: not found"):
        pr.ViewerWidget(shared).snapshot()


def test_outputs_of_cells_have_a_picture(widget):
    data, _ = widget._repr_mimebundle_()
    picture = Image.open(io.BytesIO(base64.b64decode(data["image/png"])))
    assert picture.format == "PNG" and picture.size == SMALL and np.asarray(picture).std() > 5
    assert data[VIEW]["model_id"] == widget.model_id and widget._picture[:4] == b"\x89PNG"


def test_a_closed_widget_leaves_its_picture(widget, cell):
    cell.run("a", "1")
    widget._ipython_display_()
    widget.camera = pr.Camera((4, 0, 0), (0, 0, 0), size=(2000, 1000))
    widget.close()
    (first, number, update), (bundle, again, updated) = cell.shown
    assert VIEW in first[0] and not update and number
    assert updated and again == number and set(bundle) == {"text/plain", "image/png"}
    picture = Image.open(io.BytesIO(base64.b64decode(bundle["image/png"])))
    assert picture.size == (128, 64)
    widget._ipython_display_()
    assert cell.shown[-1][0] == bundle and cell.shown[-1][1:] == ("", False)
    widget.close()


def test_a_widget_that_is_discarded_renders_nothing(widget, cell, monkeypatch):
    widget._ipython_display_()
    with monkeypatch.context() as exiting:
        exiting.setattr(sys, "is_finalizing", lambda: True)
        widget.__del__()
    assert widget.comm is not None
    monkeypatch.setattr(module, "draw", None)  # rendering would fail
    widget.__del__()
    assert widget.comm is None and len(cell.shown) == 1


AT_EXIT = """
import pointray as pr
from pointray.viewer.notebook import widget as module
module.show = lambda *arguments, **options: None
scene = pr.Scene()
scene.add(pr.Model(pr.procedural("sphere", 500)))
widget = pr.ViewerWidget(scene)
widget._ipython_display_()
"""


@pytest.mark.long
def test_a_widget_that_is_shown_prints_nothing_when_python_exits():
    done = subprocess.run([sys.executable, "-c", AT_EXIT], capture_output=True, text=True, timeout=400)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_cell_that_runs_again_closes_the_widget_that_it_replaces(scene, cell):
    one, two, other = (pr.ViewerWidget(scene) for _ in range(3))
    cell.run("a", "1")
    one._ipython_display_()
    two._ipython_display_()
    cell.run("b", "2")
    two._ipython_display_()
    cell.run("a", "3")
    other._ipython_display_()
    assert one.comm is None and two.comm is not None  # the second one is still shown in the other cell
    assert not any(update for _, _, update in cell.shown)  # the output of the first one is gone
    other._ipython_display_()
    cell.run("a", "4")
    other._ipython_display_()
    assert other.comm is not None
    for widget in (two, other):
        widget.close()


def test_a_notebook_that_closes_the_widget_ends_it(widget):
    assert widget._is_alive()
    widget.comm._closed = True  # as marimo does when its cell runs again
    assert not widget._is_alive() and widget.comm is None


def test_notebooks_are_detected(monkeypatch):
    assert not detection.in_notebook()
    shell_of(monkeypatch, "TerminalInteractiveShell")
    assert not detection.in_notebook()
    for kind in ("ZMQInteractiveShell", "Shell"):  # Jupyter and VS Code; Colab
        shell_of(monkeypatch, kind)
        assert detection.in_notebook()
    monkeypatch.delitem(sys.modules, "IPython")
    marimo = ModuleType("marimo")
    monkeypatch.setitem(sys.modules, "marimo", marimo)
    assert not detection.in_notebook()
    for runs in (False, True):
        marimo.running_in_notebook = lambda runs=runs: runs
        assert detection.in_notebook() is runs


def test_view_returns_the_widget_in_a_notebook(monkeypatch, scene, capsys):
    shell_of(monkeypatch)
    widget = pr.view(scene)
    assert isinstance(widget, pr.ViewerWidget) and capsys.readouterr().out == ""
    widget.close()


def test_points_are_loaded_before_the_picture_of_the_notebook_is_made(monkeypatch, model):
    monkeypatch.setattr(module, "MAX_WAIT", SECONDS)  # `model` has compiled most kernels
    shell_of(monkeypatch)
    widget = pr.view(pr.procedural("sphere", 1_000))
    data, _ = widget._repr_mimebundle_()
    assert np.asarray(Image.open(io.BytesIO(base64.b64decode(data["image/png"])))).std() > 5
    widget.close()


def test_view_serves_the_page_without_anywidget(monkeypatch, scene, capsys):
    shell_of(monkeypatch)
    monkeypatch.setitem(sys.modules, "anywidget", None)
    viewer = pr.view(scene)
    assert isinstance(viewer, Viewer) and "pip install 'pointray[notebook]'" in capsys.readouterr().out
    assert "<iframe" in viewer._repr_html_()
    viewer.close()
    with pytest.raises(ImportError, match=r"pip install 'pointray\[notebook\]'"):
        pr.ViewerWidget(scene)


def test_the_page_of_the_widget_requests_nothing():
    html, script = page_html(), widget_module()
    assert "<script" not in html and "stylesheet" not in html and "lil-gui" in html and 'id="view"' in html
    assert "Run the cell again" in html and "open its new address" not in html
    assert "PAGE_OF_POINTRAY" not in script and "http://www.w3.org" not in html
    for name in PAGE.glob("*.js"):
        assert f'"{name.name}": ' in script
    assert notebook.__doc__
