"""Readers that other packages register, and those of pointray in PyVista."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import zipfile
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import numpy as np
import pytest

import pointray as pr
from pointray.io import known_formats, plugins

MODULE = """
import numpy as np

def read(path):
    rows = np.loadtxt(path, skiprows=1)
    return {"x": rows[:, 0], "y": rows[:, 1], "z": rows[:, 2], "weight": rows[:, 3].astype(np.int16)}
"""
FILES = {
    "smallscan.py": MODULE,
    "smallscan-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: smallscan\nVersion: 1.0\n",
    "smallscan-1.0.dist-info/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    "smallscan-1.0.dist-info/entry_points.txt": "[pointray.readers]\n.small = smallscan:read\n",
    "smallscan-1.0.dist-info/RECORD": "",
}
USE = """
import sys, pointray as pr
points = pr.read(sys.argv[1])
print(len(points), points.attributes["weight"].dtype, "smallscan" in sys.modules)
"""


def small_scan(folder):
    file = folder / "a.small"
    np.savetxt(file, np.random.default_rng(0).random((50, 4)) * 9, header="small", comments="")
    return file


@pytest.mark.long
def test_a_package_with_a_reader_in_a_fresh_environment(tmp_path):
    wheel, fresh = tmp_path / "smallscan-1.0-py3-none-any.whl", tmp_path / "fresh"
    with zipfile.ZipFile(wheel, "w") as archive:
        for name, text in FILES.items():
            archive.writestr(name, text)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(fresh)], check=True)
    python = fresh / "bin" / "python"
    place = subprocess.run([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], text=True, **DONE)
    libraries = [sysconfig.get_path("purelib"), str(Path(pr.__file__).parents[1])]
    (Path(place.stdout.strip()) / "libraries.pth").write_text("\n".join(libraries))
    file = small_scan(tmp_path)
    before = subprocess.run([python, "-c", USE, file], capture_output=True, text=True)
    assert "unsupported file type .small" in before.stderr
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-index", "--no-deps", str(wheel)]
    subprocess.run(pip, **DONE)
    assert subprocess.run([python, "-c", USE, file], text=True, **DONE).stdout == "50 int16 True\n"
    info = subprocess.run([python, "-m", "pointray", "info", file], text=True, **DONE)
    assert "50" in info.stdout and "small" in info.stdout


DONE = {"check": True, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}


@pytest.fixture
def register(monkeypatch):
    """Register functions of this module as readers, by extension."""

    def work(**functions):
        entries = [EntryPoint(name, f"{__name__}:{function}", plugins.GROUP) for name, function in functions.items()]
        monkeypatch.setattr(plugins, "entry_points", lambda group: entries)
        known_formats._formats.cache_clear()

    yield work
    monkeypatch.undo()
    known_formats._formats.cache_clear()


def array_reader(path):
    return np.loadtxt(path, skiprows=1)[:, :3]


def failing_reader(path):
    raise KeyError("lost")


def empty_reader(path):
    return None


def same_path(path):
    return path


def absent_reader(path):
    raise FileNotFoundError(f"{path}.index")


def test_the_extension_selects_the_reader(register, tmp_path):
    register(small="array_reader")
    points = pr.read(small_scan(tmp_path), every=5)
    assert len(points) == 10
    assert [known.name for known in pr.formats() if ".small" in known.extensions] == [
        f"small ({__name__}:array_reader)"
    ]
    pr.write(tmp_path / "b.ply", points)
    (tmp_path / "b.ply").rename(tmp_path / "b.small")  # recognised by its contents
    assert len(pr.read(tmp_path / "b.small")) == 10


@pytest.mark.parametrize(
    ("reader", "text"),
    [
        ("failing_reader", "failed: KeyError: 'lost'"),
        ("same_path", "failed: TypeError: it returned a path"),
        ("empty_reader", "failed: .*result must be Points, a path"),
        ("not_there", "failed: AttributeError"),
    ],
)
def test_a_reader_that_fails_is_named(register, tmp_path, reader, text):
    register(small=reader)
    file = small_scan(tmp_path)
    with pytest.raises(ValueError, match=f"a.small: the reader {__name__}:{reader} of .* {text}"):
        pr.read(file)


def test_errors_of_files_pass(register, tmp_path):
    register(small="absent_reader")
    with pytest.raises(FileNotFoundError, match="a.small.index"):
        pr.read(small_scan(tmp_path))


def test_pyvista_reads_scans_with_pointray(tmp_path, rng):
    pyvista = pytest.importorskip("pyvista", exc_type=ImportError)
    names = {entry.name for entry in entry_points(group="pyvista.readers") if "pointray" in entry.value}
    assert names >= {".e57", ".las", ".laz", ".pcd", ".ptx"}
    cloud = pr.Points(rng.random((30, 3)) + [4e5, 5e6, 0], colors=rng.integers(0, 256, (30, 3)).astype(np.uint8))
    pr.write(tmp_path / "a.laz", cloud)
    mesh = pyvista.read(tmp_path / "a.laz")
    assert isinstance(mesh, pyvista.PolyData) and mesh.n_points == 30
    np.testing.assert_allclose(mesh.points, cloud.world, rtol=0, atol=1e-4)
    np.testing.assert_array_equal(mesh["RGB"], cloud.colors)
