"""pointray prepare: what it writes, what it says, and how render uses it."""

import re
from pathlib import Path

import numpy as np
import pytest

import pointray as pr
from conftest import sphere_points
from pointray.cli import execute


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
    return status, *capsys.readouterr()


def test_cleaned_and_made_smaller(scan, capsys):
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


def test_render_uses_the_radii(scan, capsys, tmp_path, monkeypatch):
    small = tmp_path / "small.ply"
    assert run(capsys, "prepare", scan, "-o", small, "--count", 300, "--drop-outliers")[0] == 0
    given = []
    model = pr.Model
    monkeypatch.setattr(
        pr, "Model", lambda points, radii=None, **rest: given.append(radii) or model(points, radii, **rest)
    )
    picture = ["-o", tmp_path / "a.png", "--size", "32x24", "--spp", 1]
    assert run(capsys, "render", small, *picture)[0] == 0
    points = pr.read(small)
    assert len(points) == 300 and np.array_equal(given[0], points.attributes["radius"])
    # Not where one of them is no radius.
    bad = points.attributes["radius"].copy()
    bad[7] = np.nan
    pr.write(small, pr.Points(points.positions, points.normals, attributes={"radius": bad}))
    assert run(capsys, "render", small, *picture)[0] == 0
    assert given[1] is None


def test_normals_towards_the_viewpoint(scan, capsys):
    out = scan.with_name("out.ply")
    assert (
        run(capsys, "prepare", scan, "-o", out, "--estimate-normals", "--viewpoint", "0,0,0", "--drop-outliers")[0] == 0
    )
    points = pr.read(out)
    assert len(points) == 5100 and (np.sum(points.normals * points.positions, axis=1) < 0).mean() > 0.99
    assert not points.attributes


def test_nothing_to_do_copies(scan, capsys):
    out = scan.with_name("out.ply")
    status, text, _ = run(capsys, "prepare", scan, "-o", out)
    assert (status, len(pr.read(out))) == (0, 5102) and "nothing was to be done" in text


def test_a_tolerance_is_told_once(scan, capsys):
    """Where it is not met the share that meets it is said, in the line of the result and nowhere else."""
    out = scan.with_name("out.ply")
    status, text, err = run(capsys, "prepare", scan, "-o", out, "--tolerance", "0.01", "--drop-outliers")
    assert status == 0 and "of 5,100, within 0.01\n" in text and err == ""
    rows = sphere_points(3000) * (1 + 0.05 * np.random.default_rng(0).normal(size=(3000, 1)))
    pr.write(scan, pr.Points(rows, sphere_points(3000)))
    status, text, err = run(capsys, "prepare", scan, "-o", out, "--tolerance", "0.002")
    assert status == 0 and err == "" and text.count("0.002") == 1 and text.count("within") == 1
    assert re.search(r"of 3,000, \d\d\.\d% of them within 0\.002 of the surface, not 99\.9%: they are noisier", text)


def link_of(scan: Path, kind: str) -> Path:
    """Another name of a file."""
    other = scan.with_name(f"{kind}.ply")
    if kind == "same":
        return scan
    if kind == "roundabout":
        (scan.parent / "folder").mkdir()
        return scan.parent / "folder" / ".." / scan.name
    other.symlink_to(scan) if kind == "symlink" else other.hardlink_to(scan)
    return other


@pytest.mark.parametrize("kind", ["same", "roundabout", "symlink", "hardlink"])
def test_a_file_replaces_itself_by_force_only(scan, capsys, kind):
    out, before = link_of(scan, kind), scan.read_bytes()
    status, text, err = run(capsys, "prepare", scan, "-o", out, "--drop-duplicates")
    assert (status, text) == (2, "") and err == f"pointray: {out}: is the scan itself; --force overwrites it\n"
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
        (["--count", "9999"], "different places"),
        (["--viewpoint", "1,2,3"], "--estimate-normals"),
    ],
)
def test_bad_wishes(scan, capsys, options, words):
    out = scan.with_name("out.ply")
    status, text, err = run(capsys, "prepare", scan, "-o", out, *options)
    assert (status, text) == (2, "") and words in err and err.count("\n") == 1
    assert not out.exists() and {p.name for p in scan.parent.iterdir()} == {"scan.ply"}


@pytest.mark.parametrize(("name", "words"), [("out.las", "can write .ply"), ("no/folder/out.ply", "no such folder")])
def test_bad_outputs_are_known_before_the_work(scan, capsys, name, words):
    status, _, err = run(capsys, "prepare", scan.with_name("absent.ply"), "-o", scan.parent / name)
    assert status == 2 and words in err


def test_info_tells_of_outliers(scan, capsys):
    status, out, _ = run(capsys, "info", scan, "--json")
    assert status == 0 and '"duplicates": 100' in out and '"outliers": 2' in out
