import numpy as np
import pytest
from scipy.spatial import cKDTree

from conftest import shared_model, sphere_points
from pointray.data import Points
from pointray.neighbors import distinct, morton_order, neighbors
from pointray.points import estimate_normals, read
from pointray.points.normals import _propagate, mend_normals

RNG = np.random.default_rng(3)
SPHERE = sphere_points(3000)


def degrees(one, other):
    return np.degrees(np.arccos(np.clip(np.sum(one * other, axis=1), -1, 1)))


# --------------------------------------------------------------------------------------------------- neighbours


def naive_neighbors(positions, k, queries):
    squares = np.sum((queries[:, None].astype(float) - positions[None]) ** 2, axis=2)
    return np.sqrt(np.sort(squares, axis=1)[:, :k])


def test_neighbors_are_those_of_brute_force():
    positions, queries = RNG.random((400, 3), np.float32), RNG.random((100, 3), np.float32)
    for asked, k in ((None, 9), (queries, 1), (queries, 16)):
        distances, indices = neighbors(positions, k, asked)
        asked = positions if asked is None else asked
        np.testing.assert_allclose(distances, naive_neighbors(positions, k, asked), rtol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(positions[indices] - asked[:, None], axis=2), distances, rtol=1e-5)
        assert distances.dtype == np.float32


def test_few_positions_are_all_neighbors():
    distances, indices = neighbors(SPHERE[:3], 9)
    assert distances.shape == (3, 3)
    assert np.sort(indices, axis=1).tolist() == [[0, 1, 2]] * 3
    assert neighbors(SPHERE[:1], 9)[0].tolist() == [[0]]


def test_duplicates_are_neighbors_at_no_distance():
    distances, indices = neighbors(np.repeat(SPHERE[:20], 5, axis=0), 5)
    assert (distances == 0).all()
    assert (indices // 5 == np.arange(100)[:, None] // 5).all()


def test_distinct_finds_equal_rows():
    doubled = np.vstack([SPHERE, SPHERE[::-1], -np.zeros((2, 3)), np.zeros((1, 3))]).astype(np.float32)
    rows, places = distinct(doubled)
    assert len(rows) == 3001
    np.testing.assert_array_equal(doubled[rows][places], doubled)
    assert rows[:3000].tolist() == list(range(3000))


def test_distinct_merges_cells():
    grid = np.stack(np.meshgrid(*[np.arange(5)] * 3), axis=-1).reshape(-1, 3)
    clumps = np.repeat(grid, 4, axis=0) + RNG.uniform(0.1, 0.2, (500, 3))
    rows, places = distinct(clumps.astype(np.float32), 1.0)
    assert len(rows) == 125
    np.testing.assert_array_equal(places, np.arange(500) // 4)


def test_morton_order_keeps_neighbors_together():
    order = morton_order(SPHERE)
    assert np.sort(order).tolist() == list(range(3000))
    step = np.linalg.norm(np.diff(SPHERE[order], axis=0), axis=1)
    assert np.median(step) < 4 * np.median(cKDTree(SPHERE).query(SPHERE, k=2)[0][:, 1])


# ------------------------------------------------------------------------------------------------------ estimate


def test_normals_of_a_sphere_point_outward():
    normals = estimate_normals(Points(SPHERE)).normals
    assert degrees(normals, SPHERE).max() < 10
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)


def test_normals_of_a_wavy_ground_point_up_and_follow_it():
    x, y = RNG.uniform(-5, 5, (2, 5000))
    truth = np.stack([-0.5 * np.cos(x), np.zeros(5000), np.ones(5000)], axis=1)
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    points = Points(np.stack([x, y, 0.5 * np.sin(x)], axis=1) + [5e5, 5e6, 100])
    assert np.median(degrees(estimate_normals(points).normals, truth)) < 2
    assert degrees(estimate_normals(points).normals, truth).max() < 30


def test_each_part_is_turned_by_itself():
    parts = [SPHERE * size + np.float32(shift) for size, shift in ((1, 0), (0.5, 9), (2, -20))]
    normals = estimate_normals(Points(np.vstack(parts))).normals
    assert degrees(normals, np.vstack([SPHERE] * 3)).max() < 15


def test_signs_are_set_right_wherever_they_start():
    near = neighbors(SPHERE, 16)[1]
    for start in (np.ones(3000), -np.ones(3000), RNG.choice([-1, 1], 3000)):
        start = start.astype(np.float32)
        np.testing.assert_array_equal(_propagate(SPHERE, SPHERE * start[:, None], near), start)


def test_normals_turn_to_the_viewpoint():
    origin = np.array([1e6, 0, 0])
    inside = estimate_normals(Points(SPHERE + origin), viewpoint=origin).normals
    assert degrees(inside, -SPHERE).max() < 10


def test_everything_else_is_kept_and_bad_rows_get_no_normal():
    positions = np.vstack([SPHERE, [[np.nan, 0, 0]], SPHERE[:10]])
    points = estimate_normals(Points(positions, colors=np.ones((3011, 3)), attributes={"a": np.arange(3011)}), 12)
    np.testing.assert_array_equal(points.positions, positions)
    assert points.attributes["a"][-1] == 3010
    assert (points.colors == 255).all()
    assert points.normals[3000].tolist() == [0, 0, 0]
    np.testing.assert_array_equal(points.normals[3001:], points.normals[:10])


def test_points_on_a_line_and_few_points_get_unit_normals():
    for positions in (np.outer(np.arange(30), [1, 2, 3]), SPHERE[:3], SPHERE[:4]):
        normals = estimate_normals(Points(positions)).normals
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize(
    ("positions", "others", "words"),
    [
        (SPHERE[:2], {}, "at least 3 points"),
        (np.ones((50, 3)), {}, "50 points take 1 different"),
        (SPHERE, {"neighbors": 2}, "at least 3 neighbors"),
        (SPHERE, {"viewpoint": (0, 0)}, "viewpoint"),
        (SPHERE, {"viewpoint": (0, 0, np.nan)}, "viewpoint"),
    ],
)
def test_what_cannot_be_estimated(positions, others, words):
    with pytest.raises(ValueError, match=words):
        estimate_normals(Points(positions), **others)


@pytest.mark.parametrize(
    ("name", "viewpoint", "agree"),
    [
        ("points/stanford_bunny.ply", None, 0.999),
        ("points/nefertiti_50k.ply", None, 0.99),
        ("points/tls_pumpA_rgb.ply", (0, 0, 0), 0.999),
    ],
)
def test_estimates_agree_with_the_normals_of_real_scans(name, viewpoint, agree):
    points = read(shared_model(name))
    angle = degrees(estimate_normals(points, viewpoint=viewpoint).normals, points.normals)
    assert (angle < 90).mean() > agree
    assert np.median(angle) < 3


# ---------------------------------------------------------------------------------------------------------- mend


def test_good_normals_are_only_normalised():
    points, message = mend_normals(Points(SPHERE, SPHERE * 10.0 ** RNG.uniform(-30, 30, (3000, 1))))
    assert message is None
    np.testing.assert_allclose(points.normals, SPHERE, atol=1e-6)


def test_missing_normals_come_from_their_neighbors():
    normals = SPHERE.copy()
    normals[::7], normals[3::7] = np.nan, 0
    normals[5::70, 1] = np.inf
    points, message = mend_normals(Points(SPHERE, normals))
    lost = ~np.isfinite(normals).all(axis=1) | ~normals.any(axis=1)
    assert message.startswith(f"{lost.sum():,} of 3,000 normals")
    assert degrees(points.normals, SPHERE).max() < 15
    np.testing.assert_allclose(points.normals[~lost], SPHERE[~lost], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(points.normals, axis=1), 1, atol=1e-5)


def test_opposite_normals_around_a_missing_one():
    normals = np.tile([[0, 0, 1], [0, 0, -1]], (4, 1)).astype(float)
    positions = np.vstack([sphere_points(8), [[0, 0, 0]]])
    points, _ = mend_normals(Points(positions, np.vstack([normals, [[0, 0, 0]]])))
    assert abs(points.normals[8, 2]) == 1


@pytest.mark.parametrize("normals", [None, np.zeros_like(SPHERE), np.full_like(SPHERE, np.nan)])
def test_no_normals_at_all_are_estimated(normals):
    points, message = mend_normals(Points(SPHERE, normals))
    assert "estimated" in message
    assert degrees(points.normals, SPHERE).max() < 10


def test_rows_without_position_need_no_normal():
    positions, normals = SPHERE.copy(), SPHERE.copy()
    positions[4], normals[4] = np.nan, np.nan
    points, message = mend_normals(Points(positions, normals))
    assert message is None
    assert points.normals[4].tolist() == [0, 0, 0]
