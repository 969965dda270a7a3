"""Closest points on the surface, against formulas: near, inside, far away, at open borders, and on spheres."""

import numpy as np
import pytest

import pointray as pr
from pointray.scene.nearest_surface import NearestSurface

SPACING = {"sphere": 0.025, "torus": 0.028}  # of 20,000 points


@pytest.fixture(scope="module")
def found_near():
    made = {}
    for name in SPACING:
        scene = pr.Scene()
        scene.add(pr.Model(pr.procedural(name, 20_000)))
        made[name] = NearestSurface(scene.snapshot()).find
    return made


def positions_of(name, kind, rng, n=3000):
    if kind == "near":
        return pr.procedural(name, n, seed=5).positions + rng.normal(size=(n, 3)) * 0.03
    size = {"inside and outside": 1.5, "far": 300.0, "very far": 1e6}[kind]
    return rng.uniform(-size, size, (n, 3))


@pytest.mark.parametrize("kind", ["near", "inside and outside", "far", "very far"])
@pytest.mark.parametrize("name", SPACING)
def test_distances_are_exact_to_a_fraction_of_the_spacing(found_near, name, kind, rng):
    x = positions_of(name, kind, rng)
    found = found_near[name](x)
    exact = pr.procedural_distance(name, x)
    limit = 0.05 * SPACING[name] + 1e-9 * np.abs(exact)
    assert (np.abs(found.distance - exact) < limit).all()  # with the sign
    assert np.abs(pr.procedural_distance(name, found.position)).max() < 0.05 * SPACING[name]
    np.testing.assert_allclose(np.linalg.norm(x - found.position, axis=1), np.abs(found.distance), rtol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1, atol=1e-5)
    assert (found.instance == 0).all() and (found.point >= 0).all()


def test_closest_points_near_a_sphere_are_exact_to_a_tenth_of_the_spacing(found_near, rng):
    x = positions_of("sphere", "near", rng)
    found = found_near["sphere"](x)
    exact = x / np.linalg.norm(x, axis=1, keepdims=True)
    assert np.linalg.norm(found.position - exact, axis=1).max() < 0.1 * SPACING["sphere"]


def test_an_open_border_is_not_extended(rng):
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 81)] * 2), axis=-1).reshape(-1, 2)
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points(np.column_stack([grid, np.zeros(len(grid))]))))
    x = rng.uniform(-2, 2, (2000, 3))
    found = NearestSurface(scene.snapshot()).find(x)
    exact = np.linalg.norm(x - np.clip(x, [-1, -1, 0], [1, 1, 0]), axis=1)
    beside = (np.abs(x[:, :2]) < 0.95).all(axis=1)
    assert np.abs(np.abs(found.distance) - exact)[beside].max() < 0.1 * 0.025
    assert np.abs(np.abs(found.distance) - exact).max() < 0.025  # the surface ends within a spacing of the last points


def test_instances_are_found_in_their_places(rng):
    model, scene = pr.Model(pr.procedural("sphere", 5000)), pr.Scene()
    near = scene.add(model, pr.transform(translate=(-10, 0, 0)))
    scene.remove(scene.add(model))
    far = scene.add(model, pr.transform(scale=2, translate=(10, 0, 0)))
    x = rng.uniform(-15, 15, (500, 3))
    found = NearestSurface(scene.snapshot()).find(x)
    one, other = np.linalg.norm(x - [-10, 0, 0], axis=1) - 1, np.linalg.norm(x - [10, 0, 0], axis=1) - 2
    exact = np.where(np.abs(one) < np.abs(other), one, other)
    assert np.abs(found.distance - exact).max() < 0.01
    assert (found.instance == np.where(np.abs(one) < np.abs(other), near, far)).all()


@pytest.mark.filterwarnings("ignore:most normals point inward")
def test_surfaces_that_face_each_other_across_a_gap_are_distinguished(rng):
    """In a gap narrower than a support, rays along the normal of one wall cross the other wall first."""
    directions = pr.procedural("sphere", 1500).positions
    rows, normals = np.concatenate([0.2 * directions, 0.22 * directions]), np.concatenate([directions, -directions])
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points(rows, normals)))
    x = directions[:200] + 0.02 * rng.normal(size=(200, 3))
    radius = rng.uniform(0.202, 0.218, 200)
    x *= (radius / np.linalg.norm(x, axis=1))[:, None]
    found = NearestSurface(scene.snapshot()).find(x)
    error = np.abs(found.distance - np.minimum(radius - 0.2, 0.22 - radius))
    # Without these walls distinguished, the closest points stay on the discs of the splats, about 1e-4 off.
    assert np.quantile(error, 0.9) < 1e-5 and error.max() < 1e-3


def test_scattered_points_are_spheres(rng):
    rows = np.stack(np.meshgrid([0, 1, 2], [0, 1, 2], [0, 1, 2]), axis=-1).reshape(-1, 3) + rng.uniform(0, 0.5, (27, 3))
    model, scene = pr.Model(rows, np.full(27, 0.01), scatter="spheres"), pr.Scene()
    scene.add(model)
    assert model.scattered.all()
    found = NearestSurface(scene.snapshot()).find(rows + [0, 0, 0.03])
    np.testing.assert_allclose(found.distance, 0.02, atol=1e-4)
    assert found.point.tolist() == list(range(27))


def test_positions_that_are_not_finite_have_no_closest_point(found_near):
    found = found_near["sphere"](np.array([[0, 0, 2.0], [np.nan, 0, 0], [np.inf, 0, 0]]))
    assert np.isnan(found.distance).tolist() == [False, True, True] and found.instance.tolist() == [0, -1, -1]
    assert len(found_near["sphere"](np.zeros((0, 3))).distance) == 0


def test_a_scene_needs_a_model():
    scene = pr.Scene()
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1)))
    with pytest.raises(ValueError, match="no models"):
        NearestSurface(scene.snapshot())
