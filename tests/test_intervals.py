"""t_min and t_max only choose among what a ray hits: a shorter ray hits what the whole one does, or nothing."""

from functools import cache

import numpy as np
import pytest

import pointray as pr
from conftest import shared_model, sphere_points
from pointray.records import LONGEST

CLOUDS = "statue", "statue, refine=0", "statue, disc", "bunny", "pump"
SCANS = {"bunny": "stanford_bunny", "pump": "tls_pumpA_rgb"}
EYES = np.array([[0.6, -0.9, 0.3], [-0.6, -0.9, 0.1], [0.1, 1.0, 0.2], [1.0, 0.1, -0.2]])


@cache
def scene_of(name):
    """A scene with one model; of a real scan 40,000 points."""
    if name in SCANS:
        points = pr.read(shared_model(f"points/{SCANS[name]}.ply"))
        some = np.random.default_rng(2).permutation(len(points))[:40_000]
        model = pr.Model(points.select(np.sort(some).astype(np.int32)))
    else:
        surface, refine = "disc" if "disc" in name else "apss", 0 if "=0" in name else 1
        model = pr.Model(pr.procedural("statue", 20_000), surface=surface, refine=refine)
    scene = pr.Scene()
    scene.add(model)
    return scene, model


def cast(scene, kind, n=128):
    """n x n rays: of a picture, in tiles; of four pictures in turn, in groups; or at random, each alone."""
    rng, bounds = np.random.default_rng(7), scene.bounds
    middle, size = bounds.mean(axis=0), np.linalg.norm(bounds[1] - bounds[0])
    if kind == "alone":
        ends = bounds[0] + (bounds[1] - bounds[0]) * rng.random((n * n, 3))
        origins = middle + rng.normal(size=ends.shape) * size * rng.uniform(0.1, 0.8, (n * n, 1))
        directions = ends - origins
        return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)
    edge = n if kind == "tiles" else n // 2
    views = [pr.Camera.look_at(middle + size * eye, middle, 50, size=(edge, edge)).rays() for eye in EYES]
    if kind == "tiles":
        return views[0]
    return tuple(np.stack(part, axis=2).reshape(-1, 3) for part in zip(*views, strict=True))


def check(scene, rays, limits, t, slack):
    """Rays hit at t, inf for none; `occluded` tells the same."""
    found = scene.intersect(*rays, *limits)
    hit = np.isfinite(t)
    wrong = np.isfinite(found.t) != hit
    assert not wrong.any(), f"{wrong.sum()} of {wrong.size} hit or miss otherwise"
    apart = np.abs(found.t[hit].astype(float) - t[hit])
    assert (apart <= slack).all(), f"{(apart > slack).sum()} of {apart.size} hit elsewhere, by up to {apart.max():.3g}"
    assert np.array_equal(scene.occluded(*rays, *limits), hit)


@pytest.mark.parametrize("kind", ["tiles", "groups", "alone"])
@pytest.mark.parametrize("name", CLOUDS)
def test_a_shorter_ray_hits_the_same_or_nothing(name, kind):
    """Wherever it ends: anywhere, and just before and just behind the hit."""
    (scene, model), rng = scene_of(name), np.random.default_rng(3)
    rays, slack = cast(scene, kind), 1e-3 * model.spacing
    t = scene.intersect(*rays).t.astype(float)
    hit = np.isfinite(t)
    assert 0.1 < hit.mean() < 0.95
    far = np.where(hit, t, 3 * np.linalg.norm(scene.bounds[1] - scene.bounds[0]))
    rounding = 1e-6 * far
    for end in (far * rng.uniform(0, 1.3, t.shape), far + rounding, far - rounding - slack * rng.random(t.shape)):
        check(scene, rays, (0, end), np.where(t <= end, t, np.inf), slack)


@pytest.mark.parametrize("kind", ["tiles", "groups", "alone"])
@pytest.mark.parametrize("name", CLOUDS)
def test_a_ray_that_begins_later_hits_the_same(name, kind):
    """Wherever it begins, behind or before its origin: but not on the surface, where it is on the surface."""
    (scene, model), rng = scene_of(name), np.random.default_rng(4)
    rays, slack = cast(scene, kind), 1e-3 * model.spacing
    size = np.linalg.norm(scene.bounds[1] - scene.bounds[0])
    t = scene.intersect(*rays).t.astype(float)
    before = np.where(np.isfinite(t), t, size) - 0.06 * model.radii.max()
    for share in (rng.random(t.shape), 1 - 10 ** rng.uniform(-4, 0, t.shape)):
        begin = np.maximum(before * share, 0)
        check(scene, rays, (begin, np.inf), t, slack)
        check(scene, rays, (begin, np.where(np.isfinite(t), t * (1 + 1e-6), size)), t, slack)
    back = scene.intersect(*rays, -np.inf).t.astype(float)
    begin = np.where(np.isfinite(back), back, 0) - 0.06 * model.radii.max() - size * rng.random(t.shape)
    check(scene, rays, (np.minimum(begin, 0), np.inf), np.where(begin > 0, t, back), slack)


@pytest.mark.parametrize("order", ["tiles", "alone"])
def test_the_rest_of_a_step_behind_a_cut_is_looked_into(order):
    """Near a sphere's rim a step of the samples passes both sides; a plane cuts the first one away."""
    rng, n = np.random.default_rng(1), 32
    positions = sphere_points(3000)
    model = pr.Model(pr.Points(positions, positions))
    scene = pr.Scene()
    scene.add(model)
    half = 0.5 * model.tree.head[LONGEST] * rng.uniform(0.3, 0.9, (n, n))
    aside, turn = np.sqrt(1 - half**2), 2e-3 * np.arange(n)[:, None]
    origins = np.stack([aside * np.cos(turn), aside * np.sin(turn), np.full((n, n), -3.0)], axis=-1)
    if order == "alone":
        origins = origins.reshape(-1, 3)[::17]  # fewer than go together
        origins = np.concatenate([np.stack([origins, origins * (-1, 1, 1)], axis=1).reshape(-1, 3)])
    whole = scene.intersect(origins, [0, 0, 1.0])
    scene.clips = [((0, 0, 0), (0, 0, -1))]
    cut = scene.intersect(origins, [0, 0, 1.0])
    seen = np.isfinite(whole.t) & (whole.t < 3)
    assert seen.mean() > 0.5
    assert (cut.t[seen] > 3).all()
    assert np.isfinite(cut.t[seen]).mean() > 0.99


def test_a_plane_is_hit_wherever_a_ray_begins_and_ends():
    scene, rng = pr.Scene(), np.random.default_rng(5)
    scene.add(pr.Plane((0.1, 0.2, -0.3), (0.2, 0.3, 1)))
    origins, directions = rng.normal(size=(2, 4000, 3))
    t = scene.intersect(origins, directions, -np.inf).t.astype(float)
    assert np.isfinite(t).all()
    share = 1e-5 * np.abs(t) + 1e-5
    for begin in (-1e9, -1e3, t - share):
        assert np.array_equal(scene.intersect(origins, directions, begin).t, t)
    assert np.array_equal(scene.intersect(origins, directions, -np.inf, t + share).t, t)
    assert not scene.occluded(origins, directions, -np.inf, t - share).any()
    assert not scene.occluded(origins, directions, t + share).any()
