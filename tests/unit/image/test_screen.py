"""Display levels from a lookup table, compared with the formulas used for files."""

import numpy as np
import pytest

from pointray.base.choices import CURVES
from pointray.image.screen import to_8bit
from pointray.image.tone import linear_to_srgb, tone


def plain(image, backdrop, exposure, curve):
    """Levels by the formulas, without a table."""
    light = tone(np.nan_to_num(image[..., :3], posinf=1e30), exposure, curve)
    light = light + np.float32(backdrop)[:, None] * (1 - image[..., 3:])
    return np.rint(linear_to_srgb(light) * 255).astype(int)


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("exposure", [0.0, 1.5, -3.0])
def test_levels_are_those_of_the_curves(curve, exposure, rng):
    image = np.exp(rng.normal(-2, 3, (70, 90, 4))).astype(np.float32)
    image[..., 3] = rng.integers(0, 2, (70, 90))
    image[..., :3] *= image[..., 3:]
    backdrop = rng.uniform(0, 0.95, (70, 3))  # the curve does not change it
    levels, expected = to_8bit(image, backdrop, exposure, curve), plain(image, backdrop, exposure, curve)
    assert np.abs(levels - expected).max() <= 1
    assert (levels != expected).mean() < 0.04


def test_every_level_is_reproduced():
    from pointray.image.tone import srgb_to_linear

    grey = np.ones((1, 256, 4), np.float32)
    grey[..., :3] = srgb_to_linear(np.arange(256, dtype=np.uint8))[None, :, None]
    assert (np.abs(to_8bit(grey)[0, :, 0].astype(int) - np.arange(256)) <= 1).all()


def test_invalid_light_is_black_and_too_bright_light_white():
    image = np.ones((1, 4, 4), np.float32)
    image[0, :, :3] = np.array([np.nan, -5.0, np.inf, 0.0])[:, None]
    assert to_8bit(image)[0, :, 0].tolist() == [0, 0, 255, 0]
