"""How bright a picture is shown: so that what is seen of the surface is of medium brightness, and little burns out.

The pixels are metered, as a camera meters reflected light, which shows snow and asphalt in the same grey. Where it is
known how bright a white surface would be, as a meter of incident light measures it, that is corrected by halves.
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

MIDDLE = 0.24  # what the log average becomes, linear: sRGB 0.53
BURNT, WHITE = 0.995, 0.92  # so many of the pixels stay below this, linear: level 246
COVERED = 0.5  # alpha from which a pixel counts
DARKEST = 1e-4  # of the brightest: what is darker counts as this
LEAST, MOST = -20.0, 20.0  # stops
# Stops above the exposure that shows a white surface as 1: beyond FULL_GAIN, a share FURTHER of the metered gain is
# applied. Scans that reflect 12% of the light or more reach medium brightness. For asphalt (4%) and coal (3%) a meter
# is 2 to 3 stops too high; photographers correct it by 1.5 to 2. Darker scans have colours of underexposed photographs.
FULL_GAIN, FURTHER = 1.0, 0.5
DARKENED = 0.7  # stops that highlights may cost before they are shown by the soft curve
STEP = 1 << 16  # pixels that are looked at


PLAIN = "neutral"  # the curve of pictures whose exposure and curve are chosen
AXES = np.concatenate([np.eye(3), -np.eye(3)])


def auto_exposure(image: NDArray[np.floating], curve: str = "srgb", white: float | None = None) -> float:
    """The exposure, in stops, that shows a picture well.

    Parameters
    ----------
    image : (h, w, 3) or (h, w, 4) float
        Linear; with alpha premultiplied: where it is below a half nothing counts.
    curve : {"srgb", "neutral", "filmic", "soft"}
        By which it will be shown, see `tone`.
    white : float, optional
        Radiance of a white surface in the same light, see `white_under`: dark surfaces stay dark. None: unknown.

    Returns
    -------
    float
        Stops, a multiple of 1/16; 0 where there is nothing to be seen.

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
    """Radiance of a white matt surface that faces the lights.

    Parameters
    ----------
    lights : iterable of Light and EnvironmentLight
    integrator : see `Settings`

    Returns
    -------
    float or None
        None: it differs from place to place, or surfaces may be the light.
    """
    found = list(lights)
    if integrator == "ao" or (integrator == "phong" and not found):
        return 1.0  # an even white sky, or a headlight of irradiance pi
    if not found or not all(isinstance(light, SunLight | EnvironmentLight) for light in found):
        return None
    suns = [light for light in found if isinstance(light, SunLight)]
    total = _from_suns(suns) + sum(_brightest_side(light) for light in found if isinstance(light, EnvironmentLight))
    return total / np.pi if total > 0.0 else None


def auto_tone(image: NDArray[np.floating], white: float | None = None) -> tuple[float, str]:
    """Exposure and curve that show a picture well: the soft one where a few bright spots would leave the rest dark."""
    curve = "soft" if auto_exposure(image, "soft") - auto_exposure(image, PLAIN) > DARKENED else PLAIN
    return auto_exposure(image, curve, white), curve


def tone_of(
    image: NDArray[np.floating], exposure: float | str, curve: str, white: float | None = None
) -> tuple[float, str]:
    """Exposure and curve, of which either may be "auto"; a curve alone that is auto is "srgb"."""
    if exposure != AUTO:
        return float(exposure), "srgb" if curve == AUTO else curve
    return auto_tone(image, white) if curve == AUTO else (auto_exposure(image, curve, white), curve)


def _from_suns(suns: list[SunLight]) -> float:
    """The greatest luminance of the irradiance that a surface receives from suns: it may face away from some of them.

    Where only some of them follow the camera all are added: the angles between them are unknown.
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
    """The greatest luminance of the irradiance that surfaces across an axis receive from a sky."""
    irradiance = harmonics(AXES).T @ sky.tables()[4].reshape(9, 3)
    return float((irradiance @ np.array(LUMINANCE)).max())


@cache
def _brightest(curve: str) -> float:
    """What a curve shows as WHITE."""
    low, high = 0.0, 100.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        below = float(tone(np.array([middle], np.float32), 0.0, curve)[0]) < WHITE
        low, high = (middle, high) if below else (low, middle)
    return low
