"""The environment light in kernels: radiance, importance sampling and irradiance."""

from __future__ import annotations

import math

import numpy as np

from ..engine.jit import f64, inline
from ..engine.kernels import records as rec
from ..engine.kernels.records import World
from ..engine.kernels.sampling import find_share
from ..engine.kernels.vec import BLACK, Vec3, add, dot, load3_flat, scale, sub
from .emitters import LightSample


@inline
def has_sky(world: World) -> bool:
    """Return whether the scene has an environment light."""
    return world.sky[rec.SKY_KIND] != rec.NO_SKY


@inline
def is_importance_sampled(world: World) -> bool:
    """Return whether the sky is importance sampled: only images are, as for others BSDF sampling is as good."""
    return world.sky[rec.SKY_KIND] == rec.PICTURE_SKY


@inline
def _size(world: World) -> tuple[int, int]:
    """Return (height, width) of the environment image in pixels."""
    return world.sky_rows.size - 1, int(world.sky[rec.SKY_WIDTH])


@inline
def _image_position(world: World, d: Vec3) -> tuple[float, float]:
    """Return (row, column) of a unit direction in the environment image, in pixels from the upper left corner."""
    height, width = _size(world)
    axes = load3_flat(world.sky, rec.SKY_X), load3_flat(world.sky, rec.SKY_Y), load3_flat(world.sky, rec.SKY_Z)
    x, y, z = dot(axes[0], d), dot(axes[1], d), dot(axes[2], d)
    polar = math.acos(min(max(z, -1.0), 1.0))
    return polar / math.pi * height, (math.atan2(x, y) / (2.0 * math.pi) + 0.5) * width


@inline
def _pixel(world: World, row: int, column: int) -> Vec3:
    """Return the radiance of a pixel of the environment image; columns wrap around, rows are clamped."""
    height, width = _size(world)
    row = min(max(row, 0), height - 1)
    column = column % width
    at = 3 * (row * width + column)
    return f64(world.sky_colors[at]), f64(world.sky_colors[at + 1]), f64(world.sky_colors[at + 2])


@inline
def sky_radiance(world: World, d: Vec3) -> Vec3:
    """Return the radiance of the environment light from a unit direction; black without one."""
    if world.sky[rec.SKY_KIND] != rec.PICTURE_SKY:
        if world.sky[rec.SKY_KIND] == rec.NO_SKY:
            return BLACK
        up = dot(load3_flat(world.sky, rec.SKY_Z), d)
        horizon = load3_flat(world.sky, rec.SKY_HORIZON)
        if up < 0.0:
            return load3_flat(world.sky, rec.SKY_GROUND)
        return add(horizon, scale(sub(load3_flat(world.sky, rec.SKY_ZENITH), horizon), up))
    row, column = _image_position(world, d)
    row, column = row - 0.5, column - 0.5
    top, left = math.floor(row), math.floor(column)
    down, right = row - top, column - left
    top, left = int(top), int(left)
    upper = add(scale(_pixel(world, top, left), 1.0 - right), scale(_pixel(world, top, left + 1), right))
    lower = add(scale(_pixel(world, top + 1, left), 1.0 - right), scale(_pixel(world, top + 1, left + 1), right))
    return add(scale(upper, 1.0 - down), scale(lower, down))


@inline
def sky_pdf(world: World, d: Vec3) -> float:
    """Return the pdf per solid angle of `sample_sky` for a unit direction; 0 unless the sky is an image."""
    if world.sky[rec.SKY_KIND] != rec.PICTURE_SKY:
        return 0.0
    height, width = _size(world)
    row, column = _image_position(world, d)
    row, column = min(int(row), height - 1), min(int(column), width - 1)
    at = row * (width + 1) + column
    share = (world.sky_rows[row + 1] - world.sky_rows[row]) * (world.sky_columns[at + 1] - world.sky_columns[at])
    return share / _solid_angle(row, height, width)


@inline
def _solid_angle(row: int, height: int, width: int) -> float:
    """Return the solid angle in steradians of a pixel in a row of an equirectangular image."""
    above, below = math.cos(row * math.pi / height), math.cos((row + 1) * math.pi / height)
    return (above - below) * 2.0 * math.pi / width


@inline
def sample_sky(world: World, u: float, v: float) -> LightSample:
    """Importance-sample the environment image: return a direction with its radiance over the pdf.

    u, v : random numbers in [0, 1)
    """
    height, width = _size(world)
    row = find_share(world.sky_rows, 0, height, v)
    at = row * (width + 1)
    column = find_share(world.sky_columns, at, width, u)
    low, high = world.sky_rows[row], world.sky_rows[row + 1]
    down = (v - low) / (high - low) if high > low else 0.5
    left, right = world.sky_columns[at + column], world.sky_columns[at + column + 1]
    along = (u - left) / (right - left) if right > left else 0.5
    # Uniform over the pixel's solid angle: linear in the cosine of the polar angle.
    above, below = math.cos(row * math.pi / height), math.cos((row + 1) * math.pi / height)
    z = above + (below - above) * down
    s = math.sqrt(max(1.0 - z * z, 0.0))
    around = ((column + along) / width - 0.5) * 2.0 * math.pi
    x, y = s * math.sin(around), s * math.cos(around)
    right_hand, ahead = scale(load3_flat(world.sky, rec.SKY_X), x), scale(load3_flat(world.sky, rec.SKY_Y), y)
    d = add(right_hand, add(ahead, scale(load3_flat(world.sky, rec.SKY_Z), z)))
    pdf = (high - low) * (right - left) / _solid_angle(row, height, width)
    if pdf <= 0.0:
        return LightSample(d, np.inf, BLACK, 0.0)
    return LightSample(d, np.inf, scale(sky_radiance(world, d), 1.0 / pdf), pdf)


@inline
def sky_irradiance(world: World, n: Vec3) -> Vec3:
    """Return the unoccluded irradiance from the sky of a surface with unit normal n, by harmonics of degree 2.

    The error is 1% for light from one hemisphere, and about 5% or more for small bright spots (Ramamoorthi and Hanrahan
    2001).
    """
    x, y, z = n
    m = world.sky_mean
    total = scale(load3_flat(m, 0), 0.282095)
    total = add(total, scale(load3_flat(m, 3), 0.488603 * y))
    total = add(total, scale(load3_flat(m, 6), 0.488603 * z))
    total = add(total, scale(load3_flat(m, 9), 0.488603 * x))
    total = add(total, scale(load3_flat(m, 12), 1.092548 * x * y))
    total = add(total, scale(load3_flat(m, 15), 1.092548 * y * z))
    total = add(total, scale(load3_flat(m, 18), 0.315392 * (3.0 * z * z - 1.0)))
    total = add(total, scale(load3_flat(m, 21), 1.092548 * x * z))
    total = add(total, scale(load3_flat(m, 24), 0.546274 * (x * x - y * y)))
    return max(total[0], 0.0), max(total[1], 0.0), max(total[2], 0.0)
