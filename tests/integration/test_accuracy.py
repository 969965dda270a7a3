"""Measured quality of the surface on small clouds; a broken surface must be detected."""

import csv

import numpy as np
import pytest

import pointray as pr
from bench.helpers.measure import (
    Cloud,
    Row,
    Setting,
    cloud_of,
    lines,
    measure,
    model_of,
    overlap,
    references,
    scene_of,
    trace,
)
from bench.helpers.truth import Mesh, Shape, truth
from bench.surface import accuracy
from bench.surface.verdicts import verdicts
from helpers.marks import long

N = 20_000


@pytest.fixture(scope="module", params=["sphere", long("torus")])
def even(request):
    return cloud_of(truth(request.param), "even", N)


def errors_of(model, cloud, rays=30_000):
    return trace(scene_of(model), cloud, lines(cloud.points.bounds, rays, 3), lambda done: None)


@pytest.mark.long
def test_smooth_shapes_are_hit_at_their_surface(even):
    ours, discs = measure(even, [Setting("apss"), Setting("disc")], 30_000)
    assert ours.rays == 30_000 and ours.hits > 7_000
    assert (ours.holes, ours.missed, ours.phantoms) == (0, 0, 0)
    assert ours.depth_rms <= 0.005 and ours.normal_mean <= 0.5
    assert discs.depth_rms >= 10 * ours.depth_rms
    assert discs.normal_mean >= 5 * ours.normal_mean


@pytest.mark.long
def test_half_the_radii_leave_holes(even):
    found = errors_of(pr.Model(even.points, radius_scale=0.5), even)
    assert found.holes > 100 and found.holes >= found.missed > 0


@pytest.mark.long
def test_tilted_normals_are_detected(even):
    rng = np.random.default_rng(0)
    normals = even.points.normals + rng.normal(scale=0.1, size=(N, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    turned = errors_of(pr.Model(even.points.with_normals(normals)), even)
    exact = errors_of(pr.Model(even.points), even)
    assert np.concatenate(turned.degrees).mean() > 10 * np.concatenate(exact.degrees).mean()


@pytest.mark.long
def test_a_surface_elsewhere_is_phantom(even):
    lifted = pr.Points(even.points.positions + 0.6 * even.h * even.points.normals, even.points.normals)
    depths = np.concatenate(errors_of(pr.Model(lifted), even).depths)
    assert 0.58 < np.median(depths) < 0.62 and (depths > 0.5).mean() > 0.99


@pytest.mark.long
def test_noise_has_the_requested_size():
    cloud = cloud_of(truth("sphere"), "random", 20_000, 0.5)
    away = np.linalg.norm(cloud.points.positions, axis=1) - 1
    assert abs(away.std() / cloud.h - 0.5) < 0.02
    exact = cloud.points.positions / np.linalg.norm(cloud.points.positions, axis=1, keepdims=True)
    assert np.abs(cloud.points.normals - exact).max() < 1e-5


@pytest.mark.long
def test_random_points_are_independent():
    """The number of random points in a patch has the variance of its mean; even points have a much lower one."""
    directions = np.random.default_rng(1).normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def spread(sampling):
        x = truth("sphere").points(20_000, sampling, 0)[0]
        counts = (x @ directions.T > 0.995).sum(axis=0)
        assert abs(counts.mean() / (20_000 * 0.0025) - 1) < 0.03
        return counts.var() / counts.mean()

    assert 0.8 < spread("random") < 1.25
    assert spread("even") < 0.3


@pytest.mark.parametrize("name", ["sphere", long("torus"), long("lattice")])
def test_depth_of_a_ray_in_a_solid(name):
    """The depth is compared with dense samples of the exact distance along each ray."""
    shape, h = truth(name), 0.02
    samples = shape.surface_samples(5000, 0)
    bounds = np.stack([samples.min(axis=0), samples.max(axis=0)])
    origins, directions = next(lines(bounds, 120, 4))
    ends = np.where(np.arange(120) % 2, np.inf, np.linalg.norm(bounds[1] - bounds[0]) / 2)
    found = shape.depth(origins, directions, ends, h)
    t = np.minimum(np.arange(0, 6, 0.008), ends[:, None])
    exact = -pr.procedural_distance(name, origins[:, None] + t[..., None] * directions[:, None]).min(axis=1)
    assert (exact > h).sum() > 10
    clear = np.abs(exact / h - 0.5) > 0.25
    assert ((found > 0.5 * h) == (exact > 0.5 * h))[clear].all()


@pytest.fixture
def ball(tmp_path):
    """A mesh of the unit sphere with one triangle pulled long, and the same as a `Mesh`."""
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("embreex")
    mesh = trimesh.creation.icosphere(subdivisions=4)
    mesh.vertices[0] *= 1.5
    mesh.export(tmp_path / "stanford_bunny_mesh.ply")
    return Mesh("bunny", tmp_path), mesh


def test_the_nearest_point_of_a_mesh_is_exact(ball):
    trimesh = pytest.importorskip("trimesh")
    exact, mesh = ball
    x = np.random.default_rng(2).normal(size=(50, 3))
    near = np.concatenate([x, mesh.vertices[0] + 0.1 * x[:20], exact.surface_samples(50, 0) + 0.01 * x])
    distance, normals = exact.compare(near)
    for point, found, n in zip(near, distance, normals, strict=True):
        closest = trimesh.triangles.closest_point(mesh.triangles, np.repeat(point[None], len(mesh.faces), axis=0))
        apart = np.linalg.norm(closest - point, axis=1)
        assert abs(apart.min() - found) < 1e-6
        best = apart.argmin()
        share = trimesh.triangles.points_to_barycentric(mesh.triangles[best : best + 1], closest[best : best + 1])
        expected = share[0] @ mesh.vertex_normals[mesh.faces[best]]
        assert n @ expected > 0.99999 * np.linalg.norm(expected)


def test_depth_of_a_ray_in_a_mesh(ball):
    exact, mesh = ball
    origins, directions = next(lines(np.array([[-1.0] * 3, [1.0] * 3]), 2000, 5))
    closest = np.linalg.norm(np.cross(origins, directions), axis=1)
    depth = exact.depth(origins, directions, np.full(2000, np.inf), 0.05)
    spike = 1.25 / 1.5 * mesh.vertices[0]
    away = np.linalg.norm(np.cross(origins - spike, directions), axis=1) > 0.5
    sure = (np.abs(closest - 1) > 0.01) & away
    assert ((depth > 0) == (closest < 1))[sure].all()
    inside = sure & (closest < 0.9)
    assert inside.sum() > 100 and np.abs(depth - (1 - closest))[inside].max() < 0.03
    assert (exact.depth(origins, directions, np.zeros(2000), 0.05) == 0).all()


@pytest.mark.long
def test_counts_of_splats(even):
    small = Cloud(even.truth, "even", even.points.select(np.arange(0, N, 10)), 0.0)
    model = model_of(small, Setting("apss"))
    surface_samples = even.truth.surface_samples(2000, seed=99)
    gaps = np.linalg.norm(surface_samples[:, None] - model.points.positions[None].astype(np.float64), axis=2)
    assert abs((gaps <= model.radii).sum(axis=1).mean() - overlap(surface_samples, model)) < 1e-3
    spheres = model.tree.spheres.reshape(-1, 4, 16)
    listed = sum(
        int((spheres[g, 3] >= 0).sum())
        for first, count in model.tree.spans.reshape(-1, 2)
        for g in range(first, first + count)
    )
    assert references(model) == 4 * listed / len(small.points)


def test_verdicts_distinguish_good_from_bad():
    good = [
        Row(
            "sphere",
            "even",
            100_000,
            0.0,
            surface,
            4,
            1,
            "auto",
            10**7,
            10**6,
            0,
            0,
            0,
            depth,
            0,
            normal,
            0,
            7.0,
            5.0,
            9.0,
        )
        for surface, depth, normal in (("apss", 0.001, 0.1), ("disc", 0.1, 5.0))
    ]
    assert {v.met for v in verdicts(good, "apss")} == {True, None}
    bad = [
        Row(**{**vars(good[0]), "holes": 5, "missed": 1, "phantoms": 500, "depth_rms": 0.1, "overlap": 9.0}),
        good[1],
    ]
    failed = [v.demand for v in verdicts(bad, "apss") if v.met is False]
    assert len(failed) == 6


@pytest.mark.long
def test_a_run_writes_its_table_and_plot(tmp_path, capsys, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr("bench.helpers.measure.PIXELS", 64)
    monkeypatch.setattr("bench.helpers.measure.PLACES", 1000)
    table, plot = tmp_path / "a.csv", tmp_path / "a.png"
    size = ["--points", "1000", "--rays", "2000", "--shapes", "sphere", "--csv", str(table), "--plot", str(plot)]
    accuracy.main(["--quick", *size])
    rows = list(csv.DictReader(table.open()))
    assert [(r["sampling"], r["surface"]) for r in rows] == [
        (s, f) for s in ("even", "random") for f in ("apss", "disc")
    ]
    assert all(int(r["rays"]) == 2000 and float(r["ms"]) > 0 for r in rows)
    assert plot.stat().st_size > 10_000
    assert sorted(tmp_path.iterdir()) == [table, plot]
    assert "not measured" in capsys.readouterr().out


def test_absent_meshes_are_reported(tmp_path):
    pytest.importorskip("embreex")
    with pytest.raises(ValueError, match="stanford_bunny_mesh"):
        Mesh("bunny", tmp_path)
    assert isinstance(truth("torus"), Shape)
