"""Classification of scattered points: a slow reference, clean shapes, scenes, and extreme clouds."""

from __future__ import annotations

import numpy as np
import pytest

import pointray as pr
from bench.surface.scatter_scanners import scan
from bench.surface.scatter_scenes import CLASSES, CROWN, GROUND, ROOF, STRAY, WALL, make_scene
from helpers import naive_scatter
from helpers.places import shared_model
from pointray.cloud.preparation import placed_for_model
from pointray.surface.splats.local_planes import columns_of, disagreement, fit_planes
from pointray.surface.splats.scattered.classification import FEW, find_scattered, find_scattered_placed
from pointray.surface.splats.scattered.islands import CLOSED_IN, ISLANDS, SPECKS, absorb_islands

SIDE = 70.0  # of planes with about one point in a unit of area


def plane(rng: np.random.Generator, n: int = 5000, noise: float = 0.0) -> np.ndarray:
    """Return random points of a square, (n, 3) float32; `noise` is in spacings."""
    x = np.column_stack([rng.random((n, 2)) * SIDE, np.zeros(n)])
    return (x + rng.normal(scale=noise * SIDE / np.sqrt(n), size=x.shape)).astype(np.float32)


def found_in(positions: np.ndarray, normals: np.ndarray | None = None) -> np.ndarray:
    """Return which points a model of them classifies as scattered."""
    cloud = pr.Points(positions, normals)
    return find_scattered_placed(cloud, placed_for_model(cloud, "auto", True, lambda share: None))


def line(n: int) -> np.ndarray:
    """Return points of a line that is not along an axis."""
    return (np.linspace(0, 1, n)[:, None] * [1, 2, -1]).astype(np.float32)


def cube(rng: np.random.Generator, n: int = 6000) -> tuple[np.ndarray, np.ndarray]:
    """Return random points on the unit cube's faces, and their normals."""
    x, normals = rng.random((n, 3)), np.zeros((n, 3))
    axis, side = rng.integers(0, 3, n), rng.integers(0, 2, n)
    x[np.arange(n), axis], normals[np.arange(n), axis] = side, 2 * side - 1
    return x.astype(np.float32), normals.astype(np.float32)


def test_a_slow_twin_finds_the_same(rng):
    """A mixed cloud: a noisy plane, a ball of scattered points over it, a wire, and single points."""
    ball = rng.normal(size=(300, 3)) * 3 + [35, 35, 15]
    wire = line(60) * 30 + np.float32([10, 0, 30])
    x = np.concatenate([plane(rng, 600, 0.2), ball, wire, rng.random((20, 3)) * [SIDE, SIDE, 40]]).astype(np.float32)
    found, expected = find_scattered(x), naive_scatter.scattered(x)
    assert 0.2 < expected.mean() < 0.6
    assert (found != expected).mean() < 0.002, "float32 and float64 may differ at a threshold"


@pytest.mark.parametrize(("first", "end"), [(1, 9), (1, 17), (0, 17)])
def test_planes_and_their_bends_are_those_of_a_slow_twin(rng, first, end):
    x = (rng.normal(size=(200, 3)) * [5, 3, 1] + 100).astype(np.float32)
    near = naive_scatter.nearest(x.astype(np.float64), 17).astype(np.int32)
    found = fit_planes(columns_of(x), near, (first, end))
    expected = naive_scatter.planes(x.astype(np.float64), near[:, first:end])
    normals = np.column_stack(found[:3])
    cosine = (normals * expected.normals).sum(axis=1)
    assert np.abs(cosine).min() > 0.999
    assert np.abs(found.thickness - expected.thickness).max() < 1e-4
    assert np.abs(found.slimness - expected.slimness).max() < 1e-3
    assert np.abs(found.reach - np.linalg.norm(x[near[:, end - 1]] - x, axis=1)).max() < 1e-4
    offset = np.sign(cosine) * ((x - expected.means) * expected.normals).sum(axis=1)
    assert np.abs(found.offset - offset).max() < 1e-2
    bends = naive_scatter.bends(normals, near[:, first:end])
    assert np.abs(disagreement(found[:3], near, (first, end)) - bends).max() < 1e-4


@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_smooth_bodies_are_surfaces(name):
    assert not find_scattered(pr.procedural(name, 5000).positions).any()


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3])
def test_a_plane_with_noise_and_an_open_border_is_a_surface(rng, noise):
    assert find_scattered(plane(rng, noise=noise)).mean() <= 0.001


@pytest.mark.parametrize("thickness", [0.2, 1.0, 4.0])
def test_both_sides_of_a_plate_are_surfaces(rng, thickness):
    x = plane(rng)
    x[::2, 2] += thickness
    assert find_scattered(x).mean() <= 0.005


def test_edges_of_a_cube_are_surfaces(rng):
    x, normals = cube(rng)
    assert find_scattered(x).mean() <= 0.02
    assert find_scattered(x, normals).mean() <= 0.001


def test_normals_that_follow_the_curvature_prove_a_surface(rng):
    """Thin bars with few points across look scattered; their normals prove that they are not."""
    points = pr.procedural("lattice", 20_000)
    assert find_scattered(points.positions).mean() > 0.5
    assert not find_scattered(points.positions, points.normals).any()
    noise = rng.normal(size=points.normals.shape)
    noise /= np.linalg.norm(noise, axis=1, keepdims=True)
    assert find_scattered(points.positions, noise).mean() > 0.5


def test_normals_do_not_turn_noise_into_a_surface(rng):
    x = rng.random((5000, 3)).astype(np.float32)
    fitted = pr.estimate_normals(pr.Points(x), neighbors=20).normals
    assert find_scattered(x, fitted).mean() > 0.9


def test_fitted_normals_are_no_evidence_along_a_line(rng):
    """A line agrees with any normals that are fitted to it."""
    x = line(2000) + rng.normal(scale=2e-4, size=(2000, 3)).astype(np.float32)
    across = np.cross([1, 2, -1], [0, 0, 1]) / np.sqrt(5)
    normals = np.tile(across, (2000, 1)).astype(np.float32)
    assert not find_scattered(x, normals).any()
    assert find_scattered(x, normals, fitted=True).all()


@pytest.mark.scans
def test_fitted_normals_show_folds_that_planes_miss():
    """Lucy at 50,000 points has folds of one or two spacings."""
    points = pr.read(shared_model("points/nefertiti_50k.ply"))
    assert find_scattered(points.positions).mean() > 0.01
    assert found_in(points.positions).mean() < 0.002


def test_noise_that_is_smoothed_away_is_no_scatter(rng):
    """Scans a spacing apart, or noise of that size, become a surface after merging and smoothing."""
    x = plane(rng, noise=1.0)
    assert find_scattered(x).mean() > 0.1
    assert found_in(x).mean() < 0.01


def test_crowns_are_not_smoothed_into_surfaces(rng):
    """Ground with noise beside leaves that fill a volume."""
    ground, crown = plane(rng, noise=0.3), rng.uniform(20, 50, (2000, 3)) + [0, 0, 10]
    found = found_in(np.concatenate([ground, crown]).astype(np.float32))
    assert found[: len(ground)].mean() < 0.01 and found[len(ground) :].mean() > 0.9


def test_small_groups_follow_what_closes_them_in(rng):
    """Compared with a slow loop over each group; marked are round patches, their surroundings, and strays."""
    x = plane(rng, 3000)
    near = naive_scatter.nearest(x, 17).astype(np.int32)
    surface = np.ones(len(x), np.float32)
    for middle, size in zip(rng.integers(0, len(x), 12), [1, 4, 7, 9, 30, 60, 63, 65, 90, 200, 400, 800], strict=True):
        patch = np.argsort(((x - x[middle]) ** 2).sum(axis=1))[:size]
        surface[patch] = 1 - surface[patch]
    alone = (rng.random(len(x)) < 0.02).astype(np.float32) * (1 - surface)
    expected = naive_scatter.absorb_islands(surface, alone, near[:, 1:9], (CLOSED_IN, SPECKS, ISLANDS))
    found = absorb_islands(surface.copy(), alone, near)
    assert (found == expected).all() and 0 < (found != surface).sum() < len(x)


def test_pure_noise_is_scattered(rng):
    assert find_scattered(rng.random((5000, 3)).astype(np.float32)).mean() > 0.97
    assert find_scattered(rng.normal(size=(5000, 3)).astype(np.float32)).mean() > 0.97


def test_a_line_and_a_helix_are_scattered(rng):
    turn = np.linspace(0, 60, 2000)
    helix = np.column_stack([np.cos(turn), np.sin(turn), 0.3 * turn]).astype(np.float32)
    assert find_scattered(line(2000)).all()
    assert find_scattered(line(2000) + rng.normal(scale=2e-4, size=(2000, 3)).astype(np.float32)).all()
    assert find_scattered(helix).all()


@pytest.mark.parametrize("count", [0, 1, 2, FEW - 1])
def test_a_few_points_are_scattered(rng, count):
    found = find_scattered(rng.random((count, 3)).astype(np.float32))
    assert found.shape == (count,) and found.dtype == np.bool_ and found.all()


def test_a_plane_with_every_second_point_displaced_is_a_surface():
    x, y = (a.ravel() for a in np.meshgrid(np.arange(70.0), np.arange(70.0)))
    columns, checker = np.column_stack([x, y, x % 2]), np.column_stack([x, y, (x + y) % 2])
    assert find_scattered(columns.astype(np.float32)).mean() <= 0.01
    assert find_scattered(checker.astype(np.float32)).mean() <= 0.01


def test_coincident_points_count_once(rng):
    """Each copy gets the result of its position without copies."""
    x = plane(rng)
    x[0] = 35, 35, 30  # over the plane
    many = np.concatenate([np.repeat(x[:1], 1_000_000, axis=0), x])
    found = find_scattered(many)
    assert found[:1_000_000].all() and not found[1_000_001:].any()
    assert find_scattered(many[:1_000_000]).all()


def test_a_point_over_a_plane_is_scattered(rng):
    x = plane(rng)
    x[:20] += np.float32([0, 0, 1]) * rng.uniform(4, 30, (20, 1)).astype(np.float32)
    found = find_scattered(x)
    assert found[:20].all() and found[20:].mean() <= 0.002


@pytest.mark.parametrize("factor", [1e-12, 1e12])
def test_the_unit_of_length_does_not_matter(rng, factor):
    x = np.concatenate([plane(rng), rng.random((1000, 3)) * 20 + [20, 20, 10]]).astype(np.float32)
    scaled = (x * np.float64(factor)).astype(np.float32)
    assert (find_scattered(scaled) != find_scattered(x)).mean() <= 0.001


def test_threads_do_not_matter_and_progress_ends_at_1(rng):
    x, shares = np.concatenate([plane(rng), rng.random((3000, 3)) * 20]).astype(np.float32), []
    assert (find_scattered(x, threads=1) == find_scattered(x, threads=2, progress=shares.append)).all()
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_wrong_arguments_are_named(rng):
    x = plane(rng, 100)
    with pytest.raises(ValueError, match="positions"):
        find_scattered(x[:, :2])
    with pytest.raises(ValueError, match="normals"):
        find_scattered(x, x[1:])
    with pytest.raises(ValueError, match="threads"):
        find_scattered(x, threads=0)


def shares_of(sampling: str, noise: float, seeds: range) -> np.ndarray:
    """Return the share of scattered points of each class, in scenes that were not used to tune thresholds."""
    counts, found = np.zeros((2, len(CLASSES)), np.int64)
    for seed in seeds:
        labelled = scan(make_scene(seed), sampling, np.random.default_rng(1))
        labels, scattered = labelled.labels, found_in(labelled.noisy(noise, np.random.default_rng(2)))
        counts += np.bincount(labels, minlength=len(CLASSES))
        found += np.bincount(labels[scattered], minlength=len(CLASSES))
    return found / np.maximum(counts, 1)


@pytest.mark.parametrize("noise", [0.0, 0.25])
def test_airborne_scans_have_ground_roofs_crowns_and_strays(noise):
    shares = shares_of("airborne 4", noise, range(200, 204))
    assert max(shares[[GROUND, WALL, ROOF]]) < 0.05 and shares[CROWN] > 0.9 and shares[STRAY] > 0.75


@pytest.mark.long
@pytest.mark.parametrize("sampling", ["terrestrial", "vehicle"])
def test_scans_from_the_ground_have_walls_and_crowns(sampling):
    shares = shares_of(sampling, 0.1, range(200, 201))
    assert max(shares[[GROUND, WALL, ROOF]]) < 0.05 and shares[CROWN] > 0.9 and shares[STRAY] > 0.7


@pytest.mark.scans
@pytest.mark.parametrize("name", ["stanford_bunny", "nefertiti_50k", "stanford_lucy_50k"])
def test_vertices_of_meshes_are_surfaces(name):
    points = pr.read(shared_model(f"points/{name}.ply"))
    assert find_scattered(points.positions, points.normals).mean() <= 0.001


@pytest.mark.long
def test_the_statue_is_a_surface():
    points = pr.procedural("statue", 200_000)
    assert find_scattered(points.positions, points.normals).mean() <= 0.001
