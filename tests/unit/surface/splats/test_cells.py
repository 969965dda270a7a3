"""Cells, gaps and medians computed for 16 points at once, compared with those of single points and with NumPy."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial import Voronoi

from helpers.clouds import sphere_points
from helpers.marks import long
from pointray.cloud.neighbors import distinct, neighbors
from pointray.cloud.statistics import quantile
from pointray.surface.splats import cells, choose_radii
from pointray.surface.splats.borders import FOLD, GAP, find_gaps
from pointray.surface.splats.cells import NEIGHBORS
from pointray.surface.splats.closed import CLOSED, OPEN, UNSURE, WIDE, distances, measure_closed, pack_table
from pointray.surface.splats.medians import medians_around
from pointray.surface.splats.radii import _in_cells
from pointray.surface.splats.sheets import BESIDE, OPPOSED, find_sheets
from pointray.surface.splats.voronoi import OTHER_SHEET, Neighborhood, measure_cells


def square(n, seed=0):
    return np.random.default_rng(seed).uniform(size=(n, 3)).astype(np.float32) * np.float32([1, 1, 0])


def up(n, sign=1):
    return np.repeat(np.float32([[0, 0, sign]]), n, axis=0)


def cube(n):
    """Random points on a cube, with the normals of its faces."""
    rng = np.random.default_rng(11)
    axis, side, x = rng.integers(0, 3, n), rng.integers(0, 2, n), rng.uniform(size=(n, 3))
    normals = np.zeros((n, 3))
    x[np.arange(n), axis], normals[np.arange(n), axis] = side, 2 * side - 1
    return x.astype(np.float32), normals.astype(np.float32)


def clusters(n):
    """Return points of a plane; a third of them have two others very close."""
    rng, x = np.random.default_rng(0), square(n)
    size = 1e-4 / np.sqrt(n) * np.float32([1, 1, 0])
    second = x[::3] + size * rng.normal(size=x[::3].shape)
    return np.vstack([x, second, second + size * rng.normal(size=second.shape)]).astype(np.float32)


def noisy_sphere(n, noise):
    rng, x = np.random.default_rng(12), sphere_points(n, seed=1)
    normals = x + noise * rng.normal(size=x.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return (x + 0.07 * rng.normal(size=x.shape)).astype(np.float32), normals.astype(np.float32)


def some_flipped(n):
    """Return points of a plane; one in 20 faces the other way and has few neighbours on its own sheet."""
    return square(n), up(n) * np.where(np.arange(n) % 20 == 0, -1, 1)[:, None].astype(np.float32)


def grid(m):
    return np.stack(np.meshgrid(np.arange(m), np.arange(m), [0]), -1).reshape(-1, 3).astype(np.float32)


CLOUDS = {
    "random": lambda: (square(3001), up(3001)),
    "sphere": lambda: (sphere_points(3000), sphere_points(3000)),
    "noise": lambda: noisy_sphere(3000, 0.2),
    "rough": lambda: noisy_sphere(3000, 0.5),
    "cube": lambda: cube(3000),
    "wall": lambda: (
        np.vstack([square(1500), square(1500, 2) - np.float32([0, 0, 0.01])]),
        np.vstack([up(1500), -up(1500)]),
    ),
    "grid": lambda: (grid(40), up(1600)),
    "clusters": lambda: (clusters(3000), up(5000)),
    "flipped": lambda: some_flipped(3000),
    "tiny": lambda: (square(3001) * np.float32(1e-12), up(3001)),
    "huge": lambda: (square(3001) * np.float32(1e12), up(3001)),
    "far": lambda: (square(3001) + np.float32([1000, -2000, 500]), up(3001)),
    "line": lambda: (square(2000) * np.float32([1, 0, 0]), up(2000)),
    "few": lambda: (square(22), up(22)),
}


@cache
def cloud(name):
    """Return points and normals, writeable: read-only arrays have another type in Numba."""
    return CLOUDS[name]()


def table_and_neighborhood(name, count=NEIGHBORS + 1):
    x, n = cloud(name)
    neighborhood = Neighborhood(np.arange(len(x), dtype=np.int32), neighbors(x, count).indices)
    return x, n, neighborhood, measure_closed(pack_table(x, n), neighborhood)


# ---------------------------------------------------------------------------------------------------------- cells


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("count", [9, 21, 41])
def test_closed_cells_equal_those_of_single_points(name, count):
    x, n, neighborhood, found = table_and_neighborhood(name, min(count, len(cloud(name)[0])))
    reach, sure = measure_cells(x, n, neighborhood)
    closed = found.state == CLOSED
    tie = np.abs(2 * reach / distances(x, neighborhood, -1) - 1) < 1e-5  # a vertex half as far as the last neighbour
    assert (sure | tie)[closed].all()
    assert not (sure & ~tie)[found.state == OPEN].any()
    # Where points are close together, corners that are kept 1e-5 beyond a side may lie far along it.
    np.testing.assert_allclose(found.reach[closed], reach[closed], rtol=0.05 if name == "clusters" else 2e-5)
    np.testing.assert_allclose(found.fourth, neighbors(x, 5).distances[:, 4], rtol=1e-6)


@pytest.mark.parametrize("name", ["random", "clusters"])
def test_closed_cells_equal_those_of_a_voronoi_diagram(name):
    x, _, _, found = table_and_neighborhood(name)
    flat = x[:, :2].astype(np.float64)
    diagram = Voronoi(flat)
    rows = np.flatnonzero(found.state == CLOSED)
    cells = [diagram.vertices[diagram.regions[diagram.point_region[i]]] for i in rows]
    farthest = [np.linalg.norm(cell - flat[i], axis=1).max() for i, cell in zip(rows, cells, strict=True)]
    np.testing.assert_allclose(found.reach[rows], farthest, rtol=2e-5)


def test_few_cells_need_the_slow_path():
    most_of = {"random": 0.002, "sphere": 0.002, "grid": 0.0, "wall": 0.01, "cube": 0.06, "noise": 0.25}
    for name, most in most_of.items():
        assert (table_and_neighborhood(name)[3].state == UNSURE).mean() <= most, name


@pytest.mark.parametrize("name", CLOUDS)
def test_no_gap_is_overlooked(name):
    x, n, neighborhood, found = table_and_neighborhood(name)
    reach, sure = measure_cells(x, n, neighborhood)
    rows = np.flatnonzero(~sure | (reach > 1.0001 * WIDE * distances(x, neighborhood, 8)))
    gaps = rows[find_gaps(x, n, rows, neighborhood.near[rows]).any(axis=1)]
    assert found.gap[gaps].all()


def test_few_points_of_a_sphere_may_have_gaps():
    assert table_and_neighborhood("sphere")[3].gap.mean() < 0.1


@pytest.mark.parametrize("name", CLOUDS)
def test_neighbours_are_assigned_to_the_right_sheet(name):
    _, n, neighborhood, found = table_and_neighborhood(name)
    cosines = np.einsum("ijk,ik->ij", n[neighborhood.near], n)
    one_sheet, facing = (cosines[:, :9] > OTHER_SHEET).all(axis=1), (cosines < OPPOSED).any(axis=1)
    assert (found.one_sheet == one_sheet).mean() > 0.998
    assert not (facing & ~found.facing).any()
    assert (found.facing & ~facing).mean() < 0.04


def test_small_clouds_take_the_slow_path():
    x = square(15)
    found = measure_closed(pack_table(x, up(15)), Neighborhood(np.arange(15, dtype=np.int32), neighbors(x, 15).indices))
    assert (found.state == UNSURE).all() and found.gap.all() and found.facing.all() and not found.one_sheet.any()


# ----------------------------------------------------------------------------------------------- gaps and medians


def naive_gap(x, n, i, near):
    """Return the widest angle without a neighbour in a point's tangent plane, and the direction of its middle."""
    sign = 1.0 if n[i, 2] >= 0 else -1.0
    a = -1.0 / (sign + n[i, 2])
    b = n[i, 0] * n[i, 1] * a
    u = np.array([1 + sign * n[i, 0] ** 2 * a, sign * b, -sign * n[i, 0]])
    v = np.array([b, sign + n[i, 1] ** 2 * a, -n[i, 1]])
    d = np.float64(x[near]) - x[i]
    folded = n[near] @ n[i] < FOLD
    lean = np.where((d @ n[i] > 0)[:, None], -1, 1)[folded] * n[near[folded]]
    d = np.concatenate([d, lean])
    flat = np.stack([d @ u, d @ v], axis=1)
    angles = np.sort(np.arctan2(flat[:, 1], flat[:, 0])[flat.any(axis=1)])
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    k = gaps.argmax()
    middle = angles[k] + gaps[k] / 2
    return gaps[k], np.cos(middle) * u + np.sin(middle) * v


@pytest.mark.parametrize("name", ["random", "noise", "cube", "clusters", "few"])
def test_gaps_equal_those_of_sorted_angles(name):
    x, n = cloud(name)
    near = neighbors(x, NEIGHBORS + 1)[1]
    rows = np.arange(0, len(x), 1 + len(x) // 300)
    found = find_gaps(x, n, rows, near[rows])
    for i, direction in zip(rows, found, strict=True):
        gap, middle = naive_gap(np.float64(x), np.float64(n), i, near[i])
        if abs(gap - GAP) > 1e-3:
            np.testing.assert_allclose(direction, middle if gap > GAP else 0, atol=1e-3)


def test_neighbours_in_one_direction_or_none_leave_gaps():
    """Neighbours in a single direction leave the opposite one open; neighbours above a point leave all open."""
    x = np.float32([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 1]])
    found = find_gaps(x, up(4), np.arange(1), np.int32([[0, 1, 2]]))
    np.testing.assert_allclose(found, [[-1, 0, 0]], atol=1e-6)
    assert np.linalg.norm(find_gaps(x, up(4), np.arange(1), np.int32([[0, 3]]))) == pytest.approx(1)


@pytest.mark.parametrize("name", ["random", "wall", "flipped", "few"])
@pytest.mark.parametrize("own", [False, True])
def test_medians_are_those_of_numpy(rng, name, own):
    x, n, neighborhood, found = table_and_neighborhood(name)
    values = rng.lognormal(size=len(x)).astype(np.float32)
    odd = np.flatnonzero(~found.one_sheet)
    got = medians_around(values, n, neighborhood.near[:, :9], Neighborhood(odd, neighborhood.near[odd]), own)
    for i in range(0, len(x), 1 + len(x) // 500):
        near = neighborhood.near[i, 0 if own else 1 :]
        same = near[n[near] @ n[i] >= OTHER_SHEET][: 9 if own else 8]
        want = np.median(values[same if len(same) >= 4 else near[: 9 if own else 8]])
        assert got[i] == pytest.approx(want, rel=1e-6)


@pytest.mark.parametrize("n", [1, 2, 1000, 100_000])
@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.95, 1.0])
def test_quantiles_are_exact(rng, n, share):
    values = rng.lognormal(size=n).astype(np.float32)
    for some in (values, np.sort(values), np.round(values), np.zeros(n, np.float32), np.repeat(values[:1], n)):
        before = some.copy()
        assert quantile(some, share) == pytest.approx(float(np.quantile(some, share)), rel=1e-6)
        np.testing.assert_array_equal(some, before)


# --------------------------------------------------------------------------------------------------------- sheets


@pytest.mark.parametrize("name", ["wall", "rough", "random"])
@pytest.mark.parametrize("known", [False, True])
def test_sheets_equal_those_of_a_slow_search(name, known):
    x, n, neighborhood, found = table_and_neighborhood(name)
    radii = 1.5 * distances(x, neighborhood, 4)
    facing = np.flatnonzero(found.facing) if known else np.arange(len(x))
    sheets = find_sheets(x, n, radii, neighborhood.near, Neighborhood(facing, neighborhood.near[facing]))
    want, i = np.zeros(len(x), np.int8), np.arange(len(x))
    for j in neighborhood.near.T:
        d = np.float64(x[j]) - x[i]
        close = np.linalg.norm(d, axis=1) < radii[i] + radii[j]
        facing = np.einsum("ij,ij->i", n[i], n[j]) < OPPOSED
        reached = close & facing & (np.abs(np.einsum("ij,ij->i", d, n[i])) < np.maximum(radii[i], radii[j]))
        want[i[reached]] = want[j[reached]] = 1
    want |= want[neighborhood.near[:, : BESIDE + 1]].any(axis=1)
    if name == "random":
        assert sheets is None and not want.any()
    else:
        np.testing.assert_array_equal(sheets, want)


# ----------------------------------------------------------------------------------------------------- everything


def test_the_order_of_the_points_does_not_matter(rng):
    x, n = cloud("cube")
    there = choose_radii(x, n)
    order = rng.permutation(len(x))
    mixed = choose_radii(x[order], n[order])
    np.testing.assert_allclose(mixed.radii, there.radii[order], rtol=1e-5)
    np.testing.assert_allclose(mixed.borders, there.borders[order], atol=1e-5)
    np.testing.assert_array_equal(mixed.isolated, there.isolated[order])


@pytest.mark.parametrize("name", ["random", long("cube"), long("wall"), "clusters"])
def test_processing_in_parts_gives_the_same_result(name, monkeypatch):
    x, n = cloud(name)
    whole = choose_radii(x, n)
    np.testing.assert_array_equal(whole.near, neighbors(x, 9).indices)
    monkeypatch.setattr(cells, "PART", 320)  # the last part is not a multiple of 16
    for one, other in zip(choose_radii(x, n), whole, strict=True):
        np.testing.assert_array_equal(one, other)


def test_points_in_cells_equal_those_of_the_whole_grid():
    x = square(20_000)
    for cell in (0.0002, 0.002, 0.2):
        rows, members = _in_cells(x, neighbors(x, 2).distances[:, 1], cell)
        np.testing.assert_array_equal(rows, distinct(x, cell)[0])
        np.testing.assert_array_equal(members, distinct(x, cell)[1])


@pytest.mark.parametrize("clump", [3, 40, 800])
def test_clumps_of_any_size_count_once(rng, clump):
    x = np.concatenate([sphere_points(3000), sphere_points(3000)[:1] + 1e-7 * rng.normal(size=(clump, 3))])
    x = np.unique(x.astype(np.float32), axis=0)
    n = x / np.linalg.norm(x, axis=1, keepdims=True)
    radii, _, _, facing, _ = choose_radii(x, n)
    usual = choose_radii(sphere_points(3000), sphere_points(3000)).radii
    assert radii.min() > 0.4 * np.median(usual) and radii.max() < 1.3 * usual.max()
    assert not facing.any()
