"""Rays at parts that lie on disk: those are opened that a ray enters before it hits anything."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..surface.trace.cast import Pace, closest_hits, occlusions
from .rays import Rays
from .world import Snapshot, reach_boxes

MOST = 1 << 22  # pairs of a ray and a part; of more all parts are opened
MARGIN = 1e-6  # share of coordinates, and of distances: rounding leaves no part out


def closest_reached(
    scene: Snapshot, shape: tuple[int, ...], rays: Rays, pace: Pace
) -> tuple[Snapshot, dict[str, NDArray[Any]]]:
    """The closest hits of rays, see `closest_hits`, and the scene with what was opened for them."""
    now, waiting = _begin(scene, rays)
    while True:
        found = closest_hits(now.world, shape, *rays, pace)
        if waiting is None or not waiting.take(found["t"]):
            return now, found
        now = scene.opened(waiting.open)


def occluded_reached(scene: Snapshot, shape: tuple[int, ...], rays: Rays, pace: Pace) -> NDArray[np.bool_]:
    """Whether rays meet anything, see `occlusions`."""
    now, waiting = _begin(scene, rays)
    while True:
        found = occlusions(now.world, shape, *rays, pace)
        if waiting is None or not waiting.take(np.where(found, -np.inf, np.inf)):
            return found
        now = scene.opened(waiting.open)


class _Waiting:
    """Parts, and where rays enter them.

    Attributes
    ----------
    open : (k,) int64
        The rows of the instances of those that are open.
    """

    def __init__(self, scene: Snapshot, rows: NDArray[np.int64], rays: Rays) -> None:
        boxes = reach_boxes(scene.world.instances, scene.models, rows)
        self._rows, self._entry = rows, np.array([_entry(box, *rays) for box in boxes])
        self._is_open = np.zeros(len(rows), np.bool_)

    @property
    def open(self) -> NDArray[np.int64]:
        return self._rows[self._is_open]

    def take(self, t: NDArray[Any]) -> bool:
        """Open the nearest part that each ray enters before it hits something at t; False if there is none."""
        until = t * (1.0 + MARGIN * np.sign(t))
        before = np.where(self._is_open[:, None] | (self._entry > until), np.inf, self._entry)
        entered = before.min(axis=0, initial=np.inf) < np.inf
        self._is_open[before[:, entered].argmin(axis=0)] = True
        return bool(entered.any())


def _begin(scene: Snapshot, rays: Rays) -> tuple[Snapshot, _Waiting | None]:
    """The scene for the first rays, and the parts that wait; None: none does."""
    rows = scene.on_disk
    if len(rows) * len(rays[0]) > MOST:
        return scene.opened(), None
    return (scene, _Waiting(scene, rows, rays)) if len(rows) else (scene, None)


def _entry(
    box: NDArray[np.float64], origins: NDArray[np.float64], directions: NDArray[np.float64], limits: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Where rays enter a box, (n,), at t_min or later; inf where they do not."""
    pad = MARGIN * np.abs(box).max()
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = ((side - origins) / directions for side in (box[:3] - pad, box[3:] + pad))
        # Along a side the quotient is 0 / 0, NaN, which is in the box.
        near = np.fmin(one, other).max(axis=1, initial=-np.inf, where=~np.isnan(one + other))
        far = np.fmax(one, other).min(axis=1, initial=np.inf, where=~np.isnan(one + other))
        within = (directions != 0).any(axis=1) & np.isfinite(directions).all(axis=1)
        within &= (near <= far) & (far >= limits[:, 0]) & (near <= limits[:, 1])
    return np.where(within, np.maximum(near, limits[:, 0]), np.inf)
