import dataclasses

import numpy as np
import pytest

from pointray.camera import MARGIN, THREE_QUARTER, Camera

BOX = np.array([[-1, -2, 0], [3, 1, 5]], float)


def project(camera, points):
    """Pixel coordinates (column, row, as fractions of the picture) and depth of world points."""
    eye, forward, right, up = camera.basis
    offset = points - eye
    depth = offset @ forward
    u = offset @ right / (right @ right) / depth
    v = offset @ up / (up @ up) / depth
    return (u + 1) / 2, (1 - v) / 2, depth


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


def test_pixel_centres_row_0_on_top_and_the_right_to_the_right():
    _, directions = Camera.look_at((0, -1, 0), (0, 0, 0), fov=90, size=(4, 2)).rays()
    np.testing.assert_allclose(directions[0, 0] / directions[0, 0, 1], [-1.5, 1, 0.5])
    np.testing.assert_allclose(directions[1, 3] / directions[1, 3, 1], [1.5, 1, -0.5])


def test_the_fov_is_vertical():
    _, directions = Camera.look_at((0, -1, 0), (0, 0, 0), fov=40, size=(300, 2001)).rays()
    top = directions[0, 150]
    assert np.degrees(np.arctan2(top[2], np.hypot(top[0], top[1]))) == pytest.approx(20, abs=0.02)


def test_the_basis_is_that_of_the_rays():
    camera = Camera.look_at((5, 3, 2), (0, 0, 1), up=(0.1, 0, 1), fov=55, size=(7, 4))
    _, forward, right, up = camera.basis
    _, directions = camera.rays()
    for row, column in ((0, 0), (3, 6), (2, 1)):
        u, v = (column + 0.5) / 7 * 2 - 1, 1 - (row + 0.5) / 4 * 2
        direction = forward + u * right + v * up
        np.testing.assert_allclose(directions[row, column], direction / np.linalg.norm(direction))
    np.testing.assert_allclose([forward @ right, forward @ up, right @ up], 0, atol=1e-12)
    assert up[2] > 0


@pytest.mark.parametrize("view", [(0, 0, -1), (0, 0, 1), (0, 1e-9, -1), (1, 2, 3)])
@pytest.mark.parametrize("length", [1e-200, 1, 1e200])
def test_an_up_along_the_view_is_replaced(view, length):
    camera = Camera.look_at((0, 0, 0), np.multiply(view, length), up=np.multiply(view, -3.0))
    _, forward, right, up = camera.basis
    assert np.isfinite(camera.basis).all()
    np.testing.assert_allclose(np.linalg.norm(up), np.tan(np.radians(20)))
    np.testing.assert_allclose([forward @ right, forward @ up], 0, atol=1e-12)


def test_from_above_the_top_of_the_picture_is_y():
    _, _, right, up = Camera.look_at((0, 0, 9), (0, 0, 0)).basis
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
    if fov < 90:  # else a corner may come too near to the eye
        assert max(spans) == pytest.approx(1 / MARGIN, rel=1e-6)
    for ends in (column, row):
        assert ends.min() >= (1 - 1 / MARGIN) / 2 - 1e-6
        assert ends.max() <= (1 + 1 / MARGIN) / 2 + 1e-6
    towards = np.subtract(camera.eye, camera.target)
    np.testing.assert_allclose(towards / np.linalg.norm(towards), direction / np.linalg.norm(direction), atol=1e-6)


@pytest.mark.parametrize("up", [(0, 0, 2), (0, 1, 0), (0, 0, -1), (1, 0, 0), (-3, 2, 1), (1e-9, 0, -1), (0, -1e-3, -1)])
def test_the_default_view_is_from_the_front_and_above_whichever_way_is_up(up):
    camera = Camera.frame(BOX, up=up)
    towards, up = np.subtract(camera.eye, camera.target), np.array(up) / np.linalg.norm(up)
    towards /= np.linalg.norm(towards)
    assert towards @ up == pytest.approx(0.35 / np.linalg.norm(THREE_QUARTER), abs=1e-6)
    assert camera.basis[3] @ up > 0


def test_where_y_is_up_the_default_view_is_from_plus_z():
    camera = Camera.frame(BOX, up=(0, 1, 0))
    towards = np.subtract(camera.eye, camera.target)
    np.testing.assert_allclose(
        towards / np.linalg.norm(towards), np.array([0.45, 0.35, 1.0]) / np.linalg.norm(THREE_QUARTER)
    )


def test_boxes_without_thickness_are_framed():
    for box in ([[1, 1, 1], [1, 1, 1]], [[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [1, 0, 2]]):
        for direction in (THREE_QUARTER, (1, 0, 0)):
            camera = Camera.frame(box, direction)
            _, _, depth = project(camera, corners(np.array(box, float)))
            assert (depth > 0).all()


def test_cameras_are_values():
    camera = Camera.look_at([1, 2, 3], np.zeros(3), size=np.array([10, 20]))
    assert camera == Camera((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), size=(10, 20))
    assert hash(camera) == hash(dataclasses.replace(camera))
    assert dataclasses.replace(camera, fov=20).fov == 20
    with pytest.raises(dataclasses.FrozenInstanceError):
        camera.fov = 3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"eye": (0, 0, 0)}, "same point"),
        ({"eye": (0, 0)}, "eye must be three numbers"),
        ({"eye": (0, 0, np.inf)}, "eye must be finite"),
        ({"target": "abc"}, "target must be three numbers"),
        ({"up": (0, 0, 0)}, "up must not be zero"),
        ({"fov": 0}, "fov"),
        ({"fov": 180}, "fov"),
        ({"fov": np.nan}, "fov"),
        ({"size": (0, 5)}, "0x5"),
        ({"size": (5, 32769)}, "32768"),
        ({"size": (5.5, 5)}, "whole numbers"),
        ({"size": 5}, "size must be two"),
        ({"projection": "fisheye"}, "fisheye"),
    ],
)
def test_what_is_no_camera(change, words):
    with pytest.raises(ValueError, match=words):
        Camera.look_at(**{"eye": (1, 1, 1), "target": (0, 0, 0), **change})


@pytest.mark.parametrize("bounds", [BOX[::-1], BOX[:1], BOX * np.nan])
def test_what_is_no_box(bounds):
    with pytest.raises(ValueError, match="bounds"):
        Camera.frame(bounds)
