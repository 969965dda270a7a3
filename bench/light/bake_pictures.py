"""Pictures with baked light compared with path tracing: indirect light on matt surfaces, and in highlights."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy.ndimage import binary_erosion

import pointray as pr
from bench.light.bake_reference import Errors, Picture, Reference, baked_light, compare, indirect_light
from bench.light.bake_rows import Options, Row, at_least, at_most, plain_row
from bench.light.bake_scenes import statue_room
from pointray.image.tone import linear_to_srgb

NOISE, QUICK_NOISE = 0.005, 0.015  # of the references
SIZE, QUICK_SIZE = (128, 128), (64, 64)
FRAMES, QUICK_FRAMES = 16, 3
GLOSS_SIZE, QUICK_GLOSS_SIZE = (96, 96), (48, 48)
GLOSS_NOISE = 0.01
SETTLED = 1024  # samples of a highlight that leave little noise: fewer show that of the samples
FULL_COLOR = 0.2  # error, as a share of the mean, that pictures of errors show in full colour
WHITE = 2.5  # times the mean: what pictures show white
LION, BUNNY = "points/potree_lion_takanawa_rgb.ply", "points/stanford_bunny.ply"


class Subject(NamedTuple):
    """A scene and the cameras that look at it, which the baker does not know."""

    name: str
    scene: pr.Scene
    cameras: list[pr.Camera]


def around(low: np.ndarray, high: np.ndarray, up: int, size: tuple[int, int]) -> list[pr.Camera]:
    """Three views of a box: two of all of it, a third from near. up : the axis"""
    middle, wide = (low + high) / 2, float(np.linalg.norm(high - low))
    cameras = []
    for angle, height, share in ((-60.0, 0.35, 1.25), (15.0, 0.6, 1.25), (-85.0, 0.1, 0.6)):
        a = np.radians(angle)
        towards = np.roll(np.array([np.cos(a), np.sin(a), height]), up - 2)
        cameras.append(pr.Camera.look_at(middle + share * wide * towards, middle, np.eye(3)[up], size=size))
    return cameras


def subjects(options: Options) -> Iterator[Subject | Row]:
    """The scenes; for missing scans a row that names the file."""
    size = QUICK_SIZE if options.quick else SIZE
    scene = statue_room(options.points, "sky sun", wall=True)
    low, high = scene.bounds
    yield Subject("statue", scene, around(low, high, 2, size))
    for name, path, make in (("bunny in a box", BUNNY, bunny_box), ("lion", LION, lion_outside)):
        if (options.models / path).exists():
            yield make(name, _scan(options.models / path, options.points), size)
        else:
            yield plain_row(f"{name}: indirect light in pictures", f"skipped: no {path} in {options.models}")


@cache
def _scan(path: Path, most: int) -> pr.Model:
    """A scan, or a random sample of a larger one."""
    points = pr.read(path)
    if len(points) > most:
        points = points.select(np.sort(np.random.default_rng(0).permutation(len(points))[:most]))
    return pr.Model(points)


def bunny_box(name: str, model: pr.Model, size: tuple[int, int]) -> Subject:
    """The bunny (y is up) in a closed box of coloured planes under a lamp."""
    scene, (low, high) = pr.Scene(), model.bounds
    middle, half = (low + high) / 2, float((high - low).max()) * 1.1
    floor = middle.copy()
    floor[1] = low[1] + 0.01 * half
    scene.add(model, material=pr.Diffuse(0.7))
    scene.add(pr.Plane(floor, (0, 1, 0), 0.7))
    scene.add(pr.Plane(floor + (0, 2 * half, 0), (0, -1, 0), 0.7))
    scene.add(pr.Plane(middle - (half, 0, 0), (1, 0, 0), (0.75, 0.1, 0.1)))
    scene.add(pr.Plane(middle + (half, 0, 0), (-1, 0, 0), (0.1, 0.6, 0.15)))
    scene.add(pr.Plane(middle - (0, 0, half), (0, 0, 1), 0.7))
    scene.add(pr.Plane(middle + (0, 0, 2 * half), (0, 0, -1), 0.7))
    lamp = floor + (0, 1.98 * half, 0)
    scene.add_light(pr.RectLight(lamp, (0.4 * half, 0, 0), (0, 0, 0.4 * half), 10.0))
    eyes = ((-0.7, 0.2, 1.7), (0.8, 0.7, 1.6), (0.1, -0.2, 1.0))
    cameras = [pr.Camera.look_at(middle + half * np.array(eye), middle, (0, 1, 0), 55, size) for eye in eyes]
    return Subject(name, scene, cameras)


def lion_outside(name: str, model: pr.Model, size: tuple[int, int]) -> Subject:
    """A raw scan in its own colours under a sun and a sky."""
    scene = pr.Scene()
    scene.add(model)
    scene.add_light(pr.EnvironmentLight((0.7, 0.85, 1.0), horizon=0.9, ground=0.2))
    scene.add_light(pr.SunLight((-1.0, 0.6, -1.2), (2.4, 2.2, 2.0)))
    first = pr.frame(scene, size=size)
    eye, target = np.array(first.eye), np.array(first.target)
    cameras = [first]
    for angle, share in ((35.0, 0.9), (-30.0, 0.5)):
        turned = pr.transform(rotate=angle)[:3, :3] @ (eye - target)
        cameras.append(pr.Camera.look_at(target + share * turned, target, first.up, first.fov, size))
    return Subject(name, scene, cameras)


def pictures(options: Options) -> list[Row]:
    """Indirect light on matt surfaces, in views that the baker does not know."""
    rows: list[Row] = []
    for subject in subjects(options):
        rows += [subject] if isinstance(subject, Row) else _matt(subject, options)
    return rows


def _matt(subject: Subject, options: Options) -> list[Row]:
    noise = QUICK_NOISE if options.quick else NOISE
    references = [indirect_light(subject.scene, camera, noise, options) for camera in subject.cameras]
    found: list[Errors] = []
    for seed in options.chances:
        baked = pr.bake(subject.scene, pr.BakeSettings(seed=seed))
        for k, (camera, reference) in enumerate(zip(subject.cameras, references, strict=True)):
            shown = baked_light(subject.scene, camera, baked)
            found.append(compare(shown, reference))
            if seed == 0:
                show_errors(f"{subject.name} {k}", shown, reference, options)
    left = max(reference.noise for reference in references)
    what = f"{subject.name}, indirect light: "
    rmse, bias, high, correlation = (np.array(column) for column in zip(*found, strict=True))
    mean = ", mean {:.2%}"
    return [
        at_most(
            what + "RMSE",
            rmse.max(),
            0.03,
            note=f"{mean.format(rmse.mean())} (paths' noise {left:.2%})",
            aim=" (aim 2)",
        ),
        at_most(what + "bias", bias.max(), 0.01, note=mean.format(bias.mean())),
        at_most(what + "99th percentile", high.max(), 0.12, note=mean.format(high.mean())),
        at_least(what + "correlation", correlation.min(), 0.98, "{:.4f}", note=f", mean {correlation.mean():.4f}"),
    ]


def gloss(options: Options) -> list[Row]:
    """Highlights next to a coloured wall from a moving camera: RMSE over all frames.

    The statue's own colour is black: all that it shows is its highlight. Direct light of the sun is taken off, as in
    `bake_reference`. Pixels beside other surfaces do not count.
    """
    rows = []
    for exponent in (20.0, 100.0):
        material = pr.Phong(0.0, specular=0.5, exponent=exponent)
        scene = statue_room(options.points, "sky sun", material=material, wall=True)
        baked = pr.bake(scene)
        found: dict[int, list[float]] = {1: [], 64: [], SETTLED: []}
        left = 0.0
        for k, camera in enumerate(_moving(scene, options)):
            reference = indirect_light(scene, camera, QUICK_NOISE if options.quick else GLOSS_NOISE, options)
            body = binary_erosion(scene.intersect(*camera.rays()).instance == 0, np.ones((3, 3)))
            left = max(left, reference.noise)
            for samples, errors in found.items():
                shown = baked_light(scene, camera, baked, samples)
                errors.append(compare(shown, reference, body).rmse)
                if samples == SETTLED and k == 0:
                    masked = reference._replace(covered=body)
                    show_errors(f"phong {exponent:.0f}", shown, masked, options)
        for samples, errors in found.items():
            rmse = float(np.sqrt(np.mean(np.square(errors))))
            what = f"Phong {exponent:.0f}, {len(errors)} frames, highlight, samples: {samples}"
            note = f", worst frame {max(errors):.2%} (paths' noise {left:.2%})"
            one = plain_row(what, f"{rmse:.2%}{note}")
            rows.append(at_most(what, rmse, 0.05, note=note) if samples == SETTLED else one)
    return rows


def _moving(scene: pr.Scene, options: Options) -> list[pr.Camera]:
    """An eye that moves along an arc, at first towards the wall's side."""
    low, high = scene.bounds
    middle, frames = (low + high) / 2, QUICK_FRAMES if options.quick else FRAMES
    size = QUICK_GLOSS_SIZE if options.quick else GLOSS_SIZE
    cameras = []
    for angle in np.radians(np.linspace(-40.0, -80.0, frames)):
        eye = middle + 2.7 * np.array([np.cos(angle), np.sin(angle), 0.25])
        cameras.append(pr.Camera.look_at(eye, middle, size=size))
    return cameras


def show_errors(name: str, shown: Picture, reference: Reference, options: Options) -> None:
    """Write a picture of path, baked and difference side by side, if a folder is given."""
    if options.pictures is None:
        return
    options.pictures.mkdir(parents=True, exist_ok=True)
    mean = reference.light[reference.covered].mean()
    off = (shown - reference.light).mean(axis=2) / (FULL_COLOR * mean)
    off = np.clip(np.where(reference.covered, off, 0.0), -1.0, 1.0)[..., None]
    red, blue = np.array([0.8, 0.0, 0.0]), np.array([0.0, 0.2, 0.9])
    colored = 1.0 - np.abs(off) * (1.0 - np.where(off > 0, red, blue))
    parts = [linear_to_srgb(np.clip(light / (WHITE * mean), 0.0, 1.0)) for light in (reference.light, shown)]
    levels = (255 * np.concatenate([*parts, colored], axis=1) + 0.5).astype(np.uint8)
    zoom = max(1, 320 // shown.shape[0])
    whole = Image.fromarray(np.asarray(levels).repeat(zoom, axis=0).repeat(zoom, axis=1))
    whole.save(options.pictures / f"{name.replace(' ', '_')}.png")
