"""`pointray animate`: frames, films, and resumed runs."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pointray as pr
from helpers.clouds import sphere_points
from helpers.marks import long
from pointray.cli import execute
from pointray.rendering import sequence

SMALL = ["--size", "24x18", "--spp", "1", "--integrator", "phong"]
FOUR = ["--seconds", "2", "--fps", "2"]
KEYS = [
    {"time": 0, "eye": [0, -4, 0], "target": [0, 0, 0]},
    {"time": 0.5, "eye": [4, 0, 0], "target": [0, 0, 0], "up": [0, 0, 1], "fov": 30},
    {"time": 1, "eye": [0, 4, 1], "target": [0, 0, 0]},
]


@pytest.fixture(autouse=True)
def _threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POINTRAY_THREADS", "2")


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A sphere, red where x > 0, blue elsewhere."""
    rows = sphere_points(500)
    colors = np.where(rows[:, :1] > 0, np.uint8([[255, 0, 0]]), np.uint8([[0, 0, 255]]))
    pr.write(tmp_path / "scan.ply", pr.Points(rows, rows, colors))
    return tmp_path / "scan.ply"


SCENE = """
background = [0.1, 0.2, 0.3]
exposure = 0.5
curve = "filmic"

[models.ball]
procedural = "sphere"
points = 500

[models.scan]
file = "scan.ply"

[[instances]]
model = "ball"

[[instances]]
model = "scan"
translate = [1.5, 0, 0]

[[lights]]
kind = "sun"
direction = [1, 1, -1]

[camera]
eye = [0, -6, 1]
target = [0.5, 0, 0]
fov = 50
size = [24, 18]
aperture = 0.2
focus = 5.5

[settings]
seed = 3
"""


@pytest.fixture
def scene(scan: Path) -> Path:
    """A scene file with two models, one of them the scan."""
    scan.with_name("scene.toml").write_text(SCENE)
    return scan.with_name("scene.toml")


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """The cameras of all frames that are rendered; raises KeyboardInterrupt after `stop` frames."""

    class Calls(list):
        stop = 1000

    calls, real = Calls(), sequence.render_snapshot

    def render(scene: object, camera: object, *others: object) -> object:
        if len(calls) == calls.stop:
            raise KeyboardInterrupt
        calls.append(camera)
        return real(scene, camera, *others)

    monkeypatch.setattr(sequence, "render_snapshot", render)
    return calls


def animate(scan: Path, output: str, *more: str) -> int:
    return execute(["animate", str(scan), "-o", str(scan.parent / output), *SMALL, *(more or FOUR)])


def pictures(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def frames_of(film: Path, folder: Path) -> np.ndarray:
    """Return all frames of an MP4, (n, h, w, 3) uint8, extracted to pictures in a new folder."""
    program = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    folder.mkdir()
    subprocess.run([program, "-loglevel", "error", "-i", film, folder / "%03d.png"], check=True)
    return np.array([np.asarray(Image.open(path)) for path in sorted(folder.iterdir())])


# ---------------------------------------------------------------------------------------------------- the film


def test_a_turntable_writes_numbered_pictures(scan, capsys):
    view = ["--eye", "0,-4,0", "--target", "0,0,0", "--background", "0,0,0", "--integrator", "color"]
    assert animate(scan, "frames/f%03d.png", *FOUR, *view) == 0
    assert capsys.readouterr().out == f"{scan.with_name('frames')}/f%03d.png: 24x18, 4 frames, 2 seconds\n"
    folder = scan.with_name("frames")
    assert sorted(os.listdir(folder)) == [f"f00{k}.png" for k in range(4)]
    assert execute(["render", str(scan), "-o", str(scan.with_name("a.png")), *SMALL, *view]) == 0
    assert (folder / "f000.png").read_bytes() == scan.with_name("a.png").read_bytes()
    front, right, back, left = (np.asarray(Image.open(folder / f"f00{k}.png"), float) for k in range(4))
    assert front[9, 16, 0] > 150 > 50 > front[9, 7, 0]  # +x, red, is to the right of an eye at -y
    assert np.abs(back[:, ::-1] - front).mean() < 4
    assert right[9, 12, 0] > 150 and left[9, 12, 2] > 150  # a quarter later the eye is at +x


def test_a_film_contains_its_frames(scan, capsys):
    assert animate(scan, "turn.mp4") == 0
    assert capsys.readouterr().out == f"{scan.with_name('turn.mp4')}: 24x18, 4 frames, 2 seconds\n"
    assert sorted(os.listdir(scan.parent)) == ["scan.ply", "turn.mp4"]
    assert animate(scan, "pictures") == 0
    film = frames_of(scan.with_name("turn.mp4"), scan.with_name("read")).astype(int)
    assert film.shape == (4, 18, 24, 3)
    for k in range(4):
        still = np.asarray(Image.open(scan.with_name("pictures") / f"000{k}.png")).astype(int)
        assert np.abs(film[k].mean(axis=(0, 1)) - still.mean(axis=(0, 1))).max() < 4


@pytest.mark.long
def test_an_mp4_of_odd_size_is_padded(scan, capsys):
    assert animate(scan, "turn.mp4", "--seconds", "1", "--fps", "2", "--size", "23x17", "--background", "1,0,0") == 0
    assert "23x17 (rounded to even sides: 24x18), 2 frames" in capsys.readouterr().out
    film = frames_of(scan.with_name("turn.mp4"), scan.with_name("read"))
    assert film.shape == (2, 18, 24, 3)
    border = np.concatenate([film[:, -1].reshape(-1, 3), film[:, :, -1].reshape(-1, 3)])
    assert border[:, 0].min() > 200  # like its neighbours, not black
    assert np.abs(np.median(border, axis=0) - (255, 0, 0)).max() < 8  # players decode with the same colour matrix


@pytest.mark.parametrize("name", ["keys.toml", long("keys.json")])
def test_keys_are_read_from_a_file(name, scan, rendered):
    file = scan.with_name(name)
    if name == "keys.json":
        file.write_text(json.dumps({"keys": KEYS}))
    else:
        lines = ["[[keys]]\n" + "".join(f"{part} = {value}\n" for part, value in key.items()) for key in KEYS]
        file.write_text("\n".join(lines))
    assert animate(scan, "out", "--keys", str(file), "--fps", "4", "--fov", "50") == 0
    assert len(rendered) == 5
    for camera, key in zip(rendered[::2], KEYS, strict=True):
        assert (list(camera.eye), list(camera.target)) == (key["eye"], key["target"])
        assert camera.fov == key.get("fov", 50) and camera.size == (24, 18)


def test_frames_are_coloured_by_an_attribute(scan):
    assert animate(scan, "plain") == 0 and animate(scan, "tall", *FOUR, "--color-by", "height:gray") == 0
    plain, tall = (pictures(scan.with_name(name)) for name in ("plain", "tall"))
    assert sorted(plain) == sorted(tall) and all(plain[name] != tall[name] for name in plain)


# ------------------------------------------------------------------------------------------------- scene files


def still(scene: Path, *more: str) -> bytes:
    """The picture that `render` makes of a scene file."""
    picture = scene.with_name("still.png")
    assert execute(["render", str(scene), "-o", str(picture), *more]) == 0
    return picture.read_bytes()


def test_a_scene_file_is_rendered_on_a_turntable(scene, rendered, capsys):
    assert execute(["animate", str(scene), "-o", str(scene.with_name("out")), *FOUR]) == 0
    assert capsys.readouterr().out == f"{scene.with_name('out')}: 24x18, 4 frames, 2 seconds\n"
    frames = pictures(scene.with_name("out"))
    loaded = pr.load_scene(scene).camera
    assert rendered == pr.turntable(loaded, 4) and all(camera.aperture == 0.2 for camera in rendered)
    assert sorted(frames) == [f"000{k}.png" for k in range(4)] and len(set(frames.values())) == 4
    assert frames["0000.png"] == still(scene)  # settings, exposure and curve are those of the file


def test_options_override_a_scene_file(scene, rendered):
    options = ["--size", "16x12", "--fov", "30", "--exposure", "1", "--background", "0,0,0"]
    assert execute(["animate", str(scene), "-o", str(scene.with_name("out")), *FOUR, *options]) == 0
    assert (rendered[3].fov, rendered[3].size, rendered[3].focus) == (30, (16, 12), 5.5)
    assert (scene.with_name("out") / "0000.png").read_bytes() == still(scene, *options)


def test_a_framed_scene_file_turns_about_its_target(scene, rendered):
    scene.write_text(SCENE.replace("eye = [0, -6, 1]\ntarget = [0.5, 0, 0]", 'projection = "orthographic"'))
    assert animate(scene, "out") == 0
    first = rendered[0]
    assert all((camera.target, camera.projection) == (first.target, "orthographic") for camera in rendered)
    assert (scene.with_name("out") / "0000.png").read_bytes() == still(scene, *SMALL)


def test_keys_inherit_the_lens_of_a_scene_file(scene, rendered):
    """A key without a lens uses that of the file."""
    scene.with_name("keys.json").write_text(json.dumps({"keys": KEYS}))
    arguments = ["animate", str(scene), "-o", str(scene.with_name("out")), "--keys", str(scene.with_name("keys.json"))]
    assert execute([*arguments, "--fps", "4"]) == 0
    assert [camera.fov for camera in rendered[::2]] == [50, 30, 50]
    for camera, key in zip(rendered[::2], KEYS, strict=True):
        assert (list(camera.eye), list(camera.target)) == (key["eye"], key["target"])
        assert (camera.size, camera.aperture, camera.focus) == ((24, 18), 0.2, 5.5)


@pytest.mark.long
def test_an_interrupted_film_of_a_scene_file_is_resumed(scene, rendered, capsys):
    assert animate(scene, "whole") == 0
    del rendered[:]
    rendered.stop = 3
    assert animate(scene, "out") == 130
    rendered.stop = 1000
    assert animate(scene, "out") == 0
    assert len(rendered) == 4 and "4 frames, 3 of them rendered before" in capsys.readouterr().out
    assert pictures(scene.with_name("out")) == pictures(scene.with_name("whole"))


@pytest.mark.parametrize("name", [long("scene.toml"), "scan.ply"])
def test_frames_are_rendered_again_if_a_file_of_the_scene_changed(name, scene, rendered, capsys):
    rendered.stop = 2
    assert animate(scene, "out") == 130
    capsys.readouterr()
    rendered.stop = 1000
    os.utime(scene.with_name(name), (0, 0))
    assert animate(scene, "out") == 0 and len(rendered) == 6
    assert capsys.readouterr().err.endswith("rendering all frames again, because these changed: scene\n")


# ---------------------------------------------------------------------------------------- what was interrupted


def test_an_interrupted_film_is_resumed(scan, rendered, capsys):
    assert animate(scan, "whole/%04d.png") == 0
    del rendered[:]
    rendered.stop = 3
    assert animate(scan, "out") == 130
    assert "run the same command to continue" in capsys.readouterr().err
    left = pictures(scan.with_name("out"))
    assert sorted(left) == ["%04d.png.json", "0000.png", "0001.png", "0002.png"]
    rendered.stop = 1000
    assert animate(scan, "out") == 0
    assert len(rendered) == 4 and "4 frames, 3 of them rendered before" in capsys.readouterr().out
    assert pictures(scan.with_name("out")) == pictures(scan.with_name("whole"))


def test_an_interrupted_mp4_is_resumed(scan, rendered):
    pytest.importorskip("imageio_ffmpeg")
    assert animate(scan, "whole.mp4") == 0
    del rendered[:]
    rendered.stop = 2
    assert animate(scan, "out.mp4") == 130
    assert sorted(os.listdir(scan.parent)) == ["out.mp4.frames", "scan.ply", "whole.mp4"]
    rendered.stop = 1000
    assert animate(scan, "out.mp4") == 0 and len(rendered) == 4
    assert sorted(os.listdir(scan.parent)) == ["out.mp4", "scan.ply", "whole.mp4"]
    assert scan.with_name("out.mp4").read_bytes() == scan.with_name("whole.mp4").read_bytes()


def test_the_scan_is_not_read_if_only_the_film_is_missing(scan, rendered, monkeypatch):
    pytest.importorskip("imageio_ffmpeg")

    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("pointray.image.mp4.write_mp4", interrupted)
        assert animate(scan, "out.mp4") == 130
    monkeypatch.setattr(pr, "Model", interrupted)
    assert animate(scan, "out.mp4") == 0 and len(rendered) == 4


def test_a_truncated_picture_is_rendered_again(scan, rendered):
    rendered.stop = 3
    assert animate(scan, "out") == 130
    folder = scan.with_name("out")
    whole = pictures(folder)
    (folder / "0001.png").write_bytes(whole["0001.png"][:-40])
    (folder / "0002.png").unlink()
    rendered.stop = 1000
    assert animate(scan, "out") == 0 and len(rendered) == 6
    assert all(pictures(folder)[f"000{k}.png"] == whole[f"000{k}.png"] for k in range(3))


def test_frames_of_other_settings_are_rendered_again(scan, rendered, capsys):
    rendered.stop = 2
    assert animate(scan, "out") == 130
    capsys.readouterr()
    rendered.stop = 1000
    assert animate(scan, "out", *FOUR, "--exposure", "1", "--background", "0,0,0") == 0
    err = capsys.readouterr().err
    assert err.startswith("pointray: note: ") and err.count("\n") == 1
    assert (
        err.endswith("rendering all frames again, because these changed: exposure, background\n") and len(rendered) == 6
    )


@pytest.mark.long
def test_frames_of_another_color_by_are_rendered_again(scan, rendered, capsys):
    rendered.stop = 2
    assert animate(scan, "out") == 130
    capsys.readouterr()
    rendered.stop = 1000
    assert animate(scan, "out", *FOUR, "--color-by", "z") == 0
    assert (
        capsys.readouterr().err.endswith("rendering all frames again, because these changed: color by\n")
        and len(rendered) == 6
    )


def test_pictures_without_a_record_are_rendered_again(scan, rendered):
    """Such pictures may come from another program."""
    assert animate(scan, "out") == 0 and animate(scan, "out") == 0
    assert len(rendered) == 8


# ------------------------------------------------------------------------------------------- what is bad input


def bad_input(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run the command and return the one line that it prints."""
    assert execute(["animate", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("pointray: ") and err.count("\n") == 1, err
    return err


BAD_KEYS = {
    "unknown 'zoom'": [*KEYS[:2], {**KEYS[2], "zoom": 2}],
    "target is missing": [KEYS[0], KEYS[1], {"time": 3, "eye": [0, 0, 0]}],
    "key 2: eye must be three finite numbers": [KEYS[0], {**KEYS[1], "eye": [0, float("nan"), 0]}, KEYS[2]],
    "key 3: time 0.5 must be later than": [KEYS[0], KEYS[1], {**KEYS[2], "time": 0.5}],
    "at least two keys": KEYS[:1],
    "must be a list": {"first": KEYS[0]},
    "key 2: expected time, eye, target": [KEYS[0], 7],
    "key 2: time must be": [KEYS[0], {**KEYS[1], "time": "soon"}],
    "key 1: target must be three": [{**KEYS[0], "target": "123"}, KEYS[1]],
    "key 1: fov must be a number of degrees between": [{**KEYS[0], "fov": 180}, KEYS[1]],
    "key 1: up must be three": [{**KEYS[0], "up": [True, 0, 0]}, KEYS[1]],
    "key 1: fov must be": [{**KEYS[0], "fov": True}, KEYS[1]],
    "key 2: eye and target are the same": [KEYS[0], {**KEYS[1], "eye": [0, 0, 0]}],
    "key 2: time must be a finite number": [KEYS[0], {**KEYS[1], "time": 10**400}],
}


@pytest.mark.parametrize("words", BAD_KEYS)
def test_bad_keys_are_refused_before_the_scan_is_read(words, tmp_path, capsys):
    """Bad keys are reported before the scan is read, which here is invalid."""
    (tmp_path / "scan.ply").write_text("nothing")
    (tmp_path / "keys.json").write_text(json.dumps({"keys": BAD_KEYS[words]}))
    arguments = [str(tmp_path / "scan.ply"), "-o", str(tmp_path / "out"), "--keys", str(tmp_path / "keys.json")]
    err = bad_input(arguments, capsys)
    assert err.startswith(f"pointray: {tmp_path / 'keys.json'}: ") and words in err
    assert sorted(os.listdir(tmp_path)) == ["keys.json", "scan.ply"]


NO_KEYS = [("a.toml", "keys = ["), ("a.json", "{"), ("a.toml", "x = 1"), ("a.txt", "")]


@pytest.mark.parametrize(("name", "text"), NO_KEYS)
def test_invalid_files_of_keys_are_refused(name, text, tmp_path, capsys):
    (tmp_path / "scan.ply").write_text("nothing")
    (tmp_path / name).write_text(text)
    arguments = [str(tmp_path / "scan.ply"), "-o", str(tmp_path / "out"), "--keys", str(tmp_path / name)]
    assert bad_input(arguments, capsys).startswith(f"pointray: {tmp_path / name}: ")
    assert str(tmp_path / "none.toml") in bad_input([*arguments[:-1], str(tmp_path / "none.toml")], capsys)


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("--seconds 0", "--seconds"),
        ("--seconds 1e9", "100000 frames"),
        ("--seconds 0.01", "1 to 100000 frames"),
        ("--fps nan", "--fps"),
        ("--turns inf", "--turns"),
        ("--size 24", "--size"),
        ("--light moon:0,0,1", "--light"),
        ("--exposure 1000", "--exposure"),
        ("--keys keys.json --seconds 3", "--seconds cannot be combined with --keys"),
        ("--keys keys.json --eye 0,0,0", "--eye cannot be combined with --keys"),
    ],
)
def test_options_are_checked_first(option, words, tmp_path, capsys):
    (tmp_path / "scan.ply").write_text("nothing")
    assert words in bad_input([str(tmp_path / "scan.ply"), "-o", str(tmp_path / "out"), *option.split()], capsys)
    assert os.listdir(tmp_path) == ["scan.ply"]


@pytest.mark.parametrize(
    ("output", "words"),
    [
        ("film.gif", "expected .mp4"),
        ("a.png", "%04d.png"),
        ("a%04d.gif", "cannot write .gif"),
        ("a%04d_%d.png", "one %d"),
        ("a%s.png", "one %d"),
        ("no/such/%04d.png", "folder not found"),
        ("no/film.mp4", "folder not found"),
        ("used.mp4", "used.mp4.frames: needed for frames"),
        ("film.mp4 --background none", "transparency"),
        ("file/film.mp4", "folder not found"),
        ("file/%04d.png", "folder not found"),
        ("file", "folder not found"),
    ],
)
def test_the_output_is_checked_first(output, words, tmp_path, capsys):
    (tmp_path / "used.mp4.frames").mkdir()
    (tmp_path / "used.mp4.frames" / "mine.txt").write_text("keep it")
    (tmp_path / "file").write_text("in the way")
    assert words in bad_input([str(tmp_path / "missing.ply"), "-o", *f"{tmp_path}/{output}".split()], capsys)
    assert sorted(os.listdir(tmp_path)) == ["file", "used.mp4.frames"]


def test_a_broken_scan_leaves_nothing(tmp_path, capsys):
    (tmp_path / "scan.ply").write_text("nothing")
    assert "scan.ply" in bad_input([str(tmp_path / "scan.ply"), "-o", str(tmp_path / "out.mp4")], capsys)
    assert os.listdir(tmp_path) == ["scan.ply"]


def test_without_ffmpeg_the_error_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    err = bad_input([str(tmp_path / "missing.ply"), "-o", str(tmp_path / "a.mp4")], capsys)
    assert err.startswith(f"pointray: {tmp_path / 'a.mp4'} needs imageio-ffmpeg: pip install 'pointray[film]'; see ")


def test_an_error_of_ffmpeg_is_reported(scan, monkeypatch, capsys):
    pytest.importorskip("imageio_ffmpeg")
    monkeypatch.setattr("pointray.image.mp4.CRF", "plenty")
    assert animate(scan, "out.mp4") == 1
    printed = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("Compiling")]
    assert len(printed) == 1 and printed[0].startswith(f"pointray: {scan.with_name('out.mp4')}: ffmpeg: ")
    assert sorted(os.listdir(scan.parent)) == ["out.mp4.frames", "scan.ply"]  # the frames are kept for the next run


@pytest.mark.parametrize("output", ["out", "out.mp4"])
def test_a_missing_attribute_is_reported(output, scan, capsys):
    arguments = [str(scan), "-o", str(scan.with_name(output)), *SMALL, *FOUR, "--color-by", "width"]
    err = bad_input(arguments, capsys)
    assert "'width'" in err and "available: x, y, z" in err and os.listdir(scan.parent) == ["scan.ply"]


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("--color-by z", "--color-by is not for a scene file"),
        ("--ground", "--ground is not for a scene file"),
        ("--radius-scale 2", "--radius-scale is not for a scene file"),
        ("--seconds 0", "--seconds"),
        ("--fov 180", "fov must be"),
        ("--keys keys.json --turns 3", "--turns cannot be combined with --keys"),
    ],
)
def test_options_that_conflict_with_a_scene_file_are_refused(option, words, scene, capsys):
    assert words in bad_input([str(scene), "-o", str(scene.with_name("out")), *option.split()], capsys)
    assert sorted(os.listdir(scene.parent)) == ["scan.ply", "scene.toml"]


def test_errors_in_a_scene_file_are_reported(scene, capsys):
    scene.write_text(SCENE.replace("fov = 50", "fov = 500"))
    err = bad_input([str(scene), "-o", str(scene.with_name("out"))], capsys)
    assert err.startswith(f"pointray: {scene}:27: camera.fov: must be a number of degrees between")
    assert bad_input([str(scene.with_name("no.toml")), "-o", str(scene.with_name("out"))], capsys)


def test_a_transparent_scene_file_cannot_become_an_mp4(scene, capsys):
    pytest.importorskip("imageio_ffmpeg")
    film = ["-o", str(scene.with_name("out.mp4"))]
    assert "--background none: MP4" in bad_input([str(scene), *film, "--background", "none"], capsys)
    scene.write_text(SCENE.replace("[0.1, 0.2, 0.3]", '"none"'))
    assert bad_input([str(scene), *film], capsys).startswith(f"pointray: {scene}:2: background: MP4 does not support")
    scene.write_text(SCENE.replace("background = [0.1, 0.2, 0.3]", ""))
    assert bad_input([str(scene), *film], capsys).startswith(f"pointray: {scene}: background: MP4 does not support")
    assert execute(["animate", str(scene), *film, *SMALL, *FOUR, "--background", "1,0,0"]) == 0
