"""If the disk is full or the process is killed, the old file is kept, and no other files are left."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from helpers.marks import long
from pointray.base import atomic_write as files
from pointray.base.atomic_write import replacing
from pointray.cli import execute
from pointray.image import write_layers
from pointray.image.exr import _check_whole as check_exr_whole
from pointray.image.frames import Frames
from pointray.image.mp4 import _check_whole as check_mp4_whole, write_mp4

if os.name == "posix":
    import resource

pytestmark = pytest.mark.skipif(os.name != "posix", reason="limits, locks and signals of POSIX")

# For each name: writes a whole file, then again and again with a limit that cuts it off, at many lengths and within the
# last block, which waits in a buffer. Prints the number of limits, and those where that went unnoticed.
SWEEP = """
import json, resource, signal, sys
from pathlib import Path
import numpy as np
import pointray as pr
from pointray.cli.benchmark import show
from pointray.cli.benchmark.frames import Row
from pointray.image.frames import Frames
from pointray.image.mp4 import write_mp4

folder, pictures, names = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]
random = np.random.default_rng(1).random
image = random((40, 36, 4), dtype=np.float32)
points = pr.Points(random((300, 3)))
model = pr.Model(pr.procedural("sphere", 300)) if {"model.pointray", "light.bake"} & set(names) else None
if "light.bake" in names:
    scene = pr.Scene()
    scene.add(model)
    scene.add_light(pr.EnvironmentLight())
    light = pr.bake(scene, pr.BakeSettings(links=4))
frames = Frames(folder / "%04d.png.json" / "%04d.png", {"seed": [0] * 900}, 9, (36, 40))
row = Row(1000, "far", "8x8", "none", *[1.0] * (len(Row.__annotations__) - 4))
writers = {
    "picture.png": lambda file: pr.write_image(file, image),
    "picture.jpg": lambda file: pr.write_image(file, image),
    "picture.exr": lambda file: pr.write_image(file, image),
    "layers.npz": lambda file: pr.write_layers(file, {"radiance": image, "depth": image[..., 0]}),
    **{name: lambda file: pr.write(file, points) for name in names if name.startswith("points.")},
    "model.pointray": lambda file: model.save(file),
    "light.bake": lambda file: light.save(file),
    "film.mp4": lambda file: write_mp4(file, pictures, 3, 24, (36, 40)),
    "%04d.png.json": lambda file: frames.begin(),
    "plot.svg": lambda file: show.plot(file, [row]),
}

def sweep(file, write):
    file.parent.mkdir()
    write(file)
    size, wrong = file.stat().st_size, []
    step = 97 if file.suffix != ".mp4" else 997
    limits = {0, 1, size // 3, size // 2, size - 9, size - 2, size - 1, *range(max(size - 40 * step, 0), size, step)}
    for limit in sorted(limits):
        file.write_bytes(b"old")
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        try:
            write(file)
            wrong.append([limit, "no error"])
        except OSError:
            pass
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        if file.read_bytes() != b"old" or len(list(file.parent.iterdir())) != 1:
            wrong.append([limit, sorted(p.name for p in file.parent.iterdir())])
    return len(limits), wrong

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # else the first byte beyond the limit would kill
print(json.dumps({name: sweep(folder / name / name, writers[name]) for name in names}))
"""
NAMES = "picture.png", "picture.jpg", "layers.npz", "points.ply", "%04d.png.json"
SCANS = "points.pcd", "points.csv", "points.ptx", "points.glb", "points.laz", "points.copc.laz"
OF_MODELS = "model.pointray", "light.bake"


def sweep(folder, *names, pictures="", **variables):
    """Check files of these names, in one process, because its start takes longest."""
    folder.mkdir(exist_ok=True)
    command = [sys.executable, "-c", SWEEP, str(folder), str(pictures), *names]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, **variables}, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert list(found) == list(names)
    for name, (count, wrong) in found.items():
        assert count >= 10, name
        assert not wrong, name


def test_a_file_that_is_cut_off_anywhere_does_not_replace_the_old_one(tmp_path):
    has_exr = importlib.util.find_spec("OpenEXR") is not None
    sweep(tmp_path, *NAMES, *(["picture.exr"] if has_exr else []))


@pytest.mark.long
def test_a_scan_that_is_cut_off_does_not_replace_the_old_one(tmp_path):
    """Writers that seek, or that use a library which hides errors, notice it too."""
    has_pye57 = importlib.util.find_spec("pye57") is not None
    sweep(tmp_path, *SCANS, *(["points.e57"] if has_pye57 else []))


@pytest.mark.long
def test_a_model_and_light_that_are_cut_off_do_not_replace_the_old_ones(tmp_path):
    sweep(tmp_path, *OF_MODELS)


@pytest.mark.long
def test_a_plot_that_is_cut_off_does_not_replace_the_old_one(tmp_path):
    pytest.importorskip("matplotlib")
    sweep(tmp_path, "plot.svg")


@pytest.fixture
def pictures(tmp_path, rng):
    """The pattern of three numbered pictures; skips the test if no film can be made."""
    pytest.importorskip("imageio_ffmpeg")
    folder = tmp_path / "pictures"
    frames = Frames(folder / "%04d.png", {}, 3, (36, 40))
    frames.begin()
    for k in range(3):
        frames.keep(k, rng.random((40, 36, 4), dtype=np.float32), 0.0)
    return frames.pattern


@pytest.mark.long
def test_a_film_that_is_cut_off_does_not_replace_the_old_one(tmp_path, pictures):
    import imageio_ffmpeg

    ffmpeg = tmp_path / "ffmpeg"  # a process that continues at the limit, as on a full disk
    ffmpeg.write_text(f"#!/bin/sh\ntrap '' XFSZ\nexec {imageio_ffmpeg.get_ffmpeg_exe()} \"$@\"\n")
    ffmpeg.chmod(0o755)
    sweep(tmp_path / "film", "film.mp4", pictures=pictures, IMAGEIO_FFMPEG_EXE=str(ffmpeg))


def test_what_an_exr_lacks_is_seen(tmp_path, rng):
    """A file is refused wherever it is cut off, and if its table of chunks was not written at the end."""
    pytest.importorskip("OpenEXR")
    file = tmp_path / "a.exr"
    write_layers(file, {"depth": rng.random((70, 9))})
    whole = file.read_bytes()
    check_exr_whole(file)
    for length in range(0, len(whole), 7):
        file.write_bytes(whole[:length])
        with pytest.raises(OSError, match="incomplete"):
            check_exr_whole(file)
    head = whole.index(b"\0\0", whole.index(b"screenWindowWidth") + 30)
    file.write_bytes(whole[: head + 2] + bytes(40) + whole[head + 42 :])
    with pytest.raises(OSError, match="incomplete"):
        check_exr_whole(file)


def test_what_a_film_lacks_is_seen(tmp_path, pictures):
    file = tmp_path / "a.mp4"
    write_mp4(file, pictures, 3, 24, (36, 40))
    whole = file.read_bytes()
    for length in range(0, len(whole), 53):
        file.write_bytes(whole[:length])
        with pytest.raises(OSError, match="incomplete"):
            check_mp4_whole(file)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="mounts a small file system")
def test_a_really_full_disk(tmp_path, pictures, rng):
    """On a file system of 64 KiB files are written completely, or an error is reported and the old file is kept."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("only root can mount")
    image = rng.random((64, 64, 4), dtype=np.float32)
    writers = {"a.jpg": lambda p: pr.write_image(p, image), "a.mp4": lambda p: write_mp4(p, pictures, 3, 24, (36, 40))}
    writers["a.exr"] = lambda p: pr.write_image(p, image[:20, :20])
    try:
        for name, write in writers.items():
            file, reported = disk / name, 0
            for free in range(0, 60_000, 4096):
                file.write_bytes(b"old")
                (disk / "rest").write_bytes(bytes(60 * 1024 - free - free % 4096))
                try:
                    write(file)
                except OSError:
                    reported += 1
                    assert file.read_bytes() == b"old"
                assert {p.name for p in disk.iterdir()} == {name, "rest"}
            assert reported > 0
            file.unlink()
    finally:
        subprocess.run(["umount", str(disk)], check=True)


# Renders pictures as the command line does, onto a disk with limited room: one at each limit. Prints what came of each.
COMMAND = """
import io, json, resource, signal, sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from pointray.cli import execute

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
pictures, arguments = json.loads(sys.argv[1]), sys.argv[2:]
found = []
for path, limit in pictures:
    Path(path).write_bytes(b"old")
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as errors:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        status = execute([*arguments, "-o", path])
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    files = [(p.name, p.read_bytes().decode("latin-1")) for p in Path(path).parent.iterdir()]
    found.append([status, out.getvalue(), errors.getvalue(), files])
print(json.dumps(found))
"""


@pytest.mark.parametrize("names", [("a.png",), long(("a.jpg", "a.npz"))])
def test_the_command_line_says_that_the_disk_is_full(tmp_path, names):
    """The limits of all pictures are tried in one process, because its start takes longest."""
    pr.write(tmp_path / "scan.ply", pr.Points(sphere_points(500), sphere_points(500)))
    arguments = ["render", str(tmp_path / "scan.ply"), "--size", "48x32", "--spp", "1", "--light", "headlight"]
    pictures = []
    for name in names:
        path = tmp_path / name / name
        path.parent.mkdir()
        assert execute([*arguments, "-o", str(path)]) == 0
        size = path.stat().st_size
        pictures += [(str(path), limit) for limit in (0, size // 2, size - 1)]
    command = [sys.executable, "-c", COMMAND, json.dumps(pictures), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    wanted = [[1, "", f"pointray: {path}: File too large\n", [[Path(path).name, "old"]]] for path, _ in pictures]
    assert json.loads(done.stdout) == wanted


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("words", ["--version", long("info scan.ply --json")])
def test_output_that_cannot_be_printed_is_a_failure(tmp_path, words):
    pr.write(tmp_path / "scan.ply", pr.Points(sphere_points(100)))
    command = [sys.executable, "-m", "pointray.cli", *words.split()]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.endswith("No space left on device\n") and done.stderr.count("\n") == 1


def test_an_error_that_a_library_ignores_is_raised(tmp_path, monkeypatch):
    """The error is raised even if there is room again for what is written next."""
    file = tmp_path / "a.bin"
    file.write_bytes(b"old")
    monkeypatch.setattr(files, "BUFFER", 0)  # each write goes to the disk at once
    with pytest.raises(OSError, match="File too large"), replacing(file) as beside:
        beside.write(b"one")
        limit = resource.getrlimit(resource.RLIMIT_FSIZE)
        before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (3, limit[1]))
            with suppress(OSError):
                beside.write(b"two")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limit)
            signal.signal(signal.SIGXFSZ, before)
        beside.write(b"three")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.bin", b"old")]


# ------------------------------------------------------------------------------------------------------ killed

WAITS = """
import sys, time
from pathlib import Path
from pointray.base.atomic_write import replacing

with replacing(sys.argv[1]) as beside:
    Path(beside.path).write_bytes(b"half")  # as a writer does that takes a path only
    print("writing", flush=True)
    sys.stdin.readline()
"""


def begin_writing(file):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    process = subprocess.Popen([sys.executable, "-c", WAITS, str(file)], **pipes)
    assert process.stdout.readline() == b"writing\n"
    return process


def kill(process):
    process.kill()
    process.communicate()


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def test_leftovers_of_a_killed_process_are_removed_by_the_next_write(tmp_path, monkeypatch):
    """Files of a running process and files with similar names are kept."""
    foreign = [tmp_path / ".pointray-notes.txt", tmp_path / ".pointray-0123456789abcdef0.png", tmp_path / ".pointray"]
    for path in foreign:
        path.write_text("mine")
    (tmp_path / ".pointray-0123456789abcdef").mkdir()
    killed, living = begin_writing(tmp_path / "a.png"), begin_writing(tmp_path / "b.png")
    before = names(tmp_path)
    kill(killed)
    assert names(tmp_path) == before and len(before) == 6
    monkeypatch.setattr(files, "_swept", set())  # each process cleans up a folder only once
    with replacing(tmp_path / "c.txt") as beside:
        beside.write(b"new")
    assert len(names(tmp_path)) == 6  # a leftover goes, c.txt comes
    living.communicate(b"\n")
    assert living.returncode == 0
    assert (tmp_path / "b.png").read_bytes() == b"half"
    assert names(tmp_path) == sorted([*(p.name for p in foreign), ".pointray-0123456789abcdef", "b.png", "c.txt"])


def test_a_running_process_removes_leftovers(tmp_path, monkeypatch):
    """This works while a thread writes there: each file has its own lock."""
    killed = begin_writing(tmp_path / "a.png")
    kill(killed)
    with replacing(tmp_path / "b.txt") as first:
        assert not names(tmp_path)[1:]
        monkeypatch.setattr(files, "_swept", set())
        with replacing(tmp_path / "c.txt") as second:
            second.write(b"c")
        first.write(b"b")
    assert names(tmp_path) == ["b.txt", "c.txt"]


def test_a_film_killed_at_its_start_can_be_resumed(tmp_path):
    """A leftover of an unfinished record does not cause the folder to be refused."""
    from pointray.cli.animate import film_output

    pytest.importorskip("imageio_ffmpeg")
    folder = tmp_path / "a.mp4.frames"
    folder.mkdir()
    process = begin_writing(folder / "%04d.png.json")
    kill(process)
    assert film_output(tmp_path / "a.mp4", "sky").pattern.parent == folder
    assert names(folder) == []
    (folder / "mine.png").touch()
    with pytest.raises(ValueError, match="needed for frames"):
        film_output(tmp_path / "a.mp4", "sky")


@pytest.mark.long
def test_concurrent_writers_do_not_remove_each_others_files(tmp_path):
    """All processes clean up at every write, while all write."""
    code = """
import sys
from pathlib import Path
from pointray.base import atomic_write as files
for k in range(60):
    files._swept.clear()
    with files.replacing(Path(sys.argv[1]) / f"{sys.argv[2]}.txt") as beside:
        beside.write(str(k).encode())
"""
    processes = [subprocess.Popen([sys.executable, "-c", code, str(tmp_path), str(k)]) for k in range(4)]
    assert [process.wait() for process in processes] == [0] * 4
    assert names(tmp_path) == [f"{k}.txt" for k in range(4)]
    assert {p.read_text() for p in tmp_path.iterdir()} == {"59"}
