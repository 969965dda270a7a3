"""Small files that failed once: counts, coordinates and colours of each."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import pointray as pr
from helpers.places import case_file

# Points, size of the bounds in metres, and whether there are colours; a part of the warning.
READ = {
    "las_count_too_large.las": (4100, 6, True, "700 of 4,800 are missing"),
    "pts_count_wrong.pts": (4100, 6, True, "500 of 4,600 are missing"),
    "ptx_missing_rows.ptx": (2044, 3, True, "200 of 2,500 are missing"),
    "obj_40_materials.obj": (1500, 3, True, ""),
    "glb_quantized.glb": (4100, 6, False, ""),
    "las_rgb_all_zero.las": (4100, 6, False, "zero or missing"),
    "two_a_rgb8.las": (2400, 6, True, ""),
    "two_b_rgb16.las": (2400, 6, True, ""),
    "six_columns_rgb.bin": (4100, 6, True, ""),
    "pcd_ouster_count0.pcd": (None, 3, False, ""),
    "points3D.txt": (None, 3, True, ""),
}


@pytest.mark.parametrize("name", READ)
def test_once_failing_files_are_read(name):
    count, size, is_colored, warning = READ[name]
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        points = pr.read(case_file(name))
    assert count is None or len(points) == count
    assert size / 2 < np.ptp(points.bounds, axis=0).max() <= size
    assert (points.colors is not None) == is_colored
    if is_colored:
        assert np.quantile(points.colors, 0.98) > 190
    texts = [str(one.message) for one in given]
    assert len(texts) == bool(warning) and all(warning in text for text in texts)


@pytest.mark.parametrize("name", ["las_count_too_large.las", "pts_count_wrong.pts", "ptx_missing_rows.ptx"])
def test_strict_readers_refuse_wrong_counts(name):
    with pytest.raises(ValueError, match="expected|is cut off"):
        pr.read(case_file(name), strict=True)
