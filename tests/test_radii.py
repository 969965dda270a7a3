import numpy as np
import pytest
from scipy.spatial import cKDTree

import pointray as pr
from conftest import shared_model, sphere_points
from pointray.points import read
from pointray.splats import check_radii, choose_radii

N = 10_000
SPHERE = sphere_points(N)
PLACES = sphere_points(50_000, seed=9)  # of its surface


def overlap(positions, radii, places=PLACES):
    """How many splats reach each of the places."""
    distances, rows = cKDTree(positions).query(places, k=60)
    return (distances < radii[rows]).sum(axis=1)


def even_sphere(n):
    i = np.arange(n) + 0.5
    z, turn = 1 - 2 * i / n, np.pi * (1 + np.sqrt(5)) * i
    return np.stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z], axis=1).astype(
        np.float32
    )


@pytest.mark.parametrize(("positions", "holes"), [(SPHERE, 1e-4), (even_sphere(N), 0)])
def test_the_surface_is_covered_about_eight_times(positions, holes):
    count = overlap(positions, choose_radii(positions))
    assert 7.5 < count.mean() < 9
    assert (count == 0).mean() <= holes


def test_radii_follow_scale_and_order():
    radii = choose_radii(SPHERE)
    np.testing.assert_allclose(choose_radii(SPHERE * np.float32(1000)), 1000 * radii, rtol=1e-3)
    np.testing.assert_allclose(choose_radii(SPHERE[::-1].copy())[::-1], radii, rtol=1e-5)
    assert radii.dtype == np.float32


def test_radii_follow_the_density():
    near, far = SPHERE, SPHERE[:1000] * np.float32(3) + np.float32(20)
    radii = choose_radii(np.vstack([near, far]))
    expected = 3 * np.sqrt(N / 1000)
    assert np.median(radii[N:]) / np.median(radii[:N]) == pytest.approx(expected, rel=0.1)


def test_duplicates_count_once():
    radii = choose_radii(np.repeat(SPHERE, 20, axis=0))
    np.testing.assert_allclose(radii, np.repeat(choose_radii(SPHERE), 20), rtol=1e-6)


def test_a_clump_counts_once():
    clump = SPHERE[:1] + np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32) * 1e-6
    positions = np.vstack([SPHERE, clump])
    radii = choose_radii(positions)
    usual = choose_radii(SPHERE)
    assert radii.min() > 0.5 * usual.min()
    assert (np.median(radii[N:]) / usual[0]) == pytest.approx(1, rel=0.3)


@pytest.mark.parametrize("count", [1, 5, 20])
def test_stray_points_stay_small(count):
    stray = np.float32(1000) + 50 * sphere_points(count, seed=4)
    radii = choose_radii(np.vstack([SPHERE, stray]))
    assert radii[N:].max() < 20 * np.median(radii)
    np.testing.assert_allclose(radii[:N], choose_radii(SPHERE), rtol=0.01)


def test_one_stray_point_of_few_stays_small():
    radii = choose_radii(np.vstack([sphere_points(50), [[1000, 0, 0]]]).astype(np.float32))
    assert radii[50] < 5 * np.median(radii)


def test_few_points_reach_each_other():
    np.testing.assert_allclose(choose_radii(np.array([[0, 0, 0], [0, 3, 4]], np.float32)), 5)
    assert (choose_radii(SPHERE[:5]) > 0.3).all()


@pytest.mark.parametrize(("positions", "words"), [(SPHERE[:1], "one point"), (np.ones((9, 3), np.float32), "9 points")])
def test_points_at_one_place_need_radii(positions, words):
    with pytest.raises(ValueError, match=f"{words}.*give radii"):
        choose_radii(positions)


@pytest.mark.parametrize("name", ["points/tls_pumpA_rgb.ply", "points/sfm_garden_rgb_nonormals.ply"])
def test_radii_of_real_scans_are_sane(name):
    positions = read(shared_model(name)).positions
    radii = choose_radii(positions)
    assert (radii > 0).all()
    assert radii.max() < 30 * np.median(radii)


# --------------------------------------------------------------------------------------------------------- given


def test_given_radii_are_taken():
    for given in ([1, 2, 3], np.array([1.0, 2, 3]), np.array([1, 0, 2, 0, 3], np.float32)[::2]):
        radii = check_radii(given, 3)
        assert radii.dtype == np.float32
        assert radii.tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("radii", "words"),
    [
        ([1, 2], r"\(3,\).*\(2,\)"),
        (1.0, r"\(3,\)"),
        ([[1], [2], [3]], r"\(3, 1\)"),
        (["a", "b", "c"], "numbers"),
        ([1, 0, 0], "row 1 is 0"),
        ([1, 2, -3], "row 2 is -3"),
        ([np.nan, 2, 3], "row 0 is nan"),
        ([1, np.inf, 3], "row 1 is inf"),
        ([1, 1e300, 3], r"row 1 is 1e\+300"),
        ([1, 2, 1e-300], "row 2 is 1e-300"),
    ],
)
def test_what_is_no_radius(radii, words):
    with pytest.raises(ValueError, match=words):
        check_radii(radii, 3)


@pytest.mark.parametrize("size", [1e-30, 1e30])
def test_radii_beyond_float32_are_refused(size):
    with pytest.raises(ValueError, match="radii reach from"):
        pr.Model(pr.procedural("sphere", 1000), np.full(1000, size))


def test_a_crowd_at_one_place_is_thinned():
    points = pr.procedural("sphere", 2000)
    x = np.concatenate([np.repeat(points.positions[:1], 200_000, axis=0), points.positions])
    with pytest.warns(UserWarning, match="199,985 points lie where 16 others do"):
        model = pr.Model(pr.Points(x, x))
    assert (model.tree.order >= 0).sum() == 2015
