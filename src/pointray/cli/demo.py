"""pointray demo: renders the embedded statue and times each stage."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..engine.jit import compilations, compile_seconds, thread_count
from ..image import write_image
from ..model.model import Model
from ..procedural_models import procedural
from ..rendering.camera import Camera
from ..rendering.picture import render
from ..rendering.settings import Settings
from ..scene.instances import Plane
from ..scene.scene import Scene
from ..shade.lights import SunLight
from ..shade.materials.phong import Phong

GROUND = (0.42, 0.44, 0.47)
SKY = (0.62, 0.72, 0.84)


def statue_scene(model: Model) -> Scene:
    """Return a scene with the statue on a checkered ground plane, under a sun and a weaker second one."""
    scene = Scene()
    scene.add(model, material=Phong(specular=0.04, exponent=40))
    scene.add(Plane((0, 0, float(model.bounds[0, 2])), (0, 0, 1), color=GROUND, checker=0.5))
    scene.add_light(SunLight((0.9, 1.0, -1.15), (3.6, 3.45, 3.2)))
    scene.add_light(SunLight((-1.0, 0.6, -0.25), (0.35, 0.4, 0.5)))
    scene.background = SKY
    return scene


def statue_camera(model: Model, size: tuple[int, int]) -> Camera:
    """Return a camera in front of the statue, slightly to its left."""
    return Camera.frame(model.bounds, (0.32, -1.0, 0.16), fov=30, size=size)


class Clock:
    """A progress callback that measures the seconds of each stage, without those in which kernels were compiled.

    Parameters
    ----------
    show : callable
        Progress callback that is called too.

    Attributes
    ----------
    seconds : dict of str to float
        Duration of each stage by name.
    """

    def __init__(self, show: Callable[[str, float], None]) -> None:
        self.seconds: dict[str, float] = {}
        self._show, self._stage, self._since = show, "", self._now()

    @staticmethod
    def _now() -> float:
        return time.perf_counter() - compile_seconds()

    def __call__(self, stage: str, share: float) -> None:
        """Add the time since the last call to the stage that the last call named; begin or continue `stage`.

        share : completed fraction of the stage, passed on
        """
        now = self._now()
        if self._stage:
            self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._since
        self._stage, self._since = stage, now
        self._show(stage, share)


def run_demo(
    path: Path, count: int, size: tuple[int, int], frames: int, threads: int | None, show: Callable[[str, float], None]
) -> dict[str, Any]:
    """Generate a statue, build its model, write an image of it, and measure the time of each.

    Parameters
    ----------
    path : Path
        The image.
    count : int
        Number of points.
    size : (int, int)
        Width and height of the image.
    frames : int
        Number of timed frames.
    show : callable
        Called with the stage's name and the share done.

    Returns
    -------
    dict
        Table for the user: times, frame rate, rays per second, bytes per point. Counted rays are one camera ray per
        pixel, and one shadow ray per light and covered pixel.
    """
    clock = Clock(show)
    clock("points", 0.0)
    points = procedural("statue", count)
    model = Model(points, progress=clock)
    scene, camera = statue_scene(model), statue_camera(model, size)
    settings = Settings(threads=threads)
    clock("first frame", 0.0)
    write_image(path, render(scene, camera, settings))
    compiled, compiling = compilations(), compile_seconds()
    times = []
    for frame in range(frames):
        clock("frames", frame / frames)
        start = time.perf_counter()
        image = render(scene, camera, settings)
        times.append(time.perf_counter() - start)
    clock("", 1.0)
    # The background gives every pixel alpha 1, so covered pixels are counted in an image of depths.
    covered = int((render(scene, camera, Settings("depth", threads=threads))[..., 0] != scene_sky(scene)).sum())
    median = statistics.median(times)
    rays = image.shape[0] * image.shape[1] + 2 * covered
    return {
        "points": count,
        "picture": f"{path}, {size[0]}x{size[1]}, {thread_count(threads)} threads",
        "seconds_for_points": clock.seconds["points"],
        "seconds_for_radii": clock.seconds["radii"],
        "seconds_for_tree": clock.seconds["tree"],
        "seconds_for_compilation": compiling,
        "seconds_for_first_frame": clock.seconds["first frame"],
        "kernels_compiled": compiled,
        "median_frame_ms": 1e3 * median,
        "frames_per_second": 1 / median,
        "million_rays_per_second": rays / median / 1e6,
        "bytes_per_point": model.nbytes / count,
    }


def scene_sky(scene: Scene) -> float:
    """Return the value of a pixel that shows the background in an image of depths: the red of the background colour."""
    color = scene.background
    return 0.0 if color is None else float(color[0])
