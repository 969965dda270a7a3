"""A child of `view.py`: opens a model in parts and renders pictures of it.

    python -m bench.scale.pictures FOLDER MEMORY BEGUN CAMERAS PICTURE

CAMERAS is a JSON file; the first picture is written to a PNG. BEGUN is the start time of the process (`time.time`).
Prints JSON. It imports no more than a user's script would.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pointray as pr

LIGHTS = (-0.6, 0.5, -1.0), 0.4  # the direction of the sun's light, the sky's


def lit(model: pr.Model) -> pr.Scene:
    """A model under a sun and a sky."""
    scene = pr.Scene()
    scene.add(model)
    scene.lights = [pr.SunLight(LIGHTS[0]), pr.EnvironmentLight(LIGHTS[1])]
    return scene


def show(folder: str, memory: int, begun: float, cameras: Sequence[pr.Camera], picture: str) -> dict[str, Any]:
    """What a child measures. begun : when it was started, as `time.time` counts"""
    model = pr.Model.load(folder, memory=memory)
    scene = lit(model)
    opened = time.time() - begun
    pr.write_image(picture, pr.render(scene, cameras[0]))
    first, spent = time.time() - begun, []
    for camera in cameras[1:]:
        at = time.perf_counter()
        pr.render(scene, camera)
        spent.append(time.perf_counter() - at)
    found = {"opened": opened, "first": first, "frames": spent, "resident": model.resident_bytes}
    return {**found, "moving": moving(scene, cameras[1:])}


def moving(scene: pr.Scene, cameras: Sequence[pr.Camera]) -> list[tuple[float, float]]:
    """Seconds of each picture, and the share of its width that has pixels, as the viewer draws while it moves."""
    from pointray.viewer.pace import Pace

    pace, spent = Pace(), []
    for camera in cameras:
        scale, at = pace.scale(), time.perf_counter()
        pr.render(scene, replace(camera, size=tuple(round(edge * scale) for edge in camera.size)))
        spent.append((time.perf_counter() - at, scale))
        pace.record(*spent[-1])
    return spent


def main() -> None:
    folder, memory, begun, cameras, picture = sys.argv[1:]
    views = [pr.Camera(**one) for one in json.loads(Path(cameras).read_text())]
    print(json.dumps(show(folder, int(memory), float(begun), views, picture)))


if __name__ == "__main__":
    main()
