"""`Camera`, and its rays."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import (
    Vector,
    check_choice,
    check_direction,
    check_kind,
    check_number,
    check_numbers,
    check_position,
    wrong,
)
from ..base.choices import PROJECTIONS, number_of
from ..engine.kernels import records as rec

SIZE = (640, 480)
LARGEST = 32768  # pixels a side
MARGIN = 1.05  # size of the image relative to a framed box
THREE_QUARTER = (0.45, -1.0, 0.35)  # default direction of `frame`: front, slightly right and above


@dataclass(frozen=True, slots=True)
class Camera:
    """Perspective, orthographic or panoramic camera; created by `look_at` or `frame`, which describe the parameters.

    Parameters
    ----------
    eye, target : (3,) float
        World coordinates.
    up : (3,) float
        Up direction of the image; need not be perpendicular to the view.
    fov : float
        Vertical field of view, degrees, between 0 and 180.
    size : (2,) int
        Width and height in pixels, 1 to 32768.
    projection : {"perspective", "orthographic", "panorama"}
    aperture : float
        Diameter of the lens in world units; 0: pinhole.
    focus : float, optional
        Distance of the plane in focus along the view; None: the target's distance.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If eye and target are the same, a panorama has an aperture, or a value is out of its range.

    Examples
    --------
    >>> camera = pr.Camera(eye=(0, -5, 1), target=(0, 0, 0), size=(320, 240))
    >>> camera.fov, camera.projection
    (40.0, 'perspective')
    """

    eye: Vector
    target: Vector
    up: Vector = (0.0, 0.0, 1.0)
    fov: float = 40.0
    size: tuple[int, int] = SIZE
    projection: str = "perspective"
    aperture: float = 0.0
    focus: float | None = None

    def __post_init__(self) -> None:
        checked = {
            "eye": check_position(self.eye, "eye"),
            "target": check_position(self.target, "target"),
            "up": check_direction(self.up, "up"),
            "fov": _check_fov(self.fov),
            "size": _check_size(self.size),
            "projection": _check_projection(self.projection),
            "aperture": _check_aperture(self.aperture, self.projection),
            "focus": _check_focus(self.focus),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if self.eye == self.target:
            raise ValueError(f"eye and target are the same point, {self.eye}: the view has no direction")

    @classmethod
    def look_at(
        cls,
        eye: ArrayLike,
        target: ArrayLike,
        up: ArrayLike = (0, 0, 1),
        fov: float = 40,
        size: tuple[int, int] = SIZE,
        projection: str = "perspective",
        aperture: float = 0.0,
        focus: float | None = None,
    ) -> Camera:
        """Create a camera at `eye` with `target` in the centre of the image.

        Parameters
        ----------
        eye, target : (3,) array_like
            World coordinates.
        up : (3,) array_like
            Up direction of the image; if it is parallel to the view, +y is used, else +x.
        fov : float
            Vertical field of view, degrees, between 0 and 180; ignored for a panorama.
        size : (int, int)
            Width and height in pixels, 1 to 32768.
        projection : {"perspective", "orthographic", "panorama"}
            Orthographic: parallel rays from the plane through the eye perpendicular to the view; geometry behind it is
            not visible. The image height is that of the perspective image at the target, 2 tan(fov / 2) times the
            distance of eye and target, so that the projections are interchangeable.
            Panorama: the sphere around the eye, equirectangular, 360 by 180 degrees, with the target in the centre and
            `up`, made perpendicular to the view, at the upper edge. The size 2 : 1 gives equal degrees a pixel.
        aperture : float
            Diameter of the lens in world units, not negative; 0: pinhole. A thin lens spreads a point at distance z
            along the view over a disc of diameter aperture abs(z - focus) / focus, in world units at its distance
            (circle of confusion). In an orthographic image each ray has such a lens around its origin; a panorama has
            none. The blur needs several samples a pixel.
        focus : float, optional
            Distance of the plane in focus along the view, positive, may be inf; None: the target's distance.

        Returns
        -------
        Camera

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            If eye and target are the same, a panorama has an aperture, or a value is out of its range.

        Examples
        --------
        >>> camera = pr.Camera.look_at((0, -5, 1), (0, 0, 0), fov=35, size=(320, 240))
        >>> camera.eye
        (0.0, -5.0, 1.0)
        """
        return cls(eye, target, up, fov, size, projection, aperture, focus)  # type: ignore[arg-type]  # checked there

    @classmethod
    def frame(
        cls,
        bounds: ArrayLike,
        direction: ArrayLike | None = None,
        fov: float = 40,
        size: tuple[int, int] = SIZE,
        up: ArrayLike = (0, 0, 1),
        projection: str = "perspective",
    ) -> Camera:
        """Create a camera that frames a box with a margin of 5%; for a panorama, a camera at the centre of the box.

        Parameters
        ----------
        bounds : (2, 3) array_like
            Minimum and maximum world coordinates; a box of zero size is viewed from one unit away.
        direction : (3,) array_like, optional
            From the box towards the camera. Default: from the front, slightly from the right and above, relative to
            `up`; the front is -y if z is up, and +z if y is up. A panorama looks horizontally, the opposite way.
        fov : float
            Vertical field of view, degrees, between 0 and 180. The eye of an orthographic camera stays outside the box:
            with a wide `fov` the target, whose distance gives the image height, is in front of the box's centre.
        size : (int, int)
            Width and height in pixels, 1 to 32768.
        up : (3,) array_like
            Up direction of the image.
        projection : {"perspective", "orthographic", "panorama"}

        Returns
        -------
        Camera

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            If a value is not finite or out of its range, or up or direction is zero.

        Examples
        --------
        >>> camera = pr.Camera.frame([(-1, -1, -1), (1, 1, 1)], direction=(0, -1, 0), size=(320, 240))
        >>> np.round(camera.target, 6).tolist()
        [0.0, 0.0, 0.0]
        """
        box = check_numbers(bounds, "bounds").astype(np.float64)
        if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] > box[1]).any():
            raise ValueError(f"bounds must be finite, (2, 3), the minimum first, not {box.tolist()}")
        middle = (box[0] + box[1]) / 2
        above = np.asarray(check_direction(up, "up"))
        towards = _upright(above) if direction is None else np.asarray(check_direction(direction, "direction"))
        forward, right, top = view_axes(-towards, above)
        width, height = _check_size(size)
        half = np.tan(np.radians(_check_fov(fov)) / 2) / MARGIN
        corners = np.stack(np.meshgrid(*(box - middle).T), axis=-1).reshape(-1, 3)
        depth = corners @ forward
        nearest = float(-depth.min())  # the eye stays in front of this corner, even if the box is only a line
        if _check_projection(projection) == "panorama":
            ahead = np.cross(unit(above), right) * (nearest or 1.0)
            return cls.look_at(middle, middle + ahead, up, fov, size, projection)
        if projection == "orthographic":
            tall = max(np.abs(corners @ right).max() * height / width, np.abs(corners @ top).max())
            distance = float(tall / half) or MARGIN * nearest or 1.0
            eye = middle - max(distance, MARGIN * nearest) * forward
            return cls.look_at(eye, eye + distance * forward, up, fov, size, projection)
        across, far_across = _fit(corners @ right, depth, half * width / height)
        upwards, far_up = _fit(corners @ top, depth, half)
        distance = max(far_across, far_up, MARGIN * nearest) or 1.0
        aim = middle + across * right + upwards * top
        return cls.look_at(aim - distance * forward, aim, up, fov, size)

    def record(self) -> NDArray[np.float64]:
        """Return the camera as kernels read it, (16,) float64: eye, axes, projection and lens, see `records.CAMERA`."""
        out = np.zeros(rec.CAMERA)
        eye = np.asarray(self.eye)
        forward, right, up = view_axes(np.asarray(self.target) - eye, np.asarray(self.up))
        width, height = self.size
        distance = math.dist(self.eye, self.target)
        half = np.tan(np.radians(self.fov) / 2) * (distance if self.projection == "orthographic" else 1.0)
        across, upward = (1.0, 1.0) if self.projection == "panorama" else (half * width / height, half)
        out[rec.EYE : rec.EYE + 3], out[rec.FORWARD : rec.FORWARD + 3] = eye, forward
        out[rec.ACROSS : rec.ACROSS + 3], out[rec.UPWARD : rec.UPWARD + 3] = right * across, up * upward
        out[rec.PROJECTION] = number_of(PROJECTIONS, self.projection)
        out[rec.LENS_RADIUS], out[rec.NEARNESS] = self.aperture / 2, 1 / (self.focus or distance)
        return out

    def rays(self, rows: slice = slice(None)) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rays through the centre of each pixel and of the lens.

        Parameters
        ----------
        rows : slice
            Rows of the image; h is their number. Default: all.

        Returns
        -------
        origins : (h, w, 3) float64
            In world space.
        directions : (h, w, 3) float64
            In world space, of unit length; row 0 is the top of the image.

        Raises
        ------
        TypeError
            If an argument has the wrong type.

        Examples
        --------
        >>> camera = pr.Camera.look_at((0, -5, 0), (0, 0, 0), size=(3, 3))
        >>> origins, directions = camera.rays()
        >>> directions[1, 1].round(6).tolist()
        [0.0, 1.0, 0.0]
        """
        check_kind(rows, "rows", slice, "a slice")
        width, height = self.size
        u = ((2 * np.arange(width) + 1) / width - 1)[None, :]
        v = (1 - (2 * np.arange(height)[rows] + 1) / height)[:, None]
        return self.rays_through(u, v)

    def rays_through(self, u: Any, v: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rays through points of the image and the centre of the lens.

        Parameters
        ----------
        u, v : (...) array_like of float
            Broadcast against each other: -1 at the left edge to 1 at the right edge, and -1 at the bottom to 1 at the
            top.

        Returns
        -------
        origins, directions : (..., 3) float64
            In world space; directions have unit length.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            If `u` and `v` do not broadcast.

        Examples
        --------
        >>> camera = pr.Camera.look_at((0, -5, 0), (0, 0, 0))
        >>> origins, directions = camera.rays_through(0, [-0.5, 0.5])
        >>> directions.shape
        (2, 3)
        """
        record = self.record()
        eye, forward, right, up = (record[k : k + 3] for k in (rec.EYE, rec.FORWARD, rec.ACROSS, rec.UPWARD))
        u, v = (check_numbers(a, name).astype(np.float64)[..., None] for a, name in ((u, "u"), (v, "v")))
        try:
            np.broadcast_shapes(u.shape, v.shape)
        except ValueError:
            raise ValueError(f"u and v do not broadcast: {u.shape[:-1]} and {v.shape[:-1]}") from None
        if record[rec.PROJECTION] == rec.ORTHOGRAPHIC:
            origins = eye + u * right + v * up
            return origins, np.broadcast_to(forward, origins.shape).copy()
        if record[rec.PROJECTION] == rec.PANORAMA:
            turn, tilt = np.pi * u, np.pi / 2 * v
            directions = np.cos(tilt) * (np.cos(turn) * forward + np.sin(turn) * right) + np.sin(tilt) * up
        else:
            directions = forward + u * right + v * up
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.broadcast_to(eye, directions.shape).copy(), directions


def _fit(offset: NDArray[np.float64], depth: NDArray[np.float64], half: float) -> tuple[float, float]:
    """Return where the nearest camera stands whose view encloses a box between two opposite side planes of the view.

    Returns the camera's position along one image axis, and its distance backwards along the view, both from the centre
    of the box. The side planes are those that limit the image on this axis.

    offset, depth : (8,), coordinates of the box's corners along the axis and along the view, from the box's centre
    half : tangent of half the field of view along the axis
    """
    high, low = np.max(offset - depth * half), np.max(-offset - depth * half)
    return float(high - low) / 2, float(high + low) / (2 * half)


def view_axes(view: NDArray[np.float64], up: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Return the unit vectors forward, right and up of a camera, (3,) float64 each.

    view : from the eye to the target, of any length; up : need not be perpendicular to it; if parallel, +y is used,
        else +x
    """
    forward = unit(view)
    # Looking straight down, +y is up, as on a map.
    for choice in (unit(up), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])):
        right = np.cross(forward, choice)
        if np.linalg.norm(right) > 1e-6:
            break
    right = unit(right)
    return forward, right, np.cross(right, forward)


def _upright(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the default direction from a framed box to the camera, adapted to an up vector.

    THREE_QUARTER, which is meant for z up, is rotated by the smallest rotation from z to `up`; about x if `up` is -z.
    """
    direction, up = np.array(THREE_QUARTER), unit(up)
    if np.abs(up[:2]).max() < 1e-6:
        return direction if up[2] >= 0 else direction * (1.0, -1.0, -1.0)
    half = up + (0.0, 0.0, 1.0)
    return np.asarray(direction - (half @ direction) / (1.0 + up[2]) * half + 2.0 * direction[2] * up)


def unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normalize a vector, (3,); the squares of tiny components do not underflow."""
    scaled = vector / np.abs(vector).max()  # avoids underflow of squares
    return np.asarray(scaled / np.linalg.norm(scaled))


def _check_fov(fov: Any) -> float:
    return check_number(fov, "fov", "a number of degrees between 0 and 180", lambda x: 0 < x < 180)


def _check_projection(projection: Any) -> str:
    return check_choice(projection, "projection", PROJECTIONS)


def _check_aperture(aperture: Any, projection: str) -> float:
    width = check_number(aperture, "aperture", "a finite number, not negative", lambda x: 0 <= x < np.inf)
    if width and projection == "panorama":
        raise ValueError("aperture must be 0 for a panorama, which has no lens")
    return width


def _check_focus(focus: Any) -> float | None:
    return None if focus is None else check_number(focus, "focus", "a positive distance, or None", lambda x: x > 0)


def _check_size(size: Any) -> tuple[int, int]:
    wanted = "two whole numbers, width and height"
    sides = check_numbers(size, "size", wanted)
    if sides.shape != (2,) or sides.dtype.kind == "f":
        raise wrong("size", wanted, size)
    width, height = map(int, sides)
    if not (1 <= width <= LARGEST and 1 <= height <= LARGEST):
        raise ValueError(f"size must be 1 to {LARGEST} pixels a side, not {width}x{height}")
    return width, height
