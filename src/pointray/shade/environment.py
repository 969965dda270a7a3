"""Environment light: constant, a gradient from ground to zenith, or an image of the sphere."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import check_numbers, rgb, unit_vector, wrong_type
from ..base.arrays import Doubles, Floats
from ..engine.kernels import records as rec
from .lights import Light
from .pictures import read_picture

LARGEST = 16384  # pixels a side
BRIGHTEST = 1e9
FINE = 64  # rows of the grid for integrals of a gradient
# Spherical harmonics of the clamped cosine, by degree (Ramamoorthi and Hanrahan 2001).
COSINE_LOBE = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4], [1, 3, 5])


@dataclass(frozen=True, eq=False)
class EnvironmentLight:
    """Light from all directions, at infinite distance.

    Parameters
    ----------
    radiance : float or (3,) float
        Radiance of all directions, W/(m2 sr), linear RGB, or a number for grey. With `horizon` or `ground` it is that
        of the zenith, with `image` a factor.
    horizon, ground : float or (3,) float, optional
        Radiance of a gradient: linear in the sine of the elevation from horizon to zenith, constant below the horizon.
        If one is None it equals the other; if both are, the light is constant.
    image : (h, w, 3) float array_like, or path of an .hdr or .exr file, optional
        Linear radiance of the sphere, equirectangular. Row 0 is up, the middle column ahead (+y if up is z), and the
        right half is to the right of an observer who looks ahead.
    up : (3,) float
        World direction of the zenith.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    OSError
        If the image cannot be opened.
    ImportError
        If the image is a path and OpenImageIO is not installed (`pip install 'pointray[files]'`).
    ValueError
        If a value is negative, NaN, infinite or above 1e9, an image has a wrong shape, or both an image and a gradient
        are given.

    Examples
    --------
    >>> sky = pr.EnvironmentLight((0.2, 0.4, 0.9), horizon=0.8, ground=0.2)
    >>> panorama = pr.EnvironmentLight(image=np.ones((16, 32, 3)))
    >>> scene = pr.Scene()
    >>> scene.lights = [sky, pr.SunLight((1, 1, -1.2))]
    """

    radiance: ArrayLike = 1.0
    horizon: ArrayLike | None = None
    ground: ArrayLike | None = None
    image: ArrayLike | str | os.PathLike[str] | None = None
    up: ArrayLike = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if self.image is not None and (self.horizon is not None or self.ground is not None):
            raise ValueError("an environment is an image or a gradient, not both")
        rgb(self.radiance, "radiance")
        unit_vector(self.up, "up")
        for name in ("horizon", "ground"):
            if getattr(self, name) is not None:
                rgb(getattr(self, name), name)
        if self.image is not None:
            object.__setattr__(self, "image", _check_image(self.image))

    def tables(self) -> tuple[NDArray[Any], ...]:
        """Return the light as the five arrays that kernels read, fields of `World`.

        They are sky (kind, axes, colours), sky_colors (pixels of an image), sky_rows and sky_columns (distribution for
        importance sampling), sky_mean (irradiance as spherical harmonics); see `records.World`.
        """
        sky, scale = np.zeros(rec.SKY), rgb(self.radiance, "radiance")
        x, y, z = _axes(unit_vector(self.up, "up"))
        sky[rec.SKY_X : rec.SKY_X + 3], sky[rec.SKY_Y : rec.SKY_Y + 3], sky[rec.SKY_Z : rec.SKY_Z + 3] = x, y, z
        if self.image is None:
            sky[rec.SKY_KIND] = rec.GRADIENT_SKY
            ground = self.horizon if self.ground is None else self.ground
            horizon = self.ground if self.horizon is None else self.horizon
            sky[rec.SKY_ZENITH : rec.SKY_ZENITH + 3] = scale
            sky[rec.SKY_HORIZON : rec.SKY_HORIZON + 3] = scale if horizon is None else rgb(horizon, "horizon")
            sky[rec.SKY_GROUND : rec.SKY_GROUND + 3] = scale if ground is None else rgb(ground, "ground")
            return sky, np.zeros(0, np.float32), np.zeros(0), np.zeros(0), _irradiance(_gradient(sky), (x, y, z))
        colors = np.asarray(self.image, np.float32) * scale.astype(np.float32)
        sky[rec.SKY_KIND], sky[rec.SKY_WIDTH] = rec.PICTURE_SKY, colors.shape[1]
        rows, columns = _shares(colors)
        if rows[-1] == 0.0:  # a black image
            sky[rec.SKY_KIND] = rec.NO_SKY
        return sky, colors.reshape(-1), rows, columns, _irradiance(colors, (x, y, z))


def no_sky() -> tuple[NDArray[Any], ...]:
    """Return what `EnvironmentLight.tables` returns, for a scene without environment light: five arrays for kernels."""
    return np.zeros(rec.SKY), np.zeros(0, np.float32), np.zeros(0), np.zeros(0), np.zeros(27)


def _check_image(image: Any) -> Floats:
    """Return a validated equirectangular image of radiance, (h, w, 3) float32.

    image : array (h, w, 3 or 4), or path of a file
    """
    name = "image"
    if isinstance(image, str | os.PathLike):
        name, image = os.fspath(image), read_picture(image)
    array = check_numbers(image, name, "an image of the sphere, or a path")
    if array.ndim != 3 or array.shape[2] not in (3, 4):
        raise ValueError(f"{name}: expected the shape (h, w, 3), got {array.shape}")
    height, width = array.shape[:2]
    if not (2 <= height <= LARGEST and 2 <= width <= LARGEST):
        raise ValueError(f"{name}: expected 2 to {LARGEST} pixels a side, got {width}x{height}")
    colors = np.ascontiguousarray(array[..., :3], np.float32)
    bad = ~((colors >= 0) & (colors <= BRIGHTEST))  # true for NaN
    if bad.any():
        row, column, channel = np.argwhere(bad)[0]
        where = f"row {row}, column {column} has {colors[row, column, channel]}"
        raise ValueError(f"{name}: radiance must lie between 0 and {BRIGHTEST:g}; {where}")
    return colors


def _axes(up: Doubles) -> tuple[Doubles, Doubles, Doubles]:
    """Return the world's x, y and z axes, turned by the smallest rotation that takes z to `up`, a unit vector."""
    if up[2] < -1.0 + 1e-12:
        return np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0]), up
    x, y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    half = up + (0.0, 0.0, 1.0)
    return x - up[0] / (1.0 + up[2]) * half, y - up[1] / (1.0 + up[2]) * half, up


def _gradient(sky: Doubles) -> Doubles:
    """Return a gradient sky as an equirectangular image, (FINE, 2 FINE, 3). sky : its record, see `records.SKY`"""
    height = np.cos((np.arange(FINE) + 0.5) / FINE * np.pi)[:, None]
    zenith, horizon, ground = (sky[k : k + 3] for k in (rec.SKY_ZENITH, rec.SKY_HORIZON, rec.SKY_GROUND))
    rows = np.where(height >= 0, horizon + height * (zenith - horizon), ground)
    return np.repeat(rows[:, None], 2 * FINE, axis=1)


def _solid_angles(height: int, width: int) -> Doubles:
    """Return the solid angle of a pixel in each row of an equirectangular image, (height,), in steradians."""
    edges = np.cos(np.arange(height + 1) / height * np.pi)
    return np.asarray((edges[:-1] - edges[1:]) * 2.0 * np.pi / width)


def _shares(colors: Floats) -> tuple[Doubles, Doubles]:
    """Return the cumulative distributions by which an environment image is importance sampled.

    A pixel counts with its brightest neighbour, as radiance is interpolated.

    colors : (h, w, 3), equirectangular

    Returns
    -------
    (h + 1,) float64
        Share of the light above each row.
    (h * (w + 1),) float64
        Share of each row's light to the left of each pixel.
    """
    light = colors.max(axis=2).astype(np.float64)
    light = np.maximum.reduce([light, np.roll(light, 1, axis=1), np.roll(light, -1, axis=1)])
    light = np.maximum.reduce([light, np.concatenate([light[:1], light[:-1]]), np.concatenate([light[1:], light[-1:]])])
    light *= _solid_angles(*light.shape)[:, None]
    columns = np.concatenate([np.zeros((len(light), 1)), np.cumsum(light, axis=1)], axis=1)
    rows = np.concatenate([[0.0], np.cumsum(columns[:, -1])])
    columns /= np.where(columns[:, -1:] > 0, columns[:, -1:], 1.0)
    return rows / (rows[-1] or 1.0), columns.reshape(-1)


def harmonics(d: Doubles) -> Doubles:
    """Return the nine real spherical harmonics up to degree 2 at unit directions d, (..., 3): (9, ...)."""
    x, y, z = np.moveaxis(d, -1, 0)
    return np.stack(
        [
            np.full_like(x, 0.282095),
            0.488603 * y,
            0.488603 * z,
            0.488603 * x,
            1.092548 * x * y,
            1.092548 * y * z,
            0.315392 * (3.0 * z * z - 1.0),
            1.092548 * x * z,
            0.546274 * (x * x - y * y),
        ]
    )


def _irradiance(colors: NDArray[Any], axes: tuple[Doubles, Doubles, Doubles]) -> Doubles:
    """Return the irradiance of a surface as a function of its world normal: nine spherical harmonics times RGB, (27,).

    colors : (h, w, 3), equirectangular image of radiance
    axes : world directions (right, ahead, up) of the image
    """
    height, width = colors.shape[:2]
    polar = (np.arange(height) + 0.5) / height * np.pi
    around = ((np.arange(width) + 0.5) / width - 0.5) * 2.0 * np.pi
    total = np.zeros((9, 3))
    angles = _solid_angles(height, width)
    for k in range(height):  # a row at a time, to save memory
        s, c = np.sin(polar[k]), np.cos(polar[k])
        d = (np.sin(around) * s)[:, None] * axes[0] + (np.cos(around) * s)[:, None] * axes[1] + c * axes[2]
        total += angles[k] * harmonics(d) @ colors[k].astype(np.float64)
    return (COSINE_LOBE[:, None] * total).reshape(-1)


class Lights:
    """Immutable list of the lights of a scene, in the order of addition, with at most one environment light.

    `plus` shares the items with the list that it extends, so adding a light takes constant time.

    Raises
    ------
    ValueError
        If there are two environment lights.
    TypeError
        If an item is not a light.
    """

    def __init__(self, lights: Iterable[Any] = ()) -> None:
        self._items: list[Light | EnvironmentLight] = []
        self._count, self._around = 0, False
        for light in lights:
            self._around |= self._check(light)
            self._items.append(light)
            self._count += 1

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Light | EnvironmentLight]:
        return islice(self._items, self._count)

    def plus(self, light: Any) -> Lights:
        """Return a list with one more light; this one is unchanged. Errors are those of the constructor."""
        more = Lights()
        more._around, more._count = self._check(light, "light") or self._around, self._count + 1
        more._items = self._items
        if len(self._items) == self._count:
            more._items.append(light)
        if more._items[self._count] is not light:  # this list has been extended before
            more._items = [*self, light]
        return more

    def _check(self, light: Any, name: str = "lights") -> bool:
        """Validate a light to add; return whether it is an environment light. name : of the argument, for messages"""
        if isinstance(light, EnvironmentLight):
            if self._around:
                raise ValueError("the scene has an EnvironmentLight already")
            return True
        if not isinstance(light, Light):
            known = ", ".join(kind.__name__ for kind in (*get_args(Light), EnvironmentLight))
            raise wrong_type(name, f"one of {known}", light)
        return False
