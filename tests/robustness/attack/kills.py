"""SIGKILL at random moments while files are written: either the old or the new file must be there, whole.

Files that a killed process leaves beside it must be gone after the next process has written into that folder.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import pointray as pr
from attack import Attack, CrashError, WrongError
from attack.mutate import Rng, pick
from attack.writers import LEFTOVERS, Write, commands, film, frame_image, in_child, versions_of, writers
from pointray.io.known_formats import written
from pointray.model.model_file import SAVED

LONGEST = 0.06  # seconds until the kill, at least
TIMES = 3  # the kill comes within so many times what a file takes


def killed_after(rng: Rng, work: Callable[[], None], longest: float = LONGEST) -> None:
    """Work in a process that is killed at a random moment; CrashError if it ends by another signal."""
    child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            os._exit(1)
    time.sleep(float(rng.random()) * longest)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) != signal.SIGKILL:
        raise CrashError(f"{signal.Signals(os.WTERMSIG(status)).name} while writing")
    if os.WIFEXITED(status):
        raise WrongError("the writer ended by itself")


def write_for_ever(write: Write, path: Path) -> None:
    """Write one version after the other."""
    version = 0
    while True:
        version = 1 - version
        write(path, version)


def render_for_ever(folder: Path) -> None:
    """Render a film again and again."""
    version = 0
    while True:
        version += 1
        frames = film(folder, version)
        missing, _ = frames.find()
        frames.begin()
        for k in missing:
            frames.keep(k, frame_image(k), 0.0)
        frames.finish()


def check_film(folder: Path) -> bool:
    """Whether there are frames; WrongError if one is not whole."""
    pictures = sorted(folder.glob("[0-9]*.png"))
    for path in pictures:
        with Image.open(path) as picture:
            picture.load()
    return bool(pictures)


def in_process(write: Callable[[], None]) -> None:
    """Write in a process of its own, because each process cleans up a folder only once."""

    def work() -> dict[str, Any]:
        write()
        return {}

    in_child(work)


def check_opens(path: Path) -> None:
    """WrongError if a scan or model that is whole does not open."""
    if path.suffix == SAVED:
        pr.Model.load(path)
    elif path.suffix in written():
        pr.read(path)


def check_folder(folder: Path, write: Callable[[], None], known: set[str]) -> None:
    """WrongError if the next process that writes leaves something beside its file."""
    in_process(write)
    left = sorted({path.name for path in folder.iterdir()} - known)
    if left:
        raise WrongError(f"left in the folder after the next write: {Path(left[0]).suffix} {LEFTOVERS}")


def begin(folder: Path) -> Attack:
    """Writers that are killed."""
    known = writers() | commands(folder)
    contents, longest = {}, {}
    for name, (extension, write) in known.items():
        contents[name] = versions_of(write, folder / f"a{extension}")
        begun = time.monotonic()
        write(folder / f"a{extension}", 0)
        longest[name] = max(LONGEST, TIMES * (time.monotonic() - begun))

    def attack(rng: Rng, index: int) -> bool:
        target = folder / f"{index}"
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        try:
            return killed(rng, target)
        finally:
            shutil.rmtree(target)

    def killed(rng: Rng, target: Path) -> bool:
        name = pick(rng, [*known, "film"])
        if name == "film":
            killed_after(rng, lambda: render_for_ever(target))
            whole = check_film(target)
            with suppress(FileNotFoundError):
                film(target, 0).note.unlink()
            names = {path.name for path in target.glob("[0-9]*.png")} | {"00.png", film(target, 0).note.name}
            check_folder(target, lambda: film(target, 0).keep(0, frame_image(0), 0.0), names)
            return whole
        extension, write = known[name]
        path = target / f"a{extension}"
        if rng.random() < 0.5:
            in_process(lambda: write(path, 0))
        before = path.exists()
        killed_after(rng, lambda: write_for_ever(write, path), longest[name])
        if path.exists() and path.read_bytes() not in contents[name]:
            raise WrongError(f"{extension}: neither the old file nor the new one")
        if before and not path.exists():
            raise WrongError(f"{extension}: the old file is gone")
        done = path.exists() and path.read_bytes() == contents[name][1]
        if name == "cache" and path.with_suffix(".json").exists():
            json.loads(path.with_suffix(".json").read_bytes())
        if done and name != "npz":
            check_opens(path)
        check_folder(target, lambda: write(path, 0), {path.name, *(["a.json"] if name == "cache" else [])})
        return done

    np.seterr(all="ignore")
    return attack
