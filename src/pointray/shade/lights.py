"""Lights. Colours are linear RGB; a number means grey."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..records import LIGHT, LIGHT_KIND, LIGHT_PLACE, LIGHT_POWER, POINT_LIGHT, SUN_LIGHT


def vector(value: ArrayLike, name: str) -> NDArray[np.float64]:
    """Three finite numbers."""
    array = np.asarray(value, np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ValueError(f"{name} must be three finite numbers, not {value!r}")
    return array


def rgb(value: ArrayLike, name: str) -> NDArray[np.float64]:
    """RGB of a number or of three, finite and not negative."""
    try:
        array = np.broadcast_to(np.asarray(value, np.float64), (3,)).copy()
    except (ValueError, TypeError):
        raise ValueError(f"{name} must be a number or three (red, green, blue), not {value!r}") from None
    if not np.isfinite(array).all() or (array < 0).any():
        raise ValueError(f"{name} must be finite and not negative, not {value!r}")
    return array


@dataclass(frozen=True)
class PointLight:
    """A light of no size at a place; irradiance falls with the square of the distance.

    Parameters
    ----------
    position : (3,) float, world
    intensity : float or (3,) float
        Radiant intensity, W/sr.
    """

    position: ArrayLike
    intensity: ArrayLike

    def record(self) -> NDArray[np.float64]:
        """The light as kernels read it, (8,) float64."""
        out = np.zeros(LIGHT)
        out[LIGHT_KIND] = POINT_LIGHT
        out[LIGHT_PLACE : LIGHT_PLACE + 3] = vector(self.position, "position")
        out[LIGHT_POWER : LIGHT_POWER + 3] = rgb(self.intensity, "intensity")
        return out


@dataclass(frozen=True)
class SunLight:
    """Parallel light with hard shadows.

    Parameters
    ----------
    direction : (3,) float, world
        The way the light travels.
    irradiance : float or (3,) float
        On a surface that faces it, W/m2. A white diffuse surface under irradiance pi has radiance 1.
    """

    direction: ArrayLike
    irradiance: ArrayLike = np.pi

    def record(self) -> NDArray[np.float64]:
        """The light as kernels read it, (8,) float64."""
        direction = vector(self.direction, "direction")
        length = np.linalg.norm(direction)
        if length == 0:
            raise ValueError("direction must not be zero")
        out = np.zeros(LIGHT)
        out[LIGHT_KIND] = SUN_LIGHT
        out[LIGHT_PLACE : LIGHT_PLACE + 3] = direction / length
        out[LIGHT_POWER : LIGHT_POWER + 3] = rgb(self.irradiance, "irradiance")
        return out
