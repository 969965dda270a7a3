"""The comparison with other programs: silhouettes, lines of code, absent programs, and a small run."""

import importlib.util
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from bench import beside
from bench.comparison import measure, page, peers
from bench.comparison.measure import coverage, covered, overlap
from bench.comparison.peers import PEERS, SCRIPTS


def test_gaps_do_not_change_a_silhouette_but_a_shift_does():
    disc = np.hypot(*np.mgrid[-40:40, -40:40]) < 25
    sparse = disc.copy()
    sparse[::3] = False
    assert overlap(disc, disc) == 1.0 and overlap(disc, sparse) > 0.98
    assert overlap(disc, np.roll(disc, 8, axis=1)) < 0.85


def test_a_pixel_is_covered_if_it_differs_from_the_background(tmp_path):
    levels = np.full((60, 80, 3), (230, 226, 220), np.uint8)
    levels[30:40, 20:70] = 90
    Image.fromarray(levels).save(tmp_path / "picture.png")
    assert (covered(tmp_path / "picture.png") == (levels[..., 0] == 90)).all()


@pytest.mark.long
def test_the_surface_covers_the_disc_of_a_sphere():
    points = pr.procedural("sphere", 2000)
    camera = pr.Camera.look_at((0, -5, 0), (0, 0, 0), (0, 0, 1), fov=40, size=(80, 60))
    y, x = np.mgrid[-29.5:30, -39.5:40] * np.tan(np.radians(20)) / 30
    radius = float(np.linalg.norm(points.positions, axis=1).mean())
    disc = np.hypot(x, y) < np.tan(np.arcsin(radius / 5))
    assert overlap(coverage(points, camera), disc) > 0.97


def test_each_program_has_a_script_whose_lines_are_counted():
    scripts = {path.stem for path in SCRIPTS.glob("*.py")}
    assert scripts == {peer.key for peer in PEERS} - {"pointray", "cloudcompare"}
    for peer in PEERS:
        if peer.key in scripts:
            text = (SCRIPTS / f"{peer.key}.py").read_text()
            assert 5 < int(peer.lines) < len(text.splitlines()) - 3 and "https://" in text


def _run(folder, monkeypatch, *words):
    pr.write(folder / "torus.ply", replace(pr.procedural("torus", 1500), colors=np.full((1500, 3), 90, np.uint8)))
    words = [str(folder / "torus.ply"), "-o", str(folder / "comparison.md"), "--size", "96x72", "--repeat", "1", *words]
    monkeypatch.setattr(sys, "argv", ["beside", *words])
    assert beside.main() == 0
    return (folder / "comparison.md").read_text()


def test_an_absent_program_is_named(tmp_path, monkeypatch, capsys):
    absent = replace(PEERS[1], needs=("no_such_program",))
    monkeypatch.setattr(beside, "PEERS", [absent])
    text = _run(tmp_path, monkeypatch, "--only", absent.key)
    assert f"not run: no_such_program not installed: {absent.install}" in text
    assert "not run" in capsys.readouterr().out


def test_a_failed_program_is_reported(tmp_path):
    result = measure.Result(PEERS[0], tmp_path / "none.png")
    measure.run(result, [sys.executable, "-c", "raise SystemExit('no display')"])
    assert result.failure == "failed with status 1: no display" and result.seconds == []


def test_a_program_that_hangs_is_stopped_and_run_again(tmp_path, monkeypatch):
    monkeypatch.setattr(measure, "LONGEST", 0.2)
    monkeypatch.setattr(measure, "TRIES", 2)
    hanging = "import time; time.sleep(60)"
    result = measure.Result(PEERS[0], tmp_path / "none.png")
    measure.run(result, [sys.executable, "-c", hanging])
    assert result.failure == "failed: stopped 2 times after 0.2 s" and result.stopped == 2


def test_the_page_says_how_many_runs_were_stopped(tmp_path):
    Image.new("RGB", (64, 48)).save(tmp_path / "points.png")
    result = measure.Result(PEERS[1], tmp_path / "points.png", [1.0], [2.0], 10**9, 0.9, stopped=2)
    page.write_page(tmp_path / "comparison.md", [(tmp_path / "torus.ply", 9, [result])], (64, 48), 10)
    assert "Open3D, points: 2 runs were stopped after 150 s" in (tmp_path / "comparison.md").read_text()


@pytest.mark.long
@pytest.mark.skipif(importlib.util.find_spec("pyvista") is None, reason="PyVista is not installed")
def test_a_small_scan_is_compared(tmp_path, monkeypatch):
    text = _run(tmp_path, monkeypatch, "--only", "pointray", "pyvista_points")
    rows = [row.split(" | ") for row in text.splitlines() if " GB | " in row]
    assert [row[0] for row in rows] == ["| pointray", "| PyVista, points"]
    for row in rows:
        assert float(row[1]) > 0 and 0.05 < float(row[3].removesuffix(" GB")) < 4
        assert float(row[5].removesuffix(" |")) > 0.8
    assert text.count("![") == 2 and len(list((tmp_path / "pictures" / "comparison").glob("torus_*.webp"))) == 2


def test_the_newest_llvm_is_chosen_unless_one_is_given(monkeypatch):
    monkeypatch.setenv(peers.LLVM, "mine.so")
    assert peers.environment()[peers.LLVM] == "mine.so"
