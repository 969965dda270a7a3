"""`Model.to_mesh`: closed meshes on the surface that rays hit, in blocks, and what is left out."""

import sys

import numpy as np
import pytest

import pointray as pr
from helpers.marks import long
from pointray.scene import meshing

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("skimage")


@pytest.fixture(scope="module")
def sphere():
    return pr.Model(pr.procedural("sphere", 5000))


CASES = [("sphere", 5000, 40, 2, 1), ("torus", 5000, 50, 0, 1), long("statue", 100_000, 100, None, 1)]


@pytest.mark.parametrize(("name", "n", "cells", "euler", "pieces"), CASES)
def test_the_mesh_is_closed_and_on_the_surface(name, n, cells, euler, pieces):
    model = pr.Model(pr.procedural(name, n))
    mesh = model.to_mesh(cells)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    assert mesh.body_count == pieces and (euler is None or mesh.euler_number == euler)
    spacing, cell = model.spacing / 1.15, np.ptp(mesh.vertices, axis=0).max() / cells
    error = np.abs(pr.procedural_distance(name, mesh.vertices))
    assert np.quantile(error, 0.99) < 0.1 * spacing and error.max() < cell
    if name != "statue":
        assert error.max() < 0.05 * spacing
    assert (mesh.vertex_normals * _outwards(name, mesh.vertices)).sum(axis=1).mean() > 0.9
    assert mesh.visual.kind == "vertex"


def _outwards(name, x):
    """Directions of the gradient of the exact distance."""
    steps = 1e-4 * np.eye(3)
    slope = np.stack([pr.procedural_distance(name, x + s) - pr.procedural_distance(name, x - s) for s in steps], 1)
    return slope / np.linalg.norm(slope, axis=1, keepdims=True)


def test_blocks_give_the_same_mesh(sphere, monkeypatch):
    whole = sphere.to_mesh(30)
    monkeypatch.setattr(meshing, "SLAB_BYTES", 1)  # slabs of eight layers
    parts = sphere.to_mesh(30)
    assert parts.is_watertight and parts.euler_number == 2
    order, other = (np.lexsort(mesh.vertices.T) for mesh in (whole, parts))
    np.testing.assert_allclose(whole.vertices[order], parts.vertices[other], atol=1e-9)
    assert len(whole.faces) == len(parts.faces)


def test_the_default_resolution_is_the_spacing_and_progress_increases(sphere):
    told = []
    mesh = sphere.to_mesh(progress=lambda stage, share: told.append((stage, share)))
    edges = mesh.edges_unique_length
    assert 0.3 < np.median(edges) / sphere.spacing < 1.5
    assert {stage for stage, _ in told} == {"meshing"} and told[-1][1] == 1
    assert (np.diff([share for _, share in told]) >= 0).all()


def test_vertices_have_the_colours_of_the_points_in_world_coordinates(rng):
    points = pr.procedural("sphere", 5000)
    colors = np.where(points.positions[:, 2:] > 0, [200, 40, 10], [20, 60, 220]).astype(np.uint8)
    far = pr.Points(points.world + [500_000, 5_600_000, 100], points.normals, colors)
    mesh = pr.Model(far).to_mesh(30)
    assert mesh.is_watertight
    local = mesh.vertices - [500_000, 5_600_000, 100]
    assert np.abs(np.linalg.norm(local, axis=1) - 1).max() < 0.002
    for side, color in ((local[:, 2] > 0.2, [200, 40, 10]), (local[:, 2] < -0.2, [20, 60, 220])):
        assert np.abs(mesh.visual.vertex_colors[side, :3].astype(int) - color).max() <= 1
    assert pr.Model(points.changed(colors=None)).to_mesh(10).visual.kind is None


def test_holes_are_closed_with_a_warning():
    points = pr.procedural("sphere", 20_000)
    cut = pr.Model(points.select(points.positions[:, 2] > -0.8))
    with pytest.warns(UserWarning, match=r"\d+% of the mesh's vertices close holes"):
        mesh = cut.to_mesh(40)
    assert mesh.is_watertight and mesh.euler_number == 2
    assert abs(mesh.bounds[0, 2] + 0.8) < 0.1


def test_an_open_surface_has_no_mesh():
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 60)] * 2), axis=-1).reshape(-1, 2)
    hills = np.column_stack([grid, 0.1 * np.sin(3 * grid[:, 0]) * np.cos(2 * grid[:, 1])])
    up = np.tile([0.0, 0, 1], (len(hills), 1))
    for points in (hills, pr.Points(hills, up), pr.Points(hills, -up)):
        with pytest.raises(ValueError, match="encloses no volume, or only parts"):
            pr.Model(points).to_mesh(40)


@pytest.mark.filterwarnings("ignore:most normals point inward")
def test_normals_that_point_inward_are_named():
    ball = pr.procedural("sphere", 5000)
    cut = ball.select(ball.positions[:, 2] > -0.8)
    for points in (ball, cut, pr.procedural("torus", 5000)):
        with pytest.raises(ValueError, match="its normals point inward: flip them with points.with_normals"):
            pr.Model(points.with_normals(-points.normals)).to_mesh(20)
    twice = ball.with_normals(-ball.normals)
    assert pr.Model(twice.with_normals(-twice.normals)).to_mesh(20).is_watertight


def test_scattered_points_are_left_out(sphere, rng):
    ball = pr.procedural("sphere", 5000)
    strays = rng.uniform(2, 3, (20, 3))
    mask = np.arange(5020) >= 5000
    model = pr.Model(np.concatenate([ball.positions, strays]), scatter="spheres", _scattered=mask)
    assert model.scattered.sum() >= 20
    mesh = model.to_mesh(60)
    assert mesh.is_watertight and np.abs(mesh.vertices).max() < 1.1


def test_export_writes_a_file_that_is_read_again(sphere, tmp_path):
    sphere.to_mesh(20).export(tmp_path / "ball.ply")
    back = trimesh.load(tmp_path / "ball.ply", process=False)
    assert back.is_watertight and back.euler_number == 2


@pytest.mark.parametrize("value", [1, 5000, 2.5, True, "10"])
def test_wrong_resolutions_are_refused(sphere, value):
    with pytest.raises(ValueError, match="resolution must be"):
        sphere.to_mesh(value)


@pytest.mark.parametrize("package", ["trimesh", "skimage.measure"])
def test_a_missing_package_has_a_command(sphere, package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=r"Model.to_mesh needs .*: pip install 'pointray\[mesh\]'"):
        sphere.to_mesh(10)
