"""Camera rays in kernels: sample positions in a pixel, projections, thin lens.

Filter importance sampling (Ernst, Stamminger and Greiner 2006): sample positions are distributed as the filter and have
equal weights, so that pixels do not share samples.
"""

from __future__ import annotations

import math

import numpy as np

from ..base.choices import FILTERS, number_of
from ..engine.jit import Array, inline
from ..engine.kernels import records as rec
from ..engine.kernels.sampling import IN_PIXEL, sample_pair
from ..engine.kernels.vec import Vec3, add, dot, load3_flat, on_circle, scale, sub, unit

BOX, TENT, GAUSSIAN, BLACKMAN_HARRIS = (
    number_of(FILTERS, name) for name in ("box", "tent", "gaussian", "blackman-harris")
)

# In pixels from the pixel centre. The radius of the box is 0.5, of the tent 1.
SIGMA, GAUSSIAN_END = 0.5, 1.5
BLACKMAN_HARRIS_END = 1.5
WINDOW = (0.35875, 0.48829, 0.14128, 0.01168)  # a0 to a3 (Harris 1978)

_WITHIN = 1.0 - math.exp(-0.5 * (GAUSSIAN_END / SIGMA) ** 2)  # integral of the truncated Gaussian
_STEPS = 64


def _quantiles() -> Array:
    """Tabulate the Blackman-Harris window for importance sampling: 65 distances from its centre, in pixels.

    Beyond the k-th distance lies a fraction w^2 of one half of the window, w = k / 64. The square resolves the flat
    ends of the window; the error of interpolation is 3e-5.
    """
    x = np.linspace(0.0, 1.0, 4097)  # from the end to the centre
    share = x + sum((-1) ** k * WINDOW[k] / WINDOW[0] * np.sin(k * np.pi * x) / (k * np.pi) for k in (1, 2, 3))
    return BLACKMAN_HARRIS_END * (1.0 - np.interp(np.linspace(0.0, 1.0, _STEPS + 1) ** 2, share, x))


_QUANTILES = _quantiles()


@inline
def _tent(u: float) -> float:
    """Return the quantile u (0 to 1) of the tent filter: a position along one axis, -1 to 1 pixels from the centre."""
    return math.sqrt(2.0 * u) - 1.0 if u < 0.5 else 1.0 - math.sqrt(2.0 - 2.0 * u)


@inline
def _gaussian(u: float, v: float) -> tuple[float, float]:
    """Return a random position of a sample, distributed as the Gaussian filter truncated at a circle.

    The position is in pixels right and down from the pixel centre, at most 1.5 away (Box and Muller 1958).

    u, v : random numbers, 0 to 1
    """
    radius = SIGMA * math.sqrt(-2.0 * math.log(1.0 - u * _WITHIN))
    x, y = on_circle(v)
    return radius * x, radius * y


@inline
def _blackman_harris(u: float) -> float:
    """Return the quantile u (0 to 1) of the Blackman-Harris filter: a position, -1.5 to 1.5 pixels from the centre."""
    w = _STEPS * math.sqrt(2.0 * min(u, 1.0 - u))
    k = min(int(w), _STEPS - 1)
    away = _QUANTILES[k] + (w - k) * (_QUANTILES[k + 1] - _QUANTILES[k])
    return -away if u < 0.5 else away


@inline
def position_in_pixel(key: int, sample: int, shape: int) -> tuple[float, float]:
    """Return a random position for a sample, in pixels right and down from the pixel centre.

    The positions of all samples are distributed as the pixel filter.

    key : number of the pixel, from which random numbers are computed; sample : index of the sample
    shape : number of the pixel filter
    """
    u, v = sample_pair(key, sample, IN_PIXEL)
    if shape == TENT:
        return _tent(u), _tent(v)
    if shape == GAUSSIAN:
        return _gaussian(u, v)
    if shape == BLACKMAN_HARRIS:
        return _blackman_harris(u), _blackman_harris(v)
    return u - 0.5, v - 0.5


@inline
def on_screen(size: tuple[int, int], x: float, y: float) -> tuple[float, float]:
    """Map a position in pixels, x right and y down, to (u, v): -1 to 1 from left to right and from bottom to top.

    size : width and height of the image in pixels; x, y : from the top left corner of the image
    """
    return 2.0 * x / size[0] - 1.0, 1.0 - 2.0 * y / size[1]


@inline
def project(camera: Array, projection: int, u: float, v: float) -> tuple[Vec3, Vec3]:
    """Return the ray (o, d) through the centre of the lens at (u, v) of the image.

    The component of d along the view is 1; for a panorama d is a unit vector.

    camera : (16,), eye, axes, projection and lens; projection : number of the projection
    u, v : -1 to 1 from left to right and from bottom to top
    """
    eye, forward = load3_flat(camera, rec.EYE), load3_flat(camera, rec.FORWARD)
    across, upward = load3_flat(camera, rec.ACROSS), load3_flat(camera, rec.UPWARD)
    if projection == rec.PANORAMA:
        turn, tilt = math.pi * u, 0.5 * math.pi * v
        level = add(scale(forward, math.cos(turn)), scale(across, math.sin(turn)))
        return eye, add(scale(level, math.cos(tilt)), scale(upward, math.sin(tilt)))
    aside = add(scale(across, u), scale(upward, v))
    if projection == rec.ORTHOGRAPHIC:
        return add(eye, aside), forward
    return eye, add(forward, aside)


@inline
def through_lens(camera: Array, ray: tuple[Vec3, Vec3], position: tuple[float, float]) -> tuple[Vec3, Vec3]:
    """Return a camera ray (o, d) moved to another point of the lens; both rays meet in the plane in focus.

    camera : (16,), eye, axes, projection and lens; ray : through the lens's centre
    position : (x, y) of the other point on the lens, in lens radii from the centre
    """
    x, y = position[0] * camera[rec.LENS_RADIUS], position[1] * camera[rec.LENS_RADIUS]
    aside = add(scale(unit(load3_flat(camera, rec.ACROSS)), x), scale(unit(load3_flat(camera, rec.UPWARD)), y))
    return add(ray[0], aside), sub(ray[1], scale(aside, camera[rec.NEARNESS]))


@inline
def depth_of(camera: Array, ray: tuple[Vec3, Vec3], t: float) -> float:
    """Return the depth along the view of the point at t on a camera ray (o, d).

    In a panorama it is the distance from the eye.
    """
    return t if camera[rec.PROJECTION] == rec.PANORAMA else t * dot(ray[1], load3_flat(camera, rec.FORWARD))
