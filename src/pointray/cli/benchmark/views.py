"""The views in which speed is measured: far shows the whole model, near fills the whole image."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from ...base.arrays import Doubles
from ...cloud.points import Points
from ...rendering.camera import Camera
from ...scene.scene import Scene

FROM = (0.45, -1.0, 0.2)
TALL = 0.9  # share of the image's height that the silhouette spans in the far view
FULL = 0.95  # smallest share of pixels that hit in the near view
COARSE = 128  # size in pixels of the images that determine the near view


def far_view(points: Points, bounds: Doubles, size: tuple[int, int]) -> Camera:
    """Return a camera that shows the whole model, its silhouette spanning 90% of the image's height.

    If the silhouette is too wide for that, it spans 90% of the width. bounds : (2, 3), minimum and maximum
    """
    camera = Camera.frame(bounds, FROM, size=size)
    world = points.world[:: max(1, len(points) // 100_000)]
    for _ in range(4):
        eye, target = np.asarray(camera.eye), np.asarray(camera.target)
        forward = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(forward, (0, 0, 1))
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        away = world - eye
        depth = away @ forward
        seen = np.stack([away @ right / depth, away @ up / depth], axis=1)
        low, high = seen.min(axis=0), seen.max(axis=0)
        x, y = (low + high) / 2
        half = max((high - low)[1], (high - low)[0] * size[1] / size[0]) / 2 / TALL
        target = eye + np.linalg.norm(target - eye) * (forward + x * right + y * up)
        camera = Camera.look_at(eye, target, fov=float(np.degrees(2 * np.arctan(half))), size=size)
    return camera


def near_view(scene: Scene, far: Camera, size: tuple[int, int]) -> Camera:
    """Return a camera so near to the model that 95% of the pixels hit it, aimed at the widest place of its silhouette.

    far : camera that shows the whole model; the returned one is moved from there towards the model
    """
    coarse = Camera.look_at(far.eye, far.target, fov=far.fov, size=(COARSE, COARSE))
    hits = scene.intersect(*coarse.rays())
    inside = distance_transform_edt(np.pad(np.isfinite(hits.t), 1))[1:-1, 1:-1]
    row, column = np.unravel_index(int(inside.argmax()), inside.shape)
    target, eye = hits.position[row, column], np.asarray(far.eye)
    share = min(1.0, 2.0 * float(inside.max()) / COARSE)
    while True:
        camera = Camera.look_at(target + share * (eye - target), target, fov=far.fov, size=(COARSE, COARSE))
        if np.isfinite(scene.intersect(*camera.rays()).t).mean() >= FULL or share < 1e-3:
            return Camera.look_at(camera.eye, target, fov=far.fov, size=size)
        share *= 0.9
