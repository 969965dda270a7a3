"""The cache of models: hits, misses, eviction, and robustness against damage."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
import warnings

import numpy as np
import pytest

import pointray as pr
from pointray.cli import execute
from pointray.model import model_cache
from pointray.model.model_cache import entry_of

MADE = {"surface": None, "samples": 4}


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty cache that keeps small models, and a scan with an old modification time."""
    monkeypatch.setenv("POINTRAY_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(model_cache, "WORTH", 100)
    scan = tmp_path / "scan.ply"
    pr.write(scan, pr.procedural("sphere", 2000))
    _age(scan)
    return scan


def _age(file, seconds=10.0):
    then = time.time() - seconds
    os.utime(file, (then, then))


def _model(n=2000):
    return pr.Model(pr.procedural("sphere", n))


def test_a_model_is_found_again_with_its_levels_and_notes(place):
    model = _model()
    model.make_levels()
    entry = entry_of([place], MADE)
    assert entry.load() is None
    assert entry.store(model, ["its coordinates are rounded"])
    with pytest.warns(UserWarning, match="its coordinates are rounded"):
        again = entry_of([place], dict(reversed(MADE.items()))).load()
    np.testing.assert_array_equal(again.points.positions, model.points.positions)
    np.testing.assert_array_equal(again.radii, model.radii)
    assert [len(level.points) for level in again.levels] == [len(level.points) for level in model.levels]


def test_another_file_time_size_or_setting_is_a_cache_miss(place, tmp_path):
    assert entry_of([place], MADE).store(_model())
    assert entry_of([place], {**MADE, "samples": 5}).load() is None
    other = tmp_path / "other.ply"
    other.write_bytes(place.read_bytes())
    assert entry_of([other], MADE).load() is None
    assert entry_of([place, place], MADE).load() is None
    _age(place, 20.0)
    assert entry_of([place], MADE).load() is None


def test_a_file_that_was_just_written_or_has_changed_is_not_kept(place, monkeypatch):
    model, entry = _model(), entry_of([place], MADE)
    os.utime(place)
    assert not entry.store(model)
    with monkeypatch.context() as patch:
        patch.setattr(model_cache, "SETTLED", 3600.0)  # else it is old enough on a slow machine
        assert not entry_of([place], MADE).store(model)
    _age(place)
    entry = entry_of([place], MADE)
    assert entry.store(model)
    place.unlink()
    assert not entry.store(model)


def test_small_models_are_not_kept(place, monkeypatch):
    monkeypatch.setattr(model_cache, "WORTH", 2001)
    assert not entry_of([place], MADE).store(_model())


def test_the_least_recently_used_models_are_removed(place, tmp_path, monkeypatch):
    entries = []
    for k in range(4):
        scan = tmp_path / f"{k}.ply"
        scan.write_bytes(place.read_bytes())
        _age(scan)
        entries.append(entry_of([scan], MADE))
    model = _model()
    for k, entry in enumerate(entries[:3]):
        assert entry.store(model)
        _age(entry.path, 100 - k)
    assert entries[0].load() is not None  # now it is the most recently used one
    size = entries[0].path.stat().st_size
    monkeypatch.setattr(model_cache, "MOST_BYTES", int(3.5 * size))
    assert entries[3].store(model)
    assert [entry.load() is not None for entry in entries] == [True, False, True, True]
    assert [known["bytes"] for known in model_cache.describe()] == [size] * 3
    monkeypatch.setattr(model_cache, "MOST_BYTES", 10)
    assert not entries[1].store(model)
    assert model_cache.clear() == (3, 3 * size)
    assert list(model_cache.folder().iterdir()) == []


def test_damaged_models_are_built_again(place):
    entry, model, dice = entry_of([place], MADE), _model(), np.random.default_rng(3)
    assert entry.store(model)
    whole = entry.path.read_bytes()
    for k in range(60):
        data = bytearray(whole[: dice.integers(len(whole))] if k % 3 == 0 else whole)
        for at in dice.integers(len(data), size=3) if data else ():
            data[at] = dice.integers(256)
        entry.path.write_bytes(data)
        if k % 2:
            entry.path.with_suffix(".json").write_bytes(
                bytes(dice.integers(256, size=dice.integers(9), dtype=np.uint8))
            )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            again = entry.load()
        if again is None:
            assert not entry.path.exists()
    assert entry.store(model)
    assert len(entry.load().points) == 2000


@pytest.mark.parametrize(
    "beside",
    ["[" * 100_000, "3", '{"files": 3, "notes": [], "points": 3}', '{"files": ["a"], "notes": [], "points": 3}']
    + ['{"files": [{"path": 3}], "notes": [], "points": 3}', '{"files": [], "notes": 3, "points": "many"}'],
)
def test_a_damaged_description_does_no_harm(place, capsys, beside):
    entry = entry_of([place], MADE)
    assert entry.store(_model())
    entry.path.with_suffix(".json").write_text(beside)
    for command in (["cache"], ["cache", "--json"]):
        assert execute(command) == 0
    assert len(entry.load().points) == 2000
    entry.path.with_name("folder.json").mkdir()
    assert execute(["cache", "--clear"]) == 0
    assert not entry.path.exists() and not capsys.readouterr().err


def test_a_full_disk_or_a_folder_that_cannot_be_made_is_no_error(place, tmp_path, monkeypatch):
    (tmp_path / "cache").write_text("a file where the folder should be")
    entry = entry_of([place], MADE)
    assert entry.load() is None
    assert not entry.store(_model())
    assert model_cache.describe() == []


WRITER = """
import sys
from pathlib import Path
import pointray as pr
from pointray.model import model_cache
from pointray.cli import execute
model_cache.WORTH = 100
models = [pr.Model(pr.procedural("sphere", n)) for n in (2000, 3000)]
entry = model_cache.entry_of([Path(sys.argv[1])], {"surface": None, "samples": 4})
print("ready", flush=True)
while True:
    for model in models:
        assert entry.store(model)
"""


@pytest.mark.long
def test_killed_processes_that_write_the_same_model_leave_a_valid_one(place):
    dice, entry, seen = random.Random(5), entry_of([place], MADE), set()
    for _ in range(4):
        command = [sys.executable, "-c", WRITER, place]
        writers = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
        for writer in writers:
            assert writer.stdout.readline() == "ready\n"
        while not entry.path.exists():  # a first model is written
            assert all(writer.poll() is None for writer in writers)
            time.sleep(0.01)
        time.sleep(dice.uniform(0, 0.05))  # they are killed at a random time
        for writer in writers:
            writer.send_signal(signal.SIGKILL)
            writer.wait()
            writer.stdout.close()
        model = entry.load()
        if model is not None:
            seen.add(len(model.points))
            assert len(model.radii) == len(model.points)
    assert seen
    entry.store(_model())
    left = {path.suffix for path in model_cache.folder().iterdir()}
    assert left == {".json", ".pointray"}
