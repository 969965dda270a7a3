"""Automatic exposure: surfaces get medium brightness, and few highlights are clipped.

Pixels are metered like reflected light by a camera, which would show snow and asphalt in the same grey. If the radiance
of a white surface is known, as from an incident light meter, half of the excess gain is taken back.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import rgb, unit_vector
from ..base.choices import AUTO
from ..engine.kernels.vec import LUMINANCE
from ..shade.environment import EnvironmentLight, harmonics
from ..shade.lights import SunLight
from .tone import tone

MIDDLE = 0.24  # linear target of the log average: sRGB 0.53
BURNT, WHITE = 0.995, 0.92  # this fraction of pixels stays below this linear value, level 246
COVERED = 0.5  # minimum alpha of metered pixels
DARKEST = 1e-4  # lower limit of metered luminance, relative to the brightest pixels
LEAST, MOST = -20.0, 20.0  # stops
# Gain in stops above the exposure that shows a white surface as 1: beyond FULL_GAIN, only the fraction FURTHER of it is
# applied. Scans with an albedo of 12% or more reach medium brightness. For asphalt (4%) and coal (3%) metering is 2 to
# 3 stops too high; photographers correct it by 1.5 to 2. Darker scans have colours of underexposed photographs.
FULL_GAIN, FURTHER = 1.0, 0.5
DARKENED = 0.7  # stops that highlights may cost before the soft curve is used
STEP = 1 << 16  # approximate number of metered pixels


PLAIN = "neutral"  # default curve if exposure and curve are automatic
AXES = np.concatenate([np.eye(3), -np.eye(3)])


def auto_exposure(image: NDArray[np.floating], curve: str = "srgb", white: float | None = None) -> float:
    """Return the exposure, in stops, at which an image has medium brightness and few highlights are clipped.

    Parameters
    ----------
    image : (h, w, 3) or (h, w, 4) float
        Linear, premultiplied; the fourth channel is alpha. Pixels with alpha below 0.5 are ignored.
    curve : {"srgb", "neutral", "filmic", "soft"}
        Tone curve with which the image will be shown.
    white : float, optional
        Radiance of a white surface in the same light, see `white_under`, by which dark surfaces are recognized and
        stay dark. None: unknown.

    Returns
    -------
    float
        Stops, a multiple of 1/16; 0 for an empty or black image.

    References
    ----------
    Reinhard, Stark, Shirley and Ferwerda: Photographic Tone Reproduction for Digital Images (2002), the log average.
    """
    flat = image.reshape(-1, image.shape[-1])
    flat = flat[:: max(len(flat) // STEP, 1)].astype(np.float64)
    if flat.shape[1] == 4:
        flat = flat[flat[:, 3] >= COVERED]
        with np.errstate(invalid="ignore"):
            flat = flat[:, :3] / flat[:, 3:]
    flat = flat[np.isfinite(flat).all(axis=1)]
    light = flat @ np.array(LUMINANCE)
    brightest = float(np.quantile(flat.max(axis=1), BURNT)) if len(flat) else 0.0
    if brightest <= 0.0:
        return 0.0
    average = float(np.exp(np.log(np.maximum(light, DARKEST * brightest)).mean()))
    stops = min(np.log2(MIDDLE / average), np.log2(_brightest(curve) / brightest))
    if white is not None:
        full = FULL_GAIN - np.log2(white)
        stops = min(stops, full + FURTHER * (stops - full))
    return float(np.clip(np.floor(16.0 * stops) / 16.0, LEAST, MOST))


def white_under(lights: Iterable[Any], integrator: str = "phong") -> float | None:
    """Return the radiance of a white diffuse surface that faces the lights of a scene, for `auto_exposure`.

    Parameters
    ----------
    lights : iterable of Light and EnvironmentLight
    integrator : str
        Name of the integrator. "ao" has a uniform white sky in place of the lights, "phong" a headlight if there are no
        lights.

    Returns
    -------
    float or None
        None if it depends on the position, or surfaces may emit light.
    """
    found = list(lights)
    if integrator == "ao" or (integrator == "phong" and not found):
        return 1.0  # a uniform white sky, or a headlight of irradiance pi
    if not found or not all(isinstance(light, SunLight | EnvironmentLight) for light in found):
        return None
    suns = [light for light in found if isinstance(light, SunLight)]
    total = _from_suns(suns) + sum(_brightest_side(light) for light in found if isinstance(light, EnvironmentLight))
    return total / np.pi if total > 0.0 else None


def auto_tone(image: NDArray[np.floating], white: float | None = None) -> tuple[float, str]:
    """Return (exposure in stops, name of the tone curve) for an image.

    The curve is "soft" if a few bright spots would darken the rest, else "neutral".

    white : radiance of a white surface in the same light, which keeps dark surfaces dark; None if unknown
    """
    curve = "soft" if auto_exposure(image, "soft") - auto_exposure(image, PLAIN) > DARKENED else PLAIN
    return auto_exposure(image, curve, white), curve


def tone_of(
    image: NDArray[np.floating], exposure: float | str, curve: str, white: float | None = None
) -> tuple[float, str]:
    """Return (exposure in stops, name of the tone curve); "auto" for either is replaced by a choice for the image.

    With a given exposure the automatic curve is "srgb".

    white : radiance of a white surface in the same light, which keeps dark surfaces dark; None if unknown
    """
    if exposure != AUTO:
        return float(exposure), "srgb" if curve == AUTO else curve
    return auto_tone(image, white) if curve == AUTO else (auto_exposure(image, curve, white), curve)


def _from_suns(suns: list[SunLight]) -> float:
    """Return the luminance of the irradiance from suns on a surface that is turned to receive as much as possible.

    If some suns follow the camera and others do not, the angles between them are unknown, and the sum of the luminances
    of all is returned.
    """
    if not suns:
        return 0.0
    towards = np.array([-unit_vector(sun.direction, "direction") for sun in suns])
    power = np.array([rgb(sun.irradiance, "irradiance") for sun in suns]) @ np.array(LUMINANCE)
    if len({sun.camera for sun in suns}) > 1:
        return float(power.sum())
    together = power @ towards
    facing = np.vstack([towards, together / max(float(np.linalg.norm(together)), 1e-30)])
    return float((np.maximum(facing @ towards.T, 0.0) @ power).max())


@lru_cache(maxsize=1)
def _brightest_side(sky: EnvironmentLight) -> float:
    """Return the largest luminance of a sky's irradiance on surfaces that face one of the six axis directions."""
    irradiance = harmonics(AXES).T @ sky.tables()[4].reshape(9, 3)
    return float((irradiance @ np.array(LUMINANCE)).max())


@cache
def _brightest(curve: str) -> float:
    """Return the linear input that a tone curve maps to WHITE; outputs above WHITE look overexposed."""
    low, high = 0.0, 100.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        below = float(tone(np.array([middle], np.float32), 0.0, curve)[0]) < WHITE
        low, high = (middle, high) if below else (low, middle)
    return low
