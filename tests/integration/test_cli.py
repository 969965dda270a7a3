"""The command line: output, messages and exit status."""

import json
import os
import re
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.clouds import sphere_points
from helpers.marks import long
from pointray.base.manual import REPORT, address_of
from pointray.cli import execute

SMALL = ["--size", "32x24", "--spp", "1"]
HEADER = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"


@pytest.fixture(autouse=True)
def _threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POINTRAY_THREADS", "2")  # restores the number that --threads has set


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """The unit sphere, with normals and colours."""
    rows = sphere_points(3000)
    path = tmp_path / "scan.ply"
    pr.write(path, pr.Points(rows, rows, np.full((3000, 3), 200, np.uint8)))
    return path


def ascii_ply(path: Path, rows: np.ndarray, announced: int | None = None) -> Path:
    """Write positions as text, which allows NaN and wrong counts."""
    lines = "".join(f"{x} {y} {z}\n" for x, y, z in rows)
    path.write_text(HEADER.format(len(rows) if announced is None else announced) + lines)
    return path


def bad_input(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run the command and return the one line that it prints."""
    capsys.readouterr()
    assert execute(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("pointray: ") and err.count("\n") == 1, err
    return err


VERSION = "--version", 0, f"{pr.__version__}\n", ""
ABSENT = "info absent.ply", 2, "", "pointray: absent.ply: No such file or directory\n"


@pytest.mark.parametrize(
    ("module", "call"),
    [("pointray", VERSION), ("pointray.cli", VERSION), long("pointray", ABSENT), long("pointray.cli", ABSENT)],
)
def test_the_command_can_be_run_as_a_module(module: str, call: tuple[str, int, str, str]) -> None:
    words, *wanted = call
    command = [sys.executable, "-m", module, *words.split()]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert [done.returncode, done.stdout, done.stderr] == wanted


# ------------------------------------------------------------------------------------------------ what it makes


def test_render_frames_and_lights_automatically(scan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = scan.with_name("a.png")
    assert execute(["render", str(scan), "-o", str(picture), *SMALL]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert re.fullmatch(rf"{re.escape(str(picture))}: 32x24, 3,000 points, exposure -?[\d.]+", first)
    assert second == "view: front, up +z (as in most files). Change with --view and --up."
    image = np.asarray(Image.open(picture))
    assert image.shape == (24, 32, 3)
    assert image[12, 16].min() > 60  # the sphere, lit
    assert 30 < image[0, 0].min() < image[-1, 0].min() < 150  # the gradient


def test_render_without_background_is_transparent(scan: Path) -> None:
    picture = scan.with_name("a.png")
    assert execute(["render", str(scan), "-o", str(picture), *SMALL, "--background", "none"]) == 0
    alpha = np.asarray(Image.open(picture))[..., 3]
    assert alpha[0, 0] == 0 and alpha[12, 16] == 255


def test_render_from_an_eye(scan: Path) -> None:
    """Colours of normals show which side is visible."""
    picture = scan.with_name("a.png")
    view = ["--eye", "0,-4,0", "--target", "0,0,0", "--fov", "45", "--integrator", "normal"]
    assert execute(["render", str(scan), "-o", str(picture), *SMALL, *view, "--surface", "paper"]) == 0
    red, green, blue = np.asarray(Image.open(picture))[12, 16]
    assert green < 40 and abs(int(red) - 188) < 12 and abs(int(blue) - 188) < 12  # -y faces us


def test_target_alone_moves_the_framed_camera(scan: Path) -> None:
    pictures = [scan.with_name(name) for name in ("a.png", "b.png")]
    plain = [*SMALL, "--background", "none", "--light", "headlight"]
    for picture, more in zip(pictures, ([], ["--target", "0,0,50"]), strict=True):
        assert execute(["render", str(scan), "-o", str(picture), *plain, *more]) == 0
    covered = [(np.asarray(Image.open(picture).convert("RGBA"))[..., 3] > 0).any() for picture in pictures]
    assert covered == [True, False]


def test_ground_lights_and_exposure_have_an_effect(scan: Path) -> None:
    """The sphere casts a shadow on the ground under a sun; more light and more exposure are brighter."""

    def mean(*more: str) -> float:
        picture = scan.with_name("a.jpg")
        view = ["--eye", "0,-5,4", "--target", "0,0,-1", "--exposure", "0", *SMALL]
        assert execute(["render", str(scan), "-o", str(picture), *view, *more]) == 0
        return float(np.asarray(Image.open(picture), float).mean())

    sun = ["--light", "sun:1,0.2,-1"]
    alone, ground = mean(*sun, "--background", "0,0,0"), mean(*sun, "--background", "0,0,0", "--ground")
    assert ground > alone + 20
    assert mean(*sun, "--background", "0,0,0", "--ground", "--exposure", "-2") < 0.7 * ground
    assert mean(*sun, "--light", "point:-4,-4,4", "--background", "0,0,0", "--ground") > ground + 5


def test_each_projection_covers_its_part_of_the_picture(scan: Path) -> None:
    """An orthographic frame fits the sphere's box; a panorama is taken from inside the sphere."""
    covered = {}
    for projection in ("perspective", "orthographic", "panorama"):
        picture = scan.with_name("a.png")
        more = ["--size", "60x60", "--background", "none", "--projection", projection, "--light", "headlight"]
        assert execute(["render", str(scan), "-o", str(picture), "--spp", "1", *more]) == 0
        covered[projection] = (np.asarray(Image.open(picture).convert("RGBA"))[..., 3] > 0).mean()
    assert covered["panorama"] == 1
    assert 0.1 < covered["perspective"] != covered["orthographic"] > 0.1


def test_aperture_focus_and_filter_have_an_effect(scan: Path) -> None:
    """The camera stands 4 in front of the sphere. A lens blurs its outline unless it is in focus."""

    def half_covered(*more: str) -> float:
        picture = scan.with_name("a.png")
        view = ["--eye", "0,-4,0", "--target", "0,0,0", "--size", "48x48", "--background", "none", "--spp", "16"]
        assert execute(["render", str(scan), "-o", str(picture), *view, "--light", "headlight", *more]) == 0
        alpha = np.asarray(Image.open(picture))[..., 3]
        return float(((alpha > 20) & (alpha < 235)).mean())

    sharp = half_covered("--filter", "box")
    assert half_covered("--filter", "box", "--aperture", "0.5", "--focus", "3.75") < 1.5 * sharp
    assert half_covered("--filter", "box", "--aperture", "0.5", "--focus", "2") > 3 * sharp
    assert half_covered("--filter", "gaussian") > 1.2 * sharp


def test_threads_and_seed_have_an_effect(scan: Path) -> None:
    pictures = []
    for threads in ("1", "2"):
        picture = scan.with_name(f"{threads}.png")
        assert execute(["render", str(scan), "-o", str(picture), *SMALL, "--threads", threads, "--seed", "3"]) == 0
        pictures.append(picture.read_bytes())
    assert pictures[0] == pictures[1]


def test_info_lists_facts(scan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["info", str(scan), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["points"] == 3000 and facts["normals"] and facts["colors"] and facts["missing"] == []
    assert np.allclose(facts["size"], 2, atol=0.02)
    assert 0.01 < facts["spacing"] < 0.1
    assert execute(["info", str(scan)]) == 0
    assert "3,000" in capsys.readouterr().out


def test_info_lists_missing_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = sphere_points(500)
    rows[7] = np.nan
    rows[8] = rows[9]
    assert execute(["info", str(ascii_ply(tmp_path / "bare.ply", rows)), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["points"], facts["not_finite"], facts["duplicates"]) == (500, 1, 1)
    assert [line.split(":")[0] for line in facts["missing"]] == ["normals", "colors", "some positions"]


def test_demo_makes_a_picture_and_prints_facts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "statue.png"
    arguments = ["demo", "-o", str(picture), "--points", "5000", "--size", "40x30", "--frames", "2", "--json"]
    assert execute(arguments) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["points"] == 5000
    assert facts["frames_per_second"] > 0 and facts["million_rays_per_second"] > 0 and facts["bytes_per_point"] > 28
    assert np.asarray(Image.open(picture)).shape == (30, 40, 3)
    assert execute([*arguments[:-1]]) == 0  # as a table
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert any(line.startswith(f"picture {picture}"[:40]) for line in lines)


# --------------------------------------------------------------------------------------------- what is bad input


BROKEN = {
    "not_a_ply.ply": "hello, this is no scan\n",
    "empty.ply": "",
    "no_end.ply": "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n",
    "cut.ply": HEADER.format(100) + "0 0",
    "nothing.ply": HEADER.format(0),
    "nan.ply": HEADER.format(2) + "nan nan nan\nnan nan nan\n",
    "scan.xyz": "0 0 zero\n",
}


@pytest.mark.parametrize("name", BROKEN)
@pytest.mark.parametrize("command", ["render", "info"])
def test_broken_files_are_named(name: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / name
    file.write_text(BROKEN[name])
    more = ["-o", str(tmp_path / "a.png")] if command == "render" else []
    assert bad_input([command, str(file), "--strict", *more], capsys).startswith(f"pointray: {file}: ")
    assert os.listdir(tmp_path) == [name]


@pytest.mark.parametrize("count", [1, 10_000])
def test_coincident_points_are_reported(count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = ascii_ply(tmp_path / "one.ply", np.tile([1.0, 2.0, 3.0], (count, 1)))
    assert str(file) in bad_input(["render", str(file), "-o", str(tmp_path / "a.png")], capsys)
    assert os.listdir(tmp_path) == ["one.ply"]


def test_a_missing_file_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing = tmp_path / "missing.ply"
    for arguments in (["info", str(missing)], ["render", str(missing), "-o", str(tmp_path / "a.png")]):
        assert str(missing) in bad_input(arguments, capsys)
    assert str(tmp_path) in bad_input(["info", str(tmp_path)], capsys)


def test_points_that_are_not_finite_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = sphere_points(2000)
    rows[:5] = np.nan
    file = ascii_ply(tmp_path / "some.ply", rows)
    assert execute(["render", str(file), "-o", str(tmp_path / "a.png"), *SMALL, "--light", "headlight"]) == 0
    notes = [line for line in capsys.readouterr().err.splitlines() if "note:" in line]
    assert len(notes) == 1 and notes[0].startswith("pointray: note: 5 of 2,000 points")


@pytest.mark.parametrize("output", ["no_such_folder/a.png", "a.gif", "a", "folder.png"])
def test_the_output_is_checked_first(output: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A bad output is reported before the missing file is looked for."""
    (tmp_path / "folder.png").mkdir()
    printed = bad_input(["render", str(tmp_path / "missing.ply"), "-o", str(tmp_path / output)], capsys)
    assert "missing.ply" not in printed and "write" in printed
    assert "missing.ply" not in bad_input(["demo", "-o", str(tmp_path / output)], capsys)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--eye", "1,2"),
        ("--eye", "1,2,x"),
        ("--target", "nan,0,0"),
        ("--up", "0,0,0"),
        ("--fov", "180"),
        ("--fov", "wide"),
        ("--size", "640"),
        ("--size", "0x480"),
        ("--projection", "fisheye"),
        ("--aperture", "-1"),
        ("--aperture", "nan"),
        ("--aperture", "1 --projection panorama"),
        ("--focus", "0 --aperture 1"),
        ("--focus", "2"),
        ("--filter", "sinc"),
        ("--integrator", "magic"),
        ("--spp", "0"),
        ("--seed", "-1"),
        ("--threads", "0"),
        ("--surface", "mesh"),
        ("--samples", "1"),
        ("--radius-scale", "0"),
        ("--radius-scale", "inf"),
        ("--exposure", "nan"),
        ("--eye", "0,0,0 --target 0,0,0"),
        ("--background", "black"),
        ("--background", "0,0,-1"),
        ("--light", "moon:0,0,1"),
        ("--light", "sun:0,0,0"),
        ("--light", "sun:0,0,-1:bright"),
        ("--light", "point:1,2,3:-1"),
        ("--color-by", "z:magenta"),
        ("--color-by", "z:gray:2,1"),
        ("--legend", ""),
    ],
)
def test_options_are_checked_first(option: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Bad options are reported before the file is read, which is empty."""
    file = tmp_path / "broken.ply"
    file.write_text("nothing")
    assert "broken.ply" not in bad_input(
        ["render", str(file), "-o", str(tmp_path / "a.png"), option, *value.split()], capsys
    )


def test_unknown_commands_and_options_are_reported(capsys: pytest.CaptureFixture[str]) -> None:
    bad_input(["sculpt"], capsys)
    bad_input(["info", "--loudly"], capsys)
    bad_input(["render"], capsys)
    bad_input(["demo", "--points", "10"], capsys)


# ------------------------------------------------------------------------------------------------- how it ends


def test_a_full_disk_is_a_failure(
    scan: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: object, **more: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pr, "write_image", full)
    picture = scan.with_name("a.png")
    assert execute(["render", str(scan), "-o", str(picture), *SMALL, "--light", "headlight"]) == 1
    assert capsys.readouterr().err == f"pointray: {picture}: No space left on device\n"


def test_a_defect_is_one_line(scan: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*arguments: object, **more: object) -> None:
        raise RuntimeError("something\nbroke")

    monkeypatch.setattr(pr, "Model", broken)
    assert execute(["render", str(scan), "-o", str(scan.with_name("a.png")), *SMALL]) == 1
    assert capsys.readouterr().err == f"pointray: RuntimeError: something broke; see {address_of(REPORT)}\n"


def test_warnings_of_the_caller_are_not_affected(scan: Path) -> None:
    before = warnings.showwarning, list(warnings.filters)
    assert execute(["info", str(scan)]) == 0
    assert (warnings.showwarning, list(warnings.filters)) == before


def test_help_and_version_import_nothing_heavy() -> None:
    program = """
import sys
from pointray.cli import execute
commands = "--help", "render --help", "animate --help", "bake --help", "convert --help", "--version"
status = [execute(arguments.split()) for arguments in commands]
heavy = {name.split(".")[0] for name in sys.modules} & {"numpy", "numba", "llvmlite", "scipy", "PIL"}
print(status, sorted(heavy))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-2:] == [pr.__version__, "[0, 0, 0, 0, 0, 0] []"]


# A background job of a shell ignores Ctrl-C; this test needs it in any case.
PROGRAM = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from pointray.cli import main
main()
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT")
@pytest.mark.parametrize("command", ["render scan.ply -o a.png", "demo -o a.png --points 20000"])
def test_an_interrupt_while_compiling_ends_the_command(command: str, scan: Path, tmp_path: Path) -> None:
    """The status is 130, nothing else is printed, and no files are left."""
    environment = {**os.environ, "POINTRAY_CACHE": str(tmp_path / "cache"), "POINTRAY_KERNELS": "jit"}
    words = [sys.executable, "-c", PROGRAM, *command.split()]
    with subprocess.Popen(words, cwd=tmp_path, env=environment, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        assert b"Compiling" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        assert process.stderr.read() == b""
        assert process.wait(timeout=300) == 130
    assert sorted(os.listdir(tmp_path)) == ["cache", "scan.ply"]


def test_an_interrupt_during_class_creation_is_recognised(monkeypatch, capsys):
    """Python 3.11 turns it into a RuntimeError."""

    class Interrupted:
        def __set_name__(self, owner, name):
            raise KeyboardInterrupt

    def make(*arguments, **options):
        type("Made", (), {"part": Interrupted()})

    monkeypatch.setattr("pointray.cli.commands.app", make)
    assert execute(["demo"]) == 130
    assert capsys.readouterr().err == ""
