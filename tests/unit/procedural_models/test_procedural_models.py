"""The procedural models have the promised number of points, on the exact surface, even, and always the same."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from helpers.marks import long
from pointray.engine.jit import Array, kernel
from pointray.procedural_models import _MESH_CELL, NAMES, area, mesh, procedural, procedural_distance, sample
from pointray.procedural_models.clay import _foot
from pointray.procedural_models.creases import edges_of


@cache
def drawn(name: str, n: int, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Sample of a model, shared by tests and therefore read-only."""
    arrays = sample(name, n, seed=seed)
    for array in arrays:
        array.setflags(write=False)
    return arrays


def spacing(points: np.ndarray, name: str) -> np.ndarray:
    """Distance from each point to its nearest neighbour, in units of sqrt(area / n)."""
    return cKDTree(points).query(points, k=2)[0][:, 1] / np.sqrt(area(name) / len(points))


def gradient(name: str, x: np.ndarray, step: float = 1e-6) -> np.ndarray:
    offsets = step * np.stack([np.eye(3), -np.eye(3)], axis=1)
    values = procedural_distance(name, x[:, None, None] + offsets)
    return (values[..., 0] - values[..., 1]) / (2 * step)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("n", [1000, long(20_000)])
def test_exactly_n_points(name, n):
    positions, normals, colors = drawn(name, n)
    assert positions.shape == normals.shape == colors.shape == (n, 3)
    assert (positions.dtype, normals.dtype, colors.dtype) == (np.float32, np.float32, np.uint8)


@pytest.mark.parametrize("n", [1, long(2), long(17)])
@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_very_few_points(name, n):
    assert sample(name, n)[0].shape == (n, 3)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("n", [1000, long(20_000)])
def test_points_lie_on_the_surface_at_every_n(name, n):
    positions = drawn(name, n)[0].astype(np.float64)
    assert np.abs(procedural_distance(name, positions)).max() < 3e-7


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("n", [1000, long(20_000)])
def test_normals_are_the_gradient(name, n):
    positions, normals, _ = drawn(name, n)
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-6
    slope = gradient(name, positions.astype(np.float64))
    # a step of float32 in the position turns the normal by step / radius of curvature (0.005)
    assert np.abs(slope - normals).max() < 2e-4
    assert np.quantile(np.abs(slope - normals), 0.99) < 1e-5


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "n"), [("sphere", 20_000), *((name, 100_000) for name in ("sphere", "torus", "lattice", "statue"))]
)
def test_points_are_spread_evenly(name, n):
    positions = drawn(name, n)[0]
    assert np.mean(spacing(positions, name) < 0.55) < 1e-3
    probes = drawn(name, n, seed=7)[0]
    gaps = cKDTree(positions).query(probes)[0] / np.sqrt(area(name) / n)
    assert np.quantile(gaps, 0.999) < 0.9
    assert gaps.max() < 1.5


@pytest.mark.long
@pytest.mark.parametrize("name", ["statue", "sphere"])
def test_the_same_points_with_any_number_of_threads(name, monkeypatch):
    first = sample(name, 10_000, seed=3)
    monkeypatch.setenv("POINTRAY_THREADS", "1")
    for a, b in zip(first, sample(name, 10_000, seed=3), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(first[0], sample(name, 10_000, seed=4)[0])


def test_sphere_and_torus_distances(rng):
    x = rng.normal(size=(4, 5, 3))
    np.testing.assert_allclose(procedural_distance("sphere", x), np.linalg.norm(x, axis=-1) - 1, atol=1e-15)
    ring = np.hypot(np.hypot(x[..., 0], x[..., 1]) - 1, x[..., 2]) - 0.4
    np.testing.assert_allclose(procedural_distance("torus", x), ring, atol=1e-15)
    assert procedural_distance("sphere", [0, 0, 2]).shape == ()
    assert procedural_distance("sphere", [0, 0, 2]) == 1


def test_lattice_distances_at_a_strut():
    # a strut is a plain cylinder of radius 0.035 at its middle
    assert procedural_distance("lattice", [0.0, 0.25, 0.25 + 0.055]) == pytest.approx(0.02, rel=1e-9)
    assert procedural_distance("lattice", [0.0, 0.25, 0.25]) < 0
    assert procedural_distance("lattice", [0.0, 0.0, 0.0]) > 0.2


@pytest.mark.long
@pytest.mark.parametrize("name", ["statue", "lattice"])
def test_distance_is_euclidean_near_the_surface(name, rng):
    positions, normals, _ = drawn(name, 200_000)
    tree = cKDTree(positions)
    spread = np.sqrt(area(name) / len(positions))
    for offset in (0.1, 0.05, 0.04):
        chosen = rng.integers(0, len(positions), 150)
        x = positions[chosen] + offset * normals[chosen].astype(np.float64)
        nearest = tree.query(x)[0]
        keep = nearest > 4 * spread
        assert keep.sum() > 100
        # the nearest sample is farther than the nearest point of the surface, by at most gap^2 / (2 distance)
        slack = spread**2 / nearest[keep] + 0.01 * nearest[keep]
        found = np.abs(procedural_distance(name, x[keep]))
        assert np.mean(np.abs(found - nearest[keep]) > slack) < 0.05  # 0.003 at the statue


@pytest.mark.long
def test_statue_is_one_closed_solid():
    vertices, faces = mesh("statue")
    links = coo_matrix((np.ones(len(faces)), (faces[:, 0], faces[:, 1])), shape=(len(vertices),) * 2)
    assert connected_components(links, directed=False)[0] == 1
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    _, counts = np.unique(edges[:, 0] * len(vertices) + edges[:, 1], return_counts=True)
    assert (counts % 2 == 0).all()
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", np.cross(a, b), c).sum() / 6 > 0.3  # negative if normals point inward


def test_statue_stands_on_the_ground():
    positions = drawn("statue", 1000)[0]
    assert abs(positions[:, 2].min()) < 1e-3
    assert 1.8 < positions[:, 2].max() < 2.2
    assert np.abs(positions[:, :2]).max() < 0.8


@pytest.mark.long
def test_statue_has_relief_finer_than_32000_points():
    """Neighbouring normals differ by far more in the coarse cloud than in the fine one."""
    turns = []
    for n in (32_000, 200_000):
        positions, normals, _ = drawn("statue", n)
        near = cKDTree(positions).query(positions[:20_000], k=2)[1][:, 1]
        turns.append(np.mean(np.einsum("ij,ij->i", normals[:20_000], normals[near])))
    assert turns[0] < 0.95
    assert turns[1] > turns[0] + 0.03


@pytest.mark.long
def test_areas_are_those_of_the_formulas():
    assert area("sphere") == pytest.approx(4 * np.pi, rel=1e-4)
    assert area("torus") == pytest.approx(4 * np.pi**2 * 0.4, rel=1e-4)


@pytest.mark.long
def test_statue_is_coloured_by_part():
    colors = drawn("statue", 20_000)[2].astype(int)
    assert len(np.unique(colors // 32, axis=0)) > 40


def test_unknown_names_and_counts_are_refused():
    with pytest.raises(ValueError, match="statue, sphere, torus, lattice"):
        sample("bunny", 10)
    with pytest.raises(ValueError, match="statue, sphere, torus, lattice"):
        procedural_distance("bunny", [0, 0, 0])
    for n in (0, -5, 10**12, 2.5, "many", None):
        with pytest.raises(ValueError, match="n"):
            sample("sphere", n)
    with pytest.raises(ValueError, match="shape"):
        procedural_distance("sphere", [[0, 0]])


def test_points_are_handed_over():
    data = pytest.importorskip("pointray.cloud.points")
    points = procedural("sphere", 100)
    assert isinstance(points, data.Points)
    assert points.positions.shape == (100, 3)
    assert points.colors.dtype == np.uint8


@kernel
def _feet(a: Array, b: Array, d: Array, out: Array) -> None:
    """Compute the parameters of the nearest points of curves A + 2 a t + b t^2, d = A - x."""
    for i in range(len(out)):
        out[i] = _foot(
            a[i, 0] * a[i, 0] + a[i, 1] * a[i, 1] + a[i, 2] * a[i, 2],
            a[i, 0] * b[i, 0] + a[i, 1] * b[i, 1] + a[i, 2] * b[i, 2],
            b[i, 0] * b[i, 0] + b[i, 1] * b[i, 1] + b[i, 2] * b[i, 2],
            d[i, 0] * a[i, 0] + d[i, 1] * a[i, 1] + d[i, 2] * a[i, 2],
            d[i, 0] * b[i, 0] + d[i, 1] * b[i, 1] + d[i, 2] * b[i, 2],
        )


@pytest.mark.parametrize("bend", [3.0, 1.0, 0.1, 1e-3, 1e-6])
def test_the_nearest_point_of_a_bent_tube(bend, rng):
    """No sample of the curve is nearer. A bend of 3 is a hairpin."""
    n, t = 2000, np.linspace(0, 1, 2001)[:, None, None]
    a, d = rng.normal(size=(2, n, 3))
    b = bend * rng.normal(size=(n, 3)) - (bend > 2) * a
    found = np.empty(n)
    _feet(a, b, d, found)
    assert ((found >= 0) & (found <= 1)).all()

    def distance(t):
        return np.linalg.norm(d + 2 * a * t + b * t * t, axis=-1)

    assert (distance(found[:, None]) <= distance(t).min(axis=0) + 1e-9).all()


@pytest.mark.parametrize("name", [long("statue"), "sphere", "torus", "lattice"])
def test_no_part_of_space_with_surface_is_skipped(name):
    """The mesh is closed: a skipped part would be a hole, or a wall between the two signs."""
    vertices, faces = mesh(name)
    ends, sides = edges_of(faces, len(vertices))
    assert (np.bincount(sides.ravel()) % 2 == 0).all()
    lengths = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    assert lengths.max() < 6 * _MESH_CELL[name]
    assert np.abs(procedural_distance(name, vertices[::199])).max() < 1e-3
