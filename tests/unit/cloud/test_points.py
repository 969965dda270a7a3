import pickle
from functools import partial

import numpy as np
import pytest

import pointray as pr
from pointray.cloud.georeference import Georeference
from pointray.cloud.points import Points

CLOUD = np.random.default_rng(1).random((1000, 3))
UTM = np.array([637369.0, 5851979.0, 406.0])


def test_small_coordinates_have_a_zero_origin():
    points = Points(CLOUD)
    assert not points.origin.any()
    assert points.positions.dtype == np.float32
    assert points.positions.flags.c_contiguous
    np.testing.assert_array_equal(points.positions, CLOUD.astype(np.float32))


@pytest.mark.parametrize("scale", [1e-4, 1.0, 100.0])
def test_map_coordinates_are_exact_to_a_ten_thousandth_of_the_spacing(scale):
    world = UTM + CLOUD * scale
    points = Points(world)
    spacing = scale / np.sqrt(len(CLOUD))
    assert points.origin.any()
    assert np.abs(points.world - world).max() <= max(1e-4 * spacing, 1e-9)
    assert np.abs(points.bounds - [world.min(axis=0), world.max(axis=0)]).max() <= max(1e-4 * spacing, 1e-9)


def test_few_distant_points_of_a_map_keep_millimetres():
    world = np.round(UTM + [[0.123, 0.456, 0.789], [4321.987, 10.5, 3.25], [25.125, 3999.999, -7.001]], 3)
    assert np.array_equal(np.round(Points(world).world, 3), world)


def test_float32_far_from_zero_is_kept_to_the_last_bit():
    few = (UTM / 100 + CLOUD[:20] * 300).astype(np.float32)
    assert np.array_equal(Points(few).world, few)
    assert not Points(few).origin.any()


def test_one_stray_point_does_not_hide_that_coordinates_are_large():
    world = np.vstack([UTM + CLOUD, [[0, 0, 0]]])
    points = Points(world)
    assert np.abs(points.world - world)[:-1].max() < 1e-6


def test_a_given_origin_is_kept():
    points = Points(CLOUD + 5, origin=(5, 5, 5))
    assert points.origin.tolist() == [5, 5, 5]
    np.testing.assert_allclose(points.positions, CLOUD, atol=1e-6)


def test_arrays_are_copied_only_if_needed_and_are_writable():
    array = CLOUD.astype(np.float32)
    assert np.shares_memory(Points(array).positions, array)
    array.flags.writeable = False
    strided = np.zeros((1000, 6), np.float32)[:, ::2]
    for given in (
        array,
        strided,
        CLOUD.astype(">f8"),
        CLOUD.astype(np.float16),
        (CLOUD * 9).astype(int),
        CLOUD.tolist(),
    ):
        positions = Points(given).positions
        assert positions.flags.writeable
        assert positions.flags.c_contiguous
        assert positions.dtype.isnative
        np.testing.assert_allclose(positions, given, rtol=1e-3)


def test_rows_that_are_not_finite_are_kept_and_marked():
    world = CLOUD.copy()
    world[3, 1], world[5, 2], world[7, 0] = np.nan, np.inf, 3e38
    points = Points(world)
    assert len(points) == 1000
    assert np.flatnonzero(~points.finite).tolist() == [3, 5, 7]
    assert points.bounds.max() <= 1


def test_colors_are_bytes_or_floats_and_alpha_is_dropped():
    expected = np.array([[0, 128, 255]] * 2, np.uint8)
    for colors in (expected, expected / 255, [[0.001, 0.501, 0.999]] * 2, np.array([[0, 128, 255, 7]] * 2, np.uint8)):
        stored = Points(np.eye(3)[:2], colors=colors).colors
        assert stored.dtype == np.uint8
        np.testing.assert_array_equal(stored, expected)


def test_attributes_keep_their_dtypes_and_values():
    times = np.arange(1000) * 1e-7 + 3e8
    given = {
        "a": np.arange(1000),
        "b": np.ones((1000, 2)),
        "c": CLOUD[:, 0] > 0.5,
        "time": times,
        "class": np.arange(1000).astype(">u2"),
        "half": np.arange(1000).astype(np.float16),
    }
    points = Points(CLOUD, attributes=given)
    assert {name: (a.shape, a.dtype.name) for name, a in points.attributes.items()} == {
        "a": ((1000,), "int64"),
        "b": ((1000, 2), "float64"),
        "c": ((1000,), "bool"),
        "time": ((1000,), "float64"),
        "class": ((1000,), "uint16"),
        "half": ((1000,), "float32"),
    }
    for name, values in given.items():
        np.testing.assert_array_equal(points.attributes[name], values)


def test_the_georeference_is_kept():
    georeference = Georeference("EPSG:25832", "metre", (0.01, 0.01, 0.001), (5e5, 0, 0), ((1, 2, 3),))
    points = Points(UTM + CLOUD, georeference=georeference)
    for other in (points.select(np.arange(5)), points.with_normals(CLOUD), pickle.loads(pickle.dumps(points))):
        assert other.georeference == georeference
        assert other.crs == "EPSG:25832"
    assert Georeference(**georeference.facts) == georeference
    for wrong in ({"crs": 4}, {"scale": (1, 1, 1)}, {"scale": (0, 1, 1), "offset": (0, 0, 0)}, {"stations": ((1, 2),)}):
        with pytest.raises(ValueError, match="|".join(wrong)):
            Georeference(**wrong)


def test_select_applies_to_all_columns():
    points = Points(UTM + CLOUD, CLOUD, (CLOUD * 255).astype(np.uint8), {"a": np.arange(1000)})
    few = points.select(np.array([7, 3]))
    np.testing.assert_array_equal(few.world, points.world[[7, 3]])
    np.testing.assert_array_equal(few.origin, points.origin)
    np.testing.assert_array_equal(few.normals, points.normals[[7, 3]])
    np.testing.assert_array_equal(few.colors, points.colors[[7, 3]])
    assert few.attributes["a"].tolist() == [7, 3]


def test_repr_lists_the_columns():
    text = repr(Points(UTM + CLOUD, CLOUD, attributes={"intensity": CLOUD[:, 0]}))
    assert "1,000" in text
    assert "normals, intensity" in text
    assert "\n" not in text


def test_points_can_be_sent_to_another_process():
    points = Points(UTM + CLOUD, CLOUD)
    again = pickle.loads(pickle.dumps(points))
    np.testing.assert_array_equal(again.world, points.world)
    np.testing.assert_array_equal(again.normals, points.normals)


ONE = [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(
    ("positions", "others", "message"),
    [
        (np.zeros((0, 3)), {}, "no points"),
        ([1, 2, 3], {}, r"\(n, 3\), not \(3,\)"),
        (np.zeros((5, 2)), {}, r"\(5, 2\)"),
        ([[1, 2, 3], [4, 5]], {}, "positions is not a regular array"),
        ([["a", "b", "c"]], {}, "positions must hold ints or floats"),
        ([[1j, 2, 3]], {}, "complex128"),
        (np.full((2, 3), None), {}, "object"),
        ([[np.nan] * 3] * 4, {}, "none of the 4 rows is finite"),
        (ONE, {"normals": np.zeros((2, 3))}, r"normals must have the shape \(1, 3\).*\(2, 3\)"),
        (ONE, {"normals": np.zeros((3, 1))}, r"normals.*\(3, 1\)"),
        (ONE, {"colors": np.zeros((1, 2))}, r"colors.*\(1, 2\)"),
        (ONE, {"colors": [[0, 0.5, 1.01]]}, "between 0 and 1; row 0"),
        (ONE, {"colors": [[0, np.nan, 1]]}, "between 0 and 1"),
        (ONE, {"colors": np.array([[0, 1, 256]])}, "uint8"),
        (ONE, {"attributes": {"a": [1, 2]}}, r"attribute 'a'.*\(2,\)"),
        (ONE, {"attributes": {"a": 1.0}}, r"attribute 'a'.*\(\)"),
        (ONE, {"attributes": {3: [1.0]}}, "string"),
        (ONE, {"origin": (1, 2)}, "origin"),
        (ONE, {"origin": (1, 2, np.inf)}, "origin"),
    ],
)
def test_errors_are_reported(positions, others, message):
    with pytest.raises(ValueError, match=message):
        Points(positions, **others)


def test_colors_of_16_bits_span_the_whole_range(rng):
    levels = np.arange(65536, dtype=np.uint16)
    rows = np.stack([levels, levels[::-1], np.full_like(levels, 65535)], axis=1)
    colors = Points(rng.random((65536, 3)), colors=rows).colors
    assert colors.dtype == np.uint8
    np.testing.assert_array_equal(colors, np.rint(rows / 65535 * 255))
    with pytest.raises(ValueError, match=r"colors must be uint8 .*uint16 .*not int32"):
        Points(CLOUD, colors=np.zeros((1000, 3), np.int32))


def test_former_names_are_deprecated_aliases():
    known = Georeference("EPSG:25832")
    with pytest.warns(DeprecationWarning, match="pointray.Survey is deprecated: use pointray.Georeference") as found:
        assert pr.Survey is Georeference
    assert found[0].filename == __file__
    for make in (partial(Points, CLOUD), partial(Points.about, np.zeros(3), CLOUD), Points(CLOUD).changed):
        with pytest.warns(DeprecationWarning, match="the argument survey is deprecated: use georeference") as found:
            points = make(survey=known)
        assert found[0].filename == __file__
        with pytest.warns(DeprecationWarning, match="Points.survey is deprecated: use Points.georeference"):
            assert points.survey is known is points.georeference
        with pytest.raises(TypeError, match="give only georeference"):
            make(survey=known, georeference=known)
