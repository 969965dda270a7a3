"""`pr.prepare`: the same files as the command, and bad input."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from pointray.cli import execute
from pointray.model import preparation


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A sphere of radius 1 with 100 duplicates and two stray points."""
    rows = np.vstack([sphere_points(3000), sphere_points(100), [[80, 0, 0], [0, -90, 0]]]).astype(np.float32)
    normals = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    attributes = {"gps_time": np.arange(3102.0), "classification": np.arange(3102, dtype=np.uint8) % 4}
    pr.write(tmp_path / "scan.ply", pr.Points(rows, normals, attributes=attributes))
    (tmp_path / "flight.txt").write_text("0 0 0 5\n3200 5 0 5\n")
    return tmp_path / "scan.ply"


def bytes_in(path: Path) -> dict[str, bytes]:
    """The files of a folder, or one file, without identifiers, which are random."""
    files = path.iterdir() if path.is_dir() else [path]
    return {file.name if path.is_dir() else "": file.read_bytes() for file in files}


CALLS: dict[str, tuple[str, list[str], dict[str, Any]]] = {
    "copy": ("ply", [], {}),
    "share": (
        "ply",
        ["--tolerance", "0.5%", "--drop-outliers", "--drop-duplicates"],
        {"tolerance": "0.5%", "drop_outliers": True, "drop_duplicates": True},
    ),
    "length": (
        "ply",
        ["--tolerance", "0.02", "--smooth", "0", "--drop-outliers"],
        {"tolerance": np.float64(0.02), "smooth": 0.0, "drop_outliers": True},
    ),
    "count": ("ply", ["--count", "300", "--every", "2"], {"count": np.int32(300), "every": 2}),
    "viewpoint": (
        "npy",
        ["--estimate-normals", "--viewpoint", "0,0,9", "--keep", "classification=1,2"],
        {"normals": "fit", "viewpoint": (0, 0, 9), "keep": {"classification": (1, 2)}},
    ),
    "trajectory": (
        "ply",
        ["--normals", "fit", "--trajectory", "{folder}/flight.txt", "--drop-strays"],
        {"normals": "fit", "trajectory": "{folder}/flight.txt", "drop_strays": True},
    ),
    "model": (
        "pointray",
        ["--scatter", "discs", "--scatter-size", "2", "--no-levels"],
        {"scatter": "discs", "scatter_size": 2, "levels": False},
    ),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", CALLS)
def test_the_files_are_those_of_the_command(name: str, scan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ending, words, options = CALLS[name]
    one, other = scan.with_name(f"one.{ending}"), scan.with_name(f"other.{ending}")
    words = [word.format(folder=scan.parent) for word in words]
    options = {key: x.format(folder=scan.parent) if isinstance(x, str) else x for key, x in options.items()}
    assert execute(["prepare", str(scan), "-o", str(one), *words]) == 0
    done = pr.prepare(scan, other, **options)
    assert str(done).replace("other", "one") == capsys.readouterr().out.rstrip("\n")
    assert one.read_bytes() == other.read_bytes()
    points = pr.Model.load(other).points if ending == "pointray" else pr.read(other)
    assert (done.path, done.points, done.parts) == (other, len(points), 0)


@pytest.mark.parametrize("fits", [True, False])
def test_parts_are_those_of_the_command(fits: bool, scan: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setattr(preparation, "fits", lambda files, request, memory: fits)
    monkeypatch.setattr("secrets.token_hex", lambda count: "0" * 2 * count)  # identifiers of models
    one, other, stages = scan.with_name("one.pointray"), scan.with_name("other.pointray"), []
    words = ["--part-points", "2048", "--every", "2", "--memory", "2GiB"]
    assert execute(["prepare", str(scan), "-o", f"{one}/", *words]) == 0
    done = pr.prepare(
        [scan], f"{other}/", every=2, part_points=2048, memory=2 << 30, progress=lambda *x: stages.append(x)
    )
    assert str(done).replace("other", "one") == capsys.readouterr().out.rstrip("\n")
    assert bytes_in(one) == bytes_in(other)
    assert (done.points, done.parts) == (len(pr.Model.load(other).points), len(pr.Model.load(other).parts))
    assert stages and all(isinstance(stage, str) and 0 <= share <= 1 for stage, share in stages)


def test_a_slash_or_a_flag_asks_for_parts(scan: Path) -> None:
    folder = scan.parent
    assert pr.prepare(scan, f"{folder}/a.pointray/").parts > 0
    assert pr.prepare(scan, folder / "b.pointray", in_parts=True).parts > 0
    assert pr.prepare(scan, f"{folder}/c.pointray/", in_parts=False).parts == 0
    assert pr.prepare(folder / "c.pointray", folder / "d.ply", count=500).points == 500  # a saved model as input


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tolerance": 1, "count": 9}, "give either tolerance or count, not both"),
        ({"tolerance": -1}, "tolerance must be a positive number"),
        ({"tolerance": "5 apples"}, "tolerance must be .* not '5 apples'"),
        ({"tolerance": 1e9}, "scan.ply: tolerance .*diagonal"),
        ({"count": 0}, "count must be 1 or more, not 0"),
        ({"count": 9999}, "different positions"),
        ({"viewpoint": (1, 2, 3)}, "viewpoint requires normals='fit' or drop_strays"),
        ({"trajectory": "a.txt"}, "trajectory requires normals='fit'"),
        ({"normals": "fit", "trajectory": "a.txt", "viewpoint": (1, 2, 3)}, "viewpoint and trajectory exclude"),
        ({"smooth": -1.0}, "smooth must be"),
        ({"scatter": "discs"}, "scatter and scatter_size require a model"),
        ({"in_parts": True}, "a model in parts is a folder whose name ends in .pointray"),
        ({"memory": 1 << 30, "in_parts": False}, "memory requires a model in parts: out .*out.pointray/"),
        ({"part_points": 0}, "part_points must be 1 or more"),
        ({"every": 0}, "every must be"),
        ({"opacity": 2}, "opacity must be"),
        ({"count": "many"}, "count must be a whole number from 1, or None, not 'many'"),
    ],
)
def test_bad_input_is_refused_and_leaves_nothing(options: dict[str, Any], words: str, scan: Path) -> None:
    before = set(scan.parent.iterdir())
    with pytest.raises(ValueError, match=words):
        pr.prepare(scan, scan.with_name("out.ply"), **options)
    assert set(scan.parent.iterdir()) == before


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: ([], f / "b.ply"), "paths must name at least one file"),
        (lambda f: (3, f / "b.ply"), "paths must be Points, a path or list of paths"),
        (lambda f: (f / "scan.ply", 3), "out must be a path"),
        (lambda f: (f / "scan.ply", f / "scan.ply"), "is an input; use force=True to overwrite it"),
        (lambda f: (f / "scan.ply", f / "a.foo"), "cannot write .foo"),
        (lambda f: ([f / "scan.ply"] * 2, f / "b.ply"), "is given twice"),
    ],
)
def test_bad_files_are_refused(change: Callable[[Path], Any], words: str, scan: Path) -> None:
    with pytest.raises(ValueError, match=words):
        pr.prepare(*change(scan.parent))
    with pytest.raises(FileNotFoundError):
        pr.prepare(scan.with_name("absent.ply"), scan.with_name("b.ply"))


def test_a_saved_model_keeps_its_surface_and_rows(scan: Path) -> None:
    saved, out = scan.with_name("a.pointray"), scan.with_name("b.pointray")
    pr.prepare(scan, saved)
    for options, words in (
        ({"scatter": "discs"}, "scatter, scatter_size and normals are part of a saved model"),
        ({"normals": "file"}, "are part of a saved model"),
        ({"every": 2}, "every is for scans, not for saved models"),
        ({"drop_strays": True}, "drop_strays is for scans"),
    ):
        with pytest.raises(ValueError, match=words):
            pr.prepare(saved, out, **options)
    assert not out.exists()
    pr.prepare(saved, out)
    assert out.read_bytes() == saved.read_bytes()


def test_a_failed_write_leaves_the_old_file(scan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = scan.with_name("out.ply")
    out.write_bytes(b"before")
    monkeypatch.setattr("pointray.base.atomic_write.Replacement.take_place_of", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        pr.prepare(scan, out)
    assert out.read_bytes() == b"before" and len(list(scan.parent.iterdir())) == 3
