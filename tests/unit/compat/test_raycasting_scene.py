"""`RaycastingScene` beside Open3D's class: names, dtypes, shapes and misses, and results on a sphere."""

import inspect

import numpy as np
import pytest

import pointray as pr
from pointray.compat import RaycastingScene, occupancy

POINTS = 20_000
SPACING = np.sqrt(4 * np.pi / POINTS)


@pytest.fixture(scope="module")
def open3d():
    return pytest.importorskip("open3d", exc_type=ImportError)


@pytest.fixture(scope="module")
def points():
    scene = RaycastingScene()
    assert scene.add_points(pr.procedural("sphere", POINTS)) == 0
    return scene


@pytest.fixture(scope="module")
def triangles(open3d):
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.t.geometry.TriangleMesh.create_sphere(1.0, 200))
    return scene


@pytest.fixture
def rays(rng):
    """Rays of which half hit. None grazes the sphere: there triangles differ from it."""
    direction = rng.normal(size=(400, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    side = np.cross(direction, rng.normal(size=(400, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    offset = np.where(np.arange(400) % 2, rng.uniform(0, 0.95, 400), rng.uniform(1.05, 2, 400))
    origin = offset[:, None] * side - 4 * direction
    direction *= rng.uniform(0.2, 5, (400, 1))
    return np.concatenate([origin, direction], axis=1).astype(np.float32).reshape(20, 20, 6)


@pytest.fixture
def queries(rng):
    return rng.uniform(-1.5, 1.5, (20, 20, 3)).astype(np.float32)


def same_form(one, other):
    """Compare the names, dtypes and shapes of a result with Open3D's; return both as arrays."""
    if not isinstance(one, dict):
        one, other = {"": one}, {"": other}
    other = {name: values.numpy() for name, values in other.items()}
    assert set(one) == set(other)
    for name, values in one.items():
        assert isinstance(values, np.ndarray)
        assert (values.dtype, values.shape) == (other[name].dtype, other[name].shape), name
    return one, other


def test_methods_and_parameters_are_those_of_open3d(open3d):
    other = open3d.t.geometry.RaycastingScene
    names = {name for name in dir(other) if not name.startswith("_")}
    assert names <= set(dir(RaycastingScene)) and RaycastingScene.INVALID_ID == other.INVALID_ID
    for name in names - {"INVALID_ID", "add_triangles", "create_rays_pinhole"}:
        text = getattr(other, name).__doc__.split(") ->")[0].split("(", 1)[1]
        expected = [part.split(":")[0].strip() for part in text.split(",")]
        assert list(inspect.signature(getattr(RaycastingScene, name)).parameters) == expected


def test_first_hits_agree(points, triangles, rays):
    one, other = same_form(points.cast_rays(rays), triangles.cast_rays(rays))
    hit = np.isfinite(other["t_hit"])
    assert (np.isfinite(one["t_hit"]) == hit).all() and 0.4 < hit.mean() < 0.6
    position = rays[..., :3] + rays[..., 3:] * np.where(hit, one["t_hit"], 0)[..., None]
    assert np.abs(np.linalg.norm(position[hit], axis=-1) - 1).max() < 0.1 * SPACING
    away = np.abs(one["t_hit"][hit] - other["t_hit"][hit]) * np.linalg.norm(rays[hit][:, 3:], axis=1)
    across = -(one["primitive_normals"] * rays[..., 3:]).sum(-1)[hit] / np.linalg.norm(rays[hit][:, 3:], axis=1)
    assert (away * across).max() < 0.1 * SPACING  # measured across the surface
    assert (one["primitive_normals"] * other["primitive_normals"]).sum(-1)[hit].min() > 0.99
    for name in ("geometry_ids", "primitive_ids", "primitive_uvs", "primitive_normals"):
        np.testing.assert_array_equal(one[name][~hit], other[name][~hit])
    assert (one["geometry_ids"][hit] == 0).all()
    nearest = pr.procedural("sphere", POINTS).positions[one["primitive_ids"][hit]]
    assert np.linalg.norm(position[hit] - nearest, axis=1).max() < 2 * SPACING


def test_occlusions_agree(points, triangles, rays):
    for limits in ({}, {"tnear": 1.0, "tfar": 3.5}, {"tnear": 0.3}, {"tfar": 0.1}):
        one, other = same_form(points.test_occlusions(rays, **limits), triangles.test_occlusions(rays, **limits))
        assert (one[""] != other[""]).mean() < 0.01


def test_limits_of_occlusions_are_those_of_open3d(points, triangles):
    """From the centre, towards the sphere, and away from it."""
    rays = np.array([[0, 0, 0, 1, 0.01, 0.02], [-5, 0.1, 0.1, 1, 0, 0], [5, 0.1, 0.1, 1, 0, 0]], np.float32)
    nan, inf = np.nan, np.inf
    expected = {(nan, inf): 0, (0, nan): 0, (-10, inf): 2, (-10, -1): 0, (-inf, inf): 2, (inf, inf): 0, (3, 2): 0}
    for limits, count in expected.items():
        one, other = same_form(points.test_occlusions(rays, *limits), triangles.test_occlusions(rays, *limits))
        np.testing.assert_array_equal(one[""], other[""])
        assert one[""].sum() == count


def test_many_rays_and_threads_are_valid(points, triangles):
    x = np.array([[0.2, 0.3, 0.1], [0, 0, 1.2]], np.float32)
    one, other = same_form(points.compute_occupancy(x, nsamples=101), triangles.compute_occupancy(x, nsamples=101))
    assert one[""].tolist() == other[""].tolist() == [1, 0]
    ray = [[0, -5, 0.1, 0, 1, 0]]
    for count in (1, 1000, 2**31, 2**70):
        assert points.cast_rays(ray, nthreads=count)["t_hit"] == points.cast_rays(ray)["t_hit"]


def test_closest_points_of_queries_that_are_not_finite(points):
    found = points.compute_closest_points([[np.nan, 0, 0], [np.inf, 0, 0], [0, 0, 2]])
    assert np.isnan(found["points"][:2]).all() and np.isnan(found["primitive_normals"][:2]).all()
    assert (found["geometry_ids"] == points.INVALID_ID).tolist() == [True, True, False]
    assert (found["primitive_ids"] == points.INVALID_ID).tolist() == [True, True, False]
    assert not found["primitive_uvs"].any()


def test_all_intersections_agree(points, triangles, rays):
    one, other = same_form(points.count_intersections(rays), triangles.count_intersections(rays))
    np.testing.assert_array_equal(one[""], other[""])
    one, other = same_form(points.list_intersections(rays), triangles.list_intersections(rays))
    for name in ("ray_splits", "ray_ids", "geometry_ids"):
        np.testing.assert_array_equal(one[name], other[name])
    flat = rays.reshape(-1, 6)
    direction = flat[one["ray_ids"], 3:]
    position = flat[one["ray_ids"], :3] + direction * one["t_hit"][:, None]
    assert np.abs(np.linalg.norm(position, axis=1) - 1).max() < 0.1 * SPACING
    away = np.abs(one["t_hit"] - other["t_hit"])[:, None] * direction
    assert np.abs((away * position).sum(axis=1)).max() < 0.1 * SPACING


def test_distances_agree(points, triangles, queries):
    for name in ("compute_distance", "compute_signed_distance"):
        one, other = same_form(getattr(points, name)(queries), getattr(triangles, name)(queries))
        assert np.abs(one[""] - other[""]).max() < 0.1 * SPACING
    one, other = same_form(points.compute_occupancy(queries), triangles.compute_occupancy(queries))
    sure = np.abs(np.linalg.norm(queries, axis=-1) - 1) > 0.1 * SPACING
    np.testing.assert_array_equal(one[""][sure], other[""][sure])
    assert 0.1 < one[""].mean() < 0.5


def test_closest_points_agree(points, triangles, queries):
    one, _ = same_form(points.compute_closest_points(queries), triangles.compute_closest_points(queries))
    radius = np.linalg.norm(queries, axis=-1, keepdims=True)
    outer = radius[..., 0] > 0.3  # near the centre, all points are as near
    exact = (queries / radius)[outer]
    assert np.linalg.norm(one["points"][outer] - exact, axis=1).max() < 0.1 * SPACING
    assert (one["primitive_normals"][outer] * exact).sum(axis=1).min() > 0.999
    assert (one["geometry_ids"] == 0).all() and one["primitive_ids"].max() < POINTS


VIEWS = [
    {"fov_deg": 60, "center": [0, 0, 0], "eye": [3, 1, 2], "up": [0, 0, 1], "width_px": 8, "height_px": 6},
    {"fov_deg": 110.5, "center": [1, 2, 3], "eye": [-3, 1, 2], "up": [0.1, 2, 0.3], "width_px": 5, "height_px": 7},
    {"intrinsic_matrix": [[5, 0.3, 2], [0, 4, 1.5], [0, 0, 1]], "extrinsic_matrix": 0, "width_px": 4, "height_px": 3},
]


@pytest.mark.parametrize("view", VIEWS)
def test_rays_of_a_camera_are_equal(open3d, view, rng):
    view = dict(view)
    if "extrinsic_matrix" in view:
        view["intrinsic_matrix"], view["extrinsic_matrix"] = np.array(view["intrinsic_matrix"]), np.eye(4)
        view["extrinsic_matrix"][:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        view["extrinsic_matrix"][:3, 3] = 1, 2, 3
    one = RaycastingScene.create_rays_pinhole(**view)
    other = open3d.t.geometry.RaycastingScene.create_rays_pinhole(**view).numpy()
    assert one.dtype == other.dtype and one.shape == other.shape
    np.testing.assert_allclose(one, other, atol=1e-5)
    np.testing.assert_array_equal(one, RaycastingScene.create_rays_pinhole(*view.values()))


def test_an_empty_scene_gives_misses(open3d):
    rays = np.array([[0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 0, 0]], np.float32)
    one, other = RaycastingScene(), open3d.t.geometry.RaycastingScene()
    for name in ("cast_rays", "list_intersections", "count_intersections", "test_occlusions"):
        mine, theirs = same_form(getattr(one, name)(rays), getattr(other, name)(rays))
        for key in mine:
            np.testing.assert_array_equal(mine[key], theirs[key])
    assert one.compute_occupancy([[0, 0, 0]]).tolist() == [0]
    with pytest.raises(ValueError, match="no models"):
        one.compute_distance([[0, 0, 0]])


def test_tensors_are_taken_as_arrays(open3d, points):
    rows = [[0.0, -5, 0.1, 0, 1, 0], [0, -5, 3, 0, 1, 0]]
    expected = points.cast_rays(np.array(rows))["t_hit"]

    class Dlpack:
        """A tensor without a conversion to NumPy."""

        def __init__(self, array):
            self.__dlpack__, self.__dlpack_device__ = array.__dlpack__, array.__dlpack_device__

    class Cuda:
        """A tensor that must be copied from a GPU first, like one of PyTorch."""

        def detach(self):
            return self

        def cpu(self):
            return np.array(rows)

    given = [rows, np.array(rows, np.float32), open3d.core.Tensor(rows), Dlpack(np.array(rows)), Cuda()]
    for value in given:
        np.testing.assert_array_equal(points.cast_rays(value)["t_hit"], expected)


def test_geometries_are_numbered_and_changes_are_seen():
    scene, ball = RaycastingScene(), pr.procedural("sphere", 2000)
    assert scene.add_points(ball) == 0
    query = [[6.0, 0, 0]]
    assert abs(scene.compute_distance(query)[0] - 5) < 0.01
    assert scene.add_points(pr.Model(ball.positions + np.float32([5, 0, 0]))) == 1
    assert scene.add_points(ball.positions + np.float32([0, 0, 5]), np.full(2000, 0.1), surface="disc") == 2
    assert scene.compute_distance(query)[0] < 0.01
    rays = [[x, -5, z, 0, 1, 0] for x, z in ((0, 0), (5, 0), (0, 5), (9, 9))]
    assert scene.cast_rays(rays)["geometry_ids"].tolist() == [0, 1, 2, scene.INVALID_ID]
    assert scene.compute_closest_points([[0, 0, 7.0]])["geometry_ids"].tolist() == [2]


def test_sides_of_an_open_surface_do_not_depend_on_one_ray():
    """Seven eighths of a sphere: through the hole, rays leave without a crossing."""
    ball = pr.procedural("sphere", 20_000)
    scene = RaycastingScene()
    scene.add_points(ball.select(~(ball.positions > 0).all(axis=1)))
    assert scene.compute_occupancy([[-0.3, -0.3, -0.3], [0, 0, -0.5], [2, 0, 0], [0, -3, 0]], nsamples=5).tolist() == [
        1,
        1,
        0,
        0,
    ]


def test_rays_through_a_hole_do_not_make_outer_positions_inner(rng, monkeypatch):
    """Below the lower half of a sphere, rays upwards enter it and leave through its opening: an odd number."""
    ball = pr.procedural("sphere", 20_000)
    scene = RaycastingScene()
    scene.add_points(ball.select(ball.positions[:, 2] < 0))
    below = rng.uniform([-0.5, -0.5, -1.5], [0.5, 0.5, -1.1], (500, 3))
    directions = np.array([[0.1, 0, 1]] * 3 + [[1, 0.1, 0]] * 3)
    monkeypatch.setattr(occupancy, "directions_of", lambda count: directions[:count])
    up = np.concatenate([below, np.tile([0.1, 0, 1], (500, 1))], axis=1)
    assert scene.count_intersections(up).tolist() == [1] * 500
    assert not scene.compute_occupancy(below).any()


def test_values_beyond_float32_are_finite(points):
    for length in (1e-300, 1e-150, 1e150, 1e300):
        ray = [[0, -5, 0.1, 0, length, 0]]
        assert points.count_intersections(ray).tolist() == [2]
        assert np.isfinite(points.list_intersections(ray)["t_hit"]).all()
    assert points.compute_signed_distance([[0, 1e99, 0]]).tolist() == [np.finfo(np.float32).max]
    assert np.isnan(points.compute_distance([[np.nan, 0, 0], [0, 1e200, 0]])).all()


WRONG = [
    ("cast_rays", ([[0, 0, 0]],), {}, r"rays must have the shape \(\.\.\., 6\), got \(1, 3\)"),
    ("cast_rays", ("abc",), {}, "rays must be an array or tensor of numbers"),
    ("list_intersections", ([[1, 2, 3, 4, 5, 6], [1]],), {}, "rays must be"),
    ("count_intersections", (np.ones((2, 6), bool),), {}, "rays must be"),
    ("compute_distance", ([[0, 0]],), {}, r"query_points must have the shape \(\.\.\., 3\)"),
    ("compute_occupancy", ([[0, 0, 0]],), {"nsamples": 2}, "nsamples must be odd"),
    ("compute_signed_distance", ([[0, 0, 0]],), {"nsamples": 0}, "nsamples must be a whole number"),
    ("compute_occupancy", ([[0, 0, 0]],), {"nsamples": 100_001}, "nsamples must be a whole number from 1 to 99999"),
    ("cast_rays", ([[0] * 6],), {"nthreads": -1}, "nthreads must be a whole number from 0"),
    ("test_occlusions", ([[0] * 6],), {"tnear": "a"}, "tnear must be a number"),
    ("create_rays_pinhole", (60, [0, 0, 0], [0, 0, 5], [0, 0, 1], 3, 2), {}, "up must not be parallel"),
    ("create_rays_pinhole", (180, [0, 0, 0], [0, 5, 5], [0, 0, 1], 3, 2), {}, "fov_deg must be"),
    ("create_rays_pinhole", (60, [0, 0, 0], [0, 5, 5], [0, 0, 1], 0, 2), {}, "width_px must be"),
    ("create_rays_pinhole", (60, [0, 0], [0, 5, 5], [0, 0, 1], 3, 2), {}, r"center must have the shape \(3,\)"),
    ("create_rays_pinhole", (np.zeros((3, 3)), np.eye(4), 3, 2), {}, "intrinsic_matrix is singular"),
    ("create_rays_pinhole", (np.eye(3), np.full((4, 4), np.nan), 3, 2), {}, "extrinsic_matrix must be finite"),
    ("add_points", (np.zeros((0, 3)),), {}, "no points"),
]


@pytest.mark.parametrize(("name", "args", "options", "message"), WRONG)
def test_wrong_arguments_are_named(points, name, args, options, message):
    with pytest.raises(ValueError, match=message):
        getattr(points, name)(*args, **options)


def test_wrong_types_and_devices_are_refused(points):
    with pytest.raises(TypeError, match="rays"):
        points.cast_rays(object())
    with pytest.raises(TypeError, match="extrinsic_matrix"):
        points.create_rays_pinhole(intrinsic_matrix=np.eye(3), width_px=3, height_px=2)
    with pytest.raises(ValueError, match="device must be a CPU"):
        RaycastingScene(device="CUDA:0")
    with pytest.raises(ValueError, match="radii and options"):
        points.add_points(pr.Model(pr.procedural("sphere", 100)), surface="disc")
    RaycastingScene(nthreads=2, device="CPU:0")


def test_the_room_is_an_attribute_that_is_loaded_when_it_is_needed():
    assert pr.compat.RaycastingScene is RaycastingScene
