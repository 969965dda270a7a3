"""Camera paths of films: turntables and keyframes."""

import numpy as np
import pytest

import pointray as pr


def views(cameras):
    away = np.array([np.subtract(camera.target, camera.eye) for camera in cameras])
    return away / np.linalg.norm(away, axis=1, keepdims=True)


def degrees_between(a, b):
    return np.degrees(np.arccos(np.clip((a * b).sum(axis=-1), -1, 1)))


# ------------------------------------------------------------------------------------------------ the turntable


def test_a_turntable_goes_counter_clockwise():
    first = pr.Camera.look_at((3, -4, 2), (1, 1, 0), fov=33, size=(8, 6))
    cameras = pr.turntable(first, 8)
    assert len(cameras) == 8 and cameras[0] == first
    arms = np.array([np.subtract(camera.eye, camera.target) for camera in cameras])
    np.testing.assert_allclose(arms[2], [5, 2, 2], atol=1e-12)  # a quarter: (2, -5) becomes (5, 2)
    np.testing.assert_allclose(arms[4], [-2, 5, 2], atol=1e-12)
    assert {(camera.target, camera.fov, camera.size) for camera in cameras} == {(first.target, 33.0, (8, 6))}


def test_turns_may_be_negative_or_fractional():
    first = pr.Camera.look_at((0, -1, 0), (0, 0, 0))
    np.testing.assert_allclose(pr.turntable(first, 4, turns=-1)[1].eye, [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(pr.turntable(first, 2, turns=0.5)[1].eye, [1, 0, 0], atol=1e-12)


def test_a_turntable_seen_from_above_rotates_the_picture():
    tops = np.array([camera.record()[9:12] for camera in pr.turntable(pr.Camera.look_at((0, 0, 5), (0, 0, 0)), 4)])
    tops /= np.linalg.norm(tops, axis=1, keepdims=True)
    np.testing.assert_allclose(tops[0] + tops[2], 0, atol=1e-12)
    np.testing.assert_allclose((tops[:-1] * tops[1:]).sum(axis=1), 0, atol=1e-12)


@pytest.mark.parametrize(("frames", "turns"), [(0, 1), (2.0, 1), (10**9, 1), (3, np.nan)])
def test_invalid_turntables_are_refused(frames, turns):
    with pytest.raises(ValueError, match="frames|turns"):
        pr.turntable(pr.Camera.look_at((0, -1, 0), (0, 0, 0)), frames, turns)


# ------------------------------------------------------------------------------------------------------ keys

KEYS = [
    (1.0, pr.Camera.look_at((0, -5, 1), (0, 0, 1), fov=40, size=(8, 6))),
    (2.0, pr.Camera.look_at((4, -3, 2), (0, 0, 1), fov=50)),
    (2.5, pr.Camera.look_at((5, 0, 1), (0, 1, 2), up=(0, 1, 3), fov=20)),
    (4.0, pr.Camera.look_at((0, 6, 0), (0, 0, 0), fov=20)),
]


def test_a_path_goes_through_its_keys():
    cameras = pr.fly(KEYS, 24)
    assert len(cameras) == 73 and {camera.size for camera in cameras} == {(8, 6)}
    for time, key in KEYS:
        found = cameras[round((time - 1) * 24)]
        assert (found.eye, found.target, found.up, found.fov) == (key.eye, key.target, key.up, key.fov)


def test_the_path_is_continuous_at_keys():
    """The curve passes through the keys, so frames at keys do not jump."""
    steps = np.diff([camera.eye for camera in pr.fly(KEYS, 200)], axis=0)
    speeds = np.linalg.norm(steps, axis=1)
    assert np.abs(np.diff(speeds)).max() < 0.02 * speeds.max()
    turns = degrees_between(*(views(pr.fly(KEYS, 200))[k:][:599] for k in (0, 1)))
    assert np.abs(np.diff(turns)).max() < 0.05 * turns.max()
    fovs = [camera.fov for camera in pr.fly(KEYS, 200)]
    assert min(fovs) == 20 and max(fovs) == 50


def test_a_view_that_turns_round_does_not_collapse():
    """The target moves to the eye's other side: half a turn, level, at an even rate, never through the eye."""
    keys = [(0, pr.Camera.look_at((0, 0, 0), (0, 2, 0))), (1, pr.Camera.look_at((0, 0, 0), (0, -4, 0)))]
    cameras = pr.fly(keys, 36)
    assert all(camera.eye == (0, 0, 0) for camera in cameras)
    np.testing.assert_allclose([camera.target[2] for camera in cameras], 0, atol=1e-9)
    distances = [np.linalg.norm(camera.target) for camera in cameras]
    assert min(distances) == 2 and max(distances) == 4
    np.testing.assert_allclose(degrees_between(views(cameras)[1:], views(cameras)[:-1]), 5, atol=0.5)


@pytest.mark.parametrize("other", [(4, 0, 0), (0, 4, 0)])  # a quarter and half a turn
def test_the_eye_orbits_a_common_target_of_two_keys(other):
    keys = [(0, pr.Camera.look_at((0, -4, 0), (0, 0, 0))), (1, pr.Camera.look_at(other, (0, 0, 0)))]
    cameras = pr.fly(keys, 36)
    np.testing.assert_allclose([camera.target for camera in cameras], 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm([camera.eye for camera in cameras], axis=1), 4)
    np.testing.assert_allclose([camera.eye[2] for camera in cameras], 0, atol=1e-9)


def test_the_camera_is_still_between_equal_keys():
    still = pr.Camera.look_at((4, -3, 2), (0, 0, 1))
    keys = [(0, KEYS[0][1]), (1, still), (2, still), (3, KEYS[3][1])]
    cameras = pr.fly(keys, 20)[20:41]
    np.testing.assert_allclose([camera.eye for camera in cameras], [still.eye] * 21, atol=1e-12)
    np.testing.assert_allclose([camera.target for camera in cameras], [still.target] * 21, atol=1e-12)


def test_a_last_key_between_two_frames():
    assert len(pr.fly([(0, KEYS[0][1]), (0.99, KEYS[1][1])], 10)) == 10


@pytest.mark.parametrize(
    ("times", "fps", "message"),
    [
        ([0], 24, "at least two"),
        ([0, 0], 24, "increase"),
        ([0, np.nan], 24, "increase"),
        ([0, 1], 0, "fps"),
        ([0, 1e9], 24, "100000 frames"),
    ],
)
def test_invalid_keys_are_refused(times, fps, message):
    with pytest.raises(ValueError, match=message):
        pr.fly([(time, KEYS[0][1]) for time in times], fps)
