"""Nearest neighbours compared with brute force, degenerate clouds included."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial import cKDTree

from helpers.clouds import sphere_points
from helpers.marks import long
from pointray.cloud.neighbors import NeighborTree, distinct, kd_order, neighbor_chunks, neighbors, take
from pointray.cloud.neighbors.order import LEAF
from pointray.cloud.neighbors.search import PER_NEIGHBOR, SPARE

SPHERE = sphere_points(3000)
GRID = np.stack(np.meshgrid(*[np.arange(11)] * 3), axis=-1).reshape(-1, 3).astype(np.float32)
FLAT = np.random.default_rng(3).random((1500, 3)) * (1, 1, 0)

CLOUDS = {
    "sphere": SPHERE,
    "random": np.random.default_rng(4).random((2000, 3)),
    "grid": GRID,
    "rounded grid": GRID * np.float32(0.1),
    "line": np.linspace(0, 1, 2000)[:, None] * (1, 0, 0),
    "plane": FLAT,
    "two far clusters": np.random.default_rng(5).random((1800, 3)) + np.repeat([[0], [1e5]], 900, axis=0),
    "density": np.concatenate([FLAT, 1e-4 * FLAT]),
    "tiny": SPHERE[:900] * np.float32(1e-12),
    "tiniest": SPHERE[:900] * np.float32(1e-37),
    "huge": SPHERE[:900] * np.float32(1e12),
    "hugest": SPHERE[:900] * np.float32(3e38),
    "far": SPHERE + np.float32(1000),
    "in threes": np.repeat(SPHERE[:400], 3, axis=0),
    "one place": np.ones((3000, 3)),
    "17": SPHERE[:17],
    "one": SPHERE[:1],
}
CLOUDS = {name: np.asarray(cloud, np.float32) for name, cloud in CLOUDS.items()}


def brute_force(positions, k, queries):
    """Return the k nearest neighbours by float64 distance, ties ordered by row."""
    d = queries[:, None].astype(float) - positions[None].astype(float)
    squares = d[..., 0] ** 2 + d[..., 1] ** 2 + d[..., 2] ** 2
    near = np.argsort(squares, axis=1, kind="stable")[:, :k]
    return np.sqrt(np.take_along_axis(squares, near, 1)).astype(np.float32), near


@pytest.mark.parametrize("every", [7, long(1)])
@pytest.mark.parametrize("name", CLOUDS)
def test_neighbors_equal_those_of_brute_force(name, every):
    """Ties included: except for thousands of points at one place, their order is defined.

    Brute force sorts all points for each query, so only each seventh is checked: all lanes of 16 occur.
    """
    positions = CLOUDS[name]
    queries = np.concatenate([positions[::3], positions[:7] * np.float32(0.9)])
    for asked in (None, queries):
        most, first = brute_force(positions, 80, (positions if asked is None else asked)[::every])
        for k in (1, 8, 21, 80):
            distances, indices = neighbors(positions, k, asked)
            np.testing.assert_allclose(distances[::every], most[:, :k], rtol=2e-7, err_msg=f"k = {k}")
            if name != "one place":
                np.testing.assert_array_equal(indices[::every], first[:, :k], err_msg=f"k = {k}")
            assert (distances.dtype, indices.dtype) == (np.float32, np.int32)
            assert distances.shape == indices.shape
            assert len(indices) == len(positions if asked is None else asked)


def test_neighbors_are_those_of_scipy(rng):
    """At a size with many levels of boxes, and blocks whose surroundings overflow."""
    clumps = rng.normal(size=(300, 3)).astype(np.float32)
    positions = np.concatenate([clumps + np.float32(s) * sphere_points(300) for s in 10.0 ** -np.arange(0, 6, 0.05)])
    positions = np.concatenate([positions, clumps[:200] * 1000])
    distances, indices = neighbors(positions, 20)
    wanted = cKDTree(positions).query(positions, 20)[0]
    np.testing.assert_allclose(distances, wanted, rtol=1e-6)
    assert (np.sort(indices, axis=1)[:, 1:] > np.sort(indices, axis=1)[:, :-1]).all()


def test_positions_in_order_are_neighbors_too():
    positions = SPHERE[kd_order(SPHERE)]
    rows = NeighborTree(positions, in_order=True).rows(9)
    np.testing.assert_array_equal(rows[::7], brute_force(positions, 9, positions[::7])[1])
    np.testing.assert_array_equal(NeighborTree(positions, in_order=True).query(9)[1], rows)
    np.testing.assert_array_equal(NeighborTree(positions, in_order=True).rows(9, slice(160, 333)), rows[160:333])
    assert [part.start for part, _ in neighbor_chunks(positions, 9)] == [0]
    np.testing.assert_array_equal(np.concatenate([found for _, found in neighbor_chunks(positions, 9)]), rows)


def test_points_that_are_not_in_kd_order_get_the_right_neighbors():
    rows = brute_force(SPHERE, 9, SPHERE[::7])[1]
    np.testing.assert_array_equal(NeighborTree(SPHERE, in_order=True).rows(9)[::7], rows)


def test_no_queries_have_no_neighbors():
    distances, indices = neighbors(SPHERE, 3, SPHERE[:0])
    assert distances.shape == indices.shape == (0, 3)


def test_queries_may_be_any_rows_of_an_array(rng):
    positions = rng.random((500, 3), np.float32)
    distances, indices = neighbors(positions, 3, positions[::2])
    assert np.array_equal(indices, neighbors(positions, 3)[1][::2])
    assert np.array_equal(neighbors(np.asfortranarray(positions), 3, positions[::2])[0], distances)


def test_more_points_than_are_collected(rng):
    cloud = np.concatenate([SPHERE, np.float32(1e-3) * rng.random((16 * (SPARE + 20 // PER_NEIGHBOR), 3), np.float32)])
    distances, indices = neighbors(cloud, 20)
    wanted, rows = brute_force(cloud, 20, cloud[::7])
    np.testing.assert_allclose(distances[::7], wanted, rtol=2e-7)
    np.testing.assert_array_equal(indices[::7], rows)


@pytest.mark.parametrize("count", [*range(1, 40), 255, 256, 257, 3000])
def test_aligned_ranges_of_the_order_are_boxes_of_a_kd_tree(count):
    order = kd_order(SPHERE[:count])
    assert np.sort(order).tolist() == list(range(count))
    path, size = SPHERE[order], LEAF
    while size < count:
        for start in range(0, count - size, 2 * size):
            one, other = path[start : start + size], path[start + size : start + 2 * size]
            assert (one.max(axis=0) <= other.min(axis=0)).any()
        size *= 2


def test_many_points_have_an_order_too(rng):
    """The first splits are done by several threads."""
    positions = rng.random((40_000, 3), np.float32)
    order = kd_order(positions)
    assert np.array_equal(np.sort(order), np.arange(40_000))
    boxes = positions[order].reshape(-1, 16, 3)
    assert np.ptp(boxes, axis=1).mean() < 1.5 * (16 / 40_000) ** (1 / 3)


@pytest.mark.long
@pytest.mark.parametrize("features", ["", None])
def test_other_processors_find_the_same_neighbors(features, tmp_path):
    """Checked without AVX-512, and with bounds checks of all array accesses."""
    code = (
        "import numpy as np; from pointray.cloud.neighbors import neighbors, kd_order;"
        "p = np.random.default_rng(0).random((700, 3), np.float32); p = np.concatenate([p, p[:50]]);"
        "d, i = neighbors(p, 12); q = p.astype(float);"
        "s = ((q[:, None] - q) ** 2); s = s[..., 0] + s[..., 1] + s[..., 2];"
        "assert (i == np.argsort(s, axis=1, kind='stable')[:, :12]).all(); print('same')"
    )
    env = {**os.environ, "POINTRAY_CACHE": str(tmp_path), "POINTRAY_KERNELS": "jit"}
    if features is None:
        env["POINTRAY_CHECK"] = "1"
    else:
        env |= {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": features}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    assert done.stdout.strip() == "same", done.stderr[-800:]


def test_distinct_finds_equal_rows():
    doubled = np.vstack([SPHERE, SPHERE[::-1], -np.zeros((2, 3)), np.zeros((1, 3))]).astype(np.float32)
    rows, groups = distinct(doubled)
    assert len(rows) == 3001
    np.testing.assert_array_equal(doubled[rows][groups], doubled)
    assert rows[:3000].tolist() == list(range(3000))
    assert [len(array) for array in distinct(SPHERE[:0])] == [0, 0]


def test_distinct_merges_cells(rng):
    grid = np.stack(np.meshgrid(*[np.arange(5)] * 3), axis=-1).reshape(-1, 3)
    clumps = np.repeat(grid, 4, axis=0) + rng.uniform(0.1, 0.2, (500, 3))
    rows, groups = distinct(clumps.astype(np.float32), 1.0)
    assert len(rows) == 125
    np.testing.assert_array_equal(groups, np.arange(500) // 4)


@pytest.mark.parametrize("kind", ["<f4", "<f8", "<i4", "<i2", "u1", "?"])
@pytest.mark.parametrize("shape", [(), (3,), (2, 2), (0,)])
def test_rows_are_taken_as_numpy_does(rng, kind, shape):
    values = rng.integers(0, 2, (50_000, *shape)).astype(kind)
    for rows in (rng.integers(0, 50_000, 70_000), rng.permutation(50_000).astype(np.int32), np.zeros(0, np.int64)):
        found = take(values, rows)
        assert found.dtype == values.dtype
        np.testing.assert_array_equal(found, values[rows])
    np.testing.assert_array_equal(take(values[::2], np.array([1, 0])), values[[2, 0]])


def test_queries_at_hundreds_of_coincident_points_beside_others(rng):
    """Missing returns at 0, 0, 0: the bound of such a query shrank for ever."""
    positions = np.concatenate([np.zeros((300, 3)), rng.uniform(-20, 20, (2500, 3))]).astype(np.float32)
    queries = np.concatenate([rng.uniform(-3, 3, (400, 3)), np.zeros((40, 3))]).astype(np.float32)
    near = NeighborTree(positions).query(8, queries)
    exact = np.linalg.norm(queries[:, None].astype(float) - positions, axis=2)
    np.testing.assert_allclose(near.distances, np.sort(exact, axis=1)[:, :8], rtol=1e-5, atol=1e-6)
