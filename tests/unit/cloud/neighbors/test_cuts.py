"""The kd order of clouds larger than memory has the same parts as the kd order in memory."""

from functools import cache

import numpy as np
import pytest

from helpers.clouds import sphere_points, uneven_points
from pointray.cloud.neighbors import kd_order
from pointray.cloud.neighbors.cuts import find_cuts


def in_chunks(points, rows=3001):
    return lambda: (points[a : a + rows] for a in range(0, len(points), rows))


def parts_of(points, size):
    cuts = find_cuts(in_chunks(points), len(points), size)
    return np.concatenate([cuts.parts_of(points[a : a + 999], a) for a in range(0, len(points), 999)])


CLOUDS = {
    "sphere": lambda: sphere_points(50_000, 2),
    "uneven": lambda: uneven_points(40_000),
    "small and large": lambda: np.random.default_rng(11).normal(size=(30_000, 3)) * [1e-30, 1e-3, 1e20],
    "one more than two parts": lambda: sphere_points(2 * 4096 + 1, 3),
    "two parts": lambda: sphere_points(2 * 4096, 4),
    "as many as a part": lambda: sphere_points(4096, 5),
}


@cache
def cloud(name):
    """Return writeable points: read-only arrays have another type in Numba."""
    return CLOUDS[name]().astype(np.float32)


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("size", [1024, 16384])
def test_parts_are_ranges_of_the_order_in_memory(name, size):
    points = cloud(name)
    order, parts = kd_order(points), parts_of(points, size)
    for k, start in enumerate(range(0, len(points), size)):
        assert np.array_equal(np.flatnonzero(parts == k), np.sort(order[start : start + size]))


@pytest.mark.parametrize("kind", ["grid", "plane", "one place", "signs of zero"])
def test_ties_are_cut_by_rows(rng, kind):
    """Parts are full and on one side of each cut; of points on the cut the first side gets the lower rows."""
    n, size = 20_000, 2048
    points = {
        "grid": rng.integers(0, 4, (n, 3)),
        "plane": np.column_stack([rng.random((n, 2)) * [1, 0], np.repeat(3.0, n)]),
        "one place": np.ones((n, 3)),
        "signs of zero": np.zeros((n, 3)) * rng.choice([-1.0, 1.0], (n, 3)),
    }[kind].astype(np.float32)
    cuts = find_cuts(in_chunks(points), n, size)
    parts = cuts.parts_of(points, 0)
    assert np.bincount(parts).tolist() == [size] * (n // size) + [n % size]
    first = cuts.axes[0]
    half = parts < 16384 // size
    here, there = points[half, first], points[~half, first]
    assert here.max() <= there.min()
    on = points[:, first] == there.min()
    assert np.flatnonzero(on & half).max(initial=-1) < np.flatnonzero(on & ~half).min()


def test_progress_goes_from_zero_to_one():
    shares = []
    find_cuts(in_chunks(cloud("sphere")), 50_000, 1024, shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0 and len(shares) > 50


def test_chunks_of_another_length_are_an_error():
    with pytest.raises(ValueError, match="49,999 points were read where 50,000"):
        find_cuts(in_chunks(cloud("sphere")[1:]), 50_000, 1024)


@pytest.mark.parametrize("kind", ["grid", "plane"])
def test_ties_are_cut_as_in_memory(rng, kind):
    points = rng.integers(0, 30, (70_000, 3)) if kind == "grid" else rng.random((50_000, 3)).round(2) * [1, 1, 0]
    points = points.astype(np.float32)
    order, parts = kd_order(points), parts_of(points, 16384)
    for k, start in enumerate(range(0, len(points), 16384)):
        assert np.array_equal(np.flatnonzero(parts == k), np.sort(order[start : start + 16384]))


@pytest.mark.parametrize("name", ["sphere", "grid"])
def test_a_part_that_is_sorted_by_itself_has_the_order_of_the_whole(rng, name):
    points = cloud("sphere") if name == "sphere" else rng.integers(0, 30, (70_000, 3)).astype(np.float32)
    size = 16384
    order, parts = kd_order(points), parts_of(points, size)
    for k, start in enumerate(range(0, len(points), size)):
        rows = np.flatnonzero(parts == k)
        assert np.array_equal(rows[kd_order(points[rows])], order[start : start + size])
