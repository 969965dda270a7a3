"""Lights as the panel shows them: with angles, sRGB colours and a switch."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..auto_view.direction import angles_of, direction_of
from ..base.arguments import Vector, rgb
from ..base.choices import LIGHTS
from ..image.tone import linear_to_srgb, srgb_to_linear
from ..scene.scene import Scene
from ..shade.environment import EnvironmentLight
from ..shade.lights import Light, PointLight, SunLight

Color = tuple[float, float, float]

SUN, POINT, SKY = LIGHTS
OWN = "own"
DEFAULT_STRENGTH = 3.0  # irradiance of a new sun, and of a new point light at the model's middle
MAX_LIGHTS = 32  # rows of lights in the panel: it cannot add more
POINT_LIGHT_DISTANCE = 1.2  # share of the model's diagonal: distance of a new point light from its middle


@dataclass(frozen=True)
class LightControl:
    """A light that the panel can change; a light of any other kind can only be switched off.

    Attributes
    ----------
    kind : str
    color : (3,) sRGB
        The brightest channel is 1.
    strength : float
        Irradiance of a sun, radiant intensity of a point light, radiance of a sky.
    azimuth, elevation : float
        Degrees, direction to a sun in the axes that `up` gives: 0 is the front, 90 to the right.
    angle : float
        Degrees, diameter of a sun's disk.
    position : (3,) world, for a point light
    camera : bool
        Whether it follows the camera: angles are about the camera's axes, the position is relative to the camera.
    light : for kind "own": a light of the scene, unchanged
    first : the light whose values these were at first
        While they are, that light is taken: values that were converted differ in their last bits, and baked light would
        no longer fit.
    """

    kind: str
    color: Color = (1.0, 1.0, 1.0)
    strength: float = DEFAULT_STRENGTH
    azimuth: float = 30.0
    elevation: float = 45.0
    angle: float = 0.53
    position: Vector = (0.0, 0.0, 0.0)
    light: Light | EnvironmentLight | None = None
    on: bool = True
    camera: bool = False
    original: Light | EnvironmentLight | None = field(default=None, compare=False)

    def make(self, up: Vector) -> Light | EnvironmentLight:
        """The light with these values."""
        if self.light is not None:
            return self.light
        if self.original is not None and self == _control_of(self.original, up):
            return self.original
        power = srgb_to_linear(np.array(self.color, np.float64)) * self.strength
        if self.kind == SUN:
            return SunLight(-direction_of(self.azimuth, self.elevation, self._up(up)), power, self.angle, self.camera)
        if self.kind == POINT:
            return PointLight(self.position, power, self.camera)
        return EnvironmentLight(power, up=up)

    def _up(self, up: Vector) -> Vector:
        """The axis that its angles are about."""
        return (0.0, 1.0, 0.0) if self.camera else up


def new_light_control(kind: str, scene: Scene, up: Vector) -> LightControl:
    """A new light with initial values."""
    if kind != POINT:
        return LightControl(kind, strength=DEFAULT_STRENGTH if kind == SUN else 1.0)
    low, high = scene.bounds
    away = POINT_LIGHT_DISTANCE * float(np.linalg.norm(high - low))
    x, y, z = ((low + high) / 2 + away * direction_of(-40.0, 40.0, up)).tolist()
    return LightControl(POINT, strength=DEFAULT_STRENGTH * away * away, position=(x, y, z))


def light_controls_of(scene: Scene, up: Vector) -> tuple[LightControl, ...]:
    """The controls of a scene's lights."""
    return controls_of(scene.lights, up)


def controls_of(lights: Iterable[Light | EnvironmentLight], up: Vector) -> tuple[LightControl, ...]:
    """The controls of lights."""
    return tuple(_control_of(light, up) for light in lights)


def _control_of(light: Light | EnvironmentLight, up: Vector) -> LightControl:
    if isinstance(light, SunLight):
        color, strength = _split(light.irradiance)
        about = (0.0, 1.0, 0.0) if light.camera else up
        azimuth, elevation = angles_of(-np.asarray(light.direction, np.float64), about)
        return LightControl(
            SUN, color, strength, azimuth, elevation, float(light.angle), camera=light.camera, original=light
        )
    if isinstance(light, PointLight):
        color, strength = _split(light.intensity)
        x, y, z = np.asarray(light.position, np.float64).tolist()
        return LightControl(POINT, color, strength, position=(x, y, z), camera=light.camera, original=light)
    return LightControl(OWN, light=light)


def _split(power: Any) -> tuple[Color, float]:
    """Colour (sRGB) and strength of a power."""
    values = rgb(power, "power")
    strength = float(values.max()) or 1.0
    r, g, b = linear_to_srgb(values / strength).tolist()
    return (r, g, b), strength if values.max() > 0 else 0.0
