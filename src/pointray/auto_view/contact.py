"""The contact shadow of an object that stands: on an invisible ground, composited behind the picture.

Rays from a grid of points on the ground find how much of the sky and of a wide key light the object blocks. The grid is
smoothed and looked up where the camera's rays meet the ground, so that a picture needs no more samples, and frames of a
film or of the viewer share one grid.

A ground in the scene (`Plane(shadow_catcher=True)`) would cost shadow rays for each sample of each pixel, and hide the
object from below.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..engine.kernels.records import ACROSS, EYE, FORWARD, ORTHOGRAPHIC, PANORAMA, PROJECTION, UPWARD
from ..rendering.camera import Camera
from ..scene.scene import Scene
from .direction import axes_of

Floats = NDArray[np.float64]

CELLS = 72  # of the grid, a side
SKY_RAYS, KEY_RAYS = 16, 8  # from each cell
KEY_SHARE = 0.35  # of the light, the rest is the sky's: less than the studio's, so that the shadow stays soft
KEY_CONE = 14.0  # degrees: half the angle of the key light
MARGIN = 0.8  # width of the ground beyond the object's box, as a share of its largest side
LENGTH = 1.25  # of rays, as a share of the same: from below the base they reach the other side of the object
STRENGTH = 0.8  # most that a shadow takes off the background
FADE = 0.6  # share of the ground's half width from which shadows fade out towards its edge
LEVEL = 0.001  # share of the points that may lie below the ground
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


class ContactShadow(NamedTuple):
    """The shadow of a standing object on the ground.

    Attributes
    ----------
    middle : (3,) float64
        World, on the ground.
    axes : (3, 3) float64
        Unit rows: two along the ground, and up.
    half : float
        Half the width of the grid.
    shadow : (CELLS, CELLS) float32
        The share of light that is missing, at the middles of the cells; first along the first axis.
    """

    middle: Floats
    axes: Floats
    half: float
    shadow: NDArray[np.float32]

    def seen_by(self, camera: Camera) -> NDArray[np.float32] | None:
        """The alpha of the shadow in a camera's picture, (h, w); None if the ground is not seen from above."""
        record, (width, height) = camera.record(), camera.size
        axes = self.axes @ np.stack([record[k : k + 3] for k in (FORWARD, ACROSS, UPWARD)]).T  # each axis: f, r, u
        eye = self.axes @ (record[EYE : EYE + 3] - self.middle)
        if record[PROJECTION] == PANORAMA or eye[2] <= 0.0:
            return None
        right = ((2 * np.arange(width) + 1) / width - 1)[None, :]
        upward = (1 - (2 * np.arange(height) + 1) / height)[:, None]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if record[PROJECTION] == ORTHOGRAPHIC:
                start = [eye[k] + right * axes[k, 1] + upward * axes[k, 2] for k in range(3)]
                t = -start[2] / axes[2, 0]
                place = [start[k] + t * axes[k, 0] for k in range(2)]
            else:
                toward = [axes[k, 0] + right * axes[k, 1] + upward * axes[k, 2] for k in range(3)]
                t = -eye[2] / toward[2]
                place = [eye[k] + t * toward[k] for k in range(2)]
        return self._look_up(place[0], place[1], t)

    def _look_up(self, x: Floats, y: Floats, t: Floats) -> NDArray[np.float32]:
        """The shadow at places on the ground, bilinear; 0 beyond the grid, and where t is not in front."""
        out = np.zeros(t.shape, np.float32)
        inside = (t > 0) & (np.abs(x) < self.half) & (np.abs(y) < self.half)
        at = (np.stack([x[inside], y[inside]]) / self.half + 1) * (CELLS / 2) - 0.5
        at = np.clip(at, 0, CELLS - 1.001)
        (i, j), (u, v) = at.astype(np.int64), (at % 1).astype(np.float32)
        flat, row = self.shadow.reshape(-1), i * CELLS + j
        near = flat[row] * (1 - v) + flat[row + 1] * v
        far = flat[row + CELLS] * (1 - v) + flat[row + CELLS + 1] * v
        out[inside] = near * (1 - u) + far * u
        return out

    def put_under(self, image: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
        """A picture with the shadow under it: black, premultiplied, where the picture is transparent.

        image : (h, w, 4) float32, premultiplied
        """
        alpha = self.seen_by(camera)
        if alpha is None:
            return image
        out = image.copy()
        out[..., 3] += (1 - out[..., 3]) * alpha
        return out


def contact_shadow(scene: Scene, positions: Floats, up: ArrayLike, key: ArrayLike | None = None) -> ContactShadow:
    """Compute the contact shadow of a scene's models.

    Parameters
    ----------
    positions : (n, 3) float64
        World: points of the object that stands.
    up : (3,) array_like
    key : (3,) array_like, optional
        The direction in which the key light travels, world.
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
    # Not `occluded`: this kernel is compiled already, and most rays meet nothing.
    blocked = np.isfinite(scene.intersect(origins, directions @ axes, 0.0, LENGTH * size).t)
    return ContactShadow(middle, axes, half, _finished((blocked * weights).sum(axis=-1), ground / half))


def _directions(key: Floats | None) -> tuple[Floats, Floats]:
    """Directions from each cell to the light, (CELLS, CELLS, k, 3), in the ground's axes, and their weights, (k,).

    The same in all cells but for a turn, which a smoothing over neighbours averages: the sky's by the cosine.
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


def _disc(count: int, turn: Floats) -> Floats:
    """Points of the unit disc, (..., count, 2): a sunflower, turned by a share of a full turn in each cell."""
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), 2 * np.pi * (k * GOLDEN + turn)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def _finished(shadow: Floats, place: Floats) -> NDArray[np.float32]:
    """A grid of shares of blocked light, smoothed, and faded out towards the edge."""
    for axis in (0, 1):
        padded = np.pad(shadow, [(2, 2) if k == axis else (0, 0) for k in (0, 1)], mode="edge")
        rows = [np.take(padded, np.arange(CELLS) + k, axis=axis) for k in range(5)]
        shadow = (rows[0] + rows[4] + 4 * (rows[1] + rows[3]) + 6 * rows[2]) / 16
    away = np.clip((np.hypot(place[..., 0], place[..., 1]) - FADE) / (1 - FADE), 0, 1)
    return (STRENGTH * shadow * (1 - away * away * (3 - 2 * away))).astype(np.float32)
