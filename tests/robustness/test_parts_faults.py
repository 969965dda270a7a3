"""Folders of models in parts that are damaged, mixed, shared by two writers, or on a disk that fills."""

import errno
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from pointray.base.disk_columns import Column
from pointray.cli import execute
from pointray.io.files import request_of
from pointray.io.selection import Selection
from pointray.model.model_folder import INDEX, SURFACE_ONLY
from pointray.model.out_of_core import exclusive_lock as alone_module, prepare as prepare_module
from pointray.model.out_of_core.builder import OutOfCoreBuilder
from pointray.model.out_of_core.prepare import prepare, unfinished_part_points
from pointray.surface.tree.settings import check_settings

SIZE = 1 << 14  # the least there is for so few points


def prepared(file: Path, folder: Path, smooth: str | float = "auto", surface: str = "apss") -> dict[str, bytes]:
    """The files of the model in parts of a file."""
    reading = request_of(), Selection(1, None, None, None, None)
    prepare([file], reading, folder, (check_settings(surface, 4, 1, "auto"), smooth), SIZE)
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("scan") / "a.ply"
    rows = sphere_points(20_000)
    pr.write(file, pr.Points(rows, rows, colors=np.full((len(rows), 3), 99, np.uint8)))
    return file


@pytest.fixture(scope="module")
def whole(scan: Path) -> Path:
    """A folder of two parts."""
    prepared(scan, scan.parent / "whole")
    return scan.parent / "whole"


@pytest.fixture(scope="module")
def paper(scan: Path) -> Path:
    """A folder of the same points with other settings."""
    prepared(scan, scan.parent / "paper", surface="paper")
    return scan.parent / "paper"


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    """A copy that may be damaged."""
    return Path(shutil.copytree(whole, tmp_path / "a.pointray"))


# ----------------------------------------------------------------------------------------------------- what is opened


def missing(folder: Path, other: Path) -> None:
    (folder / "part-0001.pointray").unlink()


def foreign(folder: Path, other: Path) -> None:
    """A part of a model of the same points with other settings."""
    shutil.copy(other / "part-0001.pointray", folder / "part-0001.pointray")


def swapped(folder: Path, other: Path) -> None:
    shutil.copy(folder / "part-0000.pointray", folder / "part-0001.pointray")
    index = json.loads((folder / INDEX).read_text())
    index["parts"][1].update({name: index["parts"][0][name] for name in ("nbytes", "sha256")})
    (folder / INDEX).write_text(json.dumps(index))


def newer(folder: Path, other: Path) -> None:
    file = folder / "part-0001.pointray"
    found, version = file.read_bytes(), f'"version": {SURFACE_ONLY}'.encode()
    assert found.count(version) == 1
    file.write_bytes(found.replace(version, version[:-1] + b"9"))


def cut_off(folder: Path, other: Path) -> None:
    file = folder / "part-0001.pointray"
    file.write_bytes(file.read_bytes()[:-999])


def absurd(folder: Path, other: Path) -> None:
    """A tree whose numbers point to where nothing is."""
    file = folder / "part-0001.pointray"
    found = file.read_bytes()
    file.write_bytes(found[:4096] + b"\xff" * (len(found) - 4096))


@pytest.mark.parametrize("damage", [missing, foreign, swapped, newer, cut_off, absurd])
def test_a_part_that_is_no_part_of_the_model_is_named(
    damage: Callable[[Path, Path], None], folder: Path, paper: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damage(folder, paper)
    words = ["render", str(folder), "-o", str(tmp_path / "a.png"), "--size", "64x64", "--light", "headlight"]
    assert execute(words) == 2
    line = capsys.readouterr().err
    assert "part-0001.pointray: " in line and line.count("\n") == 1
    assert not (tmp_path / "a.png").exists()


def test_an_index_of_another_version_is_reported(folder: Path) -> None:
    index = json.loads((folder / INDEX).read_text())
    (folder / INDEX).write_text(json.dumps({**index, "version": 99}))
    with pytest.raises(
        ValueError, match=r"index\.json: written by another version of pointray: run `pointray prepare` again"
    ):
        pr.Model.load(folder)


@pytest.mark.long
def test_parts_of_the_same_have_the_same_id_and_others_another_one(scan: Path, whole: Path, tmp_path: Path) -> None:
    """So a part of other points, settings or sizes is seen."""
    shutil.copy(scan, tmp_path / "b.ply")
    again, others = prepared(scan, tmp_path / "again"), prepared(tmp_path / "b.ply", tmp_path / "others")
    assert again == {path.name: path.read_bytes() for path in whole.iterdir()}
    paper, unmoved = prepared(scan, tmp_path / "p", surface="paper"), prepared(scan, tmp_path / "q", smooth=0.0)
    assert len({json.loads(files[INDEX])["id"] for files in (again, others, paper, unmoved)}) == 4


# ------------------------------------------------------------------------------------------------------- two writers


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such locks")
def test_a_folder_whose_writer_has_just_ended_is_not_written_to(
    scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It locked a file that was removed before."""
    unfinished = tmp_path / "a" / "unfinished"
    monkeypatch.setattr(alone_module.fcntl, "flock", lambda lock, how: shutil.rmtree(unfinished))
    with pytest.raises(ValueError, match="another process is preparing a model in this folder"):
        prepared(scan, tmp_path / "a")


def test_a_folder_that_has_just_been_finished_is_not_written_to(
    scan: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    monkeypatch.setattr(prepare_module, "check_unfinished", lambda path: path / "unfinished")
    with pytest.raises(ValueError, match="already exists and is not empty"):
        prepared(scan, folder)
    assert before == {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.long
def test_a_run_that_ends_before_it_has_tidied_up_goes_on(
    scan: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*paths: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(prepare_module, "_remove", stop)
        with pytest.raises(KeyboardInterrupt):
            prepared(scan, tmp_path / "a")
    assert len(pr.Model.load(tmp_path / "a").parts) == 2
    assert prepared(scan, tmp_path / "a") == {path.name: path.read_bytes() for path in whole.iterdir()}


def test_unfinished_work_of_another_version_is_refused(
    scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(prepare_module, "__version__", "0.0.9")
        patch.setattr(OutOfCoreBuilder, "build", lambda self: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            prepared(scan, tmp_path / "a")
    with pytest.raises(
        ValueError, match="contains unfinished work with different version: use the same to resume, or remove"
    ):
        prepared(scan, tmp_path / "a")
    assert unfinished_part_points(tmp_path / "a") == SIZE


@pytest.mark.long
def test_what_was_found_and_is_lost_is_named(scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(OutOfCoreBuilder, "_write", lambda self: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            prepared(scan, tmp_path / "a")
    for column in ("merged.f4x3", "placed.f4x3", "radii.f4x0"):
        damaged = Path(shutil.copytree(tmp_path / "a", tmp_path / column))
        (damaged / "unfinished" / column).unlink()
        with pytest.raises(ValueError, match=f"{column[:-5]} is missing: remove the folder to start over"):
            prepared(scan, damaged)


# ---------------------------------------------------------------------------------------------------- a disk that fills


@contextmanager
def disk_of(folder: Path, size: int) -> Iterator[Callable[[int], None]]:
    """A file system of a given number of bytes; yields a function that changes its size."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if not sys.platform.startswith("linux") or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("only root can mount")

    def resize(size: int) -> None:
        subprocess.run(["mount", "-o", f"remount,size={size}", str(folder)], check=True)

    try:
        yield resize
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.mark.long
def test_a_disk_that_fills_at_any_stage_is_reported_and_the_work_resumes(
    scan: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever was half written is not taken for whole."""
    monkeypatch.setattr("pointray.io.spooling.spool._check_disk_space", lambda *about: None)
    size, named, runs = 1 << 19, [], 0
    with disk_of(tmp_path / "disk", size) as resize:
        while True:
            try:
                found = prepared(scan, tmp_path / "disk" / "a")
                break
            except OSError as error:
                named.append(Path(error.filename).relative_to(tmp_path / "disk").as_posix())
                assert error.strerror is not None and error.strerror.endswith(
                    "No space left on device: free some space and run the same command again to resume"
                )
            assert not (tmp_path / "disk" / "a" / INDEX).exists()
            runs, size = runs + 1, size + (1 << 15)
            assert runs < 400
            resize(size)
    assert found == {path.name: path.read_bytes() for path in whole.iterdir()}
    assert len(named) > 10
    assert {"raw", "scattered", "points"} <= {Path(name).name.partition(".")[0] for name in named}, set(named)


@pytest.mark.long
def test_any_column_may_be_half_written(
    scan: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put, wanted, calls, failing = Column._put, [""], [0], [2]

    def fail(self: Column, data: memoryview, place: int) -> int:
        calls[0] += self.name == wanted[0]
        if self.name == wanted[0] and calls[0] == failing[0]:
            put(self, data[: len(data) // 2], place)
            raise OSError(errno.ENOSPC, "No space left on device")
        return put(self, data, place)

    monkeypatch.setattr(Column, "_put", fail)
    monkeypatch.setattr("pointray.model.out_of_core.arrange.CHUNK", 4096)
    monkeypatch.setattr("pointray.io.spooling.convert.CHUNK", 4096)
    second = {"positions": 2, "scattered.colors": 2, "points.normals": 2}  # of later columns only one part is left
    for name in (*second, "tiles", "merged", "placed", "normals", "radii"):
        wanted[:], calls[:], failing[:] = [name], [0], [second.get(name, 1)]
        with pytest.raises(OSError, match=rf"free some space and run the same command again to resume.*/{name}\."):
            prepared(scan, tmp_path / "a")
        assert not (tmp_path / "a" / INDEX).exists()
    wanted[:] = [""]
    assert prepared(scan, tmp_path / "a") == {path.name: path.read_bytes() for path in whole.iterdir()}


def test_the_command_says_that_the_disk_is_full(scan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    disk = tmp_path / "disk"
    with disk_of(disk, 7 << 19):
        words = ["prepare", str(scan), "-o", f"{disk / 'a.pointray'}/", "--memory", "2GiB", "--part-points", str(SIZE)]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("pointray.cli.prepare.fits", lambda files, request, memory: memory is None)
            assert execute(words) == 1
            line = capsys.readouterr().err
            assert (
                line.startswith(f"pointray: {disk / 'a.pointray'}/")
                and "free some space and run the same command" in line
            )
            assert line.count("\n") == 1
            subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
            assert execute(words) == 0
        assert len(pr.Model.load(disk / "a.pointray").parts) == 2
