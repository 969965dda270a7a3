"""All crossings of rays: as many as a formula gives, in order, whatever the length of the direction."""

import numpy as np
import pytest

import pointray as pr
from pointray.scene import crossings
from pointray.scene.crossings import find_crossings
from pointray.scene.rays import check_rays


@pytest.fixture(scope="module")
def balls():
    """Two spheres of radius 1 and 2, the second one about (5, 0, 0)."""
    model, scene = pr.Model(pr.procedural("sphere", 20_000)), pr.Scene()
    scene.add(model)
    scene.add(model, pr.transform(scale=2, translate=(5, 0, 0)))
    return scene


def crossings_of(scene, origins, directions, t_min=0, t_max=np.inf):
    return find_crossings(scene.snapshot(), *check_rays(origins, directions, t_min, t_max))


def formula(origins, directions, center, radius):
    """The two t of each ray on a sphere, NaN for a miss, and how deep the ray is in it, in radii."""
    o = origins - center
    a, b, c = (directions**2).sum(1), (o * directions).sum(1), (o**2).sum(1) - radius**2
    with np.errstate(invalid="ignore"):
        root = np.sqrt(b * b - a * c)
    return np.stack([(-b - root) / a, (-b + root) / a], axis=1), 1 - np.sqrt((o**2).sum(1) - b * b / a) / radius


def test_every_crossing_is_found_in_order(balls, rng):
    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = rng.uniform([-1, -2, -2], [7, 2, 2], (5000, 3)) - 20 * directions
    directions *= rng.uniform(0.1, 10, (5000, 1))
    found = crossings_of(balls, origins, directions)
    (one, depth), (two, depth2) = formula(origins, directions, 0, 1), formula(origins, directions, [5, 0, 0], 2)
    sure = (np.abs(depth) > 1e-5) & (np.abs(depth2) > 1e-5)
    exact = np.sort(np.concatenate([one, two], axis=1), axis=1)  # NaN last
    counts = np.isfinite(exact).sum(axis=1)
    assert np.bincount(counts, minlength=5)[[0, 2, 4]].min() > 50
    assert (np.bincount(found.ray, minlength=5000) == counts)[sure].all()
    chosen = sure[found.ray]
    t = exact[sure][np.isfinite(exact[sure])]
    lengths = np.linalg.norm(directions, axis=1)[found.ray][chosen]
    grazing = np.minimum(np.abs(depth), np.abs(depth2))[found.ray][chosen] < 1e-3
    assert (np.abs(found.t[chosen] - t) * lengths)[~grazing].max() < 2e-3
    first = np.diff(found.ray, prepend=-1) > 0
    assert (found.entering[1:] != found.entering[:-1])[~first[1:]].all() and found.entering[first].all()
    assert set(found.instance.tolist()) == {0, 1}
    moved = origins[found.ray] + found.t[:, None] * directions[found.ray]
    assert np.abs(moved - found.position).max() < 1e-9


def test_rays_that_only_graze_a_surface_leave_it(balls, rng):
    """Rays less deep in the sphere than the limit of the start rule, which the search alone does not see leave."""
    angle = rng.uniform(0, 2 * np.pi, 200)
    height = 1 - rng.uniform(2e-5, 2e-4, 200)
    origins = np.stack([np.full(200, -3.0), height * np.cos(angle), height * np.sin(angle)], axis=1)
    found = crossings_of(balls, origins, [1, 0, 0], 0, 4)
    assert (np.bincount(found.ray, minlength=200) == 2).mean() > 0.95
    assert (np.bincount(found.ray, minlength=200) % 2 == 0).all()


@pytest.mark.parametrize("gap", [1.0, 1.4])
def test_sheets_that_face_the_same_way_are_separate(rng, gap):
    """Between two sheets closer than their supports the surface has a third one; all three in both directions."""
    plane = np.stack(np.meshgrid(*[np.linspace(-1, 1, 41)] * 2), axis=-1).reshape(-1, 2)
    radius, n = 0.0575, len(plane)
    heights = np.repeat([0, gap * radius], n)
    points = pr.Points(np.column_stack([np.tile(plane, (2, 1)), heights]), np.tile([0.0, 0, 1], (2 * n, 1)))
    scene = pr.Scene()
    scene.add(pr.Model(points, np.full(2 * n, radius)))
    origins = np.column_stack([rng.uniform(-0.8, 0.8, (500, 2)), np.full(500, 3.0)])
    down = crossings_of(scene, origins, [0, 0, -1])
    up = crossings_of(scene, origins * [1, 1, -1], [0, 0, 1])
    for found, start, direction in ((down, 3, -1), (up, -3, 1)):
        assert (np.bincount(found.ray, minlength=500) == 3).all()
        height = np.sort((start + direction * found.t).reshape(500, 3), axis=1) / radius
        np.testing.assert_allclose(height, np.tile([0, gap / 2, gap], (500, 1)), atol=0.02)
    assert down.entering.all() and not up.entering.any()


@pytest.mark.parametrize("gap", [0.0, 0.005, 0.02])
def test_models_may_be_as_near_to_each_other_as_they_like(rng, gap):
    """A sphere in a slightly larger one; the gap in support radii. Four of them need the tree over instances."""
    model = pr.Model(pr.procedural("sphere", 5000))
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for count in (2, 4):
        scene = pr.Scene()
        for k in range(count):
            scene.add(model, pr.transform(scale=1 + k * gap * float(np.median(model.radii))))
        found = crossings_of(scene, -5 * directions, directions)
        assert (np.bincount(found.ray, minlength=400) == 2 * count).all()
        assert (np.bincount(found.instance) == 800).all() and (np.bincount(found.entering) == 400 * count).all()
        assert (np.diff(found.t)[np.diff(found.ray) == 0] >= 0).all()


def test_planes_within_a_model_are_crossed_too(balls, rng):
    scene = pr.Scene()
    scene.add(pr.Model(pr.procedural("sphere", 5000)))
    plane = scene.add(pr.Plane((0, 0, 0), (0, 0, 1)))
    other = scene.add(pr.Plane((0, 0, 0.5), (0, 0, 1)))
    origins = np.column_stack([rng.uniform(-0.3, 0.3, (50, 2)), np.full(50, 3.0)])
    found = crossings_of(scene, origins, [0, 0, -1])
    assert found.instance.reshape(50, 4).tolist() == [[0, other, plane, 0]] * 50


def test_limits_select_crossings(balls):
    found = crossings_of(balls, [-3, 0, 0], [1, 0, 0], [0, 2.5, 0], [np.inf, np.inf, 5])
    assert [found.t[found.ray == k].round(2).tolist() for k in range(3)] == [[2, 4, 6, 10], [4, 6, 10], [2, 4]]


def test_planes_are_crossed_and_misses_give_nothing():
    scene = pr.Scene()
    scene.add(pr.Plane((0, 0, 0), (0, 0, 1)))
    assert crossings_of(scene, [0, 0, 2], [0, 0, -1]).t.tolist() == [2]
    assert len(crossings_of(scene, [0, 0, 2], [0, 0, 1]).t) == 0
    assert len(crossings_of(scene, np.zeros((0, 3)), [0, 0, 1]).t) == 0
    assert len(crossings_of(scene, [0, 0, 2], [0, 0, 0]).t) == 0


def test_rays_in_batches_keep_their_numbers(balls, monkeypatch):
    origins = np.stack([np.full(10, -3.0), np.linspace(-1.5, 1.5, 10), np.zeros(10)], axis=1)
    whole, shares = crossings_of(balls, origins, [1, 0, 0]), []
    monkeypatch.setattr(crossings, "BATCH", 4)
    parts = find_crossings(balls.snapshot(), *check_rays(origins, [1, 0, 0], 0, np.inf), shares.append)
    np.testing.assert_array_equal(whole.ray, parts.ray)
    np.testing.assert_array_equal(whole.t, parts.t)
    assert shares == [0.4, 0.8, 1.0]
