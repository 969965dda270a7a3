"""Full disks: writers and commands that may write only a limited number of bytes.

If the disk fills, they end with status 1 and one line, the old file is whole, and nothing is left beside it. Otherwise
the status is 0 and the new file is whole. The limit is the process's limit on the size of files, or a small file system
where this process may mount one.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import resource
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import pointray as pr
from attack import Attack, WrongError
from attack.mutate import Rng, pick
from attack.writers import film, frame_image, in_child, versions_of, writers
from pointray.cli import execute

CLONE_NEWNS, MS_REC, MS_PRIVATE = 0x00020000, 1 << 14, 1 << 18
PAGE = 4096
SMALL = ["--size", "48x32", "--spp", "1"]


def limit_files(size: int) -> None:
    """Let no file of this process grow beyond this size: writes fail, as on a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def mount_small(folder: Path, size: int) -> bool:
    """Mount a small file system that only this process sees onto a folder; False if that is not allowed."""
    libc = ctypes.CDLL(None, use_errno=True)
    if os.geteuid() != 0 or libc.unshare(CLONE_NEWNS) != 0:
        return False
    if libc.mount(b"none", b"/", None, ctypes.c_ulong(MS_REC | MS_PRIVATE), None) != 0:
        return False
    return bool(libc.mount(b"tmpfs", bytes(folder), b"tmpfs", ctypes.c_ulong(0), f"size={size}".encode()) == 0)


def told_by(arguments: list[str]) -> tuple[int, list[str]]:
    """A command's exit status and its lines of errors."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = execute(arguments)
    return status, [line for line in err.getvalue().splitlines() if "note: " not in line]


class Job:
    """Something that writes a file, and both versions of the file.

    run : writes the new version; returns None, or the status and lines of a command
    """

    def __init__(self, name: str, run: Callable[[Path], tuple[int, list[str]] | None], old: bytes, new: bytes) -> None:
        self.name, self.run, self.old, self.new = name, run, old, new


def jobs_in(folder: Path) -> list[Job]:
    """Writers, and the commands that end in them."""
    jobs = []
    for extension, write in writers().values():
        old, new = versions_of(write, folder / f"a{extension}")
        jobs.append(Job(f"a{extension}", lambda path, write=write: write(path, 1), old, new))  # type: ignore[misc]
    scan = folder / "scan.ply"
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(400, 3))
    pr.write(scan, pr.Points(rows / np.linalg.norm(rows, axis=1, keepdims=True)))
    commands = [("out.png", ["render", *SMALL]), ("out.jpg", ["render", *SMALL]), ("out.npz", ["render", *SMALL])]
    commands += [("out.ply", ["prepare", "--estimate-normals"]), ("out.pointray", ["prepare", "--no-levels"])]
    for name, (command, *options) in commands:
        path = folder / name

        def run(path: Path, command: str = command, options: list[str] = options) -> tuple[int, list[str]]:
            return told_by([command, str(scan), "-o", str(path), *options])

        if run(path) != (0, []):
            raise RuntimeError(f"{command} to {name} fails on a disk with room")
        jobs.append(Job(name, run, b"old", path.read_bytes()))
        path.unlink()
    return jobs


def found_in(target: Path) -> dict[str, str]:
    """Name and contents of each file, the contents as hexadecimal digits."""
    return {path.name: path.read_bytes().hex() for path in sorted(target.iterdir())}


def write_there(job: Job, target: Path, kept: bool) -> dict[str, Any]:
    """Let a job write into a folder; returns status, lines, whether it raised, and what is there afterwards."""
    path = target / job.name
    raised, result = "", None
    try:
        result = job.run(path)
    except OSError:
        raised = "OSError"
    except Exception as error:
        raised = f"{type(error).__name__}: {' '.join(str(error).split())}"
    status, lines = result or (1 if raised else 0, [])
    return {
        "status": status,
        "lines": lines,
        "raised": raised,
        "command": result is not None,
        "found": found_in(target),
    }


def judge(job: Job, kept: bool, result: dict[str, Any]) -> bool:
    """Whether the new file is there; WrongError if neither version is, or if the messages are not true."""
    status, found = result["status"], result["found"]
    if status not in (0, 1) or result["raised"] not in ("", "OSError"):
        raise WrongError(f"{job.name}: status {status} {result['lines'][:1]} {result['raised'][:120]}")
    if result["command"] and len(result["lines"]) != status:
        raise WrongError(f"{job.name}: status {status} with {len(result['lines'])} lines")
    want = {job.name: job.new.hex()} if status == 0 else {job.name: job.old.hex()} if kept else {}
    if found != want:
        beside = sorted(set(found) - set(want))
        state = f"left beside: {Path(beside[0]).suffix}" if beside else "the file is not whole"
        raise WrongError(f"{job.name}: status {status} {result['raised']}, {state}")
    return status == 0


def begin(folder: Path) -> Attack:
    """Writers onto full disks."""
    jobs, target = jobs_in(folder), folder / "here"

    def small_disk(job: Job, room: int, kept: bool) -> dict[str, Any]:
        if not mount_small(target, room):
            limit_files(min(room, len(job.new)))
        if kept:
            (target / job.name).write_bytes(job.old)
        return write_there(job, target, kept)

    def limited(job: Job, size: int, kept: bool) -> dict[str, Any]:
        limit_files(size)
        return write_there(job, target, kept)

    def film_on_full_disk(rng: Rng) -> bool:
        """Check that frames are whole, and that the note beside them says nothing untrue."""

        def work() -> dict[str, Any]:
            limit_files(int(rng.integers(0, 12_000)))
            frames, done = film(target, 0, 3), 0
            try:
                frames.begin()
                for k in range(3):
                    frames.keep(k, frame_image(k), 0.0)
                    done += 1
                frames.finish()
            except OSError:
                pass
            return {"done": done, "names": sorted(path.name for path in target.iterdir())}

        result = in_child(work)
        whole = [k for k in range(3) if film(target, 0, 3)._complete(k)]
        if len(whole) != len(list(target.glob("[0-9]*.png"))):
            raise WrongError("a frame is not whole")
        if any(name.startswith(".") for name in result["names"]) or len(whole) < result["done"]:
            raise WrongError(f"film: {result['done']} frames done, there are {result['names']}")
        return result["done"] == 3

    def attack(rng: Rng, index: int) -> bool:
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        if rng.random() < 0.08:
            return film_on_full_disk(rng)
        job, kept = pick(rng, jobs), bool(rng.random() < 0.6)
        size = len(job.new)
        if rng.random() < 0.3:
            pages = -(-size // PAGE) + (-(-len(job.old) // PAGE) if kept else 0)
            room = PAGE * int(rng.integers(1, pages + 3))
            if kept and room < len(job.old) + PAGE:
                kept = False
            return judge(job, kept, in_child(lambda: small_disk(job, room, kept)))
        if kept:
            (target / job.name).write_bytes(job.old)
        limit = int(pick(rng, (0, 1, size - 1, size, size + 1, int(rng.integers(0, size + 100)))))
        return judge(job, kept, in_child(lambda: limited(job, limit, kept)))

    return attack
