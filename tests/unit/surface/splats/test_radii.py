import numpy as np
import pytest
from scipy.spatial import cKDTree

import pointray as pr
from helpers.clouds import sphere_points
from helpers.marks import long
from helpers.places import shared_model
from pointray.cloud.neighbors import distinct, neighbors
from pointray.io.files import read
from pointray.surface.splats import check_radii, choose_radii
from pointray.surface.splats.radii import OVERLAP
from pointray.surface.splats.voronoi import Neighborhood, measure_cells

N = 10_000
SPHERE = sphere_points(N)
PLACES = sphere_points(50_000, seed=9)  # area of the surface
UP = np.array([[0, 0, 1]], np.float32)
# In one of 100 squares of 5,000 random points, up to 3 points in the middle are classified as border points.
FALSE_BORDERS = 0.003


def survey(positions, normals=None):
    """Return radii and borders of distinct points. The default normals are those of a sphere."""
    positions = np.asarray(positions, np.float32)
    normals = positions / np.linalg.norm(positions, axis=1, keepdims=True) if normals is None else normals
    normals = np.array(np.broadcast_to(normals, positions.shape), np.float32)  # read-only arrays have another type
    return choose_radii(positions, normals)[:2]


def covers(positions, radii, samples):
    """Return for each sample how many splats cover it, and its least distance to one in units of the radius."""
    distances, rows = cKDTree(positions).query(samples, k=60)
    share = distances / radii[rows]
    nearest = share.min(axis=1)
    for i in np.flatnonzero(nearest > 1 / OVERLAP):  # a wide splat may lie beyond 60 narrow ones
        nearest[i] = (np.linalg.norm(positions - samples[i], axis=1) / radii).min()
    return (share < 1).sum(axis=1), nearest


def even_sphere(n):
    i = np.arange(n) + 0.5
    z, turn = 1 - 2 * i / n, np.pi * (1 + np.sqrt(5)) * i
    return np.stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z], axis=1).astype(
        np.float32
    )


def square(rng, n):
    """Random points of the unit square, (n, 3) float32."""
    return np.column_stack([rng.uniform(size=(n, 2)), np.zeros(n)]).astype(np.float32)


# ---------------------------------------------------------------------------------------------------------- cells


def test_cells_are_those_of_a_brute_force_search(rng):
    """In a plane, a cell's farthest vertex is the centre of an empty circle through the point and two others."""
    x = square(rng, 60)
    neighborhood = Neighborhood(np.arange(60, dtype=np.int32), neighbors(x, 60).indices)
    farthest, _ = measure_cells(x, np.repeat(UP, 60, axis=0), neighborhood)
    flat = x[:, :2].astype(np.float64)
    one, other = np.triu_indices(60, 1)
    for i in range(0, 60, 7):
        a, b = flat[one] - flat[i], flat[other] - flat[i]
        cross = 2 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        aa, bb = (a * a).sum(1), (b * b).sum(1)
        with np.errstate(all="ignore"):
            centers = np.stack([b[:, 1] * aa - a[:, 1] * bb, a[:, 0] * bb - b[:, 0] * aa], 1) / cross[:, None]
        radius = np.linalg.norm(centers, axis=1)
        side = np.linalg.norm(flat - flat[i], axis=1).max()
        usable = np.isfinite(radius) & (np.abs(centers).max(axis=1) < side)  # inside the first square
        empty = [
            np.linalg.norm(flat - flat[i] - c, axis=1).min() > r - 1e-9 for c, r in zip(centers, radius, strict=True)
        ]
        assert (
            farthest[i] == pytest.approx(radius[usable & empty].max(), rel=1e-3)
            or farthest[i] > radius[usable & empty].max()
        )


@pytest.mark.parametrize("angle", [long(60), 90, long(120), long(-60), -120])
def test_a_fold_is_unfolded(angle, rng):
    """Two planes that meet at an angle have the cells of one plane."""
    x = square(rng, 4000) * np.float32([2, 1, 0]) - np.float32([1, 0, 0])
    flat, _ = survey(x, UP)
    turn = np.radians(angle)
    bent, normals = x.copy(), np.repeat(UP, len(x), axis=0)
    right = x[:, 0] > 0
    bent[right] = np.column_stack([x[right, 0] * np.cos(turn), x[right, 1], -x[right, 0] * np.sin(turn)])
    normals[right] = [np.sin(turn), 0, np.cos(turn)]
    radii, borders = survey(bent, normals)
    inner = (np.abs(x[:, 0]) < 0.8) & (np.abs(x[:, 1] - 0.5) < 0.4)
    assert borders[inner].any(axis=1).mean() < FALSE_BORDERS
    assert (np.abs(radii / flat - 1)[inner] < 0.05).mean() > 0.98


# ---------------------------------------------------------------------------------------------------------- radii


@pytest.mark.parametrize(("positions", "most"), [(SPHERE, 7.8), (even_sphere(N), 4.0)])
def test_radii_cover_the_surface_with_little_excess(positions, most):
    radii, borders = survey(positions)
    count, nearest = covers(positions, radii, PLACES)
    assert most - 1 < count.mean() < most
    assert nearest.max() < 1.01 / OVERLAP
    assert not borders.any()


def test_radii_scale_and_do_not_depend_on_order():
    radii, _ = survey(SPHERE)
    np.testing.assert_allclose(survey(SPHERE * np.float32(1000))[0], 1000 * radii, rtol=1e-3)
    np.testing.assert_allclose(survey(SPHERE[::-1].copy())[0][::-1], radii, rtol=1e-5)
    assert radii.dtype == np.float32


@pytest.mark.long
def test_a_hundredfold_density_is_covered_everywhere(rng):
    """The density of points falls a hundredfold over a square, either gradually or by a step."""
    x = square(rng, 60_000)
    for keep in (100.0 ** -x[:, 0], np.where(x[:, 0] < 0.3, 1, 0.01)):
        points = x[rng.uniform(size=len(x)) < keep]
        radii, _ = survey(points, UP)
        samples = square(rng, 100_000)
        samples = samples[(np.abs(samples[:, :2] - 0.5) < 0.42).all(axis=1)]
        count, nearest = covers(points, radii, samples)
        assert nearest.max() < 1.3 / OVERLAP
        assert np.quantile(nearest, 0.999) < 1.02 / OVERLAP  # 0.97
        assert count.mean() < 10


@pytest.mark.long
def test_lines_of_a_scan_reach_each_other(rng):
    x = np.stack(np.meshgrid(np.arange(0, 1, 0.001), np.arange(0, 1, 0.015), [0]), -1).reshape(-1, 3)
    x += rng.uniform(-2e-4, 2e-4, x.shape) * [1, 1, 0]
    radii, borders = survey(x, UP)
    inner = (np.abs(x[:, :2] - 0.5) < 0.4).all(axis=1)
    assert not borders[inner].any()
    samples = 0.8 * square(rng, 50_000) + np.float32([0.1, 0.1, 0])
    assert covers(x.astype(np.float32), radii, samples)[1].max() < 1.01 / OVERLAP


@pytest.mark.parametrize("gap", [long(1.0), long(0.25)])
def test_two_sheets_have_the_radii_of_one(gap, rng):
    x = square(rng, 5000)
    h = np.sqrt(1 / 5000)
    below = square(rng, 5000) - np.float32([0, 0, gap * h])
    radii, borders = survey(np.concatenate([x, below]), np.repeat(np.concatenate([UP, -UP]), 5000, axis=0))
    alone, ends = survey(x, UP)
    inner = (np.abs(x[:, :2] - 0.5) < 0.4).all(axis=1)
    assert (np.abs(radii[:5000] / alone - 1)[inner] < 1e-4).mean() > 0.965
    assert all(rows[inner].any(axis=1).mean() < FALSE_BORDERS for rows in (borders[:5000], ends))


@pytest.mark.long
def test_borders_end_in_small_radii_that_know_the_way_out(rng):
    x = square(rng, 20_000)
    radii, borders = survey(x, UP)
    out = x[:, :2] - np.float32(0.5)
    away = np.abs(out)
    out[away < away[:, ::-1]] = 0  # towards the nearest side
    edge = (away.max(axis=1) > 0.498) & (away.min(axis=1) < 0.4)
    assert np.quantile(radii[edge], 0.75) < 2.2 * np.median(radii)  # 1.66; whole cells would give 2.7
    found = edge & borders.any(axis=1)
    assert found.sum() > 0.7 * edge.sum()
    assert ((borders[found, :2] * np.sign(out[found])).sum(axis=1) > 0.7).mean() > 0.9


@pytest.mark.long
def test_a_mirrored_cloud_has_the_same_radii(rng):
    """Points are random with open borders. The result once depended on the handedness of a cell's corner."""
    x = square(rng, 10_000)
    radii, borders = survey(x, UP)
    for mirror in (np.float32([-1, 1, 1]), np.float32([1, -1, 1])):
        mirrored, ends = survey(x * mirror, UP)
        np.testing.assert_allclose(mirrored, radii, rtol=1e-4)
        np.testing.assert_allclose(ends * mirror, borders, atol=1e-3)
    assert borders.any(axis=1).sum() > 100


def test_a_clump_counts_once(rng):
    clump = SPHERE[:1] + rng.normal(size=(500, 3)).astype(np.float32) * 1e-6
    radii, _ = survey(np.vstack([SPHERE, clump]))
    usual, _ = survey(SPHERE)
    assert radii.min() > 0.5 * usual.min()
    assert (np.median(radii[N:]) / usual[0]) == pytest.approx(1, rel=0.3)


@pytest.mark.parametrize("count", [1, long(5), long(20)])
def test_stray_points_stay_small(count):
    stray = np.float32(1000) + 50 * sphere_points(count, seed=4)
    radii, _ = survey(np.vstack([SPHERE, stray]))
    assert radii[N:].max() < 30 * np.median(radii)
    np.testing.assert_allclose(radii[:N], survey(SPHERE)[0], rtol=0.01)


def test_a_stray_point_above_the_surface_stays_small():
    radii, _ = survey(np.vstack([SPHERE, 1.3 * SPHERE[:1]]))
    assert radii[N] < 3 * np.median(radii)


def test_one_stray_point_of_few_stays_small():
    radii, _ = survey(np.vstack([sphere_points(50), [[1000, 0, 0]]]))
    assert radii[50] < 5 * np.median(radii)


def test_splats_of_few_points_overlap():
    np.testing.assert_allclose(survey([[0, 0, 0], [0, 3, 4]], UP)[0], 5 / 2 * OVERLAP)
    assert (survey(SPHERE[:5])[0] > 0.3).all()
    line = np.outer(np.arange(30), [1, 0, 0])
    np.testing.assert_allclose(survey(line, UP)[0], 0.5 * OVERLAP, rtol=1e-4)


def test_points_at_one_place_need_radii():
    for count in (1, 9):
        x = np.ones((count, 3))
        with pytest.raises(ValueError, match="same position.*give radii"):
            pr.Model(pr.Points(x, 0 * x + [0, 0, 1]))


def test_coincident_points_with_a_given_radius_make_a_model():
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points([[0, 0, 0]], [[0, 0, 1]]), [1.0]))
    assert scene.intersect([0.1, 0, 2], [0, 0, -1]).t == pytest.approx(2, abs=1e-3)


def test_duplicates_count_once():
    points = pr.procedural("sphere", 2000)
    twice = pr.Points(np.repeat(points.positions, 3, axis=0), np.repeat(points.normals, 3, axis=0))
    np.testing.assert_allclose(pr.Model(twice).radii, np.repeat(pr.Model(points).radii, 3), rtol=1e-6)


@pytest.mark.scans
@pytest.mark.long
@pytest.mark.parametrize("name", ["points/tls_pumpA_rgb.ply", "points/rgbd_kinect_chair_rgb.ply"])
def test_radii_of_real_scans_are_plausible(name):
    points = read(shared_model(name))
    rows = distinct(points.positions)[0]
    radii, _ = survey(points.positions[rows], points.normals[rows])
    assert (radii > 0).all()
    assert radii.max() < 100 * np.median(radii)


# --------------------------------------------------------------------------------------------------------- given


def test_given_radii_are_used():
    for given in ([1, 2, 3], np.array([1.0, 2, 3]), np.array([1, 0, 2, 0, 3], np.float32)[::2]):
        radii = check_radii(given, 3)
        assert radii.dtype == np.float32
        assert radii.tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("radii", "message"),
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
def test_invalid_radii_are_refused(radii, message):
    with pytest.raises(ValueError, match=message):
        check_radii(radii, 3)


@pytest.mark.parametrize("size", [1e-30, 1e30])
def test_radii_beyond_float32_are_refused(size):
    with pytest.raises(ValueError, match="radii range from"):
        pr.Model(pr.procedural("sphere", 1000), np.full(1000, size))


def test_many_coincident_points_are_thinned():
    points = pr.procedural("sphere", 2000)
    x = np.concatenate([np.repeat(points.positions[:1], 200_000, axis=0), points.positions])
    with pytest.warns(UserWarning, match="199,985 points left out: 16 others have the same position"):
        model = pr.Model(pr.Points(x, x))
    assert (model.tree.order >= 0).sum() == 2015


@pytest.mark.long
def test_no_radius_is_much_smaller_than_those_around(rng):
    x = square(rng, 20_000)
    radii, _ = survey(x, UP)
    near = neighbors(x, 9)[1]
    assert (radii >= 0.85 * np.median(radii[near], axis=1)).mean() > 0.97  # the cells alone would give 0.84


@pytest.mark.parametrize("side", [1, -1])
def test_a_stray_point_is_small_whichever_way_it_faces(side, rng):
    x = np.concatenate([square(rng, 5000), np.float32([[0.5, 0.5, 0.3]])])
    normals = np.repeat(UP, 5001, axis=0)
    normals[-1] *= side
    radii, _ = survey(x, normals)
    assert radii[-1] < 3 * np.median(radii)
