"""The part of an image that models can cover: tiles outside are filled with the background without tracing."""

from __future__ import annotations

import itertools

import numpy as np

from ..base.arrays import Doubles, Flags
from ..engine.kernels.records import ACROSS, EYE, FORWARD, TOP_BOUNDS, TOP_CENTER, UPWARD
from .camera import Camera
from .film import Window

BEYOND = 4.0  # pixels: filters extend 1.5, and levels of detail extend half a pixel beyond their model

EVERYWHERE: Window = (-np.inf, -np.inf, np.inf, np.inf)


def window_of(camera: Camera, top: Doubles) -> Window:
    """Return the window (left, top, right, bottom), in pixels, outside of which no camera ray hits a model.

    Tiles outside are filled with the background. The window is unbounded for panoramas, with a lens, and if the camera
    is among the models.

    Parameters
    ----------
    top : (9,) float64
        Bounds of the models: a centre, and lo x y z, hi x y z relative to it, see `World.top`.
    """
    if _sees_all(camera):
        return EVERYWHERE
    record, (width, height) = camera.record(), camera.size
    eye, forward, across, upward = (record[k : k + 3] for k in (EYE, FORWARD, ACROSS, UPWARD))
    bounds = top[TOP_BOUNDS:].reshape(2, 3) + top[TOP_CENTER : TOP_CENTER + 3]
    corners = np.array(list(itertools.product(*bounds.T))) - eye
    depth = corners @ forward if camera.projection == "perspective" else np.ones(len(corners))
    if depth.min() <= 1e-6 * np.abs(corners).max():
        return EVERYWHERE
    x = (corners @ across / (across @ across) / depth + 1.0) * width / 2.0
    y = (1.0 - corners @ upward / (upward @ upward) / depth) * height / 2.0
    return x.min() - BEYOND, y.min() - BEYOND, x.max() + BEYOND, y.max() + BEYOND


def may_see(camera: Camera, boxes: Doubles) -> Flags:
    """Return whether camera rays may enter boxes, (n,); True for all with a panorama or a lens.

    Parameters
    ----------
    boxes : (n, 6) float64
        Minimum x y z, maximum x y z, world.
    """
    if _sees_all(camera):
        return np.ones(len(boxes), np.bool_)
    record = camera.record()
    eye, forward, across, upward = (record[k : k + 3] for k in (EYE, FORWARD, ACROSS, UPWARD))
    corners = boxes.reshape(-1, 2, 3)[:, np.array(list(itertools.product((0, 1), repeat=3))), np.arange(3)] - eye
    x, y = (corners @ axis / (axis @ axis) for axis in (across, upward))
    depth = corners @ forward if camera.projection == "perspective" else np.ones(x.shape)
    # A box is outside the view if all its corners are beyond one side of the image.
    sides = (x - depth, -x - depth, y - depth, -y - depth)
    beyond = [(side > 0).all(axis=1) for side in sides]
    if camera.projection == "perspective":
        beyond.append((depth < 0).all(axis=1))
    return np.asarray(~np.logical_or.reduce(beyond))


def _sees_all(camera: Camera) -> bool:
    """Return whether camera rays may leave the view frustum of the image: for a panorama, or with a lens."""
    return camera.projection == "panorama" or camera.aperture > 0
