import dataclasses

import numpy as np
import pytest

from pointray.rendering.camera import MARGIN, THREE_QUARTER, Camera

BOX = np.array([[-1, -2, 0], [3, 1, 5]], float)


PROJECTIONS = ("perspective", "orthographic", "panorama")


def basis(camera):
    """Return eye, forward, right and up."""
    return camera.record()[:12].reshape(4, 3)


def project(camera, points):
    """Return the picture positions of world points (column, row, as fractions) and their depths."""
    eye, forward, right, up = basis(camera)
    right, up = right / np.linalg.norm(right), up / np.linalg.norm(up)
    x, y, depth = ((points - eye) @ axis for axis in (right, up, forward))
    if camera.projection == "panorama":
        longitude, latitude = np.arctan2(x, depth), np.arcsin(y / np.sqrt(x * x + y * y + depth * depth))
        return 0.5 + longitude / (2 * np.pi), 0.5 - latitude / np.pi, depth
    distance = depth if camera.projection == "perspective" else np.linalg.norm(np.subtract(camera.target, camera.eye))
    tall = 2 * distance * np.tan(np.radians(camera.fov) / 2)
    return 0.5 + x / (tall * camera.size[0] / camera.size[1]), 0.5 - y / tall, depth


def corners(box):
    return np.stack(np.meshgrid(*box.T), axis=-1).reshape(-1, 3)


def test_the_middle_ray_goes_to_the_target():
    camera = Camera.look_at((1, 2, 3), (4, -2, 5), size=(5, 3))
    origins, directions = camera.rays()
    assert origins.shape == directions.shape == (3, 5, 3)
    assert origins.dtype == directions.dtype == np.float64
    assert (origins == [1, 2, 3]).all()
    np.testing.assert_allclose(directions[1, 2], np.array([3, -4, 2]) / np.sqrt(29))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=2), 1)


def test_rays_go_through_pixel_centres_and_row_0_is_on_top():
    _, directions = Camera.look_at((0, -1, 0), (0, 0, 0), fov=90, size=(4, 2)).rays()
    np.testing.assert_allclose(directions[0, 0] / directions[0, 0, 1], [-1.5, 1, 0.5])
    np.testing.assert_allclose(directions[1, 3] / directions[1, 3, 1], [1.5, 1, -0.5])


def test_the_fov_is_vertical():
    _, directions = Camera.look_at((0, -1, 0), (0, 0, 0), fov=40, size=(300, 2001)).rays()
    top = directions[0, 150]
    assert np.degrees(np.arctan2(top[2], np.hypot(top[0], top[1]))) == pytest.approx(20, abs=0.02)


def test_the_basis_matches_the_rays():
    camera = Camera.look_at((5, 3, 2), (0, 0, 1), up=(0.1, 0, 1), fov=55, size=(7, 4))
    _, forward, right, up = basis(camera)
    _, directions = camera.rays()
    for row, column in ((0, 0), (3, 6), (2, 1)):
        u, v = (column + 0.5) / 7 * 2 - 1, 1 - (row + 0.5) / 4 * 2
        direction = forward + u * right + v * up
        np.testing.assert_allclose(directions[row, column], direction / np.linalg.norm(direction))
    np.testing.assert_allclose([forward @ right, forward @ up, right @ up], 0, atol=1e-12)
    assert up[2] > 0


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_hits_of_a_ray_project_to_its_pixel(projection):
    camera = Camera.look_at((5, 3, 2), (-1, 0, 1), up=(0.1, 0.2, 1), fov=55, size=(70, 40), projection=projection)
    origins, directions = camera.rays()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=2), 1, rtol=1e-14)
    distance = np.random.default_rng(1).uniform(0.1, 9, (40, 70, 1))
    column, row, _ = project(camera, origins + distance * directions)
    np.testing.assert_allclose(column * 70 - 0.5, np.tile(np.arange(70), (40, 1)), atol=1e-9)
    np.testing.assert_allclose(row * 40 - 0.5, np.tile(np.arange(40), (70, 1)).T, atol=1e-9)


def test_projections_have_the_same_height_at_the_target():
    """Rays of a pixel intersect in the plane through the target; orthographic ones start in the eye's plane."""
    eye, target = np.array([1.0, -4, 2]), np.array([0.5, 1, 1])
    forward = (target - eye) / np.linalg.norm(target - eye)
    meet = []
    for projection in ("perspective", "orthographic"):
        origins, directions = Camera.look_at(eye, target, fov=33, size=(9, 8), projection=projection).rays()
        t = ((target - origins) @ forward) / (directions @ forward)
        meet.append(origins + t[..., None] * directions)
    np.testing.assert_allclose(meet[0], meet[1], atol=1e-12)
    np.testing.assert_allclose(directions, np.broadcast_to(forward, (8, 9, 3)))
    np.testing.assert_allclose((origins - eye) @ forward, 0, atol=1e-12)


def test_a_panorama_covers_all_directions():
    camera = Camera.look_at((1, 2, 3), (1, 5, 3), size=(400, 200), projection="panorama")
    origins, directions = camera.rays()
    assert (origins == [1, 2, 3]).all()
    across = directions[99:101].mean(axis=0)
    expected = {199: (0, 1, 0), 299: (1, 0, 0), 99: (-1, 0, 0), 0: (0, -1, 0), 399: (0, -1, 0)}
    for column, direction in expected.items():
        np.testing.assert_allclose(across[column], direction, atol=0.02)
    np.testing.assert_allclose(directions[0], np.tile([0, 0, 1.0], (400, 1)), atol=0.01)
    np.testing.assert_allclose(directions[-1], np.tile([0, 0, -1.0], (400, 1)), atol=0.01)


@pytest.mark.parametrize("view", [(0, 0, -1), (0, 0, 1), (0, 1e-9, -1), (1, 2, 3)])
@pytest.mark.parametrize("length", [1e-200, 1, 1e200])
def test_an_up_vector_along_the_view_is_replaced(view, length):
    camera = Camera.look_at((0, 0, 0), np.multiply(view, length), up=np.multiply(view, -3.0))
    _, forward, right, up = basis(camera)
    assert np.isfinite(basis(camera)).all()
    np.testing.assert_allclose(np.linalg.norm(up), np.tan(np.radians(20)))
    np.testing.assert_allclose([forward @ right, forward @ up], 0, atol=1e-12)


def test_y_is_on_top_of_pictures_from_above():
    _, _, right, up = basis(Camera.look_at((0, 0, 9), (0, 0, 0)))
    assert up[1] > 0
    assert right[0] > 0


@pytest.mark.parametrize("size", [(640, 480), (200, 900), (1000, 50)])
@pytest.mark.parametrize("fov", [5, 40, 120])
@pytest.mark.parametrize("direction", [THREE_QUARTER, (0, 0, 1), (0, -1, 0), (-1, 3, -2)])
def test_a_framed_box_fits_with_a_margin(size, fov, direction):
    camera = Camera.frame(BOX + 1e6, direction, fov, size)
    column, row, depth = project(camera, corners(BOX + 1e6))
    assert (depth > 0).all()
    spans = np.ptp(column), np.ptp(row)
    if fov < 90:  # otherwise a corner may come too near to the eye
        assert max(spans) == pytest.approx(1 / MARGIN, rel=1e-6)
    for ends in (column, row):
        assert ends.min() >= (1 - 1 / MARGIN) / 2 - 1e-6
        assert ends.max() <= (1 + 1 / MARGIN) / 2 + 1e-6
    towards = np.subtract(camera.eye, camera.target)
    np.testing.assert_allclose(towards / np.linalg.norm(towards), direction / np.linalg.norm(direction), atol=1e-6)


@pytest.mark.parametrize("size", [(640, 480), (200, 900), (1000, 50)])
@pytest.mark.parametrize("fov", [5, 40, 150])
@pytest.mark.parametrize("direction", [THREE_QUARTER, (0, 0, 1), (-1, 3, -2)])
def test_a_box_framed_orthographically_fills_the_picture_up_to_the_margin(size, fov, direction):
    camera = Camera.frame(BOX + 1e6, direction, fov, size, projection="orthographic")
    column, row, depth = project(camera, corners(BOX + 1e6))
    assert (depth > 0).all()
    assert max(np.ptp(column), np.ptp(row)) == pytest.approx(1 / MARGIN, rel=1e-6)
    np.testing.assert_allclose([column.mean(), row.mean()], 0.5, atol=1e-6)
    towards = np.subtract(camera.eye, camera.target)
    np.testing.assert_allclose(towards / np.linalg.norm(towards), direction / np.linalg.norm(direction), atol=1e-6)


@pytest.mark.parametrize("direction", [None, (0, -1, 5), (0, 0, -1)])
def test_a_panorama_is_level_and_in_the_middle_of_the_box(direction):
    camera = Camera.frame(BOX, direction, projection="panorama", size=(20, 10))
    _, forward, _, up = basis(camera)
    np.testing.assert_allclose(camera.eye, BOX.mean(axis=0))
    np.testing.assert_allclose(up, [0, 0, 1], atol=1e-12)
    assert -forward[:2] @ (THREE_QUARTER if direction is None else direction)[:2] >= 0


@pytest.mark.parametrize("up", [(0, 0, 2), (0, 1, 0), (0, 0, -1), (1, 0, 0), (-3, 2, 1), (1e-9, 0, -1), (0, -1e-3, -1)])
def test_the_default_view_is_from_the_front_and_above(up):
    camera = Camera.frame(BOX, up=up)
    towards, up = np.subtract(camera.eye, camera.target), np.array(up) / np.linalg.norm(up)
    towards /= np.linalg.norm(towards)
    assert towards @ up == pytest.approx(0.35 / np.linalg.norm(THREE_QUARTER), abs=1e-6)
    assert basis(camera)[3] @ up > 0


def test_the_default_view_with_y_up_is_from_plus_z():
    camera = Camera.frame(BOX, up=(0, 1, 0))
    towards = np.subtract(camera.eye, camera.target)
    np.testing.assert_allclose(
        towards / np.linalg.norm(towards), np.array([0.45, 0.35, 1.0]) / np.linalg.norm(THREE_QUARTER)
    )


def test_boxes_without_thickness_are_framed():
    for box in ([[1, 1, 1], [1, 1, 1]], [[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [1, 0, 2]]):
        for direction in (THREE_QUARTER, (1, 0, 0)):
            for projection in ("perspective", "orthographic"):
                camera = Camera.frame(box, direction, projection=projection)
                _, _, depth = project(camera, corners(np.array(box, float)))
                assert (depth > 0).all()
            assert Camera.frame(box, direction, projection="panorama").projection == "panorama"


def test_cameras_are_immutable_values():
    camera = Camera.look_at([1, 2, 3], np.zeros(3), size=np.array([10, 20]))
    assert camera == Camera((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), size=(10, 20))
    assert hash(camera) == hash(dataclasses.replace(camera))
    assert dataclasses.replace(camera, fov=20).fov == 20
    with pytest.raises(dataclasses.FrozenInstanceError):
        camera.fov = 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"eye": (0, 0, 0)}, "same point"),
        ({"eye": (0, 0)}, "eye must be three finite numbers"),
        ({"eye": (0, 0, np.inf)}, "eye must be three finite numbers, not .*inf"),
        ({"target": "abc"}, "target must be three finite numbers"),
        ({"up": (0, 0, 0)}, "up must not be zero"),
        ({"fov": 0}, "fov"),
        ({"fov": 180}, "fov"),
        ({"fov": np.nan}, "fov"),
        ({"size": (0, 5)}, "0x5"),
        ({"size": (5, 32769)}, "32768"),
        ({"size": (5.5, 5)}, "whole numbers"),
        ({"size": 5}, "size must be two"),
        ({"projection": "fisheye"}, "fisheye"),
        ({"aperture": -0.1}, "aperture"),
        ({"aperture": np.nan}, "aperture"),
        ({"aperture": np.inf}, "aperture"),
        ({"aperture": "f/8"}, "aperture"),
        ({"aperture": 0.1, "projection": "panorama"}, "aperture must be 0 for a panorama"),
        ({"focus": 0}, "focus"),
        ({"focus": -2.0}, "focus"),
        ({"focus": np.nan}, "focus"),
    ],
)
def test_invalid_cameras_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        Camera.look_at(**{"eye": (1, 1, 1), "target": (0, 0, 0), **change})


@pytest.mark.parametrize("change", [{"projection": "fisheye"}, {"up": (0, 0, 0)}, {"direction": (0, 0, 0)}, {"fov": 0}])
def test_invalid_frames_are_refused(change):
    with pytest.raises(ValueError, match="fisheye|zero|fov"):
        Camera.frame(BOX, **change)


@pytest.mark.parametrize("bounds", [BOX[::-1], BOX[:1], BOX * np.nan])
def test_invalid_boxes_are_refused(bounds):
    with pytest.raises(ValueError, match="bounds"):
        Camera.frame(bounds)
