"""Triangle meshes in a `RaycastingScene`: sampled, with the indices of the triangles, or rejected with a reason."""

import numpy as np
import pytest

from pointray.compat import RaycastingScene
from pointray.compat.mesh_samples import sample_triangles

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)
WARNED = "represented by 20,000 points sampled every"


def cube_scene(**given):
    scene = RaycastingScene()
    with pytest.warns(UserWarning, match=WARNED):
        assert scene.add_triangles(**given, samples=20_000) == 0
    return scene


@pytest.fixture(scope="module")
def cube():
    return cube_scene(vertex_positions=CORNERS, triangle_indices=CUBE)


def test_hits_have_the_triangles_of_open3d(cube, rng):
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    other = open3d.t.geometry.RaycastingScene()
    other.add_triangles(open3d.core.Tensor(CORNERS.astype(np.float32)), open3d.core.Tensor(CUBE.astype(np.uint32)))
    target = rng.uniform(0.1, 0.9, (2000, 3))
    origin = target + 4 * rng.normal(size=(2000, 3))
    rays = np.concatenate([origin, target - origin], axis=1).astype(np.float32)
    outside = ((origin < 0) | (origin > 1)).any(axis=1)
    one = cube.cast_rays(rays)
    truth = {name: values.numpy() for name, values in other.cast_rays(rays).items()}
    place = rays[:, :3] + rays[:, 3:] * truth["t_hit"][:, None]
    edge = np.sort(np.minimum(place, 1 - place), axis=1)[:, 1]  # distance from the nearest edge
    inner = outside & (edge > 0.05)
    assert inner.sum() > 1000
    np.testing.assert_allclose(one["t_hit"][inner], truth["t_hit"][inner], atol=1e-4)
    same = inner & (one["primitive_ids"] == truth["primitive_ids"])
    assert same.sum() > 0.97 * inner.sum()  # the diagonals of the sides separate triangles
    np.testing.assert_allclose(one["primitive_normals"][same], truth["primitive_normals"][same], atol=1e-5)
    np.testing.assert_allclose(one["primitive_uvs"][same], truth["primitive_uvs"][same], atol=2e-3)
    corner = CORNERS[CUBE[one["primitive_ids"][same]]]
    u, v = one["primitive_uvs"][same].T[..., None]
    back = corner[:, 0] * (1 - u - v) + corner[:, 1] * u + corner[:, 2] * v
    np.testing.assert_allclose(back, place[same], atol=2e-3)


def test_distances_inside_and_outside(cube):
    x = np.array([[0.5, 0.5, 0.5], [0.5, 0.5, 0.9], [0.5, 0.5, 1.2], [2, 0.5, 0.5]])
    np.testing.assert_allclose(cube.compute_signed_distance(x), [-0.5, -0.1, 0.2, 1], atol=1e-3)
    assert cube.compute_occupancy(x).tolist() == [1, 1, 0, 0]
    near = cube.compute_closest_points(x[1:])
    np.testing.assert_allclose(near["primitive_normals"], [[0, 0, 1], [0, 0, 1], [1, 0, 0]], atol=1e-5)


def test_meshes_of_other_libraries_are_taken():
    trimesh = pytest.importorskip("trimesh")
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    legacy = open3d.geometry.TriangleMesh.create_box()
    ray = [[0.3, 0.4, 5, 0, 0, -1]]
    for mesh in (trimesh.creation.box((1, 1, 1)), legacy, open3d.t.geometry.TriangleMesh.from_legacy(legacy)):
        height = mesh.bounds[1, 2] if hasattr(mesh, "faces") else 1
        assert abs(cube_scene(mesh=mesh).cast_rays(ray)["t_hit"][0] - (5 - height)) < 1e-3
        assert abs(cube_scene(vertex_positions=mesh).cast_rays(ray)["t_hit"][0] - (5 - height)) < 1e-3


def test_samples_are_spread_by_area(rng):
    """A large and a small triangle, 9 to 1."""
    vertices = np.array([[0, 0, 0], [3, 0, 0], [0, 3, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0]], float)
    points, triangles = sample_triangles(vertices, np.array([[0, 1, 2], [3, 4, 5]]), 10_000)
    assert np.bincount(triangles.of_point).tolist() == [9000, 1000]
    assert (points.normals == [0, 0, 1]).all()
    x, y = points.positions[:9000, :2].T
    assert min(x.min(), y.min()) >= 0 and (x + y).max() <= 3 + 1e-6
    counts = np.histogram2d(x, y, bins=(10, 10), range=((0, 1), (0, 1)))[0]
    assert counts.min() > 10 and counts.max() < 30  # 20 on average


def test_triangles_of_mixed_orientation_have_a_warning():
    mixed = CUBE.copy()
    mixed[::2] = mixed[::2, ::-1]
    with pytest.warns(UserWarning, match="oriented differently"):
        assert sample_triangles(CORNERS, mixed, 1000)[0].normals is None
    scene = RaycastingScene()
    with pytest.warns(UserWarning) as warned:
        scene.add_triangles(CORNERS, mixed, samples=20_000)
    assert any("oriented differently" in str(one.message) for one in warned)
    assert scene.compute_occupancy([[0.5, 0.5, 0.5], [2, 2, 2]]).tolist() == [1, 0]
    soup = np.arange(36).reshape(12, 3)  # three vertices for each triangle, as in a file of STL
    with pytest.warns(UserWarning, match="oriented differently"):
        assert sample_triangles(CORNERS[mixed].reshape(-1, 3), soup, 1000)[0].normals is None
    assert sample_triangles(CORNERS[CUBE].reshape(-1, 3), soup, 1000)[0].normals is not None


@pytest.mark.filterwarnings("error")
def test_a_warning_that_is_an_error_adds_nothing():
    scene = RaycastingScene()
    with pytest.raises(UserWarning, match=WARNED):
        scene.add_triangles(CORNERS, CUBE, samples=20_000)
    assert np.isinf(scene.cast_rays([[0.3, 0.4, 5, 0, 0, -1]])["t_hit"]).all()
    assert scene.add_points(CORNERS, np.ones(8)) == 0


def test_meshes_of_open3d_without_triangles_are_rejected():
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    mesh, scene = open3d.t.geometry.TriangleMesh(), RaycastingScene()
    with pytest.raises(ValueError, match="vertex_positions: the mesh has no vertices"):
        scene.add_triangles(mesh)
    mesh.vertex.positions = open3d.core.Tensor(CORNERS)
    with pytest.raises(ValueError, match="no triangles; to add its vertices, use add_points"):
        scene.add_triangles(mesh)
    with pytest.raises(ValueError, match=r"vertex_positions|triangle_indices"):
        scene.add_triangles(open3d.geometry.TriangleMesh())


WRONG = [
    ((CORNERS, CUBE + 1), "triangle_indices must be from 0 to 7, found 8"),
    ((CORNERS, CUBE - 1), "triangle_indices must be from 0 to 7, found -1"),
    ((CORNERS, CUBE[:, :2]), "triangle_indices must be integers of shape"),
    ((CORNERS, CUBE.astype(float)), "triangle_indices must be integers of shape"),
    ((CORNERS[:, :2], CUBE), "vertex_positions must have the shape"),
    ((CORNERS * np.nan, CUBE), "vertex_positions must be finite"),
    ((CORNERS * 0, CUBE), "the mesh has no area"),
    ((CORNERS, CUBE[:0]), "no triangles; to add its vertices, use add_points"),
    ((CORNERS,), "mesh must be a triangle mesh of Open3D or trimesh"),
    ((None, CUBE), "vertex_positions must be"),
]


@pytest.mark.parametrize(("args", "message"), WRONG)
def test_other_meshes_are_rejected_with_a_reason(args, message):
    scene = RaycastingScene()
    with pytest.raises(ValueError, match=message):
        scene.add_triangles(*args)
    assert scene.cast_rays([[0.3, 0.4, 5, 0, 0, -1]])["geometry_ids"].tolist() == [scene.INVALID_ID]
