"""Colours and columns as written by other programs and datasets."""

from __future__ import annotations

import re
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

import pointray as pr
from helpers.places import case_file
from pointray.io.formats._unnamed_columns import UndecidedError, recognise_columns

BLUE, RED, GREEN = (40, 60, 220), (220, 60, 40), (60, 200, 80)


def room(rng, n=400):
    """Return points of a room and colours of its walls: similar channels, some noise."""
    xyz = np.round(rng.uniform(-3, 3, (n, 3)), 3)
    base = rng.integers(60, 200, (5, 1)) + rng.integers(-30, 30, (5, 3))
    return xyz, np.clip(base[rng.integers(0, 5, n)] + rng.integers(-9, 9, (n, 1)), 0, 255)


def names_of(*columns, **options):
    values = np.column_stack(columns).astype(float)
    return recognise_columns(values, [bool((column == np.rint(column)).all()) for column in values.T], **options).names


def datasets(rng):
    """Return rows of datasets and the names of their columns."""
    xyz, rgb = room(rng)
    n = len(xyz)
    label, instance = rng.integers(0, 13, n), rng.integers(0, 600, n)
    return {
        "S3DIS": ("x y z r g b", (xyz, rgb)),
        "S3DIS with labels": ("x y z r g b label", (xyz, rgb, label)),
        "ScanNet": ("x y z r g b column_7 column_8", (xyz, rgb, label, instance)),
        "Semantic3D": ("x y z intensity r g b", (xyz, rng.integers(-2000, 2000, n), rgb)),
        "intensity of 8 bits": ("x y z intensity r g b", (xyz, rng.integers(0, 30, n) ** 2 // 4, rgb)),
        "Semantic3D with labels": ("x y z column_4 r g b column_8", (xyz, rng.integers(-2000, 2000, n), rgb, label)),
        "normalised places": ("x y z r g b column_7 column_8 column_9", (xyz, rgb, rng.random((n, 3)))),
        "CloudCompare": ("x y z r g b alpha", (xyz, rgb, np.full(n, 255))),
        "SemanticKITTI": ("x y z intensity", (xyz, rng.random(n))),
        "returns": ("x y z column_4 column_5 column_6", (xyz, rng.integers(0, 255, n), *rng.integers(1, 5, (2, n)))),
        "numbered": ("index x y z r g b", (np.arange(n) + 1, xyz, rgb)),
        "numbered, plain": ("index x y z", (np.arange(n), xyz)),
        "scan lines": ("index x y z intensity", (np.arange(n) // 40, xyz, rng.random(n))),
        "seconds since 1970": ("gps_time x y z", (1305031102.17 + np.sort(rng.random(n)), xyz)),
        "seconds of a week": ("gps_time x y z intensity", (350000.1234 + 0.0101 * np.arange(n), xyz, rng.random(n))),
        "sorted by x": ("x y z intensity", (xyz[np.argsort(xyz[:, 0])], rng.random(n))),
        "a grid of heights": ("x y z intensity", (np.arange(n), np.zeros(n), xyz[:, 2], rng.random(n))),
    }


@pytest.mark.parametrize("name", datasets(np.random.default_rng(0)))
def test_columns_of_datasets(name, rng):
    names, columns = datasets(rng)[name]
    assert names_of(*columns) == names.split()


def test_undecided_columns_are_refused_unless_the_extension_decides(rng):
    xyz, grey = rng.uniform(-3, 3, (400, 3)), rng.integers(0, 256, (400, 4))
    with pytest.raises(UndecidedError, match="cannot be told apart"):
        names_of(xyz, grey)
    assert names_of(xyz, grey, intensity_first=True)[3:] == ["intensity", "r", "g", "b"]
    assert names_of(xyz, grey, intensity_first=False)[3:] == ["r", "g", "b", "intensity"]


def test_many_unrecognised_columns_are_one_short_note(rng):
    xyz, _ = room(rng)
    found = recognise_columns(np.column_stack([xyz, rng.normal(size=(len(xyz), 600))]), [False] * 603)
    assert found.note.startswith("600 of the columns 4 to 603 are not recognised: read as column_4, ...; name the")


def test_pts_has_intensity_before_colours(tmp_path, rng):
    """This holds for any values; other texts with an intensity from 0 to 255 are guessed, with a note."""
    xyz, rgb = room(rng)
    rows = np.column_stack([xyz, rgb.mean(axis=1).astype(int), rgb])
    np.savetxt(tmp_path / "a.pts", rows, "%.3f %.3f %.3f %d %d %d %d")
    np.testing.assert_array_equal(pr.read(tmp_path / "a.pts").colors, rgb)
    rows[:, 3] = 255 - rgb[::-1, 0]
    np.savetxt(tmp_path / "a.txt", rows, "%.3f %.3f %.3f %d %d %d %d")
    with pytest.warns(UserWarning, match="columns 5 to 7 are read as colours; name the columns with --columns"):
        np.testing.assert_array_equal(pr.read(tmp_path / "a.txt").colors, rgb)


CASES = {
    "txt_cloudcompare_rgba_float.xyz": None,
    "txt_np_savetxt_xyzrgb.txt": None,
    "txt_cc_rf_gf_bf.txt": None,
    "npy_s3dis_room.npy": None,
    "ply_uppercase_rgb.ply": None,
    "off_coff.off": None,
    "e57_rgb_float255.e57": None,
    "e57_color_invalid.e57": None,
    "ply_float_colour_neg.ply": None,
    "las_rgb8_one_16bit_outlier.las": "1 of 12,300 colour values are outside 0 to 255: clipped",
    "txt_id_xyz_noheader.txt": "column 1 contains point numbers: x, y, z are columns 2 to 4; name the columns",
}


@pytest.mark.parametrize("name", CASES)
def test_colors_of_once_failing_files_are_plausible(name):
    with pytest.warns(UserWarning, match=re.escape(CASES[name] or "")) if CASES[name] else nullcontext():
        points = pr.read(case_file(name))
    if name.startswith("txt_id"):
        assert np.ptp(points.world, axis=0).max() < 20 and points.attributes["index"][0] == 1
        return
    spread = np.quantile(points.colors, [0.02, 0.5, 0.98])
    assert spread[0] < 100 and 60 <= spread[1] <= 200 and spread[2] > 190


# ----------------------------------------------------------------------------------------------------------- ranges


def written(path: Path, colors) -> Path:
    """Write a file of points whose colours are those of an array."""
    colors = np.asarray(colors)
    xyz = np.random.default_rng(2).normal(size=(len(colors), 3)).astype(np.float32)
    rows = np.rec.fromarrays([*xyz.T, *colors.T], names="x,y,z,red,green,blue")
    np.save(path.with_suffix(".npy"), rows)
    return path.with_suffix(".npy")


@pytest.mark.parametrize(("white", "dtype"), [(1, np.float32), (255, np.uint16), (255, np.float64), (65535, np.uint16)])
def test_stray_values_do_not_decide_the_range(tmp_path, white, dtype):
    colors = np.tile(np.array([RED, GREEN, BLUE]) / 255 * white, (1000, 1)).astype(dtype)
    if white < 65535:
        colors[7, 0] = 257 * white
    expected = np.tile([RED, GREEN, BLUE], (1000, 1))
    expected[7, 0] = 255 if white < 65535 else expected[7, 0]
    with pytest.warns(UserWarning, match=f"1 of 9,000 .* 0 to {white}: clipped") if white < 65535 else nullcontext():
        found = pr.read(written(tmp_path / "a", colors)).colors
    assert np.abs(found.astype(int) - expected).max() <= 1


def test_few_painted_points_keep_their_range(tmp_path):
    """All but 3 of 9,000 values are zero; the 3 are not outliers."""
    colors = np.zeros((3000, 3), np.uint16)
    colors[7] = 65535
    assert pr.read(written(tmp_path / "a", colors)).colors.sum() == 3 * 255


@pytest.mark.parametrize("value", [0, np.nan])
def test_colours_that_are_all_zero_count_as_missing(tmp_path, value):
    with pytest.warns(UserWarning, match="zero or missing: they are ignored"):
        assert pr.read(written(tmp_path / "a", np.full((50, 3), value))).colors is None


def test_points_without_a_colour_are_grey(tmp_path):
    colors = np.tile(np.array(RED, np.float32) / 255, (50, 1))
    colors[3, 1], colors[5], colors[6, 0] = np.nan, np.nan, -1e-7
    with pytest.warns(UserWarning, match="2 points without a colour"):
        found = pr.read(written(tmp_path / "a", colors)).colors
    assert found[[3, 5]].tolist() == [[128] * 3] * 2 and found[6].tolist() == [0, *RED[1:]]


def test_the_range_is_that_of_each_file(tmp_path):
    one = written(tmp_path / "a", np.tile(np.array(RED, np.uint16), (20, 1)))
    other = written(tmp_path / "b", np.tile(np.array(RED, np.uint16) * 257, (20, 1)))
    black = written(tmp_path / "c", np.zeros((20, 3), np.uint16))
    with pytest.warns(UserWarning, match="zero or missing"), pytest.warns(UserWarning, match="have: colors .*c.npy"):
        found = pr.read([one, other, black]).colors
    assert found.tolist() == [[*RED]] * 40 + [[128] * 3] * 20


@pytest.mark.parametrize(
    ("letters", "normals", "colors"),
    [("C", False, "220 60 40 255"), ("CN", True, "0.8627 0.2353 0.1569 1"), ("N", True, ""), ("", False, "")],
)
def test_off_files_with_normals_and_colours(tmp_path, letters, normals, colors):
    rows = [f"{x} 0 1 {'0 0 1 ' * normals}{colors}" for x in range(4)]
    (tmp_path / "a.off").write_text(f"{letters}OFF\n# by hand\n4 0 0\n" + "\n".join(rows) + "\n")
    points = pr.read(tmp_path / "a.off")
    assert points.normals is None if not normals else points.normals.tolist() == [[0, 0, 1]] * 4
    assert points.colors is None if not colors else points.colors.tolist() == [[*RED]] * 4
