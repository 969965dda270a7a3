"""Films: where the camera is in each frame, on a turntable or along keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_kind, check_number, check_positive, check_whole, wrong
from ..engine.kernels.records import UPWARD
from .camera import Camera, unit

Floats = NDArray[np.float64]

MOST_FRAMES = 100_000
STEP = np.radians(45.0)  # a curve through directions farther apart than this gets some of the arc between them
SAME = 1e-9  # seconds: a frame this close to a key is the key


def turntable(camera: Camera, frames: int, turns: float = 1.0) -> list[Camera]:
    """Cameras on a circle: the target of the first one seems to turn on a table.

    Parameters
    ----------
    camera : Camera
        The camera of the first frame. The axis of the circle goes through its target, along its `up`.
    frames : int
        The last frame is one step before the first one, so that a film of whole turns loops.
    turns : float
        Counter-clockwise as seen from above; negative: the other way.

    Returns
    -------
    list of Camera

    Examples
    --------
    >>> for k, camera in enumerate(pr.turntable(pr.Camera.frame(scene.bounds), 48)):
    ...     pr.write_image(f"{k:04d}.png", pr.render(scene, camera))
    """
    check_kind(camera, "camera", Camera, "a Camera")
    frames = check_whole(frames, "frames", 1, MOST_FRAMES)
    turns = check_number(turns, "turns", "a finite number")
    target, axis = np.asarray(camera.target), unit(np.asarray(camera.up))
    arm, up = np.asarray(camera.eye) - target, np.asarray(camera.up)
    if np.linalg.norm(np.cross(unit(arm), axis)) < 1e-6:
        up = camera.record()[UPWARD : UPWARD + 3]  # straight above the axis the picture turns, and so does its top
    angles = 2 * np.pi * turns * np.arange(1, frames) / frames
    others = [(target + _turned(arm, axis, angle), _turned(up, axis, angle)) for angle in angles]
    return [camera, *(replace(camera, eye=tuple(eye), up=tuple(top)) for eye, top in others)]


def fly(keys: Sequence[tuple[float, Camera]], fps: float = 24.0) -> list[Camera]:
    """Cameras along a smooth path through keys.

    Parameters
    ----------
    keys : sequence of (float, Camera)
        At least two: the time in seconds, increasing, and the camera at that time. All have the size of the first.
    fps : float
        Frames a second. The first frame is the first key; the last is the last key or less than a frame before it.

    Returns
    -------
    list of Camera
        A frame that falls on a key has the key's camera.

    Notes
    -----
    Eye and target follow cubics through the keys (Catmull and Rom), directions follow the sphere: the view does not
    collapse where it turns by 180 degrees. Between keys with the same target the eye goes around it, between keys with
    the same eye the camera pans, between equal keys it is still; in general what moves less leads.
    Field of view and distance of the target stay between those of the two keys.
    """
    times = _times_of(keys)
    if len(times) < 2:
        raise ValueError(f"a film needs two keys or more, not {len(times)}")
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise ValueError(f"the times of keys must be finite and rise, not {times.tolist()}")
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


def _times_of(keys: Any) -> Floats:
    wanted = "pairs of a number of seconds and a Camera"
    if not isinstance(keys, Sequence) or isinstance(keys, str | bytes):
        raise wrong("keys", wanted, keys)
    for key in keys:
        if not isinstance(key, Sequence) or len(key) != 2 or not isinstance(key[1], Camera):
            raise wrong("keys", wanted, keys)
    return np.array(
        [
            check_number(time, f"keys[{k}]: its time", "a finite number, and times must rise")
            for k, (time, _) in enumerate(keys)
        ]
    )


def _between(times: Floats, cameras: Sequence[Camera], at: Floats) -> list[Camera]:
    """The cameras at given times, from the curves through the keys."""
    from scipy.interpolate import PchipInterpolator

    eyes, targets, ups = (np.array([getattr(camera, name) for camera in cameras]) for name in ("eye", "target", "up"))
    distances = np.linalg.norm(targets - eyes, axis=1)
    scalars = np.stack([np.log(distances), [camera.fov for camera in cameras]], axis=1)
    logs, fov = PchipInterpolator(times, scalars)(at).T
    view = np.exp(logs)[:, None] * _directions_between(times, targets - eyes, at)
    moves = [np.linalg.norm(np.diff(points, axis=0), axis=1) for points in (eyes, targets)]
    shares = moves[0] / np.maximum(moves[0] + moves[1], 1e-300)  # 1: the target leads, 0: the eye
    lead = np.interp(at, (times[1:] + times[:-1]) / 2, shares)[:, None]
    # At a key the two agree, so the one that leads may change there.
    eye = (1 - lead) * _curve(times, eyes, at) + lead * (_curve(times, targets, at) - view)
    target, up = eye + view, _directions_between(times, ups, at)
    return [
        replace(cameras[0], eye=tuple(eye[k]), target=tuple(target[k]), up=tuple(up[k]), fov=float(fov[k]))
        for k in range(len(at))
    ]


def _curve(times: Floats, values: Floats, at: Floats) -> Floats:
    """A cubic through (n, k) values, with the slope of the parabola through each and its neighbours; (m, k)."""
    from scipy.interpolate import CubicHermiteSpline

    slopes = np.gradient(values, times, axis=0)
    still = (np.diff(values, axis=0) == 0).all(axis=1)
    slopes[:-1][still] = slopes[1:][still] = 0.0
    return np.asarray(CubicHermiteSpline(times, values, slopes)(at))


def _directions_between(times: Floats, directions: Floats, at: Floats) -> Floats:
    """Unit vectors along a smooth path on the sphere through (n, 3) directions; (m, 3)."""
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


def _turn_between(a: Floats, b: Floats) -> tuple[Floats, float]:
    """Axis and angle of the shortest turn from one unit vector to another; opposite ones have a level axis if any."""
    axis = np.cross(a, b)
    angle = float(np.arctan2(np.linalg.norm(axis), a @ b))
    if np.linalg.norm(axis) < 1e-9:
        axis = np.array([0.0, 0.0, 1.0]) - a * a[2]
        axis = axis if np.linalg.norm(axis) > 1e-3 else np.array([1.0, 0.0, 0.0])
    return unit(axis), angle


def _turned(vectors: Floats, axis: Floats, angle: float) -> Floats:
    """Vectors, (..., 3), turned about a unit axis (Rodrigues)."""
    along = (vectors @ axis)[..., None] * axis
    return np.asarray(along + (vectors - along) * np.cos(angle) + np.cross(axis, vectors) * np.sin(angle))
