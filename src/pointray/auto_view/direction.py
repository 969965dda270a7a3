"""The direction to view a scan from: a body from slightly above, terrain from higher up, a scanned side from before."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .camera_frame import find_camera_frame
from .sample import Sample
from .upright import axis_direction, is_flat

Floats = NDArray[np.float64]

ENOUGH = 50_000  # points whose shape is looked at
STRAY = 0.002  # share of the points at either end that counts as strays
BODY = (25.0, 18.0)  # from the front, a little to the right and above
TERRAIN = (25.0, 40.0)
ASIDE = 20.0  # degrees that a scanned side is turned away, so that its depth is seen
SIDED = 0.15  # a longer mean of the level normals means that the scan has one side only
STEEPEST = 89.94  # degrees: a top view from which the front is still known
LONG = 1.5  # a scan this many times as long as wide lies across the picture
OBJECT = "front"  # the kind of a scan that shows a body from all sides
SECTORS = 16  # around the middle of a room
OUTERMOST = 0.45  # share of the scan's horizontal radius: walls of a room are farther from its middle
SURROUNDED, INWARD, CEILING = 0.9, 0.7, 0.05  # of sectors, of normals, and of normals that point down from above


class Outlook(NamedTuple):
    """The direction from which a scan is viewed.

    Attributes
    ----------
    azimuth, elevation : float
        Degrees.
    kind : str
        The kind of scene that the scan is taken for.
    within : bool
        Whether the camera stands inside the scan, as in a room.
    """

    azimuth: float
    elevation: float
    kind: str
    within: bool = False


def axes_of(up: ArrayLike) -> Floats:
    """Right, front and up as rows, seen by a viewer in front: unit; front is -y where z is up, else +z."""
    top = np.asarray(up, np.float64) / np.linalg.norm(up)
    ahead = np.array([0.0, -1.0, 0.0]) if abs(top[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    front = ahead - top * (ahead @ top)
    front /= np.linalg.norm(front)
    return np.stack([np.cross(top, front), front, top])


def direction_of(azimuth: float, elevation: float, up: ArrayLike) -> Floats:
    """The unit vector with an azimuth and an elevation, degrees."""
    right, front, top = axes_of(up)
    a, e = math.radians(azimuth), math.radians(elevation)
    return np.asarray(math.cos(e) * (math.cos(a) * front + math.sin(a) * right) + math.sin(e) * top)


def towards(outlook: Outlook, up: ArrayLike) -> Floats:
    """The unit vector towards the viewer of a scan; never straight up or down, where the front would be unknown."""
    return direction_of(outlook.azimuth, max(-STEEPEST, min(STEEPEST, outlook.elevation)), up)


def angles_of(direction: ArrayLike, up: ArrayLike) -> tuple[float, float]:
    """Azimuth and elevation of a direction, degrees."""
    right, front, top = axes_of(up) @ np.asarray(direction, np.float64)
    return math.degrees(math.atan2(right, front)), math.degrees(math.atan2(top, math.hypot(right, front)))


def find_outlook(sample: Sample, up: ArrayLike) -> Outlook:
    """The direction from which to view the points, by their shape and normals."""
    frame = find_camera_frame(sample.positions + sample.origin)
    if frame and (frame.certainty == 1 or np.array_equal(axis_direction(frame.up), up)):
        azimuth, elevation = angles_of(-np.median(sample.positions + sample.origin, axis=0), up)
        return Outlook(azimuth, elevation, "from the depth camera")
    step = max(len(sample.positions) // ENOUGH, 1)
    positions, normals = (
        rows[::step] @ axes_of(up).T for rows in (sample.positions, sample.normals)
    )  # right, front, up
    low, high = np.quantile(positions, [STRAY, 1.0 - STRAY], axis=0)
    known = normals.any(axis=1)
    facing = normals[known].mean(axis=0) if known.any() else np.zeros(3)
    if is_flat(positions):
        return Outlook(_broadside(positions), TERRAIN[1], "flat, from above")
    around, under_roof = _surroundings(positions[known], normals[known], (low + high) / 2)
    if around:
        if under_roof:
            return Outlook(BODY[0], 0.0, "room, from inside", True)
        return Outlook(BODY[0], TERRAIN[1], "enclosed place, from above")
    if math.hypot(facing[0], facing[1]) > SIDED:
        azimuth = math.degrees(math.atan2(facing[0], facing[1]))
        return Outlook(azimuth + ASIDE, BODY[1], "the scanned side")
    return Outlook(*BODY, OBJECT)


def _broadside(positions: Floats) -> float:
    """The azimuth, near the front, for which the longest extent lies across the picture."""
    flat = positions[:, :2] - np.median(positions[:, :2], axis=0)
    size, axes = np.linalg.eigh(flat.T @ flat)
    if size[1] < LONG * LONG * size[0]:
        return TERRAIN[0]
    right, front = axes[:, 0] if axes[1, 0] >= 0 else -axes[:, 0]
    return math.degrees(math.atan2(right, front))


def _surroundings(positions: Floats, normals: Floats, middle: Floats) -> tuple[bool, bool]:
    """Whether surfaces stand all around a middle and face it, and whether there is a ceiling too."""
    if len(positions) == 0:
        return False, False
    away = positions - middle
    walls = np.abs(normals[:, 2]) < 0.5
    if not walls.any():
        return False, False
    sector = (np.arctan2(away[walls, 1], away[walls, 0]) / (2 * np.pi) * SECTORS).astype(int) % SECTORS
    filled = np.bincount(sector, minlength=SECTORS) > 0.1 * walls.sum() / SECTORS
    inward = (away[walls] * normals[walls]).sum(axis=1) < 0
    reach = np.hypot(away[:, 0], away[:, 1])
    is_wide = np.median(reach[walls]) >= OUTERMOST * np.quantile(reach, 0.95)  # a body on a floor is narrower than that
    around = filled.mean() >= SURROUNDED and inward.mean() >= INWARD and is_wide
    ceiling = (normals[:, 2] < -0.7) & (away[:, 2] > 0)
    return bool(around), bool(ceiling.mean() >= CEILING)
