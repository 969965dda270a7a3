"""View direction of a scan: objects from slightly above, terrain from higher up, one-sided scans from their front."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arrays import Doubles
from .camera_frame import find_camera_frame
from .sample import Sample
from .upright import axis_direction, is_flat

MAX_POINTS = 50_000  # points used
STRAY = 0.002  # share of the points at either end that counts as outliers
BODY = (25.0, 18.0)  # azimuth and elevation of objects: from the front, slightly to the right and above
TERRAIN = (25.0, 40.0)
ASIDE = 20.0  # degrees: azimuth added for a one-sided scan, to show its depth
SIDED = 0.15  # a longer horizontal mean of the normals means that the scan has one side only
STEEPEST = 89.94  # degrees: largest elevation at which the azimuth is still defined
LONG = 1.5  # length over width from which a flat scan is turned across the image
OBJECT = "front"  # kind of a scan that shows an object from all sides
SECTORS = 16  # around the centre of a room
OUTERMOST = 0.45  # share of the scan's horizontal radius: walls of a room are farther from its centre
SURROUNDED, INWARD, CEILING = 0.9, 0.7, 0.05  # shares: filled sectors, inward normals, ceiling normals


class Outlook(NamedTuple):
    """Direction from which a scan is viewed.

    Attributes
    ----------
    azimuth, elevation : float
        Degrees, about the up direction. Azimuth 0 is the front, 90 the right side.
    kind : str
        Detected kind of scene, for messages, such as "flat, from above"; or the name of the chosen view.
    within : bool
        Whether the camera stands inside the scan, as in a room.
    """

    azimuth: float
    elevation: float
    kind: str
    within: bool = False


def axes_of(up: ArrayLike) -> Doubles:
    """Return the unit axes right, front and up as rows, (3, 3), with front towards a viewer of the front side.

    Front is -y if z is up, and +z if y is up, made perpendicular to `up`.
    """
    top = np.asarray(up, np.float64) / np.linalg.norm(up)
    ahead = np.array([0.0, -1.0, 0.0]) if abs(top[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    front = ahead - top * (ahead @ top)
    front /= np.linalg.norm(front)
    return np.stack([np.cross(top, front), front, top])


def direction_of(azimuth: float, elevation: float, up: ArrayLike) -> Doubles:
    """Return the unit vector, (3,), towards a viewer at an azimuth (0 front, 90 right) and an elevation, in degrees."""
    right, front, top = axes_of(up)
    a, e = math.radians(azimuth), math.radians(elevation)
    return np.asarray(math.cos(e) * (math.cos(a) * front + math.sin(a) * right) + math.sin(e) * top)


def towards(outlook: Outlook, up: ArrayLike) -> Doubles:
    """Return the unit vector, (3,), towards the viewer; elevation is clamped so that the azimuth stays defined."""
    return direction_of(outlook.azimuth, max(-STEEPEST, min(STEEPEST, outlook.elevation)), up)


def angles_of(direction: ArrayLike, up: ArrayLike) -> tuple[float, float]:
    """Return azimuth (0 front, 90 right) and elevation of a direction, (3,), in degrees."""
    right, front, top = axes_of(up) @ np.asarray(direction, np.float64)
    return math.degrees(math.atan2(right, front)), math.degrees(math.atan2(top, math.hypot(right, front)))


def find_outlook(sample: Sample, up: ArrayLike) -> Outlook:
    """Choose the view direction of a scan from the shape and the normals of its points.

    Objects are seen from slightly above, flat scans from higher up, one-sided scans from that side, rooms from inside.
    """
    frame = find_camera_frame(sample.positions + sample.origin)
    if frame and (frame.certainty == 1 or np.array_equal(axis_direction(frame.up), up)):
        azimuth, elevation = angles_of(-np.median(sample.positions + sample.origin, axis=0), up)
        return Outlook(azimuth, elevation, "from the depth camera")
    step = max(len(sample.positions) // MAX_POINTS, 1)
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


def _broadside(positions: Doubles) -> float:
    """Return the azimuth, near the front, that puts the longest horizontal extent of a flat scan across the image.

    positions : (n, 3), right, front, up. Scans that are not elongated get a fixed azimuth.
    """
    flat = positions[:, :2] - np.median(positions[:, :2], axis=0)
    size, axes = np.linalg.eigh(flat.T @ flat)
    if size[1] < LONG * LONG * size[0]:
        return TERRAIN[0]
    right, front = axes[:, 0] if axes[1, 0] >= 0 else -axes[:, 0]
    return math.degrees(math.atan2(right, front))


def _surroundings(positions: Doubles, normals: Doubles, middle: Doubles) -> tuple[bool, bool]:
    """Return whether walls stand all around a centre and face it, and whether there is a ceiling. A room has both.

    positions, normals : (n, 3), of a scan's points, with components right, front and up; middle : (3,), the centre
    """
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
    is_wide = np.median(reach[walls]) >= OUTERMOST * np.quantile(reach, 0.95)  # an object on a floor is narrower
    around = filled.mean() >= SURROUNDED and inward.mean() >= INWARD and is_wide
    ceiling = (normals[:, 2] < -0.7) & (away[:, 2] > 0)
    return bool(around), bool(ceiling.mean() >= CEILING)
