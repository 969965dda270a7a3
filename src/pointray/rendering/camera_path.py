"""Cameras of the frames of a film: on a turntable, or along keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..base.arguments import check_kind, check_number, check_positive, check_whole, wrong
from ..base.arrays import Doubles
from ..engine.kernels.records import UPWARD
from .camera import Camera, unit

MOST_FRAMES = 100_000
STEP = np.radians(45.0)  # between directions farther apart than this, points on the arc are inserted
SAME = 1e-9  # seconds: a frame this close to a key has the key's camera


def turntable(camera: Camera, frames: int, turns: float = 1.0) -> list[Camera]:
    """Return cameras on a circle around the target, as if it stood on a turntable.

    Parameters
    ----------
    camera : Camera
        Camera of the first frame. The axis of the circle is through its target, along its `up`.
    frames : int
        Number of frames, 1 to 100,000. The last frame is one step before the first, so that whole turns loop.
    turns : float
        Number of turns, counter-clockwise as seen from above; negative: clockwise.

    Returns
    -------
    list of Camera

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is invalid or out of its range.

    Examples
    --------
    >>> cameras = pr.turntable(pr.Camera.look_at((0, -5, 1), (0, 0, 1)), 4)
    >>> np.round(cameras[1].eye).astype(int).tolist()
    [5, 0, 1]
    """
    check_kind(camera, "camera", Camera, "a Camera")
    frames = check_whole(frames, "frames", 1, MOST_FRAMES)
    turns = check_number(turns, "turns", "a finite number")
    target, axis = np.asarray(camera.target), unit(np.asarray(camera.up))
    arm, up = np.asarray(camera.eye) - target, np.asarray(camera.up)
    if np.linalg.norm(np.cross(unit(arm), axis)) < 1e-6:
        up = camera.record()[UPWARD : UPWARD + 3]  # on the axis the image itself rotates
    angles = 2 * np.pi * turns * np.arange(1, frames) / frames
    others = [(target + _turned(arm, axis, angle), _turned(up, axis, angle)) for angle in angles]
    return [camera, *(replace(camera, eye=tuple(eye), up=tuple(top)) for eye, top in others)]


def fly(keys: Sequence[tuple[float, Camera]], fps: float = 24.0) -> list[Camera]:
    """Return cameras along a smooth path through keyframes.

    Parameters
    ----------
    keys : sequence of (float, Camera)
        At least two pairs of time in seconds, increasing, and camera. All frames have the size of the first camera.
    fps : float
        Frames a second. The first frame is the first key; the last is the last key or less than a frame before it.

    Returns
    -------
    list of Camera
        A frame at the time of a key has the key's camera.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If there are fewer than two keys, times do not increase, or there are more than 100,000 frames.

    Notes
    -----
    Eye and target follow cubic splines through the keys (Catmull-Rom); view directions are interpolated on the sphere,
    so that a turn of 180 degrees is well defined. Between keys with the same target the camera orbits it, between keys
    with the same eye it pans, between equal keys it is still; in general the point that moves less is interpolated
    directly. Field of view and distance of the target stay between those of the two keys.

    Examples
    --------
    >>> first, last = pr.Camera.look_at((0, -5, 1), (0, 0, 0)), pr.Camera.look_at((5, 0, 1), (0, 0, 0))
    >>> cameras = pr.fly([(0, first), (2, last)], fps=12)
    >>> len(cameras)
    25
    """
    times = _times_of(keys)
    if len(times) < 2:
        raise ValueError(f"keys: expected at least two, got {len(times)}")
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise ValueError(f"the times of keys must be finite and increase, not {times.tolist()}")
    fps = check_positive(fps, "fps")
    count = np.floor((times[-1] - times[0] + SAME) * fps) + 1
    if count > MOST_FRAMES:
        raise ValueError(f"fps: a film has {MOST_FRAMES} frames at most, not {count:.0f}")
    cameras = [camera for _, camera in keys]
    at = np.minimum(times[0] + np.arange(int(count)) / fps, times[-1])
    between = _between(times, cameras, at)
    nearest = np.abs(at[:, None] - times).argmin(axis=1)
    return [
        replace(cameras[k], size=cameras[0].size) if abs(times[k] - t) <= SAME else camera
        for t, k, camera in zip(at, nearest, between, strict=True)
    ]


def _times_of(keys: Any) -> Doubles:
    wanted = "pairs of a number of seconds and a Camera"
    if not isinstance(keys, Sequence) or isinstance(keys, str | bytes):
        raise wrong("keys", wanted, keys)
    for key in keys:
        if not isinstance(key, Sequence) or len(key) != 2 or not isinstance(key[1], Camera):
            raise wrong("keys", wanted, keys)
    return np.array(
        [
            check_number(time, f"keys[{k}]: its time", "a finite number, and times must increase")
            for k, (time, _) in enumerate(keys)
        ]
    )


def _between(times: Doubles, cameras: Sequence[Camera], at: Doubles) -> list[Camera]:
    """Return the cameras at times `at`, interpolated between keyframes.

    times : (n,), of the keyframes; cameras : n of them; at : (m,), in the same unit
    """
    from scipy.interpolate import PchipInterpolator

    eyes, targets, ups = (np.array([getattr(camera, name) for camera in cameras]) for name in ("eye", "target", "up"))
    distances = np.linalg.norm(targets - eyes, axis=1)
    scalars = np.stack([np.log(distances), [camera.fov for camera in cameras]], axis=1)
    logs, fov = PchipInterpolator(times, scalars)(at).T
    view = np.exp(logs)[:, None] * _directions_between(times, targets - eyes, at)
    moves = [np.linalg.norm(np.diff(points, axis=0), axis=1) for points in (eyes, targets)]
    shares = moves[0] / np.maximum(moves[0] + moves[1], 1e-300)  # 1: interpolate the target, 0: the eye
    lead = np.interp(at, (times[1:] + times[:-1]) / 2, shares)[:, None]
    # Both agree at keys, so the weights may change there.
    eye = (1 - lead) * _curve(times, eyes, at) + lead * (_curve(times, targets, at) - view)
    target, up = eye + view, _directions_between(times, ups, at)
    return [
        replace(cameras[0], eye=tuple(eye[k]), target=tuple(target[k]), up=tuple(up[k]), fov=float(fov[k]))
        for k in range(len(at))
    ]


def _curve(times: Doubles, values: Doubles, at: Doubles) -> Doubles:
    """Interpolate (n, k) values at n times by a smooth curve through them; return the values at m times `at`, (m, k).

    The curve is a cubic between neighbours, with the slopes of parabolas through three values each.
    """
    from scipy.interpolate import CubicHermiteSpline

    slopes = np.gradient(values, times, axis=0)
    still = (np.diff(values, axis=0) == 0).all(axis=1)
    slopes[:-1][still] = slopes[1:][still] = 0.0
    return np.asarray(CubicHermiteSpline(times, values, slopes)(at))


def _directions_between(times: Doubles, directions: Doubles, at: Doubles) -> Doubles:
    """Interpolate (n, 3) directions at n times on the sphere; return unit vectors at m times `at`, (m, 3)."""
    units = np.array([unit(direction) for direction in directions])
    passed, when = [units[0]], [times[0]]
    for k in range(len(units) - 1):
        axis, angle = _turn_between(units[k], units[k + 1])
        pieces = max(1, int(np.ceil(angle / STEP)))
        for share in np.arange(1, pieces) / pieces:
            passed.append(_turned(units[k], axis, share * angle))
            when.append(times[k] + share * (times[k + 1] - times[k]))
        passed.append(units[k + 1])
        when.append(times[k + 1])
    directions_at = _curve(np.array(when), np.array(passed), at)
    return np.asarray(directions_at / np.linalg.norm(directions_at, axis=1, keepdims=True))


def _turn_between(a: Doubles, b: Doubles) -> tuple[Doubles, float]:
    """Return axis and angle (radians) of the rotation from unit vector a to b.

    For opposite vectors the axis is horizontal, if possible.
    """
    axis = np.cross(a, b)
    angle = float(np.arctan2(np.linalg.norm(axis), a @ b))
    if np.linalg.norm(axis) < 1e-9:
        axis = np.array([0.0, 0.0, 1.0]) - a * a[2]
        axis = axis if np.linalg.norm(axis) > 1e-3 else np.array([1.0, 0.0, 0.0])
    return unit(axis), angle


def _turned(vectors: Doubles, axis: Doubles, angle: float) -> Doubles:
    """Rotate vectors, (..., 3), about a unit axis by an angle in radians (Rodrigues)."""
    along = (vectors @ axis)[..., None] * axis
    return np.asarray(along + (vectors - along) * np.cos(angle) + np.cross(axis, vectors) * np.sin(angle))
