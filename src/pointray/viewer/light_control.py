"""Lights as the panel shows them: angles, sRGB colours and a switch."""

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
DEFAULT_STRENGTH = 3.0  # irradiance of a new sun, or of a new point light at the model's center
MAX_LIGHTS = 32  # limit for lights in the panel
POINT_LIGHT_DISTANCE = 1.2  # from the model's center, in diagonals of its bounds


@dataclass(frozen=True)
class LightControl:
    """A light as the panel edits it. Lights of kind "own" can only be switched on and off.

    Attributes
    ----------
    kind : str
        "sun", "point", "sky" (uniform light from all directions) or "own".
    color : (3,) sRGB
        The largest channel is 1.
    strength : float
        Irradiance of a sun, radiant intensity of a point light, radiance of a sky.
    azimuth, elevation : float
        Direction to a sun in degrees, about the scene's up direction: azimuth 0 is the front, 90 the right.
    angle : float
        Diameter of a sun's disk in degrees.
    position : (3,) of a point light, world coordinates
    on : bool
        Whether the light is switched on.
    camera : bool
        Whether the light is fixed to the camera; angles and position then are in camera space.
    light : for kind "own": the light of the scene, unchanged
    original : the light from which these values were read
        `make` returns it while the values are unchanged: converted values differ in the last bits, and baked light
        would no longer fit.
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
        """Return a light for `Scene.lights` with these values. up : the scene's up direction"""
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
        """Return the axis about which the angles are measured: y for camera space, else the scene's up direction."""
        return (0.0, 1.0, 0.0) if self.camera else up


def new_light_control(kind: str, scene: Scene, up: Vector) -> LightControl:
    """Return the control of a new light with default values, which the user has added in the panel.

    kind : "sun", "point" or "sky"
    scene : a point light is placed by the bounds of this scene; up : up direction of the scene
    """
    if kind != POINT:
        return LightControl(kind, strength=DEFAULT_STRENGTH if kind == SUN else 1.0)
    low, high = scene.bounds
    away = POINT_LIGHT_DISTANCE * float(np.linalg.norm(high - low))
    x, y, z = ((low + high) / 2 + away * direction_of(-40.0, 40.0, up)).tolist()
    return LightControl(POINT, strength=DEFAULT_STRENGTH * away * away, position=(x, y, z))


def light_controls_of(scene: Scene, up: Vector) -> tuple[LightControl, ...]:
    """Return the panel's controls of the lights of a scene, in their order. up : the scene's up direction"""
    return controls_of(scene.lights, up)


def controls_of(lights: Iterable[Light | EnvironmentLight], up: Vector) -> tuple[LightControl, ...]:
    """Return the panel's controls of lights, in their order. up : the scene's up direction"""
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
    """Split a linear irradiance, intensity or radiance into a colour (sRGB, largest channel 1) and a strength."""
    values = rgb(power, "power")
    strength = float(values.max()) or 1.0
    r, g, b = linear_to_srgb(values / strength).tolist()
    return (r, g, b), strength if values.max() > 0 else 0.0
