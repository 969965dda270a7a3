"""Every example runs with few points and pixels and gives a picture."""

import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.marks import long
from helpers.places import ROOT
from pointray.cli import execute

FOLDER = ROOT / "examples"
EXAMPLES = sorted(path.name for path in FOLDER.iterdir() if path.suffix in (".toml", ".py"))
SLOWER = ("04", "07")  # they take seconds
SMALL = [
    (r"^points = [\d_]+", "points = 5000"),
    (r"^POINTS = [\d_]+", "POINTS = 5000"),
    (r"^size = .*", "size = [48, 40]"),
    (r"^SIZE = .*", "SIZE = (48, 40)"),
    (r"^spp = \d+", "spp = 2"),
    (r"^SAMPLES = \d+", "SAMPLES = 2"),
    (r"^FRAMES = \d+", "FRAMES = 2"),
    (r"spp=32", "spp=2"),
]


@pytest.fixture(autouse=True)
def _threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POINTRAY_THREADS", "2")


def picture_of(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Run a small copy of an example, by the command in its first line."""
    text = (FOLDER / name).read_text()
    command = text.splitlines()[0].split()
    assert command[0] == "#" and f"examples/{name}" in command
    for pattern, value in SMALL:
        text = re.sub(pattern, value, text, flags=re.MULTILINE)
    (folder / "examples").mkdir(exist_ok=True)
    (folder / "examples" / name).write_text(text)
    monkeypatch.chdir(folder)
    if command[1] == "pointray":
        assert execute(command[2:]) == 0
    else:
        assert command[1] == "python"
        monkeypatch.setattr(sys, "argv", command[2:])
        runpy.run_path(command[2], run_name="__main__")
    return np.asarray(Image.open(folder / command[-1]).convert("RGB"))


def test_examples_are_numbered() -> None:
    assert len(EXAMPLES) >= 6
    assert all(re.match(r"\d\d_[a-z_]+\.(toml|py)$", name) for name in EXAMPLES)


@pytest.mark.parametrize("name", [long(name) if name[:2] in SLOWER else name for name in EXAMPLES])
def test_each_example_shows_its_object(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = picture_of(name, tmp_path, monkeypatch)
    assert image.shape == (40, 48, 3)
    middle = image[10:30, 12:36].astype(float)
    assert 20 < middle.mean() < 235 and middle.std() > 8


def test_the_example_in_toml_equals_that_in_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = (picture_of(name, tmp_path, monkeypatch) for name in ("01_statue.toml", "06_statue.py"))
    assert (one == other).all()


@pytest.mark.long
def test_the_notebook_runs(tmp_path: Path) -> None:
    pytest.importorskip("anywidget", exc_type=ImportError)
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    book = nbformat.read(FOLDER / "notebook.ipynb", as_version=4)
    for cell in book.cells:
        cell.source = cell.source.replace("50_000", "2_500").replace("spp=16", "spp=2")
    nbclient.NotebookClient(book, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert not list(tmp_path.iterdir())  # the notebook leaves no files
    shown = [part.data for cell in book.cells for part in cell.get("outputs", []) if "data" in part]
    assert {"text/plain": "pointray viewer"}.items() <= next(data for data in shown if "image/png" in data).items()
    assert sum("image/png" in data for data in shown) == 3  # of the widget, its snapshot, and the rendered picture
