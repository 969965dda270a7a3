"""The time of a bake compared with paths at the same places; the time of frames with baked light."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

import pointray as pr
from bench.light.bake_exact import luminances
from bench.light.bake_gather import Places, gather, places_of_patches, rms_error
from bench.light.bake_rows import Options, Row, at_least, at_most, plain_row
from bench.light.bake_scenes import statue_room
from pointray.cli.benchmark.views import far_view

PLACES, QUICK_PLACES = 4096, 2048
SAMPLES, QUICK_SAMPLES = 8192, 1024  # paths of each of the two references at each place
FEWER = (16, 64, 256)  # paths whose error is measured
SMALL = 5000  # points of a scene that only makes kernels ready
ALBEDO = np.array((0.7, 0.6, 0.5))  # of the statue
SIZE, FRAMES = (400, 600), 15


def baking(options: Options) -> list[Row]:
    """Seconds of a bake, and how long whole paths take to the same error.

    The error is that of all light at patches of the statue, root mean square, as a share of its mean; also the median,
    which a few patches next to the floor do not decide. Paths are timed at some of the patches, with as many samples as
    lead to the same error, and the time is scaled to the number of patches.
    """
    pr.bake(statue_room(SMALL))
    scene = statue_room(options.points)
    begun = time.perf_counter()
    baked = pr.bake(scene)
    spent = time.perf_counter() - begun
    patches, arrived = len(baked._exchange.transport), baked._exchange.arrived
    places = places_of_patches(scene, baked, QUICK_PLACES if options.quick else PLACES)
    samples = QUICK_SAMPLES if options.quick else SAMPLES
    first, second = (_irradiance(scene, places, samples, seed) for seed in (1, 2))
    light = luminances(arrived.direct + arrived.indirect)[places.rows]
    errors, cost = [_errors(light, first, second)], 0.0
    for count in FEWER:
        begun = time.perf_counter()
        light = _irradiance(scene, places, count, seed=3)
        cost = (time.perf_counter() - begun) / (count * len(places))
        errors.append(_errors(light, first, second))
    needed = [_samples_for(mine, theirs) for mine, *theirs in zip(*errors, strict=True)]
    times = [count * cost * patches / spent for count in needed]
    what = f"bake of {options.points:,} points, {patches:,} patches: "
    notes = [f" ({error:.2%}: {count:.0f} paths)" for error, count in zip(errors[0], needed, strict=True)]
    return [
        at_most(what + "s", spent, options.scaled(30.0), "{:.1f}", aim=" (30 a million, aim 15)"),
        at_least(what + "times faster than paths, RMS", times[0], 4.0, "{:.1f}", notes[0]),
        plain_row(what + "the same, median", f"{times[1]:.1f}{notes[1]}, {1e-6 / cost:.2f} M paths/s"),
    ]


def _errors(light: np.ndarray, first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Root mean square and median error, as shares of the mean. first, second : two references"""
    exact = (first + second) / 2
    return rms_error(light, first, second), float(np.median(np.abs(light - exact)) / exact.mean())


def _samples_for(error: float, errors: Sequence[float]) -> float:
    """The samples that lead to an error, between or beyond those of FEWER."""
    slope, start = np.polyfit(np.log(FEWER), np.log(errors), 1)
    return float(np.exp((np.log(error) - start) / slope))


def _irradiance(scene: pr.Scene, places: Places, samples: int, seed: int) -> np.ndarray:
    """All light that arrives at places, by paths: luminance, (n,)."""
    return luminances(gather(scene, places, samples, seed) * np.pi / ALBEDO)


def alternate(calls: Mapping[str, Callable[[], object]], runs: int) -> dict[str, float]:
    """Median seconds of each call, run in turn."""
    for call in calls.values():
        call()
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(runs):
        for name, call in calls.items():
            begun = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - begun)
    return {name: statistics.median(values) for name, values in times.items()}


def frames(options: Options) -> list[Row]:
    """Frames of the statue on its floor under a sun and a sky, one shadow ray a pixel, with baked light and without."""
    rows, start = [], f"frame {SIZE[0]}x{SIZE[1]}, {options.points:,} points, Phong "
    for exponent, most in ((8.0, 1.3), (100.0, 2.5)):
        seconds = _seconds_of_frames(options.points, exponent)
        rate = f" (phong {1 / seconds['phong']:.1f})"
        what = f"{start}{exponent:.0f}: "
        if exponent == 8.0:
            rows.append(at_least(what + "a second", 1 / seconds["baked"], 30.0, "{:.1f}", rate, " (aim 60)"))
        else:
            rows.append(plain_row(what + "live reflections, a second", f"{1 / seconds['baked']:.1f}{rate}"))
        rows.append(at_most(what + "times as long", seconds["baked"] / seconds["phong"], most, "{:.2f}"))
    return rows


def _seconds_of_frames(points: int, exponent: float) -> dict[str, float]:
    material = pr.Phong((0.7, 0.6, 0.5), specular=0.3, exponent=exponent)
    scene = statue_room(points, "sky sun", material=material)
    scene.baked = pr.bake(scene)
    camera = far_view(scene.models[0].points, scene.bounds, SIZE)
    calls = {name: partial(pr.render, scene, camera, pr.Settings(name)) for name in ("phong", "baked")}
    return alternate(calls, FRAMES)
