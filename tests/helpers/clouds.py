"""Random points of a sphere."""

from __future__ import annotations

import numpy as np


def sphere_points(n: int, seed: int = 0) -> np.ndarray:
    """Random points of the unit sphere, (n, 3) float32."""
    rows = np.random.default_rng(seed).normal(size=(n, 3))
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def uneven_points(n: int) -> np.ndarray:
    """Random points of the unit sphere, half of them in a cap of a ten thousandth of its area, (n, 3)."""
    points, dice = sphere_points(n, 1).astype(np.float64), np.random.default_rng(2)
    z, angle = 1 - 2e-4 * dice.random(n // 2), dice.random(n // 2) * 2 * np.pi
    across = np.sqrt(1 - z * z)
    points[: n // 2] = np.column_stack([across * np.cos(angle), across * np.sin(angle), z])
    return points
