"""`pointray convert`: all that the target can store is written, and the rest is reported."""

from pathlib import Path

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from pointray.cli import execute
from pointray.io import files
from pointray.io.formats.splats._flat import WIDTH

MARK = b"what was there before"


@pytest.fixture
def scan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> pr.Points:
    """Write a map with all columns to a.ply of the current folder."""
    monkeypatch.chdir(tmp_path)
    rng, rows = np.random.default_rng(1), sphere_points(500)
    attributes = {"gps_time": 3e8 + rng.random(500), "classification": (np.arange(500) % 7).astype(np.uint8)}
    georeference = pr.Georeference(crs="EPSG:25832")
    points = pr.Points(
        rows + [5e5, 5.4e6, 100], rows, rng.integers(0, 256, (500, 3), np.uint8), attributes, None, georeference
    )
    pr.write("a.ply", points)
    return points


def run(capsys, *arguments):
    capsys.readouterr()
    status = execute(["convert", *arguments])
    return status, *capsys.readouterr()


def test_all_columns_are_converted(scan, capsys):
    assert run(capsys, "a.ply", "b.ply") == (0, "b.ply: 500 points\n", "")
    one, other = pr.read("a.ply"), pr.read("b.ply")
    assert np.array_equal(one.world, other.world) and other.crs == "EPSG:25832"
    assert np.array_equal(one.normals, other.normals) and np.array_equal(one.colors, other.colors)
    for name, values in one.attributes.items():
        assert other.attributes[name].dtype == values.dtype and np.array_equal(other.attributes[name], values)
    assert np.array_equal(other.attributes["gps_time"], scan.attributes["gps_time"])


def test_several_files_and_options_of_reading_are_supported(scan, capsys):
    assert run(capsys, "a.ply", "b.ply")[0] == 0
    assert run(capsys, "a.ply", "b.ply", "c.ply", "--keep", "classification=6") == (0, "c.ply: 142 points\n", "")
    assert run(capsys, ".", "d.ply", "--every", "10")[:2] == (0, "d.ply: 115 points\n")  # 50 of a and of b, 15 of c


def test_points_of_a_saved_model_are_converted(scan, capsys):
    pr.Model(pr.read("a.ply")).save("a.pointray")
    assert run(capsys, "a.pointray", "b.ply")[:2] == (0, "b.ply: 500 points\n")


def test_what_the_target_cannot_store_is_reported(scan, capsys, monkeypatch):
    monkeypatch.setattr(files, "write_points", lambda *given: ["no normals", "no colours"])
    assert run(capsys, "a.ply", "b.ply") == (0, "b.ply: 500 points; no normals; no colours\n", "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("absent.ply b.xlsx", "b.xlsx: cannot write .xlsx; supported: "),
        ("absent.ply folder/b.ply", "cannot write b.ply: folder not found"),
        ("absent.ply b.ply", "absent.ply: No such file"),
        ("a.ply a.ply", "a.ply: is an input; use --force to overwrite it"),
        ("a.ply ./a.ply", "a.ply: is an input; use --force to overwrite it"),
        (". a.ply", "a.ply: is an input; use --force to overwrite it"),
        ("a.ply", "Missing argument"),
        ("absent.ply b.las --splats", "b.las: --splats requires .ply, .spz, .splat"),
        ("absent.ply b.ply --light studio", "b.ply: --light requires .spz, .splat, or .ply with --splats"),
        ("absent.ply b.spz --up z", "--up requires --light"),
        ("a.ply b.spz --light studio --up w", "--up"),
        ("a.ply b.spz --light headlight", "--light headlight: light that moves with the camera cannot be baked"),
        ("a.ply b.spz --light sun:1,1,-1,camera", "light that moves with the camera cannot be baked"),
        ("a.ply b.spz --light bulb", "--light"),
        ("note.txt b.ply", "note.txt: "),
        ("scene.toml b.ply", "scene.toml: unsupported file type .toml"),
    ],
)
def test_bad_input_changes_no_file(arguments, message, scan, capsys):
    Path("note.txt").write_text("hello, this is no scan")
    Path("scene.toml").write_text("[models]")
    before = Path("a.ply").read_bytes()
    status, out, err = run(capsys, *arguments.split())
    assert (status, out) == (2, "") and message in err.splitlines()[-1]
    assert Path("a.ply").read_bytes() == before and not Path("b.ply").exists()


def test_force_overwrites_the_scan(scan, capsys):
    assert run(capsys, "a.ply", "a.ply", "--force", "--every", "2")[:2] == (0, "a.ply: 250 points\n")
    assert len(pr.read("a.ply")) == 250


def test_a_failure_keeps_the_old_file(scan, capsys, monkeypatch):
    def full(stream, points, progress):
        stream.write(b"half")
        raise OSError(28, "No space left on device")

    Path("b.ply").write_bytes(MARK)
    monkeypatch.setattr(files, "writer_of", lambda path, compressed: full)
    status, out, err = run(capsys, "a.ply", "b.ply")
    assert (status, out) == (1, "") and "No space left on device" in err
    assert Path("b.ply").read_bytes() == MARK and sorted(p.name for p in Path().iterdir()) == ["a.ply", "b.ply"]


def test_compressed_applies_to_pcd(scan, capsys):
    pytest.importorskip("lzf", exc_type=ImportError)
    assert run(capsys, "a.ply", "b.pcd", "--compressed")[0] == 0
    assert b"DATA binary_compressed\n" in Path("b.pcd").read_bytes()
    assert len(pr.read("b.pcd")) == 500
    status, _, err = run(capsys, "a.ply", "b.las", "--compressed")
    assert status != 0 and "compressed applies to .pcd only" in err and not Path("b.las").exists()


# ------------------------------------------------------------------------------------------------ Gaussian splats


def test_the_extension_or_an_option_selects_splats(scan, capsys):
    place = ", ".join(f"{x:.15g}" for x in scan.origin)
    lost = f"stores positions relative to ({place}), because viewers of splats use 32-bit floats"
    for output, more in (("b.spz", []), ("b.splat", []), ("c.ply", ["--splats"])):
        status, out, _ = run(capsys, "a.ply", output, *more)
        assert status == 0 and lost in out
        assert out.startswith(f"{output}: 500 points; cannot store the attributes gps_time, classification; stores")
        points = pr.read(output)
        np.testing.assert_allclose(points.world, scan.positions, atol=1e-4)
        assert set(points.attributes) == {"opacity", "scale", "rotation"}
    assert set(pr.read("a.ply").attributes) == set(scan.attributes)


def test_saved_models_and_splats_are_converted_to_splats(scan, capsys):
    model = pr.Model(pr.read("a.ply"), radius_scale=1.5)
    model.save("a.pointray")
    assert run(capsys, "a.pointray", "b.splat")[0] == 0
    width = pr.read("b.splat").attributes["scale"].max(axis=1)
    np.testing.assert_allclose(width, WIDTH * model.radii, rtol=1e-5)
    assert run(capsys, "b.splat", "c.splat")[1] == "c.splat: 500 points\n"
    np.testing.assert_allclose(pr.read("c.splat").attributes["scale"].max(axis=1), width, rtol=1e-5)


@pytest.mark.parametrize("given", ["nan.npy", "nan.pointray"])
@pytest.mark.parametrize("light", [[], ["--light", "sun:0,0,-1", "--up", "z"]])
def test_the_number_of_splats_is_printed(scan, capsys, given, light):
    """Points of a model that are not drawn have no splat."""
    world = scan.positions.copy()
    world[:50] = np.nan
    np.save("nan.npy", world)
    if given == "nan.pointray":
        with pytest.warns(UserWarning, match="50 of 500 points have no finite position"):
            pr.Model(pr.read("nan.npy")).save(given)
    status, out, _ = run(capsys, given, "b.splat", *light)
    assert status == 0 and out.startswith("b.splat: 450 points") and "; leaves out 50 points without a splat" in out
    assert len(pr.read("b.splat")) == 450


def test_splats_with_an_invalid_scale_are_not_counted(scan, capsys):
    scale = np.full((500, 3), 0.1)
    scale[:50] = np.nan
    turns = np.tile([1.0, 0, 0, 0], (500, 1))
    pr.write("a.npz", pr.Points(scan.positions, scan.normals, attributes={"scale": scale, "rotation": turns}))
    assert run(capsys, "a.npz", "b.spz")[1] == "b.spz: 450 points; leaves out 50 splats with an invalid scale\n"
    assert len(pr.read("b.spz")) == 450


def test_light_is_baked_into_splats(scan, capsys):
    """A sun from above, one from below: opposite sides are bright."""
    bright = {}
    for direction in ("0,0,-1", "0,0,1"):
        status, out, _ = run(capsys, "a.ply", "b.splat", "--light", f"sun:{direction}", "--up", "z")
        assert status == 0 and "b.splat: 500 points, lit colours, exposure " in out
        points = pr.read("b.splat")
        upper = points.normals[:, 2] > 0.5
        bright[direction] = points.colors[upper].mean() / points.colors[points.normals[:, 2] < -0.5].mean()
    assert bright["0,0,-1"] > 1.5 and bright["0,0,1"] < 1 / 1.5


def test_the_up_direction_of_the_studio_is_printed(scan, capsys):
    _, out, _ = run(capsys, "a.ply", "b.splat", "--light", "studio")
    assert len(out.splitlines()) == 2 and out.splitlines()[1].startswith("up ") and out.endswith("Change with --up.\n")
    assert run(capsys, "a.ply", "b.splat", "--light", "studio", "--up", "y")[1].count("\n") == 1
