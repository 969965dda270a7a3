"""`pointray prepare`: output, messages, and how `render` uses the output."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

import pointray as pr
from helpers.clouds import sphere_points
from helpers.marks import long
from pointray.cli import execute, report


@pytest.fixture(autouse=True)
def _threads(monkeypatch):
    monkeypatch.setenv("POINTRAY_THREADS", "2")


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A sphere of radius 1 with 100 duplicates and two stray points."""
    rows = np.vstack([sphere_points(5000), sphere_points(100), [[80, 0, 0], [0, -90, 0]]]).astype(np.float32)
    path = tmp_path / "scan.ply"
    pr.write(path, pr.Points(rows, rows, np.full((5102, 3), 200, np.uint8)))
    return path


def run(capsys, *arguments):
    capsys.readouterr()
    status = execute([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return status, out, re.sub(r"^Compiling .* kernels.*\n", "", err, flags=re.MULTILINE)


def test_a_scan_is_cleaned_and_subsampled(scan, capsys):
    small = scan.with_name("small.ply")
    status, out, _ = run(
        capsys, "prepare", scan, "-o", small, "--tolerance", "0.5%", "--drop-outliers", "--drop-duplicates"
    )
    points = pr.read(small)
    assert status == 0 and out.count("\n") == 1
    assert out.startswith(
        f"{small}: {len(points):,} points; 100 duplicates dropped, 2 outliers dropped, of 5,000, within"
    )
    assert 50 < len(points) < 1500
    assert set(points.attributes) == {"radius"} and (points.attributes["radius"] > 0).all()
    assert (points.colors == 200).all()


@pytest.mark.long
def test_render_uses_the_radii(scan, capsys, tmp_path, monkeypatch):
    small = tmp_path / "small.ply"
    assert run(capsys, "prepare", scan, "-o", small, "--count", 300, "--drop-outliers")[0] == 0
    given = []
    model = pr.Model
    monkeypatch.setattr(
        pr, "Model", lambda points, radii=None, **rest: given.append(radii) or model(points, radii, **rest)
    )
    picture = ["-o", tmp_path / "a.png", "--size", "32x24", "--spp", 1, "--light", "headlight"]
    assert run(capsys, "render", small, *picture)[0] == 0
    points = pr.read(small)
    assert len(points) == 300 and np.array_equal(given[0], points.attributes["radius"])
    # The radii are not used if one of them is invalid.
    bad = points.attributes["radius"].copy()
    bad[7] = np.nan
    pr.write(small, pr.Points(points.positions, points.normals, attributes={"radius": bad}))
    assert run(capsys, "render", small, *picture)[0] == 0
    assert given[1] is None


def test_normals_are_turned_to_the_viewpoint(scan, capsys):
    out = scan.with_name("out.ply")
    assert (
        run(capsys, "prepare", scan, "-o", out, "--estimate-normals", "--viewpoint", "0,0,0", "--drop-outliers")[0] == 0
    )
    points = pr.read(out)
    assert len(points) == 5100 and (np.sum(points.normals * points.positions, axis=1) < 0).mean() > 0.99
    assert not points.attributes


def test_without_options_the_scan_is_copied(scan, capsys):
    out = scan.with_name("out.ply")
    status, text, _ = run(capsys, "prepare", scan, "-o", out)
    assert (status, len(pr.read(out))) == (0, 5102) and "nothing to do" in text


@pytest.mark.long
def test_a_tolerance_is_printed_once(scan, capsys):
    """If the tolerance is exceeded, only the last line reports the share within it."""
    out = scan.with_name("out.ply")
    status, text, err = run(capsys, "prepare", scan, "-o", out, "--tolerance", "0.01", "--drop-outliers")
    assert status == 0 and "of 5,100, within 0.01\n" in text and err == ""
    rows = sphere_points(3000) * (1 + 0.05 * np.random.default_rng(0).normal(size=(3000, 1)))
    pr.write(scan, pr.Points(rows, sphere_points(3000)))
    status, text, err = run(capsys, "prepare", scan, "-o", out, "--tolerance", "0.002")
    assert status == 0 and err == "" and text.count("0.002") == 1 and text.count("within") == 1
    share = r"of 3,000, \d\d\.\d% of them within 0\.002 of the surface, not 99\.9%"
    assert re.search(f"{share}: the points are noisier", text)


def link_of(scan: Path, kind: str) -> Path:
    """A link to a file."""
    other = scan.with_name(f"{kind}.ply")
    if kind == "same":
        return scan
    if kind == "roundabout":
        (scan.parent / "folder").mkdir()
        return scan.parent / "folder" / ".." / scan.name
    other.symlink_to(scan) if kind == "symlink" else other.hardlink_to(scan)
    return other


@pytest.mark.parametrize("kind", ["same", "roundabout", "symlink", "hardlink"])
def test_overwriting_the_input_needs_force(scan, capsys, kind):
    out, before = link_of(scan, kind), scan.read_bytes()
    status, text, err = run(capsys, "prepare", scan, "-o", out, "--drop-duplicates")
    assert (status, text) == (2, "") and err == f"pointray: {out}: is an input; use --force to overwrite it\n"
    assert scan.read_bytes() == out.read_bytes() == before
    assert run(capsys, "prepare", scan, "-o", out, "--drop-duplicates", "--force")[0] == 0
    assert len(pr.read(out)) == 5002


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--tolerance", "1", "--count", "9"], "not both"),
        (["--tolerance", "-1"], "positive"),
        (["--tolerance", "5 apples"], "5 apples"),
        (["--tolerance", "nan%"], "positive"),
        (["--tolerance", "1e9"], "diagonal"),
        (["--count", "0"], "1 or more"),
        (["--count", "9999"], "different positions"),
        (["--viewpoint", "1,2,3"], "--estimate-normals"),
    ],
)
def test_bad_options_are_refused_and_leave_nothing(scan, capsys, options, words):
    out = scan.with_name("out.ply")
    status, text, err = run(capsys, "prepare", scan, "-o", out, *options)
    assert (status, text) == (2, "") and words in err and err.count("\n") == 1
    assert not out.exists() and {p.name for p in scan.parent.iterdir()} == {"scan.ply"}


@pytest.mark.parametrize(
    ("name", "words"),
    [("out.foo", "supported: .asc, .copc.laz, .csv, .e57"), ("no/folder/out.ply", "folder not found")],
)
def test_bad_outputs_are_reported_before_the_work(scan, capsys, name, words):
    status, _, err = run(capsys, "prepare", scan.with_name("absent.ply"), "-o", scan.parent / name)
    assert status == 2 and words in err


@pytest.fixture(scope="module")
def model_of_all(tmp_path_factory: pytest.TempPathFactory) -> tuple[pr.Points, Path]:
    """A model with all columns, far from the origin and with levels of detail."""
    torus = pr.procedural("torus", 12_000)
    n = len(torus)
    colors = np.random.default_rng(1).integers(0, 255, (n, 3), np.uint8)
    about = torus.positions + np.array([5e6, 0, 0])
    points = pr.Points(about, torus.normals, colors, {"row": np.arange(n)})
    model = pr.Model(points, surface="imls", samples=3, refine=2)
    model.make_levels()
    file = tmp_path_factory.mktemp("saved") / "torus.pointray"
    model.save(file)
    return points, file


@pytest.fixture
def saved(model_of_all: tuple[pr.Points, Path], tmp_path: Path) -> tuple[pr.Points, Path]:
    """Its points, and a copy of its file."""
    points, file = model_of_all
    return points, Path(shutil.copy(file, tmp_path))


@pytest.mark.long
def test_points_of_a_model_can_be_extracted(saved, capsys):
    points, file = saved
    out = file.with_name("out.ply")
    status, text, err = run(capsys, "prepare", file, "-o", out)
    assert (status, err) == (0, "") and text == f"{out}: {len(points):,} points; nothing to do\n"
    again = pr.read(out)
    assert np.array_equal(again.world, points.world)
    for name in ("normals", "colors"):
        assert np.array_equal(getattr(again, name), getattr(points, name))
    assert again.attributes.keys() == {"row"} and np.array_equal(again.attributes["row"], points.attributes["row"])
    # They can also be subsampled.
    status, text, _ = run(capsys, "prepare", file, "-o", out, "--count", 900)
    assert status == 0 and f"of {len(points):,}" in text and len(pr.read(out)) == 900


@pytest.mark.long
def test_a_prepared_model_keeps_its_surface(saved, capsys):
    """The surface is kept even if points are dropped. Without options the file is identical."""
    points, file = saved
    out = file.with_name("out.pointray")
    assert run(capsys, "prepare", file, "-o", out)[0] == 0
    assert out.read_bytes() == file.read_bytes()
    assert run(capsys, "prepare", file, "-o", out, "--count", 9000, "--no-levels")[0] == 0
    model, before = pr.Model.load(out), pr.Model.load(file)
    assert model.settings._replace(trim=0) == before.settings._replace(trim=0)
    assert (len(model.points), model.levels) == (9000, ())
    assert run(capsys, "prepare", file, "-o", file)[0] == 2


def test_info_describes_a_model(saved, capsys):
    points, file = saved
    status, out, _ = run(capsys, "info", file, "--json")
    facts = json.loads(out)
    assert status == 0 and facts["points"] == len(points) and facts["attributes"] == ["row"] and facts["normals"]
    model = pr.Model.load(file)
    assert (facts["surface"], facts["samples"]) == ("imls", 3)
    assert facts["levels"] == [len(level.points) for level in model.levels] and facts["levels"]
    assert facts["median_radius"] == pytest.approx(np.median(model.radii))
    assert run(capsys, "info", file)[0] == 0
    # A file of the points alone gives the same.
    run(capsys, "prepare", file, "-o", file.with_name("out.ply"))
    alone = json.loads(run(capsys, "info", file.with_name("out.ply"), "--json")[1])
    assert {name for name in alone if facts[name] != alone[name]} == {"file", "format", "files", "ranges"}
    assert alone["ranges"]["row"] == {**facts["ranges"]["row"], "dtype": alone["ranges"]["row"]["dtype"]}


@pytest.mark.parametrize("command", [["info"], ["prepare", "-o", "{folder}/out.ply"]])
def test_a_damaged_model_is_reported(tmp_path, capsys, command):
    (tmp_path / "a.pointray").write_bytes(b"\x93NUMPY and no more")
    options = [text.format(folder=tmp_path) for text in command[1:]]
    status, out, err = run(capsys, command[0], tmp_path / "a.pointray", *options)
    assert (status, out) == (2, "") and err.startswith(f"pointray: {tmp_path / 'a.pointray'}: ")
    assert [p.name for p in tmp_path.iterdir()] == ["a.pointray"]


CLOUDS = {
    "surface": lambda r: sphere_points(60_000),
    "volume": lambda r: r.random((60_000, 3)),
    "line": lambda r: np.outer(r.random(60_000), [1, 2, 3]),
    "uneven": lambda r: sphere_points(60_000) * np.exp(2 * r.normal(size=(60_000, 1))),
    "twice": lambda r: np.repeat(sphere_points(30_000), 2, axis=0),
    "far": lambda r: sphere_points(60_000) + [4e5, 5e6, 0],
    "stray": lambda r: np.vstack([sphere_points(59_999), [[1e11, 0, 0]]]),
    "grid": lambda r: np.stack(np.meshgrid(*[np.arange(245.0)] * 2, [0.0]), axis=-1).reshape(-1, 3),
}


@pytest.mark.parametrize("name", [name if name in ("surface", "uneven", "stray") else long(name) for name in CLOUDS])
def test_info_of_a_large_scan_searches_few_neighbours(name, monkeypatch):
    """The spacing is that of a sample, close to that of all points, and needs few small trees."""
    points = pr.Points(CLOUDS[name](np.random.default_rng(3)))
    monkeypatch.setattr(report, "_count_isolated", lambda *given: 0)  # reads a model's normals and radii
    whole = report.describe(points, deep=True)
    asked, ask = [], report.neighbors
    monkeypatch.setattr(report, "FEW", 50_000)
    monkeypatch.setattr(report, "GUESS", 2_000)
    monkeypatch.setattr(report, "SAMPLED", 200)
    monkeypatch.setattr(report, "neighbors", lambda rows, *rest: asked.append(len(rows)) or ask(rows, *rest))
    monkeypatch.setattr(report, "find_flaws", lambda points: pytest.fail("looked for flaws"))
    facts = report.describe(points)
    assert facts.keys() == whole.keys() and facts["duplicates"] is facts["outliers"] is facts["lone"] is None
    assert 0 < facts["spacing_sample"] <= 200
    assert facts["spacing"] == pytest.approx(whole["spacing"], rel=0.25)
    assert sum(asked) < len(points)
    same = facts.keys() - {"duplicates", "outliers", "lone", "spacing", "spacing_sample"}
    assert all(facts[name] == whole[name] for name in same)


def test_the_spacing_of_a_sample_is_exact(monkeypatch):
    """The sample's neighbours are searched in the whole cloud."""
    rows = sphere_points(60_000)
    monkeypatch.setattr(report, "SAMPLED", 60_000)
    found, count = report._sampled_spacing(rows)
    sample = rows[np.unique(np.random.default_rng(0).integers(60_000, size=(report.GUESS + 60_000))[report.GUESS :])]
    assert count == len(sample)
    assert found == pytest.approx(np.median(cKDTree(rows).query(sample, 2)[0][:, 1]), rel=1e-5)


def test_info_of_coincident_points_has_no_spacing(monkeypatch):
    monkeypatch.setattr(report, "FEW", 10)
    assert report.describe(pr.Points(np.ones((1000, 3))))["spacing"] == 0
    assert report.describe(pr.Points(np.repeat(np.eye(3), 500, axis=0)))["spacing"] == pytest.approx(np.sqrt(2))


def test_only_info_deep_counts_duplicates_and_outliers(scan, capsys, monkeypatch):
    monkeypatch.setattr(report, "FEW", 1000)
    facts = json.loads(run(capsys, "info", scan, "--json")[1])
    assert facts["duplicates"] is None and facts["outliers"] is None
    assert "not checked (use --deep)" in run(capsys, "info", scan)[1]
    facts = json.loads(run(capsys, "info", scan, "--json", "--deep")[1])
    assert (facts["duplicates"], facts["outliers"], facts["spacing_sample"]) == (100, 2, 5002)


def test_info_reports_outliers(scan, capsys):
    status, out, _ = run(capsys, "info", scan, "--json")
    assert status == 0 and '"duplicates": 100' in out and '"outliers": 2' in out
