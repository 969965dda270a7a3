"""Compare baked light with formulas and with itself: exact shapes, leaks, sums of lights, moved scenes and lights."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

import pointray as pr
from bench.light.bake_rows import Options, Row, at_most, plain_row
from bench.light.bake_scenes import (
    ALBEDO,
    Floats,
    Known,
    above_floor,
    ball_on_sheet,
    ball_shade,
    before_wall,
    dark_box,
    lit_sphere,
    single_sheet,
    statue_room,
    wall_shade,
)
from pointray.engine.kernels.vec import LUMINANCE

LIMIT = 1.25  # times the noise: a plane in another direction has another grid, too
OTHER = 1000  # a seed
SUN_MOVED = pr.SunLight((1.0, 0.5, -0.8), (2.2, 2.0, 1.8))


def luminances(light: np.ndarray) -> Floats:
    """Luminances of colours, (n, 3) or (h, w, 3)."""
    return np.asarray(light[..., :3] @ np.array(LUMINANCE))


def rms_difference(a: np.ndarray, b: np.ndarray) -> float:
    """The root mean square difference of light at points, as a share of the mean of b."""
    a, b = luminances(a), luminances(b)
    known = np.isfinite(a) & np.isfinite(b)
    return float(np.sqrt(np.mean((a - b)[known] ** 2)) / b[known].mean())


def in_sphere(options: Options) -> list[Row]:
    """All bounces within a sphere: the light is the same everywhere; what bounces is so for any place of the lamp."""
    known, exact = lit_sphere(options.few), 1.0 / (1.0 - ALBEDO)
    light = [_within(known, seed) / exact for seed in options.chances]
    known.scene.lights = [pr.PointLight((0.5, 0.0, 0.0), 1.0)]
    beside = [_within(known, seed, bounced=True) / (ALBEDO * exact) for seed in options.chances]
    what = f"inside of a sphere, albedo {ALBEDO}, {options.few:,} points: "
    aside = max(abs(float(seen.mean()) - 1.0) for seen in beside)
    return [
        at_most(what + "mean off", max(abs(float(seen.mean()) - 1.0) for seen in light), 0.01),
        at_most(what + "deviation", max(float(seen.std() / seen.mean()) for seen in light), 0.01),
        plain_row(
            what + "lamp aside, bounced", f"{aside:.2%} off, deviation {max(float(seen.std()) for seen in beside):.2%}"
        ),
    ]


def _within(known: Known, seed: int, bounced: bool = False) -> np.ndarray:
    """The light at the inside of a sphere, or what has bounced of it, (n,)."""
    baked = pr.bake(known.scene, pr.BakeSettings(seed=seed))
    light = baked.indirect if bounced else baked.irradiance
    return np.asarray(light(known.id, side=-1)[:, 0])


def _shade(known: Known, formula: Callable[[Floats], Floats], seeds: list[int]) -> tuple[float, float, float]:
    """Return errors of the ambient occlusion: RMS, maximum beyond two spacings, and its position."""
    rms, worst, where = 0.0, 0.0, 0.0
    at = np.isfinite(known.at)
    d = known.at[at]
    for seed in seeds:
        seen = pr.bake(known.scene, pr.BakeSettings(seed=seed)).ambient_occlusion(known.id)[at]
        off = np.abs(seen - formula(d))
        rms = max(rms, float(np.sqrt(np.mean(off**2))))
        beyond = np.where(d > 2 * known.spacing, off, 0.0)
        if beyond.max() > worst:
            worst, where = float(beyond.max()), float(d[beyond.argmax()] / known.spacing)
    return rms, worst, where


def below_ball(options: Options) -> list[Row]:
    """The sky below a ball that rests on a sheet."""
    rms, worst, where = _shade(ball_on_sheet(options.few), ball_shade, options.chances)
    what = f"sheet below a ball, {options.few:,} points: sky seen, "
    return [
        at_most(what + "RMS", rms, 0.015),
        at_most(what + "worst past 2 spacings", worst, 0.05, note=f" ({where:.1f} spacings from the contact)"),
    ]


def at_wall(options: Options) -> list[Row]:
    """The sky before a long wall."""
    rms, worst, where = _shade(before_wall(options.few), wall_shade, options.chances)
    what = f"sheet before a long wall, {options.few:,} points: sky seen, "
    return [
        at_most(what + "RMS", rms, 0.015),
        plain_row(what + "worst past 2 spacings", f"{worst:.2%} ({where:.1f} spacings from the wall)"),
    ]


def moved_sun(options: Options) -> list[Row]:
    """Compare `Baked.update` after the sun has moved with a new bake."""
    patches = options.points // 4
    settings = pr.BakeSettings(patches=patches)
    scene = statue_room(options.points, "sky sun")
    sky = scene.lights[0]
    baked = pr.bake(scene, settings)
    spent = []
    for light in (SUN_MOVED, scene.lights[1], SUN_MOVED):
        scene.lights = (sky, light)
        begun = time.perf_counter()
        baked.update()
        spent.append(time.perf_counter() - begun)
    some = above_floor(options.points)
    updated = baked.irradiance(0)[some]
    fresh, other = (
        pr.bake(scene, pr.BakeSettings(patches=patches, seed=seed)).irradiance(0)[some]
        for seed in (settings.seed, OTHER)
    )
    off, noise = (_mean_difference(light, fresh) for light in (updated, other))
    what = f"a sun moved, {patches:,} patches: "
    seconds = float(np.median(spent))
    return [
        at_most(what + "update, s", seconds, options.scaled(0.7), "{:.2f}", aim=" (0.7 for 250,000)"),
        at_most(what + "off a fresh bake", off, 0.01, note=f" (two fresh bakes, other seeds: {noise:.2%})"),
    ]


def _mean_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Mean absolute difference at points, each as a share of the light there."""
    a, b = luminances(a), luminances(b)
    some = np.isfinite(b) & (b > 1e-3 * np.nanmean(b))
    return float(np.mean(np.abs(a - b)[some] / b[some]))


def leaks(options: Options) -> list[Row]:
    """Light within a closed box, and on the dark side of a lone sheet."""
    return [*_box_leaks(options), *_sheet_leaks(options)]


def _box_leaks(options: Options) -> list[Row]:
    known = dark_box(options.few)
    shares, farthest, shown = [], [], []
    room = pr.Camera.look_at((0, -4, 2), (4, 5, -6), size=(96, 96))
    inside = pr.Camera.look_at((0, 0, 0), (0.7, 0.4, -0.3), fov=90, size=(96, 96))
    for seed in options.chances:
        baked = pr.bake(known.scene, pr.BakeSettings(seed=seed))
        light = luminances(baked.irradiance(known.id))
        outside = float(light[known.at > 0].mean())
        shares.append(float(np.nanmean(light[known.at < 0])) / outside)
        farthest.append(float(np.nanmax(light[known.at < 0])) / outside)
        known.scene.baked = baked
        pictures = [pr.render(known.scene, c, pr.Settings("baked", spp=16)) for c in (inside, room)]
        shown.append(float(luminances(pictures[0]).mean() / luminances(pictures[1]).mean()))
    path = [pr.render(known.scene, c, pr.Settings("path", spp=64, max_depth=None)) for c in (inside, room)]
    real = luminances(path[0]).mean() / luminances(path[1]).mean()
    what = f"closed dark box in a bright room, {options.few:,} points: "
    return [
        at_most(what + "light inside", max(shares), 0.001, "{:.3%}", note=f" (brightest splat {max(farthest):.3%})"),
        at_most(what + "in pictures", max(shown), 0.001, "{:.3%}", note=f" (paths: {real:.3%})"),
    ]


def _sheet_leaks(options: Options) -> list[Row]:
    """The dark side alone; then with a lamp behind, so that it is baked, minus the lamp's own light."""
    known = single_sheet(options.few)
    sun, lamp = known.scene.lights[0], pr.PointLight((0.2, 0.1, -1.5), 0.3)
    middle = np.isfinite(known.at)
    alone, beside = [], []
    for seed in options.chances:
        back = []
        for lights in ((sun,), (sun, lamp), (lamp,)):
            known.scene.lights = lights
            baked = pr.bake(known.scene, pr.BakeSettings(seed=seed))
            back.append(luminances(baked.irradiance(known.id, side=-1))[middle])
            if lights == (sun,):
                front = float(luminances(baked.irradiance(known.id))[middle].mean())
        alone.append(float(back[0].max()) / front)
        beside.append(float(np.abs(back[1] - back[2]).max()) / front)
    what = f"dark side of a lone sheet, {options.few:,} points: "
    return [
        at_most(what + "brightest splat", max(alone), 0.005, "{:.3%}"),
        at_most(what + "back lit, too", max(beside), 0.005, "{:.3%}"),
    ]


def sums(options: Options) -> list[Row]:
    """Compare light of two lights with the sum of both; and with the scene rotated, scaled and moved."""
    points, what = options.few, f"statue, {options.few:,} points: "
    some = above_floor(points)

    def light(
        lights: str = "sky lamp sun", seed: int = 0, matrix: Floats | None = None, floor: str = "plane"
    ) -> np.ndarray:
        scene = statue_room(points, lights, matrix, floor=floor)
        return pr.bake(scene, pr.BakeSettings(seed=seed)).irradiance(0)[some]

    base = light()
    noise = rms_difference(light(seed=OTHER), base)
    beside = f" (two seeds: {noise:.2%})"
    parts = light("sun") + light("sky lamp")
    rows = [at_most(what + "bake(A) + bake(B) - bake(A + B)", rms_difference(parts, base), noise, note=beside)]
    far, turn = pr.transform(translate=(5e6, -5e6, 5e6)), {"rotate": 77.0, "axis": (1, -2, 3)}
    moves = {
        "turned": pr.transform(**turn),
        "scaled by 1000": pr.transform(scale=1000.0),
        "moved by 5e6": far,
        "all three": far @ pr.transform(**turn, scale=1000.0),
    }
    for name, matrix in moves.items():
        off = rms_difference(light(matrix=matrix), base)
        rows.append(at_most(what + name, off, LIMIT * noise, note=beside))
    sheeted = light(floor="points"), light(matrix=far, floor="points")
    rows.append(at_most(what + "moved by 5e6, floor of points", rms_difference(*sheeted), LIMIT * noise, note=beside))
    return rows
