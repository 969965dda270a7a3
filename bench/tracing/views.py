"""Secondary rays of the benchmark's views, the same for every peer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import pointray as pr

Floats = NDArray[np.float64]


def shadow_rays(hits: pr.Hits, bounds: Floats, radius: float) -> tuple[Floats, Floats]:
    """Rays of length 1 from half a radius in front of the hits to a point light above the model."""
    low, high = bounds
    light = (low + high) / 2 + np.linalg.norm(high - low) * np.array([0.6, -0.8, 1.0])
    origins = _in_front(hits, radius)
    return origins, light - origins


def bounce_rays(hits: pr.Hits, radius: float, seed: int = 3) -> tuple[Floats, Floats]:
    """One cosine-distributed ray from half a radius in front of each hit."""
    normals = hits.normal[np.isfinite(hits.t)].astype(np.float64)
    rng = np.random.default_rng(seed)
    ball = rng.normal(size=normals.shape)
    directions = normals + ball / np.linalg.norm(ball, axis=1, keepdims=True)
    return _in_front(hits, radius), directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _in_front(hits: pr.Hits, radius: float) -> Floats:
    hit = np.isfinite(hits.t)
    return hits.position[hit] + 0.5 * radius * hits.normal[hit]
