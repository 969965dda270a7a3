"""Rays of a pinhole camera, as Open3D creates them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..base.arguments import check_number, check_whole
from ..base.arrays import Doubles, Floats
from .tensors import as_matrix

MOST_PIXELS = 1 << 28


def rays_of_matrices(intrinsic: Doubles, extrinsic: Doubles, width: int, height: int) -> Floats:
    """Return the rays of a camera, (height, width, 6) float32: origins and directions.

    intrinsic : (3, 3), upper triangular, in pixels, with pixel centres at half integers
    extrinsic : (4, 4), from world to camera space: x to the right, y down, z forward
    """
    if not abs(np.linalg.det(intrinsic)) > 0:
        raise ValueError("intrinsic_matrix is singular: its focal lengths must not be zero")
    if not abs(np.linalg.det(extrinsic[:3, :3])) > 0:
        raise ValueError("extrinsic_matrix is singular: expected a rotation and a translation")
    to_world = extrinsic[:3, :3].T
    pixels = np.ones((height, width, 3))
    pixels[..., 0], pixels[..., 1] = np.arange(width) + 0.5, (np.arange(height) + 0.5)[:, None]
    rays = np.empty((height, width, 6), np.float32)
    rays[..., :3] = -to_world @ extrinsic[:3, 3]
    rays[..., 3:] = pixels @ (to_world @ np.linalg.inv(intrinsic)).T
    return rays


def matrices_of_view(
    fov_deg: float, center: Doubles, eye: Doubles, up: Doubles, size: tuple[int, int]
) -> tuple[Doubles, Doubles]:
    """Return the matrices of a camera, (3, 3) and (4, 4), for `rays_of_matrices`.

    As in Open3D, the y axis of the camera is `up`, and the first row of the image shows what is below.

    fov_deg : horizontal field of view, degrees; center, eye, up : (3,); size : width and height in pixels
    """
    width, height = size
    focal = 0.5 * width / math.tan(0.5 * math.radians(fov_deg))
    intrinsic = np.array([[focal, 0, 0.5 * width], [0, focal, 0.5 * height], [0, 0, 1]])
    forward = center - eye
    right = np.cross(up, forward)
    if not np.linalg.norm(right) > 1e-12 * np.linalg.norm(up) * np.linalg.norm(forward):
        raise ValueError("up must not be parallel to the view, and eye must not be equal to center")
    rows = np.stack([right, np.cross(forward, right), forward])
    extrinsic = np.eye(4)
    extrinsic[:3, :3] = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    extrinsic[:3, 3] = -extrinsic[:3, :3] @ eye
    return intrinsic, extrinsic


def create_rays(intrinsic_matrix: Any, extrinsic_matrix: Any, width_px: int, height_px: int) -> Floats:
    """Return the rays of a camera given by matrices, see `RaycastingScene.create_rays_pinhole`."""
    size = _check_size(width_px, height_px)
    intrinsic = as_matrix(intrinsic_matrix, "intrinsic_matrix", (3, 3))
    return rays_of_matrices(intrinsic, as_matrix(extrinsic_matrix, "extrinsic_matrix", (4, 4)), *size)


def create_rays_of_view(fov_deg: float, center: Any, eye: Any, up: Any, width_px: int, height_px: int) -> Floats:
    """Return the rays of a camera given by its position and view, see `RaycastingScene.create_rays_pinhole`."""
    size = _check_size(width_px, height_px)
    fov = check_number(fov_deg, "fov_deg", "degrees between 0 and 180", lambda x: 0 < x < 180)
    places = [as_matrix(value, name, (3,)) for value, name in ((center, "center"), (eye, "eye"), (up, "up"))]
    return rays_of_matrices(*matrices_of_view(fov, places[0], places[1], places[2], size), *size)


def _check_size(width: Any, height: Any) -> tuple[int, int]:
    size = check_whole(width, "width_px", 1), check_whole(height, "height_px", 1)
    if size[0] * size[1] > MOST_PIXELS:
        raise ValueError(f"width_px and height_px: {size[0]} x {size[1]} are more than {MOST_PIXELS:,} pixels")
    return size
