"""Compare a path-traced picture under 5,000 lights with one under 50, and measure the cost of adding lights.

    python -m bench.light.lights [--size 160x120] [--spp 16] [--runs 5] [--counts 50,5000]

The scene is a sphere on a floor under lights of a fixed total power: points; lamps of a fixed total area, a third of
each kind; or suns. Runs alternate. Times are medians, and ratios are medians of the ratios of neighbouring runs.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import pointray as pr


def points(count: int, rng: np.random.Generator) -> list[Any]:
    """Point lights of unlike power."""
    return [
        pr.PointLight(x, power / count)
        for x, power in zip(_positions(count, rng), rng.lognormal(4, 1, count), strict=True)
    ]


def lamps(count: int, rng: np.random.Generator) -> list[Any]:
    """Spheres, disks and rectangles, each as large as its share of the area."""
    edge = 2.0 / count**0.5
    kinds: list[Callable[[Any], Any]] = [
        lambda x: pr.SphereLight(x, edge / 2, 5),
        lambda x: pr.DiskLight(x, (*rng.normal(0, 0.4, 2), -1), edge / 2, 5),
        lambda x: pr.RectLight(x, (edge / 2, 0, 0), (0, -edge / 2, edge / 4), 5),
    ]
    return [kinds[k % 3](x) for k, x in enumerate(_positions(count, rng))]


def suns(count: int, rng: np.random.Generator) -> list[Any]:
    """Suns, half a degree wide, all over the upper half of the sky."""
    return [pr.SunLight((*rng.normal(0, 1, 2), -abs(rng.normal(0, 1)) - 0.1), 3.0 / count) for _ in range(count)]


def _positions(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform((-6, -6, 2), (6, 6, 5), (count, 3))


def scene_of(lights: list[Any], model: pr.Model) -> tuple[pr.Scene, float, float]:
    """A scene, the seconds to add its lights, and those to build what rays need."""
    scene = pr.Scene()
    scene.add(model)
    scene.add(pr.Plane((0, 0, -1), (0, 0, 1), 0.6), material=pr.Phong(specular=0.3, exponent=40))
    begun = time.perf_counter()
    for light in lights:
        scene.add_light(light)
    added = time.perf_counter()
    scene.snapshot()
    return scene, added - begun, time.perf_counter() - added


def seconds(scene: pr.Scene, camera: pr.Camera, settings: pr.Settings) -> float:
    """Seconds of one picture."""
    begun = time.perf_counter()
    pr.render(scene, camera, settings)
    return time.perf_counter() - begun


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="160x120")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--counts", default="50,5000", help="numbers of lights; the first is the reference")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    counts = [int(count) for count in options.counts.split(",")]
    camera = pr.Camera.look_at((0, -7, 3), (0, 0, 0), fov=45, size=(width, height))
    settings = pr.Settings("path", spp=options.spp, max_depth=4)
    model = pr.Model(pr.procedural("sphere", 20_000))
    print(f"path, {width}x{height}, {options.spp} samples, {options.runs} runs")
    print(f"{'lights':>18} {'add, s':>8} {'build, s':>8} {'picture, s':>10} {'ratio':>6}")
    for make in (points, lamps, suns):
        made = [scene_of(make(count, np.random.default_rng(1)), model) for count in counts]
        seconds(made[0][0], camera, settings)  # compiles
        times = [[seconds(scene, camera, settings) for scene, _, _ in made] for _ in range(options.runs)]
        for k, count in enumerate(counts):
            ratio = statistics.median(run[k] / run[0] for run in times)
            spent = statistics.median(run[k] for run in times)
            print(f"{count:>11} {make.__name__:<6} {made[k][1]:8.3f} {made[k][2]:8.3f} {spent:10.3f} {ratio:6.2f}")


if __name__ == "__main__":
    main()
