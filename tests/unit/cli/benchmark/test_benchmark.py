"""`pointray bench`: the paper's table with figures of this machine."""

import importlib.util
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from pointray.cli import execute
from pointray.cli.benchmark import frames, measure, show_rows
from pointray.cli.benchmark.views import far_view, near_view


@pytest.fixture(scope="module")
def rows():
    return measure([3000, 12000], 2, 2, lambda stage, share: None)


@pytest.mark.long
def test_the_views_fill_the_intended_part_of_the_picture():
    """The far view's silhouette spans 90% of the height; in the near view 95% of the pixels hit."""
    scene, points = pr.Scene(), pr.procedural("statue", 20_000)
    model = pr.Model(points)
    scene.add(model)
    far = far_view(points, model.bounds, (200, 300))
    seen = np.isfinite(scene.intersect(*far.rays()).t)
    spans = [np.ptp(np.flatnonzero(seen.any(axis=k))) / n for k, n in ((1, 300), (0, 200))]
    assert max(spans) == pytest.approx(0.9, abs=0.02)
    near = near_view(scene, far, (200, 200))
    assert np.isfinite(scene.intersect(*near.rays()).t).mean() >= 0.94


@pytest.mark.long
def test_each_cloud_is_measured_from_far_and_near(rows):
    assert [(r.points, r.view) for r in rows] == [(n, v) for n in (3000, 12000) for v in ("far", "near")]
    for r in rows:
        assert r.frames_per_second == pytest.approx(1e3 / r.frame_ms) and r.bytes_per_point > 40
        assert r.covered > 0.9 if r.view == "near" else 0.05 < r.covered < 0.6
    far = [r.covered for r in rows if r.view == "far"]
    assert far[0] == pytest.approx(far[1], abs=0.03), "the subsampled statue is not the statue"


@pytest.mark.long
def test_cases_of_the_paper_have_its_figures(monkeypatch):
    """The stress test is a case of its own with a light and shadows, run here at a small size."""
    monkeypatch.setattr(frames, "STRESS", 4000)
    monkeypatch.setattr(frames, "PAPER", {(4000, "far"): 2.1})
    (row,) = measure([4000], 1, 1, lambda stage, share: None)
    assert (row.size, row.light, row.paper_frames_per_second) == ("640x480", "sun, shadows", 2.1)
    assert 0.02 < row.covered < 0.6


@pytest.mark.long
def test_the_table_is_printed_as_text_and_as_json(rows, capsys):
    show_rows([replace(rows[0], paper_frames_per_second=8.7), rows[1]], 2, False)
    text = capsys.readouterr().out
    assert "3,000" in text and "8.7" in text and "near" in text and "Opteron" in text
    show_rows(rows, 2, True)
    told = json.loads(capsys.readouterr().out)
    assert told["threads"] == 2 and [c["view"] for c in told["cases"]] == ["far", "near"] * 2


def test_the_command_draws_a_plot(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(frames, "SIZE", (64, 64))
    monkeypatch.setattr(frames, "procedural", lambda name, count: pr.procedural("sphere", count))
    picture = tmp_path / "bench.png"
    assert execute(["bench", "--points", "2000", "--runs", "1", "--plot", str(picture), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["cases"]) == 2
    with Image.open(picture) as image:
        assert image.size[0] > 500 and len(np.unique(image.convert("L"))) > 5
    assert list(tmp_path.iterdir()) == [picture]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--points", "12"], "1000"),
        (["--points", "2000", "--points", "2000"], "duplicate counts"),
        (["--runs", "0"], "--runs"),
        (["--plot", "bench.gif"], ".png"),
        (["--plot", "nowhere/bench.png"], "folder not found"),
    ],
)
def test_bad_input_is_reported_before_the_work(arguments, word, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert execute(["bench", *arguments]) == 2
    assert word in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_without_matplotlib_the_error_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert execute(["bench", "--plot", "bench.png"]) == 2
    assert "pip install 'pointray[plot]'" in capsys.readouterr().err
