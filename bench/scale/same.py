"""Stage `same` of `scale.py`: one scan whole and in parts; hits, frame times, and bytes."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import pointray as pr
from bench.scale.pictures import lit
from bench.scale.prepare import SURFACE, Options, asked, command_of, parts_in
from bench.scale.rows import MOST, Row
from bench.scale.watch import disk_of, watched

PARTS = 8, 64
APART, SLOWER, LARGER = 1e-5, 1.3, 1.15  # asked: share of hits, ratios of the time of a frame and of bytes
SETTINGS = pr.Settings(levels=False)


def part_size(points: int, parts: int) -> int:
    """The largest power of two of points a part that yields at least this number of parts."""
    return 1 << (max(points // parts, 1).bit_length() - 1)


def bytes_of_model(path: Path) -> int:
    """Bytes of a saved model, or of the files of a model in parts without those of levels."""
    if path.is_file():
        return path.stat().st_size
    return sum(file.stat().st_size for file in path.glob("*.pointray") if len(file.stem.split("-")) < 3)


def made(options: Options) -> dict[int, Path]:
    """Return the scan whole (1) and in parts, by the requested number; each is prepared in a separate process."""
    whole = options.there / "whole.pointray"
    if not whole.exists():
        watched(["-m", "pointray", "prepare", *options.tiles(), "-o", whole, "--no-levels", *SURFACE])
    models = {1: whole}
    for count in PARTS:
        models[count] = options.there / f"in-{count}.pointray"
        if not (models[count] / "index.json").exists():
            shutil.rmtree(models[count], ignore_errors=True)
            sized = replace(options, part_points=part_size(options.city.points, count))
            watched(command_of(sized, models[count]))
    return models


def same(options: Options) -> list[Row]:
    """Compare."""
    paths = made(options)
    cameras = [options.city.far(options.size), options.city.near(options.size), *options.city.flight(4, options.size)]
    scenes = {count: lit(pr.Model.load(path)) for count, path in paths.items()}
    times = frame_times(scenes, cameras, options.runs)
    each = sum(times[1]) / len(cameras)
    whole = options.row("same.whole.frame", each, "s", "a frame of the whole, without levels, mean of the views")
    return [whole, *(row for count in PARTS for row in _rows_of(options, count, (paths, scenes, times, cameras)))]


def frame_times(scenes: dict[int, pr.Scene], cameras: list[pr.Camera], runs: int) -> dict[int, list[float]]:
    """Least seconds of a frame of each camera, for each scene. Scenes take turns, so that all meet the same weather."""
    least = {count: [np.inf] * len(cameras) for count in scenes}
    for k, camera in enumerate(cameras):
        for _ in range(runs + 1):
            for count, scene in scenes.items():
                begun = time.perf_counter()
                pr.render(scene, camera, SETTINGS)
                least[count][k] = min(least[count][k], time.perf_counter() - begun)
    return least


def compared(one: pr.Scene, other: pr.Scene, cameras: list[pr.Camera]) -> tuple[int, int, int]:
    """(rays, those that hit something in the first, those with other bits of t in the second)."""
    rays, hit, apart = 0, 0, 0
    for camera in cameras:
        a, b = (scene.intersect(*camera.rays()).t for scene in (one, other))
        rays, hit, apart = rays + a.size, hit + int(np.isfinite(a).sum()), apart + int((a != b).sum())
    return rays, hit, apart


Measured = tuple[dict[int, Path], dict[int, pr.Scene], dict[int, list[float]], list[pr.Camera]]


def _rows_of(options: Options, count: int, measured: Measured) -> Iterator[Row]:
    paths, scenes, times, cameras = measured
    rays, hit, apart = compared(scenes[1], scenes[count], cameras)
    name, row = f"same.{count}", options.row
    yield row(f"{name}.parts", parts_in(paths[count]), "", f"parts, {count} requested")
    yield row(f"{name}.rays", rays, "", f"rays, of which {hit:,} hit the whole")
    yield asked(row(f"{name}.apart", 1e5 * apart / max(hit, 1), "in 100,000", "hits with another t"), MOST, 1e5 * APART)
    ratio = sum(times[count]) / sum(times[1])
    yield asked(row(f"{name}.frame", ratio, "", "time of a frame, of the whole's"), MOST, SLOWER)
    worst = max(a / b for a, b in zip(times[count], times[1], strict=True))
    yield row(f"{name}.worst", worst, "", "the same, of the worst of the views")
    larger = bytes_of_model(paths[count]) / bytes_of_model(paths[1])
    yield asked(row(f"{name}.bytes", larger, "", "bytes of files, of the whole's, both without levels"), MOST, LARGER)
    each = disk_of(paths[count]) / options.city.points
    yield row(f"{name}.disk", each, "bytes/point", "on the disk, with levels")
