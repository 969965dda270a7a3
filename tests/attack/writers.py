"""Writers of pictures, layers, scans, saved models and frames of a film, each in two versions that differ.

Attacks on writing compare the files with both versions, byte for byte.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import pointray as pr
from attack import CrashError, WrongError
from pointray.image.frames import Frames

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
        "ply": (".ply", lambda path, version: pr.write(path, clouds[version])),
        "model": (".pointray", lambda path, version: models[version].save(path)),
        "npz": (".npz", lambda path, version: pr.write_layers(path, layers[version])),
    }
    if find_spec("OpenEXR"):
        out["exr"] = (".exr", lambda path, version: pr.write_image(path, images[version]))
        out["layers"] = (".exr", lambda path, version: pr.write_layers(path, layers[version]))
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
            told = work()
        except BaseException as error:
            told = {"error": f"{type(error).__name__}: {error}"}
        os.write(there, json.dumps(told).encode())
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
