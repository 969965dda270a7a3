"""Lights for a scan without any: a key light beside the camera, and a sky that leaves nothing black."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import check_direction, check_number
from ..rendering.settings import Settings
from ..shade.environment import EnvironmentLight
from ..shade.lights import Light, SunLight
from .direction import axes_of, direction_of

# The direction in which the key light travels, in the camera's axes: from above its left shoulder.
KEY_DIRECTION = (0.55, -0.65, -0.6)
KEY = 0.9 * np.pi  # irradiance: a white surface that faces it has radiance 0.9
KEY_ANGLE = 5.0  # degrees: soft shadow edges for path tracing
STILL_ANGLE = 2.0  # of a key light that stands still: few samples leave no grain in its shadows' edges
ZENITH, HORIZON, GROUND = 0.34, 0.26, 0.14  # radiance of the sky, and of what lies below it
ALBEDO = 0.65  # linear, of points without colours
CLAY = (0.58, 0.37, 0.27)  # linear
SKY_RAYS = 4  # rays for each sample, for contact shadows


def studio(up: ArrayLike = (0, 0, 1), azimuth: float | None = None) -> list[Light | EnvironmentLight]:
    """Lights that show a scan well from every side.

    A sun follows the camera, above its left shoulder; the sky is a gradient, bright above and darker below.
    With `Settings(sky_rays=4)` the sky's light leaves contact shadows.

    Parameters
    ----------
    up : (3,) array_like
        The direction of the sky.
    azimuth : float, optional
        Degrees, as for `frame`: the sun stands still, above the left shoulder of a viewer on this side. Light that
        follows the camera is not baked, see `bake`. None: it follows the camera.

    Examples
    --------
    >>> scene.lights = pr.studio()
    """
    top = check_direction(up, "up")
    sky = EnvironmentLight(ZENITH, horizon=HORIZON, ground=GROUND, up=top)
    if azimuth is None:
        return [SunLight(KEY_DIRECTION, KEY, KEY_ANGLE, camera=True), sky]
    back, upward = direction_of(check_number(azimuth, "azimuth", "degrees"), 0.0, top), axes_of(top)[2]
    axes = np.stack([np.cross(upward, back), upward, back])  # of the viewer's camera
    return [SunLight((KEY_DIRECTION @ axes).tolist(), KEY, STILL_ANGLE), sky]


def fill(strength: float, up: ArrayLike = (0, 0, 1)) -> EnvironmentLight:
    """The sky alone: `strength` is its share of the light of a sun of irradiance pi on a surface that faces both."""
    return EnvironmentLight(strength, horizon=0.8 * strength, ground=0.5 * strength, up=check_direction(up, "up"))


def with_contact(settings: Settings) -> Settings:
    """Settings whose sky leaves contact shadows, where the integrator has none of its own."""
    return replace(settings, sky_rays=SKY_RAYS) if settings.integrator == "phong" else settings


def with_direct_light(settings: Settings) -> Settings:
    """Settings of the pictures that stand in for those with baked light while there is none; others as they are."""
    return with_contact(replace(settings, integrator="phong")) if settings.integrator == "baked" else settings
