"""The benchmark of contact sheets: cameras equal those of pointray, and sheets have a row for each scan."""

import sys

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from bench.looks import scatter_sheets
from bench.looks.cloudcompare import seen_from
from bench.looks.scatter_sheets import LINE, closed, options_of
from pointray.cli.declare import parsed
from pointray.cli.picture_options import PictureOptions
from pointray.cli.views import View

CAMERA = pr.Camera.look_at((3, -7, 2.5), (0.5, 0.2, -0.1), (0.1, 0, 1), fov=35, size=(40, 30))


def test_points_are_moved_to_their_pixels(rng):
    origins, directions = CAMERA.rays()
    t = rng.uniform(3, 12, (30, 40))
    positions = (origins + t[..., None] * directions).reshape(-1, 3)
    hidden = np.concatenate(
        [positions, [CAMERA.eye + 2 * (np.asarray(CAMERA.eye) - CAMERA.target)], positions[:1] * np.nan]
    )
    colors = rng.integers(0, 255, (len(hidden), 3)).astype(np.uint8)
    normals = rng.normal(size=hidden.shape)
    found = seen_from(pr.Points(hidden, normals=normals, colors=colors), CAMERA)
    flat, seen = found.positions + found.origin, found.colors
    facing = normals[:1200] @ _forward() < 0
    assert ((found.normals[:-4, 2] > 0) == facing).all()
    x, y = np.meshgrid(np.arange(40) + 0.5 - 20, 15 - 0.5 - np.arange(30))
    np.testing.assert_allclose(flat[:-4, 0], x.ravel(), atol=1e-3)
    np.testing.assert_allclose(flat[:-4, 1], y.ravel(), atol=1e-3)
    assert (np.argsort(flat[:-4, 2]) == np.argsort(-(t * (directions @ _forward())).ravel())).all()
    assert (seen[:-4] == colors[:1200]).all() and (seen[-4:] == [255, 0, 0]).all()
    assert sorted(map(tuple, flat[-4:, :2])) == [(-20, -15), (-20, 15), (20, -15), (20, 15)]


def _forward():
    forward = np.asarray(CAMERA.target) - CAMERA.eye
    return forward / np.linalg.norm(forward)


def test_the_camera_equals_that_of_the_options():
    *vectors, fov, angle, size, shape = options_of(CAMERA)
    words = dict(word.removeprefix("--").split("=") for word in vectors)
    assert (fov, size, shape) == ("--fov", "--size", "40x30")
    view = View(parsed(PictureOptions, {"size": shape, "fov": float(angle), **words}))
    assert view._look_at(view.eye, view.target, view.up) == CAMERA


def test_points_that_cover_a_picture_are_small(rng):
    camera = pr.Camera.look_at((0, 0, 5), (0, 0, 0), (0, 1, 0), size=(400, 300))
    few, many = (pr.Points(rng.uniform(-1, 1, (n, 3)) * [1, 1, 0]) for n in (200, 200_000))
    assert 10 < closed(few, camera) < 11.5 and closed(many, camera) == 4.0


@pytest.mark.long
def test_a_sheet_has_a_row_for_each_scan(tmp_path, monkeypatch, capsys):
    for name in ("a", "b"):
        pr.write(tmp_path / f"{name}.ply", pr.procedural("torus", 500))
    words = [
        str(tmp_path / "a.ply"),
        str(tmp_path / "b.ply"),
        "-o",
        str(tmp_path / "out"),
        "--size",
        "32x24",
        "--measure",
    ]
    monkeypatch.setattr(sys, "argv", ["scatter_sheets.py", *words])
    assert scatter_sheets.main() == 0
    assert Image.open(tmp_path / "out" / "sheet_a.jpg").size == (64, 2 * (24 + LINE))
    assert "0.0% scattered, one point covers up to" in capsys.readouterr().out
