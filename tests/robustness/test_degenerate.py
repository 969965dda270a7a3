"""Degenerate clouds: every hit has a unit normal, a position and one of the caller's rows, or it is a miss."""

import warnings

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from pointray.base.choices import SURFACES

UP = np.array([0.0, 0.0, 1.0])
GRID = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0), [0.0], indexing="ij"), axis=-1).reshape(-1, 3)


def turned(rng, n):
    """Random unit normals, (n, 3)."""
    normals = rng.normal(size=(n, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


# Functions that return positions, normals and radii.
CLOUDS = {
    "one point": lambda rng: (np.zeros((1, 3)), UP[None], 1.0),
    "one point far out": lambda rng: (np.full((1, 3), 1e6), UP[None], 0.5),
    "two points": lambda rng: (np.array([[0.0, 0, 0], [1, 0, 0]]), np.tile(UP, (2, 1)), 1.5),
    "two points face to face": lambda rng: (np.array([[0.0, 0, 0], [0, 0, 0.5]]), np.array([UP, -UP]), 1.0),
    "opposite normals at one place": lambda rng: (np.zeros((2, 3)), np.array([UP, -UP]), 1.0),
    "opposite normals at every place": lambda rng: (np.tile(GRID, (2, 1)), np.repeat([UP, -UP], 64, axis=0), 1.5),
    "coincident points": lambda rng: (np.zeros((7, 3)), turned(rng, 7), 1.0),
    "collinear points": lambda rng: (np.arange(20.0)[:, None] * UP[::-1], np.tile(UP, (20, 1)), 1.5),
    "a grid": lambda rng: (GRID, np.tile(UP, (64, 1)), 1.5),
    "a grid, normals at random": lambda rng: (GRID, turned(rng, 64), 1.5),
    "a grid, some normals zero": lambda rng: (GRID, np.where(np.arange(64)[:, None] % 3 > 0, UP, 0.0), 1.5),
    "radii from 0.001 to 1": lambda rng: (GRID, np.tile(UP, (64, 1)), 10.0 ** rng.uniform(-3, 0, 64)),
    "radii at the rounding of places": lambda rng: (GRID + 1000, np.tile(UP, (64, 1)), 2e-4),
    "tiny": lambda rng: (GRID * 1e-9, np.tile(UP, (64, 1)), 1.5e-9),
    "huge": lambda rng: (GRID * 1e9, np.tile(UP, (64, 1)), 1.5e9),
}


def cast_at(rng, positions, radii, n=800):
    """Rays through positions near points, some of them straight down through points or along the axes."""
    some = rng.integers(len(positions), size=n)
    radii = np.broadcast_to(radii, len(positions))[some, None]
    ends = positions[some] + radii * rng.uniform(-1, 1, (n, 3)) * rng.choice([0, 0.3, 1], (n, 1))
    axes = np.eye(3)[rng.integers(3, size=n)] * rng.choice([-1, 1], (n, 1))
    directions = np.where(rng.random((n, 1)) < 0.5, axes, turned(rng, n))
    return ends - directions * radii * rng.choice([0, 1e-3, 2, 50], (n, 1)), directions


@pytest.mark.parametrize("surface", [s if s == "apss" else long(s) for s in SURFACES])
@pytest.mark.parametrize("name", CLOUDS)
def test_hits_are_whole(rng, name, surface):
    """Hits have unit normals, and all their values are numbers."""
    positions, normals, radii = CLOUDS[name](rng)
    points = pr.Points(positions, normals, attributes={"row": np.arange(len(positions)) + 1.0})
    origins, directions = cast_at(rng, positions, radii)
    hits = 0
    for refine in (0, 1, 3):
        for trim in ("auto", None):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                model = pr.Model(
                    points, np.broadcast_to(radii, len(positions)), surface=surface, refine=refine, trim=trim
                )
            scene = pr.Scene()
            scene.add(model)
            found = scene.intersect(origins, directions, attributes=["row"])
            hit = found.instance >= 0
            assert np.array_equal(np.isfinite(found.t), hit)
            assert np.abs(np.linalg.norm(found.normal[hit].astype(float), axis=1) - 1).max(initial=0) < 1e-5
            assert (found.point[hit] >= 0).all() and (found.point[hit] < len(positions)).all()
            assert np.isfinite(found.position[hit]).all() and np.isfinite(found.color[hit]).all()
            row = found.attributes["row"][hit]
            assert (row >= 0.999).all() and (row <= len(positions) + 0.001).all()
            assert (found.normal[~hit] == 0).all() and (found.point[~hit] == -1).all()
            assert np.array_equal(scene.occluded(origins, directions), hit)
            hits += int(hit.sum())
    assert hits > 0 or "opposite" in name or "coincident" in name


@pytest.mark.parametrize("size", [1e-150, 1e150])
def test_instances_of_any_size_have_unit_normals(size):
    """The squares of its transform's entries overflow or vanish."""
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points(GRID, np.tile(UP, (64, 1))), np.full(64, 1.5)), pr.transform(scale=size))
    found = scene.intersect(np.array([3.2, 3.3, 5]) * size, (0, 0, -1))
    assert np.allclose(found.normal, UP)
    assert np.allclose(found.position / size, (3.2, 3.3, 0), atol=1e-5)


@pytest.fixture(scope="module")
def torus():
    return pr.Model(pr.procedural("torus", 3000))


EXPONENTS = -1000, -500, -110, -20, 20, 110, 500, 1000


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_a_power_of_two_in_the_direction_only_scales_t(rng, torus, exponent):
    """t scales exactly, to the last bit, wherever a ray begins and ends."""
    scene = pr.Scene()
    scene.add(torus)
    scene.add(pr.Plane((0, 0, -1), UP))
    origins, ends = rng.normal(size=(2, 3000, 3)) * ([[3.0]], [[0.4]])
    directions = ends - origins
    limits = rng.uniform(0, 0.5, 3000), rng.uniform(0.5, 2, 3000)
    limits[0][::3], limits[1][::2] = 0, np.inf
    right = scene.intersect(origins, directions, *limits)
    scaled = [np.ldexp(a, -exponent) for a in limits]
    found = scene.intersect(origins, np.ldexp(directions, exponent), *scaled)
    hit = np.isfinite(right.t)
    assert 0.3 < hit.mean() < 1
    for name in ("position", "normal", "color", "point", "instance"):
        assert np.array_equal(getattr(found, name), getattr(right, name), equal_nan=True), name
    most = np.finfo(np.float32).max
    t = np.clip(np.ldexp(right.t[hit].astype(np.float64), -exponent), -most, most).astype(np.float32)
    assert np.array_equal(found.t[hit], t) and np.isinf(found.t[~hit]).all()
    assert np.array_equal(scene.occluded(origins, np.ldexp(directions, exponent), *scaled), hit)


@pytest.mark.parametrize("length", [5e-324, 1e-310, 1e-300, 1e-150, 1e150, 1e300, 1.7e308])
def test_directions_may_have_any_length(length):
    """The shortest directions are a few steps of float64 long, but along an axis, where rounding does not turn them."""
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points(GRID, np.tile(UP, (64, 1))), np.full(64, 1.5)))
    found = scene.intersect([[3.2, 3.3, 5]], [[0, 0, -length]])
    assert found.point[0] >= 0 and 0 <= found.t[0] < np.inf
    assert np.allclose(found.position[0], (3.2, 3.3, 0), atol=1e-5)
    assert scene.occluded([3.2, 3.3, 5], [0, 0, -length])
    assert not scene.occluded([3.2, 3.3, 5], [0, 0, length])


@pytest.mark.parametrize(
    "direction", [(0, 0, 0), (np.nan, 0, -1), (0, np.inf, -1), (-np.inf, np.nan, 0), (0, 0, -np.inf)]
)
def test_invalid_directions_miss(direction):
    scene = pr.Scene()
    scene.add(pr.Model(pr.Points(GRID, np.tile(UP, (64, 1))), np.full(64, 1.5)))
    scene.add(pr.Plane((0, 0, -1), UP))
    found = scene.intersect([3.2, 3.3, 5], direction)
    assert np.isinf(found.t) and found.instance == -1 and np.isnan(found.position).all()
    assert not scene.occluded([3.2, 3.3, 5], direction)
