"""The widget in real notebooks: JupyterLab and marimo, driven by mouse and keys."""

import base64
import json
import textwrap
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest

from helpers.browser_page import SECONDS, chromium
from helpers.notebook_servers import SIZE, Cell, jupyter_lab, marimo, pixels_of
from helpers.viewer_client import CLOSE

SCENE = """
import pointray as pr
scene = pr.Scene()
ball = scene.add(pr.Model(pr.procedural("torus", 2_000)))
ground = scene.add(pr.Plane((0, 0, -1), (0, 0, 1), checker=0.4))
sun = scene.add_light(pr.SunLight((1, 1, -1.5), 3))
""".strip()
MOVED = 3.0  # mean change of levels by a drag
THREADS = "[t.name for t in __import__('threading').enumerate()].count('pointray-painter')"


@pytest.fixture(scope="module")
def browser():
    with chromium() as launch, launch() as browser:
        yield browser


@contextmanager
def opened(browser, address):
    """A tab with an address, which must not report any error of the widget.

    marimo reports a model that it has waited for longer than its own limit, as on a busy machine, and goes on.
    """
    tab = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
    tab.set_default_timeout(1e3 * SECONDS)
    errors = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto(address)
    try:
        yield tab
        assert [error for error in errors if not error.startswith("Model not found for key")] == []
    finally:
        tab.close()


class Lab:
    """A notebook in JupyterLab, with a kernel."""

    def __init__(self, server, tab, name):
        self._server, self.tab, self._name, self.kernel = server, tab, name, None

    def start(self):
        """Wait for the kernel."""
        self.wait_for_kernel()
        self.kernel = self._server.kernel(self._name)
        return self

    def close(self):
        """Stop the kernel."""
        if self.kernel is None:  # it has not started as it should
            self._server.stop_kernels()
            return
        self.kernel.close()
        self._choose("Kernel", "Shut Down Kernel")
        self.tab.locator("#jp-main-statusbar").get_by_text("No Kernel").wait_for()

    def wait_for_kernel(self):
        """Wait until the kernel does nothing; JupyterLab forgets cells that are run before the kernel has started."""
        self.tab.locator("#jp-main-statusbar").get_by_text("| Idle").wait_for()

    def run_all(self):
        self._choose("Run", "Run All Cells")

    def run(self, number):
        """Run a cell."""
        self.tab.locator(".jp-CodeCell").nth(number).locator(".cm-content").click()
        self.tab.keyboard.press("Control+Enter")

    def restart(self):
        self._choose("Kernel", "Restart Kernel…")
        self.tab.locator(".jp-Dialog button.jp-mod-accept").click()

    def save(self):
        """Save the notebook; return the data of its outputs."""
        self._choose("File", "Save Notebook")
        self.tab.locator(".jp-NotebookPanel .jp-mod-dirty").wait_for(state="detached")
        self.tab.locator(".lm-TabBar-tab.jp-mod-dirty").wait_for(state="detached")
        book = json.loads((self._server.folder / self._name).read_text())
        return [part["data"] for cell in book["cells"] for part in cell["outputs"] if "data" in part]

    def _choose(self, menu, entry):
        self.tab.locator(".lm-MenuBar-itemLabel").get_by_text(menu, exact=True).click()
        self.tab.locator(".lm-Menu-itemLabel").get_by_text(entry, exact=True).click()


@pytest.fixture(scope="module")
def jupyter(browser, tmp_path_factory):
    with jupyter_lab(tmp_path_factory.mktemp("jupyter")) as server:
        yield server


@pytest.fixture
def lab(browser, jupyter, request):
    """Opens a notebook with given cells in JupyterLab."""
    with ExitStack() as left:

        def open_book(*sources):
            name = f"{request.node.name}.ipynb"
            (jupyter.folder / name).write_text(json.dumps(book_of(sources)))
            tab = left.enter_context(
                opened(browser, jupyter.address(f"lab/workspaces/{request.node.name}/tree/{name}"))
            )
            notebook = Lab(jupyter, tab, name)
            left.callback(notebook.close)
            return notebook.start()

        yield open_book


def book_of(sources):
    """A notebook of Jupyter with these cells."""
    cells = [
        {
            "cell_type": "code",
            "id": f"cell-{number}",
            "metadata": {},
            "outputs": [],
            "execution_count": None,
            "source": source,
        }
        for number, source in enumerate(sources)
    ]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def apart(one, other):
    """The mean difference of two pictures."""
    return np.abs(one - other).mean()


def is_drawn(picture):
    return picture.shape[0] > 400 and picture.std() > 10


def check_view(cell):
    """Orbit by a drag, and brighten the picture by a slider; return the last picture."""
    picture, camera = cell.shows(), cell.camera
    assert is_drawn(picture)
    turned = cell.changed(cell.drag)
    assert apart(turned, picture) > MOVED and cell.camera != camera
    brighter = cell.changed(lambda: cell.slide("exposure", 0.7))
    assert brighter.mean() > turned.mean() + 5
    return brighter


@pytest.mark.long
def test_jupyterlab_shows_the_widget_and_saves_a_picture(lab, tmp_path):
    notebook = lab(SCENE, "w = pr.view(scene)\nw")
    notebook.run_all()
    cell = Cell(notebook.tab)
    picture = check_view(cell)
    assert notebook.kernel.value("w.camera.eye") == pytest.approx(cell.camera["eye"])
    shot = tmp_path / "shot.png"
    notebook.kernel.value(f"w.snapshot(samples=4).save({str(shot)!r})")
    assert apart(pixels_of(shot.read_bytes()), picture) < 2 * CLOSE
    (data,) = notebook.save()
    assert is_drawn(pixels_of(base64.b64decode(data["image/png"])))
    assert "application/vnd.jupyter.widget-view+json" in data
    notebook.kernel.value("w.close()")  # the last picture takes its place
    notebook.tab.locator(".jp-OutputArea-output img").wait_for()
    (data,) = notebook.save()
    assert "application/vnd.jupyter.widget-view+json" not in data
    saved = pixels_of(base64.b64decode(data["image/png"]))
    assert saved.shape == picture.shape and apart(saved, picture) < 2 * CLOSE


@pytest.mark.long
def test_jupyterlab_shows_two_widgets_that_are_independent(lab):
    notebook = lab(SCENE, "v = pr.view(scene)\nv", "w = pr.view(scene)\nw")
    notebook.run_all()
    first, second = Cell(notebook.tab, 0), Cell(notebook.tab, 1)
    before, other = first.shows(), second.shows()
    assert apart(first.changed(first.drag), before) > MOVED
    assert apart(second.picture(), other) == 0
    second.changed(lambda: notebook.kernel.value("setattr(w, 'camera', pr.Camera((3, 0, 1), (0, 0, 0)))"))
    assert second.camera["eye"] == [3, 0, 1] and first.camera["eye"] != [3, 0, 1]
    assert notebook.kernel.value("v.camera.eye") == pytest.approx(first.camera["eye"])


@pytest.mark.long
def test_a_fifth_view_pauses_the_first_until_it_is_used(lab):
    notebook = lab(SCENE, "w = pr.view(scene)\nw._height = 300", *5 * ["w"])
    notebook.run_all()
    cells = [Cell(notebook.tab, number) for number in range(5)]
    for cell in cells:
        cell.until("window.pointray")
    notebook.kernel.wait("len(w._views._views) == 4")

    def paused():
        return [number for number, cell in enumerate(cells) if cell.frame.locator("#replaced").is_visible()]

    def settled():
        (number,) = paused()
        sessions = notebook.kernel.value("sorted(w._views._views)")
        notebook.tab.wait_for_timeout(3_000)  # pages connect again a second after a loss
        assert notebook.kernel.value("sorted(w._views._views)") == sessions and paused() == [number]
        return number

    notebook.tab.wait_for_function("document.querySelectorAll('.pointray-viewer').length === 5")
    for cell in cells:
        cell.until("pointray.connected || !document.getElementById('replaced').hidden")
    first = settled()
    cells[first].drag()
    cells[first].frame.locator("#replaced").wait_for(state="hidden")
    assert settled() != first


@pytest.mark.long
def test_a_cell_that_runs_again_replaces_its_widget(lab):
    notebook = lab(SCENE, "w = pr.view(scene)\nw")
    notebook.run_all()
    Cell(notebook.tab).shows()
    notebook.kernel.value("globals().update(old=w)")
    with notebook.tab.expect_event("framedetached"):
        notebook.run(1)
    notebook.kernel.wait("old is not w and old.comm is None")
    check_view(Cell(notebook.tab))
    notebook.kernel.wait(f"{THREADS} == 1")


@pytest.mark.long
def test_a_page_that_loads_again_continues(lab):
    notebook = lab(SCENE, "w = pr.view(scene)\nw")
    notebook.run_all()
    cell = Cell(notebook.tab)
    cell.shows()
    cell.changed(cell.drag)
    camera = cell.camera
    notebook.save()
    notebook.tab.reload()
    again = Cell(notebook.tab)
    again.shows()
    assert again.camera["eye"] == pytest.approx(camera["eye"])


@pytest.mark.long
def test_a_restarted_kernel_leaves_the_picture_and_a_hint(lab):
    notebook = lab(SCENE, "w = pr.view(scene)\nw")
    notebook.run_all()
    cell = Cell(notebook.tab)
    picture = cell.shows()
    notebook.restart()
    cell.frame.locator("#banner").wait_for()
    assert "Run the cell again" in cell.frame.locator("#banner").inner_text()
    assert apart(cell.picture(), picture) == 0
    notebook.run_all()
    cell.frame.locator("#banner").wait_for(state="hidden")
    assert apart(cell.shows(), picture) < CLOSE


def marimo_notebook(folder):
    """A notebook of marimo with two widgets."""
    scene = textwrap.indent(SCENE, "    ")
    cells = f"@app.cell\ndef _():\n{scene}\n    return pr, scene\n"
    for name in "vw":
        cells += f"\n@app.cell\ndef _(pr, scene):\n    {name} = pr.view(scene)\n    {name}\n    return ({name},)\n"
    (folder / "book.py").write_text(f"import marimo\napp = marimo.App()\n\n{cells}")


@pytest.mark.long
def test_marimo_shows_two_widgets_that_are_independent(browser, tmp_path):
    marimo_notebook(tmp_path)
    with marimo(tmp_path, "run", "book.py") as address, opened(browser, address) as tab:
        first, second = Cell(tab, 0), Cell(tab, 1)
        other = second.shows()
        check_view(first)
        assert apart(second.picture(), other) == 0
        check_view(second)


@pytest.mark.long
def test_a_cell_of_marimo_that_runs_again_replaces_its_widget(browser, tmp_path):
    marimo_notebook(tmp_path)
    with marimo(tmp_path, "edit", "book.py") as address, opened(browser, address) as tab:
        cells = tab.locator(".marimo-cell")
        first, second = Cell(tab, part=cells.nth(1)), Cell(tab, part=cells.nth(2))
        first.shows()
        other = second.shows()
        camera = first.camera
        first.changed(first.drag)
        cells.nth(1).locator(".cm-content").click()
        with tab.expect_event("framedetached"):
            tab.keyboard.press("Control+Enter")
        first.until("eye => JSON.stringify(window.pointray?.camera()?.eye) === JSON.stringify(eye)", camera["eye"])
        check_view(first)
        assert apart(second.picture(), other) == 0
