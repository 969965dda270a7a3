"""t_min and t_max only select hits: a shortened ray hits what the full ray hits, or nothing."""

from functools import cache

import numpy as np
import pytest

import pointray as pr
from helpers.clouds import sphere_points
from helpers.marks import long, long_scan
from helpers.naive import KINDS, field, splats_of
from helpers.places import shared_model
from pointray.engine.kernels.tree import LONGEST
from pointray.surface.intersect.march import START, START_UNREFINED

FEW, MANY = 64, 128  # pixels across a picture, see `cast`
SMOOTH = "torus", "torus, refine=0", "torus, disc"
DETAILED = "statue", "statue, refine=0", "statue, disc"
SCANS = {"bunny": "stanford_bunny", "pump": "tls_pumpA_rgb"}
CLOUDS = [
    *((name, FEW) for name in SMOOTH),
    *(long(name, MANY) for name in DETAILED),
    *(long_scan(name, MANY) for name in SCANS),
]
EYES = np.array([[0.6, -0.9, 0.3], [-0.6, -0.9, 0.1], [0.1, 1.0, 0.2], [1.0, 0.1, -0.2]])


@cache
def scene_of(name):
    """A scene with one model; real scans are reduced to 40,000 points."""
    if name in SCANS:
        points = pr.read(shared_model(f"points/{SCANS[name]}.ply"))
        some = np.random.default_rng(2).permutation(len(points))[:40_000]
        model = pr.Model(points.select(np.sort(some).astype(np.int32)))
    else:
        surface, refine = "disc" if "disc" in name else "apss", 0 if "=0" in name else 1
        count = 20_000 if "statue" in name else 5_000
        model = pr.Model(pr.procedural(name.split(",")[0], count), surface=surface, refine=refine)
    scene = pr.Scene()
    scene.add(model)
    return scene, model


def cast(scene, kind, n):
    """Return n x n rays: of a picture (tiles), of four pictures interleaved (groups), or random ones (alone)."""
    rng, bounds = np.random.default_rng(7), scene.bounds
    middle, size = bounds.mean(axis=0), np.linalg.norm(bounds[1] - bounds[0])
    if kind == "alone":
        ends = bounds[0] + (bounds[1] - bounds[0]) * rng.random((n * n, 3))
        origins = middle + rng.normal(size=ends.shape) * size * rng.uniform(0.1, 0.8, (n * n, 1))
        directions = ends - origins
        return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)
    edge = n if kind == "tiles" else n // 2
    views = [pr.Camera.look_at(middle + size * eye, middle, fov=50, size=(edge, edge)).rays() for eye in EYES]
    if kind == "tiles":
        return views[0]
    return tuple(np.stack(part, axis=2).reshape(-1, 3) for part in zip(*views, strict=True))


def slack_of(model):
    """Return the tolerance of t: roots depend on the first leaf searched; without refinement f is linearised."""
    return model.spacing * (1e-3 if model.settings.refine else 0.03)


def check(scene, rays, limits, t, slack):
    """Return the numbers of rays that do not hit at t (inf for a miss), and of those where `occluded` differs."""
    found = scene.intersect(*rays, *limits)
    hit = np.isfinite(found.t)
    blocked = scene.occluded(*rays, *limits)
    both = hit & np.isfinite(t)
    apart = np.abs(np.where(both, found.t, 0) - np.where(both, t, 0))
    return np.flatnonzero((hit != np.isfinite(t)) | (blocked != hit) | (apart > slack))


def on_surface(model, x, d):
    """Return whether f at x is so small, for a ray of direction d, that the start rule applies."""
    splats, x = splats_of(model), x - model.points.origin
    near = splats[np.linalg.norm(splats[:, :3] - x, axis=1) < splats[:, 6]]
    share = float(START if model.settings.refine else START_UNREFINED)
    for sought_side in (-1, 1):  # two nearby sheets are tested one side at a time
        seen = near[sought_side * (near[:, 10:] @ d) <= 0]
        f, _, radius, _, _ = field.py_func(seen, np.arange(len(seen)), len(seen), x, KINDS[model.surface])
        if abs(f) < 1.1 * share * radius:
            return True
    return False


@pytest.mark.parametrize("kind", ["tiles", "groups", "alone"])
@pytest.mark.parametrize(("name", "n"), CLOUDS)
def test_a_shorter_ray_hits_the_same_or_nothing(name, n, kind):
    """Rays end at random places, and just before and just behind the hit."""
    (scene, model), rng = scene_of(name), np.random.default_rng(3)
    rays, slack = cast(scene, kind, n), slack_of(model)
    t = scene.intersect(*rays).t.astype(float)
    hit = np.isfinite(t)
    assert 0.05 < hit.mean() < 0.95
    far = np.where(hit, t, 3 * np.linalg.norm(scene.bounds[1] - scene.bounds[0]))
    rounding = 1e-6 * (far + np.linalg.norm(scene.bounds[1] - scene.bounds[0]))
    for end in (far * rng.uniform(0, 1.3, t.shape), far + rounding, far - rounding - slack * rng.random(t.shape)):
        wrong = check(scene, rays, (0, end), np.where(t <= end, t, np.inf), slack)
        assert len(wrong) == 0, f"{len(wrong)} of {t.size}"


@pytest.mark.parametrize("kind", ["tiles", "groups", "alone"])
@pytest.mark.parametrize(("name", "n"), CLOUDS)
def test_a_ray_that_starts_later_hits_the_same(name, n, kind):
    """Rays start behind or before their origin. Those that start on the surface are excluded."""
    (scene, model), rng = scene_of(name), np.random.default_rng(4)
    rays, slack = cast(scene, kind, n), slack_of(model)
    size = np.linalg.norm(scene.bounds[1] - scene.bounds[0])
    t, back = (scene.intersect(*rays, t_min).t.astype(float) for t_min in (0, -np.inf))
    before = np.where(np.isfinite(t), t, size) - 0.06 * model.radii.max()
    cases = []
    for share in (rng.random(t.shape), 1 - 10 ** rng.uniform(-4, 0, t.shape)):
        begin = np.maximum(before * share, 0)
        cases += [(begin, np.inf, t), (begin, np.where(np.isfinite(t), t + 2e-6 * size + slack, size), t)]
    begin = np.where(np.isfinite(back), back, 0) - 0.06 * model.radii.max() - size * rng.random(t.shape)
    cases.append((np.minimum(begin, 0), np.inf, np.where(begin > 0, t, back)))
    origins, directions = (a.reshape(-1, 3) for a in rays)
    # Unrefined, the start rule applies five times as far. The loop's last line checks that it explains each of these.
    few = 0.01 if model.settings.refine else 0.08
    for begin, end, right in cases:
        wrong = check(scene, rays, (begin, end), right, slack)
        starts = origins[wrong] + begin.reshape(-1, 1)[wrong] * directions[wrong]
        assert len(wrong) < few * t.size and not (len(wrong) and model.surface == "disc"), f"{len(wrong)} of {t.size}"
        assert all(on_surface(model, x, d) for x, d in zip(starts, directions[wrong], strict=True))


@pytest.mark.filterwarnings("ignore:most normals point inward")
@pytest.mark.parametrize("order", ["tiles", "alone"])
def test_rays_along_the_inside_of_a_sphere_hit_it_where_f_is_zero(order):
    """The chords are a few sample steps long: near their ends f is within the lift of the start rule."""
    rng, positions = np.random.default_rng(6), sphere_points(3000)
    model = pr.Model(pr.Points(positions, -positions))
    scene = pr.Scene()
    scene.add(model)
    hits = scene.intersect(*pr.Camera.look_at((0, 0, 0), (1, 0, 0), fov=60, size=(64, 64)).rays())
    normal, step = -hits.position / np.linalg.norm(hits.position, axis=-1, keepdims=True), model.tree.head[LONGEST]
    aside = np.cross(normal, (0, 0, 1))
    aside /= np.linalg.norm(aside, axis=-1, keepdims=True)
    chord = step * rng.uniform(1.1, 6, (64, 64, 1))
    rays = np.stack([hits.position, chord / 2 * normal + np.sqrt(1 - chord**2 / 4) * aside])
    if order == "alone":
        rays = rng.permutation(rays.reshape(2, -1, 3), axis=1)
    ends = scene.intersect(*rays)
    assert np.isfinite(ends.t).all()
    assert scene.occluded(*rays).all()
    assert np.abs(np.linalg.norm(ends.position, axis=-1) - 1).max() < 2e-3 * model.radii.min()


@pytest.mark.parametrize("order", ["tiles", "alone"])
def test_rays_along_a_sphere_leave_it_from_just_below_its_surface(order):
    """They stay within the lift of the start rule for some sample steps, across borders of leaves."""
    rng, positions = np.random.default_rng(10), sphere_points(20_000)
    model = pr.Model(pr.Points(positions, positions))
    scene = pr.Scene()
    scene.add(model)
    hits = scene.intersect(*pr.Camera.look_at((3, 0, 0), (0, 0, 0), fov=30, size=(128, 128)).rays())
    normal = hits.position / np.linalg.norm(hits.position, axis=-1, keepdims=True)
    aside = np.cross(normal, (0, 0, 1))
    aside /= np.linalg.norm(aside, axis=-1, keepdims=True)
    lowest = 1 - 0.8 * START * model.radii.min()
    height = rng.uniform(lowest, 1, (128, 128, 1))
    rays = np.stack([height * normal, lowest / height * aside - np.sqrt(1 - (lowest / height) ** 2) * normal])
    if order == "alone":
        rays = rng.permutation(rays.reshape(2, -1, 3), axis=1)
    assert not np.isfinite(scene.intersect(*rays).t).any()
    assert not scene.occluded(*rays).any()


@pytest.mark.parametrize(("name", "n"), CLOUDS)
def test_a_ray_from_the_surface_hits_the_same_in_a_tile_and_alone(name, n):
    """Rays leave hits of a camera's rays at up to 6 degrees: many are near the surface for a long way."""
    (scene, _), rng = scene_of(name), np.random.default_rng(8)
    hits = scene.intersect(*cast(scene, "tiles", 2 * n))
    normal = hits.normal[np.isfinite(hits.t)].astype(float)
    aside = np.cross(normal, rng.normal(size=normal.shape))
    aside /= np.linalg.norm(aside, axis=-1, keepdims=True)
    origins, directions = np.zeros((2, 2 * n, 2 * n, 3))  # a direction of zero, which misses, where there is no hit
    origins[np.isfinite(hits.t)] = hits.position[np.isfinite(hits.t)]
    directions[np.isfinite(hits.t)] = aside + rng.uniform(0, 0.1, (len(normal), 1)) * normal
    together = scene.intersect(origins, directions).t
    assert np.array_equal(scene.occluded(origins, directions), np.isfinite(together))
    order = rng.permutation(together.size)
    alone = scene.intersect(origins.reshape(-1, 3)[order], directions.reshape(-1, 3)[order])
    assert np.array_equal(together.reshape(-1)[order], alone.t)


@pytest.mark.parametrize("order", ["tiles", "alone"])
def test_the_rest_of_a_sample_step_behind_a_clip_plane_is_searched(order):
    """Near a sphere's rim one sample step crosses both sides, and a plane clips the first."""
    rng, n = np.random.default_rng(1), 32
    positions = sphere_points(3000)
    model = pr.Model(pr.Points(positions, positions))
    scene = pr.Scene()
    scene.add(model)
    half = 0.5 * model.tree.head[LONGEST] * rng.uniform(0.3, 0.9, (n, n))
    aside, turn = np.sqrt(1 - half**2), 2e-3 * np.arange(n)[:, None]
    origins = np.stack([aside * np.cos(turn), aside * np.sin(turn), np.full((n, n), -3.0)], axis=-1)
    if order == "alone":
        origins = origins.reshape(-1, 3)[::17]  # fewer rays than are traced together
        origins = np.concatenate([np.stack([origins, origins * (-1, 1, 1)], axis=1).reshape(-1, 3)])
    whole = scene.intersect(origins, [0, 0, 1.0])
    scene.clips = [((0, 0, 0), (0, 0, -1))]
    cut = scene.intersect(origins, [0, 0, 1.0])
    seen = np.isfinite(whole.t) & (whole.t < 3)
    assert seen.mean() > 0.5
    assert (cut.t[seen] > 3).all()
    assert np.isfinite(cut.t[seen]).mean() > 0.99


def test_planes_are_hit_for_any_start_and_end_of_a_ray():
    scene, rng = pr.Scene(), np.random.default_rng(5)
    scene.add(pr.Plane((0.1, 0.2, -0.3), (0.2, 0.3, 1)))
    origins, directions = rng.normal(size=(2, 4000, 3))
    rise = directions @ (0.2, 0.3, 1) / np.linalg.norm(directions, axis=1)
    origins, directions = (a[np.abs(rise) > 0.2] for a in (origins, directions))  # flatter rays begin on the plane
    t = scene.intersect(origins, directions, -np.inf).t.astype(float)
    assert np.isfinite(t).all()
    share = 1e-5 * np.abs(t) + 1e-5
    for begin in (-1e9, t - 10 - share, t - share):
        assert np.array_equal(scene.intersect(origins, directions, begin).t, t)
    assert np.array_equal(scene.intersect(origins, directions, -np.inf, t + share).t, t)
    assert not scene.occluded(origins, directions, -np.inf, t - share).any()
    assert not scene.occluded(origins, directions, t + share).any()
