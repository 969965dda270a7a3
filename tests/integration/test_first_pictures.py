"""The default pictures of seven real scans satisfy measures of a good picture."""

import numpy as np
import pytest

from bench.looks.first_pictures import measure, picture
from helpers.places import shared_model

SCANS = [
    *("stanford_bunny", "stanford_bunny_rangescans", "nefertiti_50k", "potree_lion_takanawa_rgb"),
    *("rgbd_kinect_chair_rgb", "tls_pumpA_rgb"),
]


@pytest.mark.scans
@pytest.mark.long
@pytest.mark.parametrize("name", [*SCANS, "tls_tower_wall_ghost_nonormals"])
def test_first_pictures_are_framed_and_exposed(name, tmp_path):
    levels, alpha = picture(shared_model(f"points/{name}.ply"), tmp_path)
    found = measure(levels, alpha)
    print(name, found)
    assert found.off <= 0.02
    assert 0.01 <= found.margin <= 0.08
    assert 0.18 <= found.mean <= 0.65  # the pump is dark; all others are above 0.35
    assert found.burnt <= 0.01
    assert found.black <= 0.05
    assert found.contrast >= 0.15
    if "rgb" not in name:
        assert found.range >= 0.35


def test_measures_of_a_known_picture_are_exact():
    levels, alpha = np.full((60, 80, 3), 100, np.uint8), np.zeros((60, 80), np.uint8)
    alpha[6:54, 30:40] = 255
    levels[6:30, 30:40] = 255
    levels[30:33, 30:40] = 0
    found = measure(levels, alpha)
    assert found.off == pytest.approx(5 / 80, abs=0.01) and found.margin == pytest.approx(0.1, abs=0.02)
    assert found.burnt == pytest.approx(0.5) and found.black == pytest.approx(1 / 16)
    assert found.mean == pytest.approx((24 * 255 + 21 * 100) / 48 / 255)
    assert found.range == pytest.approx(1 - 0)  # from the black rows, 1/16, to the white ones
    levels[30:33] = 100
    assert measure(levels, alpha).range == pytest.approx((255 - 100) / 255)
