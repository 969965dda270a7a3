"""`pointray animate`: projection and lens of the camera, and limits of time and noise."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.clouds import sphere_points
from pointray.cli import execute

FILM = ["--size", "32x24", "--spp", "1", "--seconds", "1", "--fps", "2"]


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A sphere."""
    rows = sphere_points(2000)
    pr.write(tmp_path / "scan.ply", pr.Points(rows, rows))
    return tmp_path / "scan.ply"


def film(scan, *options):
    """The frames of a film with these options."""
    out = scan.parent / "film"
    assert execute(["animate", str(scan), "-o", str(out), *FILM, *options]) == 0
    return [np.asarray(Image.open(path)) for path in sorted(out.glob("*.png"))]


def heights(frames):
    """Return the heights of the visible shape, in pixels."""
    return [int(np.ptp(np.flatnonzero(frame[..., 3].any(axis=1)))) + 1 for frame in frames]


@pytest.mark.long
def test_an_orthographic_film_has_no_perspective(scan):
    """At distance 2 and 90 degrees, a sphere has 1/2 of the picture's height, with perspective 0.58."""
    near = ["--eye", "0,-2,0", "--target", "0,0,0", "--fov", "90", "--background", "none"]
    assert heights(film(scan, *near, "--projection", "orthographic")) == [12, 12]
    assert heights(film(scan, *near)) == [14, 14]


def test_a_scan_stays_in_an_orthographic_film(scan):
    frames = film(scan, "--projection", "orthographic", "--background", "none")
    assert len(frames) == 2
    for frame in frames:
        assert frame[12, 16, 3] > 0 and not frame[[0, -1]].any() and not frame[:, [0, -1]].any()


def test_a_film_has_depth_of_field(scan):
    lens = ["--eye", "0,-6,0", "--target", "0,0,0", "--spp", "4"]
    frames = [film(scan, *lens, *more)[0] for more in ([], ["--aperture", "2", "--focus", "2"], ["--aperture", "2"])]
    assert not np.array_equal(frames[0], frames[1]) and not np.array_equal(frames[1], frames[2])


@pytest.mark.long
def test_frames_stop_at_a_noise_or_time_limit(scan):
    """Samples are added until the noise or time limit is reached."""
    corner = ["--integrator", "ao", "--ground"]
    exact, one, many = (
        film(scan, *corner, *more)[0].astype(float) for more in (["--spp", "256"], [], ["--noise", "0.01"])
    )
    assert np.abs(many - exact).mean() < 0.4 * np.abs(one - exact).mean()
    assert film(scan, *corner, "--time-limit", "0.01")[0].shape == one.shape


def test_panoramas_follow_keys_but_have_no_turntable(scan, capsys):
    keys = [{"time": t, "eye": [2 * t, -3, 0], "target": [0, 0, 0]} for t in (0, 1)]
    (scan.parent / "keys.json").write_text(json.dumps({"keys": keys}))
    out = scan.parent / "film"
    command = ["animate", str(scan), "-o", str(out), "--size", "32x16", "--spp", "1", "--fps", "1"]
    command += ["--projection", "panorama"]
    assert execute([*command, "--keys", str(scan.parent / "keys.json")]) == 0 and len(list(out.glob("*.png"))) == 2
    scan.write_text("nothing that could be read")
    assert execute(command) == 2 and "a turntable needs --eye" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--projection", "orthographic", "--aperture", "-1"], "aperture"),
        (["--focus", "3"], "--aperture"),
        (["--time-limit", "0"], "time_limit"),
        (["--noise", "-1"], "noise"),
    ],
)
def test_unsupported_options_of_films_are_refused(scan, options, message, capsys):
    assert execute(["animate", str(scan), "-o", str(scan.parent / "film"), *FILM, *options]) == 2
    output = capsys.readouterr().err
    assert message in output and len(output.splitlines()) == 1
    assert not (scan.parent / "film").exists()
