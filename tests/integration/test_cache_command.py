"""Commands load models from the cache and store them there."""

from __future__ import annotations

import json
import os
import time

import pytest

import pointray as pr
from pointray.cli import execute
from pointray.cli.scan_surface import PLAIN
from pointray.model import model_cache
from pointray.viewer import loading

SIZE = ["--size", "64x48", "--spp", "1", "--light", "headlight"]


@pytest.fixture
def scan(tmp_path, monkeypatch):
    monkeypatch.setattr(model_cache, "folder", lambda: tmp_path / "models")
    monkeypatch.setattr(model_cache, "WORTH", 1000)
    path = tmp_path / "scan.ply"
    pr.write(path, pr.procedural("torus", 5000))
    os.utime(path, (time.time() - 60,) * 2)
    return path


def kept():
    return list(model_cache.folder().glob("*.pointray"))


def test_a_picture_is_the_same_from_the_cache(scan, tmp_path, monkeypatch):
    pictures = [tmp_path / f"{k}.png" for k in range(4)]
    assert execute(["render", str(scan), "-o", str(pictures[0]), "--no-cache", *SIZE]) == 0
    assert kept() == []
    assert execute(["render", str(scan), "-o", str(pictures[1]), *SIZE]) == 0
    assert len(kept()) == 1
    monkeypatch.setattr("pointray.cli.scan_scene.ScanScene._built", lambda *_: pytest.fail("it is built again"))
    assert execute(["render", str(scan), "-o", str(pictures[2]), *SIZE]) == 0
    assert len({path.read_bytes() for path in pictures[:3]}) == 1


@pytest.mark.long
def test_other_options_of_reading_and_building_miss_the_cache(scan, tmp_path):
    for more in ([], ["--every", "2"], ["--samples", "5"], ["--normals", "fit"], ["--samples", "5"]):
        assert execute(["render", str(scan), "-o", str(tmp_path / "a.png"), *SIZE, *more]) == 0
    assert len(kept()) == 4


def test_cache_lists_and_clears(scan, tmp_path, capsys):
    assert execute(["render", str(scan), "-o", str(tmp_path / "a.png"), *SIZE]) == 0
    capsys.readouterr()
    assert execute(["cache"]) == 0
    output = capsys.readouterr().out
    assert "1 models" in output and "5,000 points" in output and str(scan) in output
    assert execute(["cache", "--info", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["bytes"] == kept()[0].stat().st_size
    assert facts["models"][0]["files"] == [str(scan)]
    assert execute(["cache", "--clear", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["removed"] == 1
    assert kept() == []
    assert execute(["cache", "--info", "--clear"]) == 2


class Shared:
    """Records what a loader shows."""

    def __init__(self):
        self.shown = []
        self.settings = pr.Settings()

    def report(self, *_):
        pass

    def show(self, scene, coarse=False):
        self.shown.append((len(scene.models[0].points), len(scene.models[0].levels), coarse))


def test_the_viewer_loads_cached_models(scan, monkeypatch):
    monkeypatch.setattr(loading, "is_warm", lambda *_: True)
    monkeypatch.setattr(loading, "LARGE_FROM", 4000)
    monkeypatch.setattr(loading, "COARSE", 2000)
    entry = model_cache.entry_of([scan], {"surface": None})
    surface = dict(PLAIN)

    def load(leveled=True):
        shared = Shared()
        loading.FileLoader([scan], surface, lambda scene: (0.0, 0.0, 1.0), leveled, entry=entry)(shared)
        return shared.shown

    first = load()
    assert first[0] == (2000, 0, True) and first[1] == (5000, 0, False) and first[-1][1] > 0
    assert load() == [first[-1]]
    assert load(leveled=False) == [(5000, 0, False)]
    model_cache.clear()
    assert entry.store(pr.Model(pr.read(scan)))  # as `render` keeps it
    assert load()[-1] == first[-1]
    assert load() == [first[-1]]


@pytest.mark.parametrize(("surface", "leveled"), [("apss", True), ("disc", False)])
def test_the_viewer_adds_levels_to_a_saved_model(tmp_path, monkeypatch, surface, leveled):
    monkeypatch.setattr(loading, "is_warm", lambda *_: True)
    monkeypatch.setattr(loading, "LARGE_FROM", 4000)
    path, shared = tmp_path / "saved.pointray", Shared()
    pr.Model(pr.procedural("torus", 5000), surface=surface).save(path)
    loading.FileLoader([path], {}, lambda scene: (0.0, 0.0, 1.0))(shared)
    assert shared.shown[0] == (5000, 0, False)
    assert (shared.shown[-1][1] > 0) == leveled
