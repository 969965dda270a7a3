"""Cameras: from a pixel to a ray."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = tuple[float, float, float]

SIZE = (640, 480)
LARGEST = 32768  # pixels a side
MARGIN = 1.05  # how much larger than a framed box the picture is
THREE_QUARTER = (0.45, -1.0, 0.35)  # from the front, a little to the right and above


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera; make it with `look_at` or `frame`.

    Attributes
    ----------
    eye, target : (3,) float
        World coordinates.
    up : (3,) float
        Which way is up in the picture; need not be perpendicular to the view.
    fov : float
        Vertical field of view, degrees.
    size : (2,) int
        Width and height in pixels.
    """

    eye: Vector
    target: Vector
    up: Vector = (0.0, 0.0, 1.0)
    fov: float = 40.0
    size: tuple[int, int] = SIZE
    projection: str = "perspective"

    def __post_init__(self) -> None:
        checked = {
            "eye": _check_vector(self.eye, "eye"),
            "target": _check_vector(self.target, "target"),
            "up": _check_vector(self.up, "up"),
            "fov": _check_fov(self.fov),
            "size": _check_size(self.size),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if self.projection != "perspective":
            raise ValueError(f"unknown projection {self.projection!r}: only 'perspective' is known")
        if self.eye == self.target:
            raise ValueError(f"eye and target are the same point, {self.eye}: there is no direction to look in")
        if not any(self.up):
            raise ValueError("up must not be zero")

    @classmethod
    def look_at(
        cls,
        eye: ArrayLike,
        target: ArrayLike,
        up: ArrayLike = (0, 0, 1),
        fov: float = 40,
        size: tuple[int, int] = SIZE,
        projection: str = "perspective",
    ) -> Camera:
        """A camera at `eye` that has `target` in the middle of its picture.

        Parameters
        ----------
        eye, target : (3,) array_like
            World coordinates.
        up : (3,) array_like
            Which way is up in the picture; where it is parallel to the view, another axis is taken.
        fov : float
            Vertical field of view, degrees, between 0 and 180.
        size : (int, int)
            Width and height in pixels, 1 to 32768.
        projection : {"perspective"}

        Raises
        ------
        ValueError
            If eye and target are the same, or a value is not finite or out of its range.
        """
        return cls(eye, target, up, fov, size, projection)  # type: ignore[arg-type]  # checked and converted there

    @classmethod
    def frame(
        cls,
        bounds: ArrayLike,
        direction: ArrayLike | None = None,
        fov: float = 40,
        size: tuple[int, int] = SIZE,
        up: ArrayLike = (0, 0, 1),
    ) -> Camera:
        """A camera that sees a whole box, as large as fits with a margin of 5%.

        Parameters
        ----------
        bounds : (2, 3) array_like
            Least and greatest world coordinates; a box without size is seen from one unit away.
        direction : (3,) array_like
            From the box towards the camera. Default: from the front, a little from the right and from above, whichever
            way is `up`; the front is -y where z is up, and +z where y is.
        fov, size, up
            As for `look_at`.
        """
        box = np.asarray(bounds, np.float64)
        if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] > box[1]).any():
            raise ValueError(f"bounds must be finite, (2, 3), the least row first, not {box.tolist()}")
        middle = (box[0] + box[1]) / 2
        above = np.asarray(_check_vector(up, "up"))
        towards = _upright(above) if direction is None else np.asarray(_check_vector(direction, "direction"))
        if not towards.any():
            raise ValueError("direction must not be zero")
        forward, right, top = _axes(-towards, above)
        width, height = _check_size(size)
        half = np.tan(np.radians(_check_fov(fov)) / 2) / MARGIN
        corners = np.stack(np.meshgrid(*(box - middle).T), axis=-1).reshape(-1, 3)
        depth = corners @ forward
        across, far_across = _fit(corners @ right, depth, half * width / height)
        upwards, far_up = _fit(corners @ top, depth, half)
        nearest = float(-depth.min())  # the eye stays in front of this corner, also where the box is only a line
        distance = max(far_across, far_up, MARGIN * nearest) or 1.0
        aim = middle + across * right + upwards * top
        return cls.look_at(aim - distance * forward, aim, up, fov, size)

    @property
    def basis(self) -> NDArray[np.float64]:
        """What kernels take, (4, 3) float64: eye, forward, right, up.

        The ray through (u, v), both -1 to 1 from left to right and from bottom to top, has the direction
        forward + u right + v up, not normalised.
        """
        eye = np.asarray(self.eye)
        forward, right, up = _axes(np.asarray(self.target) - eye, np.asarray(self.up))
        width, height = self.size
        half = np.tan(np.radians(self.fov) / 2)
        return np.stack([eye, forward, right * (half * width / height), up * half])

    def rays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The ray through the middle of each pixel.

        Returns
        -------
        origins : (h, w, 3) float64
        directions : (h, w, 3) float64
            Unit; row 0 is the top of the picture.
        """
        eye, forward, right, up = self.basis
        width, height = self.size
        u = (2 * np.arange(width) + 1) / width - 1
        v = 1 - (2 * np.arange(height) + 1) / height
        directions = forward + u[None, :, None] * right + v[:, None, None] * up
        directions /= np.linalg.norm(directions, axis=2, keepdims=True)
        return np.broadcast_to(eye, directions.shape).copy(), directions


def _fit(offset: NDArray[np.float64], depth: NDArray[np.float64], half: float) -> tuple[float, float]:
    """Where along one axis a camera stands, and how far back, so that all corners lie within its two side planes."""
    high, low = np.max(offset - depth * half), np.max(-offset - depth * half)
    return float(high - low) / 2, float(high + low) / (2 * half)


def _axes(view: NDArray[np.float64], up: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Unit vectors forward, right and up."""
    forward = _unit(view)
    # Straight down, the picture's top is +y, as on a map.
    for choice in (_unit(up), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])):
        right = np.cross(forward, choice)
        if np.linalg.norm(right) > 1e-6:
            break
    right = _unit(right)
    return forward, right, np.cross(right, forward)


def _upright(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """THREE_QUARTER, turned the shortest way that takes z to up; about x where that is down."""
    way, up = np.array(THREE_QUARTER), _unit(up) if up.any() else up
    if np.abs(up[:2]).max() < 1e-6:
        return way if up[2] >= 0 else way * (1.0, -1.0, -1.0)
    half = up + (0.0, 0.0, 1.0)
    return np.asarray(way - (half @ way) / (1.0 + up[2]) * half + 2.0 * way[2] * up)


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    scaled = vector / np.abs(vector).max()  # the square of 1e-200 is 0
    return np.asarray(scaled / np.linalg.norm(scaled))


def _check_vector(value: Any, name: str) -> Vector:
    try:
        x, y, z = (float(part) for part in value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be three numbers, not {value!r}") from None
    if not np.isfinite([x, y, z]).all():
        raise ValueError(f"{name} must be finite, not {(x, y, z)}")
    return x, y, z


def _check_fov(fov: float) -> float:
    if not isinstance(fov, int | float | np.number) or not 0 < fov < 180:  # false for NaN
        raise ValueError(f"fov must lie between 0 and 180 degrees, not {fov}")
    return float(fov)


def _check_size(size: Any) -> tuple[int, int]:
    try:
        width, height = (operator.index(side) for side in size)
    except (TypeError, ValueError):
        raise ValueError(f"size must be two whole numbers, width and height, not {size!r}") from None
    if not (1 <= width <= LARGEST and 1 <= height <= LARGEST):
        raise ValueError(f"size must be 1 to {LARGEST} pixels a side, not {width}x{height}")
    return width, height
