"""Rays cast at what was accepted: every result must be a hit with finite numbers, or a miss."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from attack import WrongError
from attack.mutate import Rng


def rays_at(rng: Rng, bounds: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """64 rays from around a box to points in it, as a tile: (8, 8, 3) origins and directions."""
    low, high = bounds
    size = float(np.linalg.norm(high - low)) or 1.0
    around = rng.normal(size=3)
    origins = (low + high) / 2 + size * (1.5 * around / np.linalg.norm(around) + 0.3 * rng.random((8, 8, 3)))
    return origins, low + rng.random((8, 8, 3)) * (high - low) - origins


def check_hits(hits: pr.Hits, rows: int, exact: bool = True) -> None:
    """WrongError if a result is neither a hit nor a miss.

    rows : number of the caller's points; exact : whether normals must have length 1, and hits name points
    """
    t, hit = hits.t, np.isfinite(hits.t)
    if np.isnan(t).any() or (t < 0).any():
        raise WrongError(f"t is {t[np.isnan(t) | (t < 0)][0]}")
    for name in ("position", "normal", "color"):
        if not np.isfinite(getattr(hits, name)[hit]).all():
            raise WrongError(f"a hit's {name} is not finite")
    if (hits.point >= rows).any() or (hits.point[hit] < (0 if exact else -1)).any():
        raise WrongError(f"a hit's point is none of {rows}: {hits.point[hit].min()} to {hits.point.max()}")
    if exact and hit.any() and not np.allclose(np.linalg.norm(hits.normal[hit], axis=-1), 1.0, atol=1e-3):
        raise WrongError("a hit's normal is not of length 1")
    if (hits.point[~hit] != -1).any() or (hits.instance[~hit] != -1).any() or (hits.normal[~hit] != 0).any():
        raise WrongError("a miss has a point, an instance or a normal")


def cast(rng: Rng, model: pr.Model, exact: bool = True) -> None:
    """Cast a tile of rays at a model, and some of them alone; the nearest hit and any hit."""
    scene = pr.Scene()
    scene.add(model)
    origins, directions = rays_at(rng, model.bounds)
    check_hits(scene.intersect(origins, directions), len(model.points), exact)
    scene.occluded(origins, directions)
    for k in range(2):
        check_hits(scene.intersect(origins[k, k], directions[k, k]), len(model.points), exact)
        scene.occluded(origins[k, k + 3], directions[k, k + 3])
