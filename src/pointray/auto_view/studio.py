"""Studio lighting for scans: a key light, a rim light behind the scan, and a sky."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import check_direction, check_number
from ..rendering.settings import Settings
from ..shade.environment import EnvironmentLight
from ..shade.lights import Light, SunLight
from .direction import axes_of, direction_of

# Directions in which the lights travel, in camera axes: the key light from the upper left, the rim light from behind
# the scan, on the right.
KEY_DIRECTION = (0.7, -0.72, -0.47)
RIM_DIRECTION = (-0.65, -0.35, 0.7)
KEY = 1.0 * np.pi  # irradiance: a white surface that faces the light has radiance 1
RIM = 0.5 * np.pi
KEY_ANGLE = 5.0  # degrees: soft shadow edges for path tracing
STILL_ANGLE = 3.0  # of lights fixed in the world: less noise at shadow edges with few samples
ZENITH, HORIZON, GROUND = 0.32, 0.21, 0.10  # radiance of the sky and of the ground below it
CLAY = (0.58, 0.44, 0.35)  # linear, of points without colours
NEUTRAL = (0.46, 0.46, 0.46)  # the same without its hue, for bounced light that is written to points without colours
SKY_RAYS = 4  # per sample, for contact shadows
SUNS = ((KEY_DIRECTION, KEY), (RIM_DIRECTION, RIM))


def studio(up: ArrayLike = (0, 0, 1), azimuth: float | None = None) -> list[Light | EnvironmentLight]:
    """Return studio lights for a scan: a key light, a rim light and a sky.

    The suns follow the camera by default. The key light shines from the camera's upper left. The rim light, half as
    bright, shines from behind the scan on the right and separates shadowed edges from the background. The sky is a
    vertical gradient. `Settings(sky_rays=4)` adds contact shadows from the sky.

    Parameters
    ----------
    up : (3,) array_like
        Zenith of the sky.
    azimuth : float, optional
        Side of a viewer for whom the suns are fixed in the world: 0 degrees is the front, 90 the right, as for `frame`.
        None: the suns follow the camera. Lights that follow the camera are not baked, see `bake`.

    Returns
    -------
    list of SunLight and EnvironmentLight
        Two suns and a sky, for `Scene.lights`.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If `up` is not a direction or `azimuth` is not a number.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> scene.lights = pr.studio(azimuth=30)
    >>> len(scene.lights)
    3
    """
    top = check_direction(up, "up")
    sky = EnvironmentLight(ZENITH, horizon=HORIZON, ground=GROUND, up=top)
    if azimuth is None:
        return [*(SunLight(d, power, KEY_ANGLE, camera=True) for d, power in SUNS), sky]
    back, upward = direction_of(check_number(azimuth, "azimuth", "degrees"), 0.0, top), axes_of(top)[2]
    axes = np.stack([np.cross(upward, back), upward, back])  # of the viewer's camera
    return [*(SunLight((d @ axes).tolist(), power, STILL_ANGLE) for d, power in SUNS), sky]


def fill(strength: float, up: ArrayLike = (0, 0, 1)) -> EnvironmentLight:
    """Return a sky with a vertical gradient. up : its zenith

    strength : its light relative to a sun of irradiance pi, on a surface that faces both
    """
    return EnvironmentLight(strength, horizon=0.8 * strength, ground=0.5 * strength, up=check_direction(up, "up"))


def with_contact(settings: Settings) -> Settings:
    """Return the settings with soft shadows from the sky (`Settings.sky_rays`) if the integrator is "phong"."""
    return replace(settings, sky_rays=SKY_RAYS) if settings.integrator == "phong" else settings


def with_direct_light(settings: Settings) -> Settings:
    """Return settings for previews until baked light is ready: direct light ("phong") in its place.

    Settings that need no baked light are returned unchanged.
    """
    return with_contact(replace(settings, integrator="phong")) if settings.integrator == "baked" else settings
