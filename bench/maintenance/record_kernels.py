"""Record the kernels and compile times of a first start in `rendering/first_start.json` of the package.

Run it after a change of the kernels used by models, pictures or bakes: `python -m bench.maintenance.record_kernels`. It
takes three to six minutes, in two processes with empty caches; the second one finds what tracing kernels share. Seconds
are scaled to a typical core of 2024.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import pointray as pr
from pointray.engine.jit import KERNELS, compile_times
from pointray.rendering import warmup

FILE = Path(warmup.__file__).with_name("first_start.json")
CAMERA = pr.Camera.look_at((3, 0, 2), (0, 0, 0), size=(16, 16))
CLICK, RAYS = f"{warmup.PACKAGE}.{warmup.CLICK}", f"{warmup.PACKAGE}.{warmup.RAYS}"


def new_kernels(use: Callable[[], Any]) -> dict[str, float]:
    """Use something; return the kernels that were not used before, and the seconds that compiling each took."""
    before = used()
    use()
    return {name: compile_times().get(name, 0.0) for name in used() if name not in before}


def used() -> list[str]:
    """Return the kernels that this process has called."""
    return [name for name, kernel in KERNELS.items() if kernel.was_called]


def torus() -> pr.Points:
    """Random points of a torus with their normals, 2,000 points."""
    u, v = np.random.default_rng(0).random((2, 2000)) * 2 * np.pi
    normals = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=1)
    ring = np.stack([np.cos(u), np.sin(u), np.zeros_like(u)], axis=1)
    return pr.Points(ring + 0.4 * normals, normals)


def first_start() -> dict[str, dict[str, float]]:
    """Use the package as a first start does; return the kernels of each stage."""
    points, scene, floor = torus(), pr.Scene(), pr.Scene()
    floor.add(pr.Plane((0, 0, -1), (0, 0, 1)))
    light = pr.EnvironmentLight()
    floor.add_light(light)
    floor.add_light(pr.SphereLight((0, 0, 2), 0.1, 1.0))
    models: list[pr.Model] = []
    settings = pr.BakeSettings(links=1, patches=64)
    rows = {"normals": new_kernels(lambda: models.append(pr.Model(points.positions)))}
    scene.add(models[0])
    scene.add_light(light)
    rows["rays"] = new_kernels(lambda: scene.intersect((0, 0, 3), (0, 0, -1)))
    rows["pictures"] = {}
    for integrator in ("phong", "path"):
        rows["pictures"] |= new_kernels(lambda name=integrator: pr.render(scene, CAMERA, pr.Settings(name)))  # type: ignore[misc]
    baked = new_kernels(lambda: pr.bake(floor, settings))
    rows["rays"][RAYS] = baked.pop(RAYS)
    rows["bake"] = baked
    rows["blend"] = new_kernels(lambda: setattr(scene, "baked", pr.bake(scene, settings)))
    rows["pictures"] |= new_kernels(lambda: pr.render(scene, CAMERA, pr.Settings("baked")))
    return rows


def other_start() -> dict[str, float]:
    """Return the kernels of a model whose points have normals, and of a click after a picture."""
    scene = pr.Scene()
    rows = new_kernels(lambda: scene.add(pr.Model(torus())))
    pr.render(scene, CAMERA, pr.Settings("phong"))
    return {**rows, CLICK: new_kernels(lambda: scene.intersect((0, 0, 3), (0, 0, -1)))[CLICK]}


def pace() -> float:
    """How much faster this core runs Python at this moment than a typical core of 2024, which takes 0.12 s for this."""
    begun = time.thread_time()
    sum(i * i for i in range(3_000_000))
    return 0.12 / (time.thread_time() - begun)


def in_fresh_process(what: str) -> Any:
    """Return what one of the functions above finds in a process of its own, with an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "POINTRAY_CACHE": folder, "POINTRAY_CHECK": "", "POINTRAY_KERNELS": "jit"}
        command = [sys.executable, __file__, what]
        return json.loads(subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True).stdout)


def rounded(kernels: dict[str, float], pace: float) -> dict[str, float]:
    """Names without the package's, and seconds of a typical core to a tenth, at least one."""
    return {name.removeprefix(f"{warmup.PACKAGE}."): max(0.1, round(took * pace, 1)) for name, took in kernels.items()}


def main() -> None:
    paces = [pace()]
    rows = in_fresh_process("first_start")
    paces.append(pace())
    other = in_fresh_process("other_start")
    speed = statistics.median([*paces, pace()])
    rows["build"] = {name: rows["normals"].pop(name) for name in list(rows["normals"]) if name in other}
    shared = rows["rays"][CLICK] - other[CLICK]
    rows["rays"][CLICK] = other[CLICK]
    found = {**{stage: rounded(kernels, speed) for stage, kernels in rows.items()}, "shared": round(shared * speed, 1)}
    FILE.write_text(json.dumps(found, indent=1) + "\n")
    print(FILE.read_text())


if __name__ == "__main__":
    if sys.argv[1:]:
        print(json.dumps({"first_start": first_start, "other_start": other_start}[sys.argv[1]]()))
    else:
        main()
