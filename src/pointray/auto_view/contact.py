"""Contact shadow of a standing object on an invisible ground plane, composited behind the image.

Rays from a grid of points on the ground find how much of the sky and of a wide key light the object blocks. The grid is
smoothed and sampled where camera rays meet the ground, so it needs no extra samples per pixel, and all frames of an
animation or of the viewer share one grid.

A shadow catcher in the scene (`Plane(shadow_catcher=True)`) would cost shadow rays for every sample of every pixel,
and would hide the object from below.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arrays import Doubles, Floats
from ..engine.kernels.records import ACROSS, EYE, FORWARD, ORTHOGRAPHIC, PANORAMA, PROJECTION, UPWARD
from ..rendering.camera import Camera
from ..scene.scene import Scene
from .direction import axes_of
from .shadow_under_image import put_under

CELLS = 72  # grid cells per side
SKY_RAYS, KEY_RAYS = 16, 8  # per cell
KEY_SHARE = 0.35  # of the light, the rest comes from the sky; less than in the studio, for a softer shadow
KEY_CONE = 14.0  # degrees: half angle of the key light
MARGIN = 0.8  # of the grid around the object's bounding box, as a share of its longest side
LENGTH = 1.25  # of rays, as a share of the same: enough to cross the object from below its base
STRENGTH = 0.8  # largest alpha of the shadow
FADE = 0.6  # share of the grid's half width at which the shadow begins to fade out
LEVEL = 0.001  # share of the points that may lie below the ground
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


class ContactShadow(NamedTuple):
    """Soft shadow under a standing object, on an invisible ground plane: a grid of blocked light.

    Attributes
    ----------
    middle : (3,) float64
        Centre of the grid, world.
    axes : (3, 3) float64
        Unit rows: two along the ground, and up.
    half : float
        Half the width of the grid.
    shadow : (CELLS, CELLS) float32
        Alpha of the shadow at the cell centres: 0.8 times the share of light blocked, smoothed and faded out towards
        the edge. The first index runs along the first axis.
    """

    middle: Doubles
    axes: Doubles
    half: float
    shadow: Floats

    def put_under(self, image: Floats, camera: Camera) -> Floats:
        """Return an image composited over the shadow, (h, w, 4) float32. The shadow is black with an alpha.

        A panorama, and the image of a camera below the ground, is returned unchanged.

        image : (h, w, 4) float32, premultiplied RGB and alpha; camera : the one that rendered it
        """
        record = camera.record()
        axes = [record[k : k + 3] for k in (FORWARD, ACROSS, UPWARD)]
        view = np.stack([record[EYE : EYE + 3] - self.middle, *axes]) @ self.axes.T
        if record[PROJECTION] == PANORAMA or view[0, 2] <= 0.0:
            return image
        image = np.require(image, np.float32, ("C", "W"))  # kernels take no read-only arrays, as those from workers are
        out = np.empty_like(image)
        put_under(image, view, bool(record[PROJECTION] == ORTHOGRAPHIC), self.shadow, self.half, out)
        return out


def contact_shadow(scene: Scene, positions: Doubles, up: ArrayLike, key: ArrayLike | None = None) -> ContactShadow:
    """Trace the contact shadow of a scene's models: the soft shadow under a standing object.

    Parameters
    ----------
    positions : (n, 3) float64
        Points of the standing object, world.
    up : (3,) array_like
    key : (3,) array_like, optional
        Direction in which the key (main) light travels, world. None: only light of the sky is blocked.
    """
    axes = axes_of(up)
    local = positions @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    low[2] = np.quantile(local[:, 2], LEVEL)
    size = float((high - low).max())
    half = float((high - low)[:2].max()) / 2 + MARGIN * size
    middle = np.append((low + high)[:2] / 2, low[2]) @ axes
    towards = None if key is None else axes @ -np.asarray(key, np.float64)
    directions, weights = _directions(towards)
    side = ((np.arange(CELLS) + 0.5) / CELLS * 2 - 1) * half
    ground = np.stack([*np.meshgrid(side, side, indexing="ij"), np.zeros((CELLS, CELLS))], axis=-1)
    origins = np.broadcast_to((middle + ground @ axes)[:, :, None], directions.shape)
    # `intersect` rather than `occluded`: its kernel is compiled already, and most rays miss.
    blocked = np.isfinite(scene.intersect(origins, directions @ axes, 0.0, LENGTH * size).t)
    return ContactShadow(middle, axes, half, _smooth_and_fade((blocked * weights).sum(axis=-1), ground / half))


def _directions(key: Doubles | None) -> tuple[Doubles, Doubles]:
    """Return directions of shadow rays for each grid cell, (CELLS, CELLS, k, 3), and their weights, (k,), with sum 1.

    The directions are in the axes of the grid (two along the ground, and up). All cells share one pattern under
    different rotations, which smoothing averages. Sky directions are cosine-distributed.

    key : (3,), direction towards the key (main) light; None or below the ground: only sky directions
    """
    k = np.arange(CELLS)
    turn = (k[:, None] * GOLDEN + k[None, :] * GOLDEN**2)[..., None] % 1.0
    sky = _disc(SKY_RAYS, turn)
    out = np.concatenate([sky, np.sqrt(1 - (sky**2).sum(axis=-1, keepdims=True))], axis=-1)
    if key is None or key[2] <= 0:
        return out, np.full(SKY_RAYS, 1 / SKY_RAYS)
    key = key / np.linalg.norm(key)
    across = np.cross(key, [1.0, 0.0, 0.0] if abs(key[0]) < 0.9 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    around = _disc(KEY_RAYS, turn) * np.tan(np.radians(KEY_CONE))
    lamp = key + around[..., :1] * across + around[..., 1:] * np.cross(key, across)
    lamp /= np.linalg.norm(lamp, axis=-1, keepdims=True)
    shares = [np.full(SKY_RAYS, (1 - KEY_SHARE) / SKY_RAYS), np.full(KEY_RAYS, KEY_SHARE / KEY_RAYS)]
    return np.concatenate([out, lamp], axis=2), np.concatenate(shares)


def _disc(count: int, turn: Doubles) -> Doubles:
    """Return points of the unit disc in a sunflower pattern, (..., count, 2).

    turn : (..., 1), rotation of the pattern in full turns
    """
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), 2 * np.pi * (k * GOLDEN + turn)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def _smooth_and_fade(shadow: Doubles, place: Doubles) -> Floats:
    """Return the alpha of a shadow: 0.8 times the blocked light, smoothed and faded out towards the edge of the grid.

    shadow : (CELLS, CELLS), share of light blocked at each cell
    place : (CELLS, CELLS, 3), position of each cell relative to the centre, in half widths of the grid
    """
    for axis in (0, 1):
        padded = np.pad(shadow, [(2, 2) if k == axis else (0, 0) for k in (0, 1)], mode="edge")
        rows = [np.take(padded, np.arange(CELLS) + k, axis=axis) for k in range(5)]
        shadow = (rows[0] + rows[4] + 4 * (rows[1] + rows[3]) + 6 * rows[2]) / 16
    away = np.clip((np.hypot(place[..., 0], place[..., 1]) - FADE) / (1 - FADE), 0, 1)
    return (STRENGTH * shadow * (1 - away * away * (3 - 2 * away))).astype(np.float32)
