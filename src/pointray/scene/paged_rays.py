"""Intersection of rays with parts on disk. A part is opened if a ray enters its box before the ray's closest hit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Flags
from ..surface.trace.cast import Pace, closest_hits, occlusions
from .rays import Rays
from .world import Snapshot, surface_boxes

MOST = 1 << 22  # pairs of a ray and a part, beyond which all parts are opened
MARGIN = 1e-6  # relative margin of boxes and distances against rounding


def closest_hits_paged(
    scene: Snapshot, shape: tuple[int, ...], rays: Rays, pace: Pace
) -> tuple[Snapshot, dict[str, NDArray[Any]]]:
    """Return the closest hits of rays, opening parts on disk that they may hit, and the scene with these parts open.

    shape : leading shape of the rays; rays : origins and directions, (n, 3), and limits t_min, t_max, (n, 2)
    pace : number of threads, progress callback

    Returns
    -------
    scene : Snapshot
        The scene in which the hits were found.
    found : dict of str to array
        For the n rays "t", "position", "normal", "color" and "point" as in `Hits`, "instance" (its row), and what is
        needed to blend attributes: "leaf", and "local", the position in model space.
    """
    now, parts = _begin(scene, rays)
    while True:
        found = closest_hits(now.world, shape, *rays, pace)
        if parts is None or not parts.open_next(found["t"]):
            return now, found
        now = scene.opened(parts.open)


def occlusions_paged(scene: Snapshot, shape: tuple[int, ...], rays: Rays, pace: Pace) -> Flags:
    """Return whether rays hit anything, (n,) bool, opening parts on disk that they may hit.

    shape : leading shape of the rays; rays : origins and directions, (n, 3), and limits t_min, t_max, (n, 2)
    pace : number of threads, progress callback
    """
    now, parts = _begin(scene, rays)
    while True:
        found = occlusions(now.world, shape, *rays, pace)
        if parts is None or not parts.open_next(np.where(found, -np.inf, np.inf)):
            return found
        now = scene.opened(parts.open)


class _DiskParts:
    """Parts on disk, and the distances at which rays enter their boxes, to decide which parts are opened next.

    rows : of the instances whose models are parts on disk; rays : origins and directions, (n, 3), and limits
        t_min, t_max, (n, 2)

    Attributes
    ----------
    open : (k,) int64
        Rows of the instances whose parts have been marked as open.
    """

    def __init__(self, scene: Snapshot, rows: NDArray[np.int64], rays: Rays) -> None:
        boxes = surface_boxes(scene.world.instances, scene.models, rows)
        self._rows, self._entry = rows, np.array([_entry(box, *rays) for box in boxes])
        self._is_open = np.zeros(len(rows), np.bool_)

    @property
    def open(self) -> NDArray[np.int64]:
        return self._rows[self._is_open]

    def open_next(self, t: NDArray[Any]) -> bool:
        """Mark the nearest closed part that each ray enters before its hit as open; return whether there is any.

        t : (n,), distance of each ray's hit so far; inf for a miss, -inf for rays that need no further part
        """
        until = t * (1.0 + MARGIN * np.sign(t))
        before = np.where(self._is_open[:, None] | (self._entry > until), np.inf, self._entry)
        entered = before.min(axis=0, initial=np.inf) < np.inf
        self._is_open[before[:, entered].argmin(axis=0)] = True
        return bool(entered.any())


def _begin(scene: Snapshot, rays: Rays) -> tuple[Snapshot, _DiskParts | None]:
    """Return the scene for the first pass of rays, and the parts on disk, all closed, to be opened as rays reach them.

    The second value is None if there is no part on disk, or if all are opened at once, for many rays and parts.

    rays : origins and directions, (n, 3), and limits t_min, t_max, (n, 2)
    """
    rows = scene.on_disk
    if len(rows) * len(rays[0]) > MOST:
        return scene.opened(), None
    return (scene, _DiskParts(scene, rows, rays)) if len(rows) else (scene, None)


def _entry(box: Doubles, origins: Doubles, directions: Doubles, limits: Doubles) -> Doubles:
    """Return the distances at which rays enter a box, (n,), at least t_min; inf for rays that miss it.

    box : (6,), min x y z, max x y z; origins, directions : (n, 3); limits : (n, 2), t_min and t_max
    """
    pad = MARGIN * np.abs(box).max()
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = ((side - origins) / directions for side in (box[:3] - pad, box[3:] + pad))
        # 0 / 0 is NaN, for a ray within the plane of a side: it counts as inside.
        near = np.fmin(one, other).max(axis=1, initial=-np.inf, where=~np.isnan(one + other))
        far = np.fmax(one, other).min(axis=1, initial=np.inf, where=~np.isnan(one + other))
        within = (directions != 0).any(axis=1) & np.isfinite(directions).all(axis=1)
        within &= (near <= far) & (far >= limits[:, 0]) & (near <= limits[:, 1])
    return np.where(within, np.maximum(near, limits[:, 0]), np.inf)
