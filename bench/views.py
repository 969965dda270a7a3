"""The views that speed is measured in, and the rays that follow from them. The same for every peer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

import pointray as pr

FROM = (0.45, -1.0, 0.2)
TALL = 0.9  # share of the picture's height that the silhouette spans, from far
FULL = 0.95  # share of the pixels that hit, from near, at least
COARSE = 128  # pixels of the pictures that views are chosen by

Floats = NDArray[np.float64]


def far_view(points: pr.Points, bounds: Floats, size: tuple[int, int]) -> pr.Camera:
    """The whole model: its silhouette spans TALL of the height, or of the width if it is wider than tall."""
    camera = pr.Camera.frame(bounds, FROM, size=size)
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
        camera = pr.Camera.look_at(eye, target, fov=float(np.degrees(2 * np.arctan(half))), size=size)
    return camera


def near_view(scene: pr.Scene, far: pr.Camera, size: tuple[int, int]) -> pr.Camera:
    """Closer to where the silhouette is widest, until FULL of the pixels hit."""
    coarse = pr.Camera.look_at(far.eye, far.target, fov=far.fov, size=(COARSE, COARSE))
    hits = scene.intersect(*coarse.rays())
    inside = distance_transform_edt(np.pad(np.isfinite(hits.t), 1))[1:-1, 1:-1]
    row, column = np.unravel_index(int(inside.argmax()), inside.shape)
    target, eye = hits.position[row, column], np.asarray(far.eye)
    share = min(1.0, 2.0 * float(inside.max()) / COARSE)
    while True:
        camera = pr.Camera.look_at(target + share * (eye - target), target, fov=far.fov, size=(COARSE, COARSE))
        if np.isfinite(scene.intersect(*camera.rays()).t).mean() >= FULL or share < 1e-3:
            return pr.Camera.look_at(camera.eye, target, fov=far.fov, size=size)
        share *= 0.9


def shadow_rays(hits: pr.Hits, bounds: Floats, radius: float) -> tuple[Floats, Floats]:
    """Rays of length 1 from half a radius in front of the hits to a point light above the model."""
    low, high = bounds
    light = (low + high) / 2 + np.linalg.norm(high - low) * np.array([0.6, -0.8, 1.0])
    origins = _in_front(hits, radius)
    return origins, light - origins


def bounce_rays(hits: pr.Hits, radius: float, seed: int = 3) -> tuple[Floats, Floats]:
    """One ray from half a radius in front of each hit, distributed by the cosine."""
    normals = hits.normal[np.isfinite(hits.t)].astype(np.float64)
    rng = np.random.default_rng(seed)
    ball = rng.normal(size=normals.shape)
    ways = normals + ball / np.linalg.norm(ball, axis=1, keepdims=True)
    return _in_front(hits, radius), ways / np.linalg.norm(ways, axis=1, keepdims=True)


def _in_front(hits: pr.Hits, radius: float) -> Floats:
    hit = np.isfinite(hits.t)
    return hits.position[hit] + 0.5 * radius * hits.normal[hit]
