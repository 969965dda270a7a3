"""Lights for a scan without any: a key light, a rim light behind the scan, and a sky that leaves nothing black."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import check_direction, check_number
from ..rendering.settings import Settings
from ..shade.environment import EnvironmentLight
from ..shade.lights import Light, SunLight
from .direction import axes_of, direction_of

# The directions in which the lights travel, in the camera's axes: the key light from the left and above, the rim light
# from the right behind the scan.
KEY_DIRECTION = (0.7, -0.72, -0.47)
RIM_DIRECTION = (-0.65, -0.35, 0.7)
KEY = 1.0 * np.pi  # irradiance: a white surface that faces it has radiance 1
RIM = 0.5 * np.pi
KEY_ANGLE = 5.0  # degrees: soft shadow edges for path tracing
STILL_ANGLE = 3.0  # of lights that stand still: few samples leave little grain in their shadows' edges
ZENITH, HORIZON, GROUND = 0.32, 0.21, 0.10  # radiance of the sky, and of what lies below it
CLAY = (0.58, 0.44, 0.35)  # linear, of points without colours
NEUTRAL = (0.46, 0.46, 0.46)  # the same without its hue: what bounces light that is written to points without colours
SKY_RAYS = 4  # rays for each sample, for contact shadows
SUNS = ((KEY_DIRECTION, KEY), (RIM_DIRECTION, RIM))


def studio(up: ArrayLike = (0, 0, 1), azimuth: float | None = None) -> list[Light | EnvironmentLight]:
    """Lights that show a scan well from every side.

    Two suns follow the camera: the key light shines from its left and above, the rim light, half as bright, from the
    right behind the scan, so that edges in the shadow stand out. The sky is a gradient, bright above and darker below.
    With `Settings(sky_rays=4)` the sky's light leaves contact shadows.

    Parameters
    ----------
    up : (3,) array_like
        The direction of the sky.
    azimuth : float, optional
        Degrees, as for `frame`: the suns stand still, as a viewer on this side has them. Light that follows the camera
        is not baked, see `bake`. None: they follow the camera.

    Examples
    --------
    >>> scene.lights = pr.studio()
    """
    top = check_direction(up, "up")
    sky = EnvironmentLight(ZENITH, horizon=HORIZON, ground=GROUND, up=top)
    if azimuth is None:
        return [*(SunLight(d, power, KEY_ANGLE, camera=True) for d, power in SUNS), sky]
    back, upward = direction_of(check_number(azimuth, "azimuth", "degrees"), 0.0, top), axes_of(top)[2]
    axes = np.stack([np.cross(upward, back), upward, back])  # of the viewer's camera
    return [*(SunLight((d @ axes).tolist(), power, STILL_ANGLE) for d, power in SUNS), sky]


def fill(strength: float, up: ArrayLike = (0, 0, 1)) -> EnvironmentLight:
    """The sky alone: `strength` is its share of the light of a sun of irradiance pi on a surface that faces both."""
    return EnvironmentLight(strength, horizon=0.8 * strength, ground=0.5 * strength, up=check_direction(up, "up"))


def with_contact(settings: Settings) -> Settings:
    """Settings whose sky leaves contact shadows, where the integrator has none of its own."""
    return replace(settings, sky_rays=SKY_RAYS) if settings.integrator == "phong" else settings


def with_direct_light(settings: Settings) -> Settings:
    """Settings of the pictures that stand in for those with baked light while there is none; others as they are."""
    return with_contact(replace(settings, integrator="phong")) if settings.integrator == "baked" else settings
