"""Lights with a position or a direction. Colours are linear RGB, or a number for grey. Flat lights are one-sided."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.arguments import LEAST_LENGTH, check_flag, check_number, rgb, unit_vector, vector
from ..engine.kernels import records as rec


def length_of(value: float, name: str) -> float:
    """Validate a length given as a parameter: return it as float; raise an error unless it is positive and finite."""
    return check_number(value, name, "a positive length", lambda x: LEAST_LENGTH < x < np.inf)


class _Checked:
    """Base class of lights, which validates the parameters when a light is constructed."""

    def __post_init__(self) -> None:
        self.record()

    def record(self) -> NDArray[np.float64]:
        """Return the light's record for kernels, (18,) float64, see `records.LIGHT`.

        Raises
        ------
        ValueError
            If a parameter is out of range.
        """
        raise NotImplementedError


def _record(kind: int, position: NDArray[np.float64], power: NDArray[np.float64]) -> NDArray[np.float64]:
    out = np.zeros(rec.LIGHT)
    out[rec.LIGHT_KIND] = kind
    out[rec.LIGHT_POSITION : rec.LIGHT_POSITION + 3], out[rec.LIGHT_POWER : rec.LIGHT_POWER + 3] = position, power
    return out


def _flat_record(
    kind: int, center: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64], radiance: ArrayLike
) -> NDArray[np.float64]:
    """Return the record for kernels of a rectangle or disk spanned by u and v, which emits on the side of u x v.

    kind : RECT_LIGHT or DISK_LIGHT; u, v : (3,), from the centre to the edge. The record is (18,), see `records.LIGHT`.
    """
    out = _record(kind, center, rgb(radiance, "radiance"))
    cross = np.cross(u, v)
    out[rec.LIGHT_U : rec.LIGHT_U + 3], out[rec.LIGHT_V : rec.LIGHT_V + 3] = u, v
    out[rec.LIGHT_FACING : rec.LIGHT_FACING + 3] = cross / np.linalg.norm(cross)
    out[rec.LIGHT_AREA] = np.linalg.norm(cross) * (4.0 if kind == rec.RECT_LIGHT else np.pi)
    return out


@dataclass(frozen=True)
class PointLight(_Checked):
    """Point light; irradiance falls with the square of the distance.

    Parameters
    ----------
    position : (3,) float
        World space.
    intensity : float or (3,) float
        Radiant intensity, W/sr; linear RGB, or a number for grey.
    camera : bool
        Attach the light to the camera: the position is then relative to the eye, (right, up, backward).

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is not finite or out of its range.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> scene.add_light(pr.PointLight(position=(2, -3, 4), intensity=20.0))
    0
    """

    position: ArrayLike
    intensity: ArrayLike
    camera: bool = False

    def record(self) -> NDArray[np.float64]:
        """Return the light's record for kernels, (18,) float64: kind, position, intensity, see `records.LIGHT`."""
        check_flag(self.camera, "camera")
        return _record(rec.POINT_LIGHT, vector(self.position, "position"), rgb(self.intensity, "intensity"))


@dataclass(frozen=True)
class SunLight(_Checked):
    """Directional light, from a disk at infinity.

    Parameters
    ----------
    direction : (3,) float
        World direction in which the light travels.
    irradiance : float or (3,) float
        Irradiance of a surface that faces the light, W/m2; linear RGB, or a number for grey. A white diffuse surface
        under irradiance pi has radiance 1.
    angle : float
        Angular diameter of the disk, degrees, 0 to 180, which softens shadows of "path" and "baked". The sun has 0.53.
    camera : bool
        Attach the light to the camera: the direction is then (right, up, backward).

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is not finite or out of its range.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> scene.add_light(pr.SunLight(direction=(1, 1, -1.2), angle=2.0))
    0
    """

    direction: ArrayLike
    irradiance: ArrayLike = np.pi
    angle: float = 0.53
    camera: bool = False

    def record(self) -> NDArray[np.float64]:
        """Return the light's record for kernels, (18,) float64: kind, direction, irradiance, see `records.LIGHT`."""
        check_flag(self.camera, "camera")
        angle = check_number(self.angle, "angle", "from 0 to 180 degrees", lambda x: 0 <= x <= 180)
        out = _record(rec.SUN_LIGHT, unit_vector(self.direction, "direction"), rgb(self.irradiance, "irradiance"))
        out[rec.LIGHT_RADIUS] = 2.0 * np.sin(np.radians(angle) / 4.0) ** 2
        return out


@dataclass(frozen=True)
class RectLight(_Checked):
    """Diffuse area light, a parallelogram that emits on the side of u x v.

    Parameters
    ----------
    center : (3,) float
        World space.
    u, v : (3,) float
        From the centre to the midpoints of two edges; not parallel.
    radiance : float or (3,) float
        W/(m2 sr); linear RGB, or a number for grey.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is not finite or out of its range, or u and v are parallel.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> scene.add_light(pr.RectLight(center=(0, 0, 3), u=(1, 0, 0), v=(0, -1, 0), radiance=5.0))
    0
    """

    center: ArrayLike
    u: ArrayLike
    v: ArrayLike
    radiance: ArrayLike

    def record(self) -> NDArray[np.float64]:
        """Return the light's record for kernels, (18,) float64: kind, geometry, radiance, see `records.LIGHT`."""
        u, v = vector(self.u, "u"), vector(self.v, "v")
        across = np.cross(unit_vector(u, "u"), unit_vector(v, "v"))
        if np.linalg.norm(across) < 1e-9:
            raise ValueError(f"u and v must not be parallel: the light has no area ({self.u!r}, {self.v!r})")
        return _flat_record(rec.RECT_LIGHT, vector(self.center, "center"), u, v, self.radiance)


@dataclass(frozen=True)
class DiskLight(_Checked):
    """Diffuse area light, a disk that emits on the side of its normal.

    Parameters
    ----------
    center, normal : (3,) float
        World space.
    radius : float
        World units, positive.
    radiance : float or (3,) float
        W/(m2 sr); linear RGB, or a number for grey.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is not finite or out of its range.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> scene.add_light(pr.DiskLight(center=(0, 0, 3), normal=(0, 0, -1), radius=0.5, radiance=(5, 4, 3)))
    0
    """

    center: ArrayLike
    normal: ArrayLike
    radius: float
    radiance: ArrayLike

    def record(self) -> NDArray[np.float64]:
        """Return the light's record for kernels, (18,) float64: kind, geometry, radiance, see `records.LIGHT`."""
        normal, radius = unit_vector(self.normal, "normal"), length_of(self.radius, "radius")
        u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        u *= radius / np.linalg.norm(u)
        return _flat_record(rec.DISK_LIGHT, vector(self.center, "center"), u, np.cross(normal, u), self.radiance)


@dataclass(frozen=True)
class SphereLight(_Checked):
    """Diffuse area light, a sphere that emits outwards.

    Parameters
    ----------
    center : (3,) float
        World space.
    radius : float
        World units, positive.
    radiance : float or (3,) float
        W/(m2 sr); linear RGB, or a number for grey.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is not finite or out of its range.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> scene.add_light(pr.SphereLight(center=(0, -2, 3), radius=0.1, radiance=50.0))
    0
    """

    center: ArrayLike
    radius: float
    radiance: ArrayLike

    def record(self) -> NDArray[np.float64]:
        """Return the light's record for kernels, (18,) float64: kind, geometry, radiance, see `records.LIGHT`."""
        out = _record(rec.SPHERE_LIGHT, vector(self.center, "center"), rgb(self.radiance, "radiance"))
        out[rec.LIGHT_RADIUS] = radius = length_of(self.radius, "radius")
        out[rec.LIGHT_AREA] = 4.0 * np.pi * radius * radius
        return out


def follows_camera(light: object) -> bool:
    """Return whether a light is attached to the camera."""
    return isinstance(light, PointLight | SunLight) and light.camera


def fixed(light: Light, eye: NDArray[np.float64], axes: NDArray[np.float64]) -> Light:
    """Return a light that is attached to the camera as a light in world space; other lights are returned as they are.

    eye : (3,), position of the camera; axes : (3, 3), rows: its right, up and backward directions in world space
    """
    if isinstance(light, SunLight) and light.camera:
        return replace(light, direction=vector(light.direction, "direction") @ axes, camera=False)
    if isinstance(light, PointLight) and light.camera:
        return replace(light, position=eye + vector(light.position, "position") @ axes, camera=False)
    return light


Light = PointLight | SunLight | RectLight | DiskLight | SphereLight
