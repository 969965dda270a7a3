"""Writers of pictures, layers, scans of all formats, saved models, frames of a film, and of the commands that write
scans, each in two versions that differ.

Attacks on writing compare the files with both versions, byte for byte.
"""

from __future__ import annotations

import io
import json
import os
import signal
import time
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import pointray as pr
from attack import CrashError, WrongError
from pointray.cli import execute
from pointray.image.frames import Frames
from pointray.io.known_formats import written
from pointray.model import model_cache
from pointray.model.model_file import SAVED

Write = Callable[[Path, int], None]
SIZE = (64, 48)
LEFTOVERS = ".pointray-*"  # files that an unfinished write leaves beside its target


def _image(version: int) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(version)
    return rng.random((SIZE[1], SIZE[0], 4)).astype(np.float32)


def _cloud(version: int) -> pr.Points:
    rng = np.random.default_rng(version)
    rows = rng.normal(size=(300, 3))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    return pr.Points(rows, rows, attributes={"heat": rows[:, 0]})


def writers() -> dict[str, tuple[str, Write]]:
    """Writers by name: the extension of a file, and a function that writes version 0 or 1 of it."""
    images = [_image(version) for version in (0, 1)]
    clouds = [_cloud(version) for version in (0, 1)]
    models = [pr.Model(cloud) for cloud in clouds]
    layers = []
    for version, model in enumerate(models):
        scene = pr.Scene()
        scene.add(model)
        camera = pr.Camera.frame(model.bounds, size=(16, 12))
        layers.append(pr.render_layers(scene, camera, pr.Settings(seed=version)))
    out: dict[str, tuple[str, Write]] = {
        "png": (".png", lambda path, version: pr.write_image(path, images[version])),
        "jpg": (".jpg", lambda path, version: pr.write_image(path, images[version][..., :3])),
        "model": (".pointray", lambda path, version: models[version].save(path)),
        "npz": (".npz", lambda path, version: pr.write_layers(path, layers[version])),
    }
    for name in written():  # scans
        out.setdefault(f"scan{name}", (name, lambda path, version: _write_scan(path, clouds[version])))
    if find_spec("OpenEXR"):
        out["exr"] = (".exr", lambda path, version: pr.write_image(path, images[version]))
        out["layers"] = (".exr", lambda path, version: pr.write_layers(path, layers[version]))
    return out


def _write_scan(path: Path, points: pr.Points) -> None:
    """Write points; that some formats cannot hold all is known."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        pr.write(path, points)


def commands(folder: Path) -> dict[str, tuple[str, Write]]:
    """The same of what commands write: `convert`, `prepare`, and the cache of models."""
    scans = [folder / f"scan-{version}.ply" for version in (0, 1)]
    clouds = [_cloud(version) for version in (0, 1)]
    for scan, points in zip(scans, clouds, strict=True):
        pr.write(scan, points)
        os.utime(scan, (time.time() - 10,) * 2)  # else it counts as just written
    models = [pr.Model(points) for points in clouds]
    os.environ["POINTRAY_CACHE"], model_cache.WORTH = str(folder / "cache"), 10
    about = {"files": model_cache._facts_of(scans), "made": {}}

    def run(*words: str) -> Write:
        """A command. words : its own, with FROM and TO"""

        def write(path: Path, version: int) -> None:
            output, known = io.StringIO(), {"FROM": str(scans[version]), "TO": str(path)}
            with redirect_stdout(output), redirect_stderr(output):
                status = execute([known.get(word, word) for word in words])
            if status != 0:
                raise WrongError(f"{words[0]}: {output.getvalue()[-200:]}")

        return write

    def store(path: Path, version: int) -> None:
        if not model_cache.Entry(path, about).store(models[version], [f"note {version}"]):
            raise WrongError("the cache keeps nothing")

    out: dict[str, tuple[str, Write]] = {f"convert{x}": (x, run("convert", "FROM", "TO")) for x in written()}
    out["prepare"] = (".ply", run("prepare", "FROM", "-o", "TO"))
    out["prepare-model"] = (SAVED, run("prepare", "FROM", "-o", "TO", "--no-levels"))
    out["cache"] = (SAVED, store)
    return out


def versions_of(write: Write, path: Path) -> list[bytes]:
    """The contents of both versions."""
    out = []
    for version in (0, 1):
        write(path, version)
        out.append(path.read_bytes())
    path.unlink()
    assert out[0] != out[1]
    return out


def film(folder: Path, version: int, count: int = 12) -> Frames:
    """Frames of a film of random pictures, with `version` in its settings."""
    return Frames(folder / "%02d.png", {"version": version}, count, SIZE)


def frame_image(k: int) -> np.ndarray[Any, Any]:
    """The picture of a frame."""
    return _image(k)


def in_child(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The result of a forked process; CrashError if a signal ends it, WrongError if it raises."""
    here, there = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(here)
        try:
            result = work()
        except BaseException as error:
            result = {"error": f"{type(error).__name__}: {error}"}
        os.write(there, json.dumps(result).encode())
        os._exit(0)
    os.close(there)
    with open(here, "rb") as pipe:
        data = pipe.read()
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        raise CrashError(f"{signal.Signals(os.WTERMSIG(status)).name} while writing")
    answer: dict[str, Any] = json.loads(data)
    if "error" in answer:
        raise WrongError(answer["error"])
    return answer
