"""Normals of a file that deviate from its surface are detected, reported, and replaced by fitted ones."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from helpers.marks import long
from helpers.places import shared_model
from pointray.cli import execute
from pointray.cli.scan_surface import PLAIN
from pointray.cloud.neighbors import few_queries as nearby
from pointray.cloud.normals.comparison import WRONG
from pointray.cloud.normals.validation import select_normals
from pointray.viewer.loading import FileLoader
from pointray.viewer.shared_scene import SharedScene

SMALL = ["--size", "32x24", "--spp", "1", "--light", "headlight"]
N = 10_000
SCANS = [
    *("stanford_bunny", "stanford_dragon", "stanford_bunny_rangescans", "stanford_dragon_stand_rangescans"),
    *("stanford_lucy_50k", "nefertiti_50k", "potree_lion_takanawa_rgb", "outcrop_qcompass_rgb"),
    *("autzen_stadium_crop_rgb", "rgbd_kinect_chair_rgb", "tls_pumpA_rgb"),
]


def unit(rows: np.ndarray) -> np.ndarray:
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-30)


def tilted(normals: np.ndarray, degrees: float, direction: np.ndarray) -> np.ndarray:
    """Return the normals, each tilted by some degrees towards a direction."""
    normals = unit(np.asarray(normals, np.float64))
    across = unit(direction - np.sum(direction * normals, axis=1, keepdims=True) * normals)
    return normals * np.cos(np.radians(degrees)) + across * np.sin(np.radians(degrees))


def ripple(steepness: float = 1.0, n: int = 12_000) -> pr.Points:
    """z = sin r, with the normals of steeper waves: 2.2 times the steepness gives a median error of 21 degrees."""
    xy = np.random.default_rng(0).uniform(-7, 7, (n, 2))
    r = np.linalg.norm(xy, axis=1)
    slopes = xy * (np.cos(r) / r)[:, None]
    return pr.Points(np.column_stack([xy, np.sin(r)]), unit(np.column_stack([-steepness * slopes, np.ones(n)])))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    pr.write(tmp_path / "ripple.ply", ripple(2.2))
    return tmp_path / "ripple.ply"


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    pr.write(tmp_path / "bare.ply", ripple().with_normals(None))
    return tmp_path / "bare.ply"


# ------------------------------------------------------------------------------------------------- what is wrong


@pytest.mark.scans
@pytest.mark.parametrize("name", [SCANS[0], *map(long, SCANS[1:])])
def test_normals_of_scans_are_valid_and_tilted_ones_invalid(name):
    points = pr.read(shared_model(f"points/{name}.ply"))
    found = pr.check_normals(points)
    assert found.angle < 5 and not found.wrong
    turned = pr.check_normals(points.with_normals(tilted(points.normals, 21, np.float64([1, 0, 0]))))
    assert turned.wrong and turned.angle == pytest.approx(21, abs=1)


@pytest.mark.parametrize("amount", [0, long(0.1), long(0.3), 0.5, long(1.0)])
def test_noise_does_not_invalidate_normals(amount):
    torus = pr.procedural("torus", N)
    spacing = np.sqrt(4 * np.pi**2 * 0.4 / N)
    offsets = np.random.default_rng(1).normal(0, amount * spacing, (N, 3))
    points = pr.Points(torus.positions + offsets, torus.normals)
    assert pr.check_normals(points).angle < 6
    wrong = pr.check_normals(points.with_normals(tilted(points.normals, 21, np.float64([0, 0, 1]))))
    assert wrong.wrong and wrong.angle == pytest.approx(21, abs=2)


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("sphere", (1, 12, 500)),
        *(long(name, (1, 2, 11, 12, 100, 500, 2_000, 20_000)) for name in ("sphere", "torus", "lattice", "statue")),
    ],
)
def test_detail_finer_than_the_points_does_not_invalidate_normals(name, counts):
    """Planes through the statue's 2,000 points are 21 degrees off its normals, and those of the lattice 45."""
    for count in counts:
        assert not pr.check_normals(pr.procedural(name, count)).wrong, f"{count} points"


def test_invalid_normals_of_a_closed_body_are_detected():
    points = pr.procedural("torus", N)
    random = np.random.default_rng(2)
    wrong = {
        "exchanged axes": points.normals[:, [0, 2, 1]],
        "all alike": np.tile([0.0, 0.0, 1.0], (len(points), 1)),
        "random": random.normal(size=(len(points), 3)),
        "turned": points.normals @ np.float64([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    }
    for name, normals in wrong.items():
        assert pr.check_normals(points.with_normals(normals)).wrong, name


def test_signs_lengths_and_missing_normals_are_ignored():
    points = pr.procedural("torus", N)
    random, usual = np.random.default_rng(2), pr.check_normals(points)
    assert usual.angle < 1
    for factors in (-1, random.choice([-1, 1], (N, 1)), random.uniform(0.1, 9, (N, 1)), 1e-30, 1e30):
        found = pr.check_normals(points.with_normals(points.normals * factors))
        assert found.angle == pytest.approx(usual.angle, abs=0.1)
    lost = points.normals * (np.arange(N) % 3 > 0)[:, None]
    lost[1] = np.nan
    assert pr.check_normals(points.with_normals(lost)).angle < 1


def test_normals_that_scatter_about_the_true_ones_are_valid():
    """The surface averages normals, and so does the comparison."""
    points = pr.procedural("torus", N)
    scattered = tilted(points.normals, 21, np.random.default_rng(3).normal(size=(N, 3)))
    assert 1 < pr.check_normals(points.with_normals(scattered)).angle < 6


@pytest.mark.parametrize("normals", [None, np.zeros((5_000, 3)), np.full((5_000, 3), np.nan)])
def test_missing_normals_are_not_invalid(normals):
    assert pr.check_normals(pr.Points(sphere_points(5_000), normals)) == (None, False)


@pytest.mark.parametrize("step", [0.5, long(1), long(2), long(3), 5])
def test_rounded_coordinates_do_not_invalidate_normals(step):
    """If all neighbours lie on one step of rounding, the plane through them is that step, and is ignored."""
    points = ripple(n=40_000)
    positions = points.positions.astype(np.float64)
    size = step * 14 / 200
    positions[:, 1] = np.round(positions[:, 1] / size) * size
    moved = (positions + [0, 2.0**23 * size, 0]).astype(np.float32)
    assert not pr.check_normals(pr.Points(moved, points.normals)).wrong


def test_the_median_deviation_decides():
    points = ripple()
    found = [pr.check_normals(points.with_normals(tilted(points.normals, d, np.float64([1, 0, 0])))) for d in (13, 17)]
    assert [one.wrong for one in found] == [False, True]
    assert found[0].angle < WRONG < found[1].angle


@pytest.mark.long
def test_only_a_sample_of_many_points_is_compared(monkeypatch):
    """The result is nearly the same, because neighbours are searched in the whole cloud."""
    points = pr.procedural("torus", 60_000)
    usual = pr.check_normals(points.with_normals(tilted(points.normals, 30, np.float64([0, 0, 1]))))
    asked, ask = [], nearby.neighbors
    monkeypatch.setattr(nearby, "FEW", 10_000)
    monkeypatch.setattr(nearby, "GUESS", 2_000)
    monkeypatch.setattr(nearby, "neighbors", lambda rows, *rest: asked.append(len(rows)) or ask(rows, *rest))
    some = nearby.find_neighborhoods(points.positions, 20, 64)
    assert 0 < sum(asked) < 30_000
    monkeypatch.setattr(nearby, "FEW", 1_000_000)
    all_of_them = nearby.find_neighborhoods(points.positions, 20, 64)
    known = np.isin(all_of_them.rows[:, 0], some.rows[:, 0])
    assert known.mean() >= nearby.SOUND
    np.testing.assert_array_equal(all_of_them.farthest[known], some.farthest)
    np.testing.assert_array_equal(np.sort(all_of_them.rows[known], axis=1), np.sort(some.rows, axis=1))
    monkeypatch.setattr(nearby, "FEW", 10_000)
    again = pr.check_normals(points.with_normals(tilted(points.normals, 30, np.float64([0, 0, 1]))))
    assert again.wrong and again.angle == pytest.approx(usual.angle, abs=0.5)


# ------------------------------------------------------------------------------------------- what is done about it


def test_wrong_normals_are_replaced_and_keep_their_side():
    truth = ripple()
    for side in (1, -1):
        with pytest.warns(UserWarning, match=r"by 21 degrees \(median\): replaced by fitted normals"):
            points = select_normals(ripple(2.2).with_normals(side * ripple(2.2).normals))
        cosines = side * np.sum(points.normals * truth.normals, axis=1)
        assert np.median(cosines) > 0.999 and (cosines > 0).mean() > 0.99


def test_valid_normals_are_kept_and_invalid_ones_on_request():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        right, wrong = ripple(), ripple(2.2)
        assert select_normals(right) is right
        assert select_normals(wrong, "file") is wrong
        assert select_normals(right, "fit").normals is None
        assert select_normals(right.with_normals(None)).normals is None


def test_a_model_keeps_the_attributes_of_points():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".* isolated points?")  # some lie in the corners
        assert pr.check_normals(pr.Model(ripple(2.2, 3_000)).points).wrong


@pytest.mark.long
def test_render_reports_replaced_normals_and_how_to_keep_them(file, tmp_path, capsys):
    picture = tmp_path / "a.png"
    assert execute(["render", str(file), "-o", str(picture), *SMALL]) == 0
    assert (
        "pointray: note: normals in the file deviate from the surface by 21 degrees (median): replaced by fitted "
        "normals (--normals file keeps them)\n"
    ) in capsys.readouterr().err
    shown = {"auto": picture.read_bytes()}
    for choice in ("file", "fit"):
        assert execute(["render", str(file), "-o", str(picture), *SMALL, "--normals", choice]) == 0
        assert "deviate from the surface" not in capsys.readouterr().err
        shown[choice] = picture.read_bytes()
    assert shown["auto"] == shown["fit"] != shown["file"]


@pytest.mark.parametrize("command", ["render", "animate", "prepare"])
def test_normals_that_a_file_lacks_cannot_be_used(command, bare, tmp_path, capsys):
    output = tmp_path / {"render": "a.png", "animate": "frames", "prepare": "b.ply"}[command]
    assert execute([command, str(bare), "-o", str(output), "--normals", "file"]) == 2
    assert capsys.readouterr().err == f"pointray: {bare}: --normals file: the file has no normals\n"
    assert not output.is_file()


@pytest.mark.parametrize("command", ["render", "animate", "prepare", "view"])
def test_a_saved_model_has_its_normals(command, tmp_path, capsys):
    saved = tmp_path / "a.pointray"
    pr.Model(ripple(1, 1_000)).save(saved)
    output = [] if command == "view" else ["-o", str(tmp_path / ("b.ply" if command == "prepare" else "b.png"))]
    output = ["-o", str(tmp_path / "frames")] if command == "animate" else output
    assert execute([command, str(saved), *output, "--normals", "fit"]) == 2
    assert "--normals are part of a saved model" in capsys.readouterr().err


def test_prepare_writes_the_normals_that_are_used(file, bare, tmp_path, capsys):
    out, truth = tmp_path / "out.ply", ripple().normals
    off = {}
    for choice in ("auto", "file", "fit"):
        assert execute(["prepare", str(file), "-o", str(out), "--normals", choice]) == 0
        cosines = np.abs(np.sum(pr.read(out).normals * truth, axis=1))
        off[choice] = np.degrees(np.median(np.arccos(np.minimum(cosines, 1))))
        assert ("deviate from the surface" in capsys.readouterr().err) == (choice == "auto")
    assert off["auto"] < 2 and off["fit"] < 2 and off["file"] == pytest.approx(21, abs=1)
    assert execute(["prepare", str(bare), "-o", str(out)]) == 0 and pr.read(out).normals is None
    assert execute(["prepare", str(bare), "-o", str(out), "--normals", "fit", "--viewpoint", "0,0,-90"]) == 0
    assert (pr.read(out).normals[:, 2] < 0).mean() > 0.99
    assert execute(["prepare", str(file), "-o", str(out), "--normals", "file", "--estimate-normals"]) == 2
    assert "exclude each other" in capsys.readouterr().err


def test_info_reports_the_same(file, bare, capsys):
    assert execute(["info", str(file), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["normals"] is True and facts["normals_wrong"] is True
    assert facts["normals_off"] == pytest.approx(21, abs=1)
    assert len(facts["notes"]) == 1 and "by 21 degrees (median): they will be estimated" in facts["notes"][0]
    assert execute(["info", str(file)]) == 0
    assert "degrees off the surface (median): wrong" in capsys.readouterr().out
    pr.write(file, ripple())
    assert execute(["info", str(file)]) == 0
    out = capsys.readouterr().out
    assert "degrees off the surface (median): good" in out and "notes" not in out
    assert execute(["info", str(bare), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["normals"], facts["normals_off"], facts["normals_wrong"], facts["notes"]) == (False, None, False, [])


def off_at_a_slope(scene: pr.Scene) -> float:
    """Return degrees between the true normal and that of a hit from above on a slope of the ripple."""
    x, y = 1.5, 1.0
    r = np.hypot(x, y)
    truth = unit(np.float64([[-x * np.cos(r) / r, -y * np.cos(r) / r, 1]]))[0]
    normal = scene.intersect([x, y, 5], [0, 0, -1]).normal
    return float(np.degrees(np.arccos(min(abs(normal @ truth), 1.0))))


@pytest.mark.parametrize("choice", ["auto", "file", "fit"])
def test_a_scene_file_chooses_the_normals(choice, file, tmp_path, recwarn):
    scene = tmp_path / "scene.toml"
    line = "" if choice == "auto" else f'normals = "{choice}"\n'
    scene.write_text(f'[models.a]\nfile = "ripple.ply"\n{line}[[instances]]\nmodel = "a"\n')
    made = pr.load_scene(scene).scene
    printed = [str(w.message) for w in recwarn if "deviate from the surface" in str(w.message)]
    assert len(printed) == (choice == "auto") and all('(normals = "file" keeps them)' in text for text in printed)
    assert (off_at_a_slope(made) > 8) == (choice == "file")


def test_invalid_choices_of_normals_in_scene_files_are_reported(file, bare, tmp_path, capsys):
    scene, saved = tmp_path / "scene.toml", tmp_path / "m.pointray"
    pr.Model(ripple(1, 1_000)).save(saved)
    wrong = {
        'file = "ripple.ply"\nnormals = "fitted"': "normals: unknown normals 'fitted' (did you mean 'fit'?)",
        'file = "m.pointray"\nnormals = "fit"': "normals: cannot be set for a saved model (m.pointray)",
        'file = "bare.ply"\nnormals = "file"': 'normals = "file": the file has no normals',
        'procedural = "sphere"\npoints = 900\nnormals = "fit"': "normals: unknown key 'normals'",
    }
    for text, message in wrong.items():
        scene.write_text(f'[models.a]\n{text}\n[[instances]]\nmodel = "a"\n')
        assert execute(["render", str(scene), "-o", str(tmp_path / "a.png")]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize("coarse", [False, True])
def test_the_viewer_shows_fitted_normals(coarse, file, monkeypatch, recwarn):
    """The coarse version of a large scan has fitted normals as well."""
    if coarse:
        monkeypatch.setattr("pointray.viewer.loading.COARSE", 4_000)
        monkeypatch.setattr("pointray.viewer.loading.LARGE_FROM", 8_000)
    shared, plain = SharedScene("a"), dict(PLAIN)
    shown: list[pr.Scene] = []
    monkeypatch.setattr(shared, "show", lambda scene, home=None, coarse=False: shown.append(scene))
    for choice in ("auto", "file"):
        FileLoader([file], plain, lambda scene: (0.0, 0.0, 1.0), False, choice)(shared)
        assert len(shown) == 1 + coarse
        assert all((off_at_a_slope(scene) > 8) == (choice == "file") for scene in shown)
        shown.clear()
    assert sum("deviate from the surface" in str(w.message) for w in recwarn) == 1
