"""Camera distance at which the projected points fill the image.

The central 99.9% of the points along each side of the image are framed, so outliers do not count. Framing the bounding
box instead would leave empty corners, and put the points too high or off centre.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import check_direction
from ..base.arrays import Doubles
from ..rendering.camera import SIZE, Camera, view_axes
from .clusters import STRAY
from .sample import Sample

MARGIN = 0.05  # on each side, as a share of the image
ROUNDS = 60
ENOUGH = 1e-4  # precision of the centring, as a share of the image
NEAREST = 0.05  # smallest distance from the eye to the nearest point, as a share of the points' extent
Part = tuple[float, float, float, float]
WHOLE = (0.0, 0.0, 1.0, 1.0)
CIRCLE = 64  # points on the circle that a turning point describes
PROFILE = 256  # heights in the profile of a turning scan


class Lens(NamedTuple):
    """Parameters of `Camera.look_at` other than positions: fov in degrees, size in pixels, projection."""

    fov: float = 40.0
    size: tuple[int, int] = SIZE
    projection: str = "perspective"


STANDARD = Lens()


def frame_points(
    sample: Sample, direction: ArrayLike, up: ArrayLike = (0, 0, 1), lens: Lens = STANDARD, free: Part = WHOLE
) -> Camera:
    """Return a camera that shows the points of a sample centred and as large as fits with a margin of 5%.

    Parameters
    ----------
    direction : (3,) array_like
        From the points towards the camera.
    up : (3,) array_like
    lens : Lens
        A panorama is taken from the median of the points.
    free : (4,) float
        Part of the image that the points fill: left, top, right, bottom, from 0 to 1.

    Returns
    -------
    Camera
        The target has the depth of the points' median.
    """
    return _frame(sample, direction, up, lens, STRAY, free)


def frame_turning(sample: Sample, direction: ArrayLike, up: ArrayLike = (0, 0, 1), lens: Lens = STANDARD) -> Camera:
    """Return a camera for a turntable: the points stay in its image while they turn about an axis along `up`.

    The axis passes through the middle of the points, and the camera's target lies on it.

    direction : (3,), from the points towards the camera; lens : field of view, size and projection

    Raises
    ------
    ValueError
        If the projection is "panorama".
    """
    if lens.projection == "panorama":
        raise ValueError("projection 'panorama' does not support turntables; use perspective or orthographic")
    axis = _unit(check_direction(up, "up"))
    low, high = np.quantile(sample.positions, [STRAY, 1.0 - STRAY], axis=0)
    middle = (low + high) / 2
    about = sample.relative_to(middle - axis * (middle @ axis))
    framed = _frame(about._replace(positions=_swept_circles(about.positions, axis)), direction, up, lens, 0.0)
    eye, view = np.asarray(framed.eye) - about.origin, np.asarray(framed.target) - np.asarray(framed.eye)
    flat = view - axis * (view @ axis)
    if flat @ flat < 1e-12 * (view @ view):  # looks along the axis: the target is on it already
        return framed
    distance = float(-(eye @ flat) / (flat @ flat))  # along the view, to its intersection with the axis
    turning = replace(framed, target=tuple(framed.eye + distance * view))
    return magnified(turning, distance) if lens.projection == "orthographic" else turning


def magnified(camera: Camera, times: float) -> Camera:
    """Return the camera with a narrower field of view, which magnifies the image of its target by `times`."""
    return replace(camera, fov=float(np.degrees(2.0 * np.arctan(np.tan(np.radians(camera.fov) / 2.0) / times))))


def _frame(sample: Sample, direction: ArrayLike, up: ArrayLike, lens: Lens, stray: float, free: Part = WHOLE) -> Camera:
    fov, (width, height), projection = lens
    Camera.look_at((0, 0, 0), (1, 0, 0), up, fov, (width, height), projection)  # checks the arguments
    forward, right, top = view_axes(-np.asarray(check_direction(direction, "direction")), np.asarray(up, np.float64))
    middle = np.median(sample.positions, axis=0)
    across, high, depth = ((sample.positions - middle) @ axis for axis in (right, top, forward))
    half = np.tan(np.radians(fov) / 2)
    sides = np.array([half * width / height, half])
    left, above, right_end, below = free
    room = sides * (right_end - left, below - above) * (1.0 - 2.0 * MARGIN)
    aim = sides * (left + right_end - 1.0, 1.0 - above - below)  # centre of the free part
    center = sample.origin + middle
    if projection == "panorama":
        level = np.cross(np.asarray(up, np.float64), right)  # a panorama is level
        return Camera.look_at(center, center + level, up, fov, (width, height), projection)
    before = -float(np.quantile(depth, stray))  # distance of the nearest point in front of the median
    extent = max(float(np.ptp(np.quantile(a, [stray, 1.0 - stray]))) for a in (across, high, depth))
    nearest = before + NEAREST * extent
    if projection == "orthographic":
        ends = [np.quantile(a, [stray, 1.0 - stray]) for a in (across, high)]
        distance = max(float(np.ptp(end)) / 2 / part for end, part in zip(ends, room, strict=True)) or 1.0
        aside, upwards = (float(end.mean() - part * distance) for end, part in zip(ends, aim, strict=True))
        eye = center + aside * right + upwards * top - max(distance, nearest) * forward
        return Camera.look_at(eye, eye + distance * forward, up, fov, (width, height), projection)
    aside, upwards, distance = _fit(np.stack([across, high]), depth, (room, aim), (nearest or 1.0, stray))
    target = center + aside * right + upwards * top
    return Camera.look_at(target - distance * forward, target, up, fov, (width, height), projection)


def _fit(
    points: Doubles, depth: Doubles, part: tuple[Doubles, Doubles], limits: tuple[float, float]
) -> tuple[float, float, float]:
    """Return the camera position at which points fill a part of the image.

    The position is to the right, upwards and backwards, relative to the origin of the points' coordinates.

    points : (2, n), coordinates to the right and upwards; depth : (n,), coordinates along the view
    part : (half sizes, centre) of the part, (2,) each, as tangents of angles from the view direction
    limits : (smallest backward position, share of the points that may lie outside at each side of the part)
    """
    (room, aim), (least, stray) = part, limits
    shift, distance = np.zeros(2), 2.0 * max(least, float(np.abs(points).max(initial=0.0)) / float(room.min()))
    for _ in range(ROUNDS):
        seen = (points - shift[:, None]) / np.maximum(depth + distance, 1e-3 * distance)
        low, high = np.quantile(seen, [stray, 1.0 - stray], axis=1)
        off, filled = (low + high) / 2 - aim, float(((high - low) / 2 / room).max())
        shift = shift + off * distance
        # The square root damps the step: points in front of the centre approach faster than the camera does.
        nearer = max(np.sqrt(filled) * distance, least) if filled > 0 else least
        done = np.abs(off / room).max() < ENOUGH and abs(nearer / distance - 1.0) < ENOUGH / 2
        distance = nearer
        if done:
            break
    return float(shift[0]), float(shift[1]), float(distance)


def _swept_circles(positions: Doubles, axis: Doubles) -> Doubles:
    """Return points, (m, 3), on the circles that a scan sweeps when it turns about an axis through the origin.

    Only the outermost circle at each height is kept, and outliers are left out.

    positions : (n, 3); axis : (3,), unit
    """
    height = positions @ axis
    radius = np.linalg.norm(positions - height[:, None] * axis, axis=1)
    low, high = np.quantile(height, [STRAY, 1.0 - STRAY])
    kept = (height >= low) & (height <= high) & (radius <= np.quantile(radius, 1.0 - 2.0 * STRAY))
    row = np.clip((height[kept] - low) / (high - low or 1.0) * PROFILE, 0, PROFILE - 1).astype(int)
    rim = np.full(PROFILE, -1.0)
    np.maximum.at(rim, row, radius[kept])
    rows = np.flatnonzero(rim >= 0)
    heights = low + (rows + 0.5) / PROFILE * (high - low)
    u = _unit(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]))
    angles = 2.0 * np.pi * np.arange(CIRCLE) / CIRCLE
    circle = np.cos(angles)[:, None] * u + np.sin(angles)[:, None] * np.cross(axis, u)
    rim = rim[rows] / np.cos(np.pi / CIRCLE)  # circumscribed polygon
    return np.asarray((rim[:, None, None] * circle + heights[:, None, None] * axis).reshape(-1, 3))


def _unit(vector: ArrayLike) -> Doubles:
    array = np.asarray(vector, np.float64)
    return np.asarray(array / np.linalg.norm(array))
