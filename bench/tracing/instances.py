"""Measure many instances of one model, the paper's 24 statues and 10,000 of them: moves, memory and levels of detail.

    python -m bench.tracing.instances [--points 1000000] [--size 640x480] [--frames 9]

Frames are shaded by Phong with one light and a shadow ray a pixel. The camera distance is such that the statues always
fill the same part of the picture. Flicker is the mean change of pixels from frame to frame while the camera moves
slowly, relative to that with all points. The part due to the motion itself is the change between pictures of 32 samples
a pixel.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import time
from collections.abc import Callable

import numpy as np

import pointray as pr

TURN = 37.0  # degrees from one statue to the next
APART = 2.2
PACES = (6, 24, 96)  # frames that the camera takes to move by a pixel


def statue_transform(k: int, across: int) -> np.ndarray:
    """Transform of statue k of a grid. Statues are turned, differ in height, and some are mirrored."""
    angle = np.radians(TURN * k)
    size = 0.85 + 0.3 * ((k * 7) % 10) / 10
    c, s = size * np.cos(angle), size * np.sin(angle)
    flip = -1.0 if k % 5 == 0 else 1.0
    x, y = APART * (k % across), APART * (k // across)
    return np.array([[c * flip, -s, 0, x], [s * flip, c, 0, y], [0, 0, size, 0], [0, 0, 0, 1]])


def grid(model: pr.Model, count: int) -> tuple[pr.Scene, float]:
    """A scene of statues on a plane under a sun, and the seconds to build it."""
    scene, across = pr.Scene(), int(np.ceil(np.sqrt(count * 1.5)))
    begun = time.perf_counter()
    for k in range(count):
        scene.add(model, statue_transform(k, across))
    scene.snapshot()
    spent = time.perf_counter() - begun
    scene.add(pr.Plane((0, 0, model.bounds[0, 2]), (0, 0, 1), 0.6))
    scene.add_light(pr.SunLight((0.5, 0.7, -1), 3))
    scene.background = (0.7, 0.8, 0.9)
    return scene, spent


def camera_of(scene: pr.Scene, size: tuple[int, int], step: float = 0.0) -> pr.Camera:
    """A camera from above, so that any number of statues fills the picture; moved by `step` pixels."""
    low, high = scene.bounds
    wide = high - low
    middle = np.array([*(low + high)[:2] / 2, low[2]])
    distance = 0.55 * wide[0] / np.tan(np.radians(20)) * size[1] / size[0]
    eye = middle + distance * np.array([0.25, -0.55, 0.8])
    shift = step * distance * 2 * np.tan(np.radians(20)) / size[1]
    return pr.Camera.look_at(eye + (shift, shift / 2, 0), middle + (shift, shift / 2, 0), size=size)


def median_ms(work: Callable[[], object], times: int) -> float:
    """Median of the milliseconds of a frame, without the first."""
    work()
    spent = []
    for _ in range(times):
        begun = time.perf_counter()
        work()
        spent.append(time.perf_counter() - begun)
    return 1e3 * statistics.median(spent)


def change(scene: pr.Scene, size: tuple[int, int], settings: pr.Settings, pace: int) -> float:
    """Mean change of a pixel from frame to frame while the camera moves by one pixel in `pace` frames."""
    images = [np.clip(pr.render(scene, camera_of(scene, size, k / pace), settings), 0, 1) for k in range(5)]
    return float(np.mean([np.abs(a - b)[..., :3].mean() for a, b in zip(images, images[1:], strict=False)]))


def report(model: pr.Model, count: int, size: tuple[int, int], frames: int) -> None:
    """Print one row: with and without levels of detail."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    scene, spent = grid(model, count)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 / count
    camera = camera_of(scene, size)
    hit = float(np.mean(scene.intersect(*camera.rays()).point >= 0))
    rates = [1e3 / median_ms(lambda s=s: pr.render(scene, camera, s), frames) for s in both()]
    moved = median_ms(lambda: (scene.update(1, statue_transform(1, 7)), scene.snapshot()), 20)
    print(
        f"{count:6,} instances: {rates[0]:5.1f} fps, with levels {rates[1]:5.1f}; statues in {hit:.0%} of the pixels; "
        f"made in {spent:.2f} s, one moved in {moved:.1f} ms; resident {max(grown, 0):.0f} bytes each",
        flush=True,
    )
    for pace in PACES:
        whole, levels = (change(scene, size, s, pace) for s in both())
        motion = change(scene, size, pr.Settings(spp=32, levels=False), pace)
        print(
            f"    1/{pace} pixel a frame: change {whole:.5f}, with levels {levels / whole:.2f} of it, "
            f"the motion itself {motion / whole:.2f}",
            flush=True,
        )


def both() -> tuple[pr.Settings, pr.Settings]:
    """Without and with levels."""
    return pr.Settings(levels=False), pr.Settings()


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--frames", type=int, default=9)
    options = parser.parse_args()
    width, height = (int(n) for n in options.size.split("x"))
    model = pr.Model(pr.procedural("statue", options.points))
    begun = time.perf_counter()
    model.make_levels()
    counts = ", ".join(f"{len(level.points):,}" for level in model.levels)
    print(f"levels of {counts} points in {time.perf_counter() - begun:.1f} s")
    for count in (24, 1000, 10_000):
        report(model, count, (width, height), options.frames)


if __name__ == "__main__":
    main()
