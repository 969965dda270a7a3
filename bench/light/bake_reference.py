"""Indirect light in pictures: path-traced, cached in files, and as rendered by the integrator "baked".

Indirect light is all light except that of lamps and suns which reaches the first surface unreflected. It is

    path(sky alone) + path(lights alone) - path(lights alone, one scattering),

and the last two use the same samples, so that direct light leaves no noise. The light of the sky is included in both
the baked light and this sum. Baked light is rendered with a copy of the scene whose lights are black after the bake.
"""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from bench.light.bake_rows import Options
from pointray.engine.kernels.vec import LUMINANCE

Picture = NDArray[np.float32]

SAMPLES = 64  # of a batch: the noise is estimated from means of batches
LEAST, MOST = 6, 400  # batches
SHOWN = 256  # samples of baked light
COVERED = 0.999  # alpha of pixels that show nothing but surfaces
POWERS = ("intensity", "irradiance", "radiance")


class Reference(NamedTuple):
    """A path-traced picture of indirect light.

    light : (h, w, 3) float32; apart : (h, w, 3) float32, half the difference of two halves of the samples
    covered : (h, w) bool, pixels that show surfaces only
    noise : standard error of the pixels' luminance, root mean square, as a share of its mean
    """

    light: Picture
    apart: Picture
    covered: NDArray[np.bool_]
    noise: float


class Errors(NamedTuple):
    """How baked light differs, as shares of the reference's mean.

    rmse : of all channels, without the reference's noise; bias : difference of the means, of the worst channel
    high : 99th percentile of the difference, of all channels; correlation : of the worst channel
    """

    rmse: float
    bias: float
    high: float
    correlation: float


def compare(shown: Picture, reference: Reference, mask: NDArray[np.bool_] | None = None) -> Errors:
    """The errors of pixels; without a mask of all that show surfaces only.

    The noise of the two halves of the reference falls out of the product of their differences.
    """
    mask = reference.covered if mask is None else mask
    a, b, apart = (picture[mask].astype(float) for picture in (shown, reference.light, reference.apart))
    mean, square = b.mean(), np.mean((a - b - apart) * (a - b + apart))
    bias = np.abs(a.mean(axis=0) / b.mean(axis=0) - 1.0).max()
    correlation = min(np.corrcoef(a[:, c], b[:, c])[0, 1] for c in range(3))
    high = np.quantile(np.abs(a - b), 0.99) / mean
    return Errors(float(np.sqrt(max(square, 0.0)) / mean), float(bias), float(high), float(correlation))


def indirect_light(scene: pr.Scene, camera: pr.Camera, noise: float, options: Options) -> Reference:
    """The indirect light in a picture by path tracing: as many samples as the noise asks for."""
    path = options.references / f"{_key(scene, camera, noise)}.npz"
    if path.exists():
        with np.load(path) as kept:
            return Reference(kept["light"], kept["apart"], kept["covered"], float(kept["noise"]))
    reference = _trace(scene, camera, noise)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, **reference._asdict())
    return reference


def _key(scene: pr.Scene, camera: pr.Camera, noise: float) -> str:
    """A key for a picture: contents of the scene, and view."""
    snapshot, digest = scene.snapshot(), hashlib.blake2b(digest_size=12)
    world = snapshot.world
    arrays: list[Any] = [world.instances, world.planes, world.lights, world.sky, world.sky_colors, world.materials]
    for model in snapshot.models:
        arrays += [model.points.positions, model.points.origin, model.tree.blocks]
    for array in (*arrays, camera.record(), np.array([*camera.size, noise, SAMPLES, LEAST, MOST])):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _trace(scene: pr.Scene, camera: pr.Camera, noise: float) -> Reference:
    shape, weights = (camera.size[1], camera.size[0]), np.array(LUMINANCE)
    halves, squares, done = [np.zeros((*shape, 3)), np.zeros((*shape, 3))], np.zeros(shape), 0
    while True:
        picture, alpha = _batch(scene, camera, seed=done)
        halves[done % 2] += picture
        squares += (picture @ weights) ** 2
        done += 1
        if done < LEAST or done % 2:
            continue
        covered, light = alpha > COVERED, (halves[0] + halves[1]) / done
        mean = light[covered] @ weights
        variance = np.maximum(squares[covered] / done - mean**2, 0.0) / (done - 1)
        left = float(np.sqrt(variance.mean()) / mean.mean())
        if left <= noise or done >= MOST:
            apart = (halves[0] - halves[1]) / done
            return Reference(light.astype(np.float32), apart.astype(np.float32), covered, left)


def _batch(scene: pr.Scene, camera: pr.Camera, seed: int) -> tuple[NDArray[np.float64], Picture]:
    """SAMPLES samples of indirect light, and alpha."""
    settings = pr.Settings("path", spp=SAMPLES, max_depth=None, filter="box", seed=seed)
    light = np.zeros((camera.size[1], camera.size[0], 3))
    alpha = np.zeros(light.shape[:2], np.float32)
    for twin, is_sky in ((_with(scene, True), True), (_with(scene, False), False)):
        if not twin.lights:
            continue
        picture = pr.render(twin, camera, settings)
        light += picture[..., :3]
        if not is_sky:
            light -= pr.render(twin, camera, replace(settings, max_depth=1))[..., :3]
        alpha = picture[..., 3]
    return light, alpha


def _with(scene: pr.Scene, sky: bool) -> pr.Scene:
    """The scene under its sky alone, or under its other lights alone."""
    twin = scene.copy()
    twin.lights = [light for light in scene.lights if isinstance(light, pr.EnvironmentLight) == sky]
    return twin


def baked_light(
    scene: pr.Scene, camera: pr.Camera, baked: pr.Baked, samples: int = SHOWN, seed: int = 12345
) -> Picture:
    """The same light as baked, (h, w, 3)."""
    twin = scene.copy()
    twin.lights = [_black(light) for light in scene.lights]
    twin.baked = baked
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pr.StaleLightWarning)
        settings = pr.Settings("baked", spp=samples, filter="box", seed=seed)
        return np.asarray(pr.render(twin, camera, settings)[..., :3])


def _black(light: Any) -> Any:
    """A light that sends out nothing; the sky as it is."""
    if isinstance(light, pr.EnvironmentLight):
        return light
    return replace(light, **{name: 0.0 for name in POWERS if hasattr(light, name)})
