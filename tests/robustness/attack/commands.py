"""Ctrl-C in the commands: SIGINT at a random moment. They end with 130 or finish, and leave no half-written file."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image

import pointray as pr
from attack import Attack, CrashError, WrongError
from attack.mutate import Rng, pick

SMALL = ["--size", "160x120", "--spp", "2"]
OLD = b"old"
# Name of the output, and the command. view writes nothing, and ends only when it is interrupted.
COMMANDS = {
    "a.png": ["render", *SMALL],
    "a.jpg": ["render", *SMALL],
    "a.npz": ["render", *SMALL],
    "a.ply": ["prepare", "--estimate-normals"],
    "a.pointray": ["prepare"],
    "film": ["animate", "--size", "64x48", "--spp", "1", "--seconds", "0.5", "--fps", "12"],
    "": ["view", "--no-open"],
}
LATEST = 1.4  # the signal comes within this many times the command's duration
WRITING = 0.8, 1.1  # the same unit: when files are written, and every second signal comes


def command_of(name: str, scan: Path, target: Path) -> list[str]:
    command, *options = COMMANDS[name]
    output = ["-o", str(target / name)] if name else []
    return [sys.executable, "-m", "pointray.cli", command, str(scan), *output, *options]


def check_files(name: str, target: Path, new: bytes | None, kept: bool) -> bool:
    """Whether the new file is there; WrongError if there is something else than it or the old one."""
    names = sorted(path.name for path in target.iterdir())
    if name == "film":
        return check_film(target / name, names)
    hidden = [found for found in names if found != name]
    if hidden:
        raise WrongError(f"{name}: left beside: {hidden[0][:10]}...{Path(hidden[0]).suffix}")
    data = (target / name).read_bytes() if names else None
    if data not in (new, OLD if kept else None):
        raise WrongError(f"{name}: neither the old file nor the new one")
    return data == new


def check_film(folder: Path, names: list[str]) -> bool:
    """Check that all frames are whole, and that nothing but the note is beside them."""
    if names not in ([], ["film"]):
        raise WrongError(f"film: left beside: {names}")
    found = sorted(folder.iterdir()) if folder.exists() else []
    for path in found:
        if path.suffix == ".png":
            with Image.open(path) as picture:
                picture.load()
        elif path.suffix != ".json" or path.name.startswith("."):
            raise WrongError(f"film: left beside the frames: {path.name[:10]}...{path.suffix}")
    return bool(found) and all(path.suffix == ".png" for path in found)


def begin(folder: Path) -> Attack:
    """Interrupts of the commands."""
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(5000, 3))
    scan, target = folder / "scan.ply", folder / "here"
    pr.write(scan, pr.Points(rows / np.linalg.norm(rows, axis=1, keepdims=True)))
    known: dict[str, tuple[bytes, float]] = {}

    def known_of(name: str) -> tuple[bytes, float]:
        """What the command writes without an interrupt, and how long it takes."""
        if name not in known:
            begun = time.monotonic()
            done = subprocess.run(command_of(name, scan, target), capture_output=True, text=True)
            if done.returncode != 0:
                raise WrongError(f"{name}: {done.stderr}")
            data = (target / name).read_bytes() if name != "film" else b""
            known[name] = data, time.monotonic() - begun
        return known[name]

    def attack(rng: Rng, index: int) -> bool:
        name = pick(rng, list(COMMANDS))
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        new, seconds = known_of(name) if name else (b"", 3.0)
        shutil.rmtree(target)
        target.mkdir()
        kept = name not in ("film", "") and rng.random() < 0.5
        if kept:
            (target / name).write_bytes(OLD)
        process = subprocess.Popen(
            command_of(name, scan, target), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        time.sleep(seconds * float(rng.uniform(*(WRITING if rng.random() < 0.5 else (0.0, LATEST)))))
        process.send_signal(signal.SIGINT)
        _, printed = process.communicate()
        status = process.returncode
        # Before the command has begun, the signal itself ends Python: a shell sees 130, too.
        early = status == -signal.SIGINT and "execute" not in printed
        if status < 0 and not early:
            raise CrashError(f"{name or 'view'}: {signal.Signals(-status).name}")
        if status not in (0, 130) and not early:
            raise WrongError(f"{name or 'view'}: exit status {status}: {printed.strip().splitlines()[-1:]}")
        if "Traceback" in printed and not early:
            raise WrongError(
                f"{name or 'view'}: exit status {status} with a traceback: {printed.strip().splitlines()[-1:]}"
            )
        if not name:
            return True
        done = check_files(name, target, new, kept)
        if status == 0 and not done:
            raise WrongError(f"{name}: exit status 0, and nothing is written")
        return done

    return attack
