"""Which way is up in a scan that does not tell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from .sample import Sample

Floats = NDArray[np.float64]

FLAT = 0.2  # share of the width: a lower scan is terrain, a city, a floor
STRAY = 0.002  # share of the points at either end that counts as strays
EDGE = 0.01  # the same, where the flatness of a scan is tested
ENOUGH = 30_000  # points that are used
SLAB = 0.05  # share of the height that counts as the base and as the top
CELLS = 32  # across the view from above
FEW = 10  # points in a slab that are too few to tell anything
# Prior scores of the axes: in programs and scanners z is up, in graphics and many meshes y.
HABIT = {"z": 0.25, "y": 0.1, "-y": -0.1, "x": -0.2, "-x": -0.2, "-z": -0.3}
# The same for Gaussian splats: their cameras are those of computer vision, y downwards; SPZ files have y upwards.
SPLAT_HABIT = {"-y": 0.4, "y": 0.2, "z": 0.0, "x": -0.2, "-x": -0.2, "-z": -0.3}
TIPS = 0.5  # penalty for an axis along which the body would fall over
FACING, PLUMB = 0.5, 0.3  # weights of normals that point upwards, and of walls
LEVEL = 0.1  # |cosine| between the axis and the normal of a wall
SIGHT = 1.2  # tangent of half the angle that a depth camera sees
EVEN = 0.97  # share of normals that face a depth camera


class Up(NamedTuple):
    """Which way is up.

    Attributes
    ----------
    axis : str
        "x", "-x", "y", "-y", "z" or "-z".
    why : str
        The reason, in a few words.
    """

    axis: str
    why: str

    @property
    def direction(self) -> tuple[float, float, float]:
        """The unit vector."""
        return axis_direction(self.axis)


def axis_direction(axis: str) -> tuple[float, float, float]:
    """The unit vector of "x", "-x", "y", "-y", "z" or "-z"."""
    sign = -1.0 if axis.startswith("-") else 1.0
    x, y, z = (sign if axis[-1] == name else 0.0 for name in "xyz")
    return x, y, z


def find_up(sample: Sample) -> Up:
    """Which way is up: z for a map; opposite to y in a depth camera's picture; else where a body would stand best."""
    if sample.far:
        return Up("z", "large coordinates, as on a map")
    step = max(len(sample.positions) // ENOUGH, 1)
    sample = sample._replace(positions=sample.positions[::step], normals=sample.normals[::step])
    if is_flat(sample.positions):
        return Up("z", "the scan is flat")
    if is_depth_picture(sample):
        ahead = np.median(sample.positions[:, 2] + sample.origin[2]) > 0
        return Up("-y" if ahead else "y", "seen from one place, as by a depth camera")
    habits = SPLAT_HABIT if sample.splats else HABIT
    scores = {axis: habit + _stance(sample, axis_direction(axis)) for axis, habit in habits.items()}
    best = max(scores, key=lambda axis: scores[axis])
    return Up(best, "splats, which would stand so" if sample.splats else "it would stand so")


def is_flat(positions: Floats) -> bool:
    """Whether points, (n, 3), are less than a fifth as high (the last axis) as wide."""
    across, deep, high = np.ptp(np.quantile(positions, [EDGE, 1.0 - EDGE], axis=0), axis=0)
    return bool(high <= FLAT * max(across, deep))


def is_depth_picture(sample: Sample) -> bool:
    """Whether all points lie in front of a camera at the world's origin that looks along z, and face it."""
    x, y, z = (sample.positions + sample.origin).T
    ahead = 1.0 if np.median(z) > 0 else -1.0
    within = (ahead * z > 0) & (np.maximum(np.abs(x), np.abs(y)) < SIGHT * np.abs(z))
    facing = np.einsum("ij,ij->i", sample.normals, sample.positions + sample.origin) < 0
    known = sample.normals.any(axis=1)
    return bool(within.mean() > 1 - STRAY and known.any() and facing[known].mean() > EVEN)


def _stance(sample: Sample, up: tuple[float, float, float]) -> float:
    """How well a scan would stand along an axis: a broad base, a small top, the body above the base; its normals."""
    axis = np.array(up)
    height = sample.positions @ axis
    flat = sample.positions[:, np.flatnonzero(axis == 0)]
    low, high = np.quantile(height, [STRAY, 1.0 - STRAY])
    slab = SLAB * (high - low)
    within = (height >= low) & (height <= high)
    base, top = flat[within & (height <= low + slab)], flat[within & (height >= high - slab)]
    whole = flat[within]
    score = _spread(base, whole) - _spread(top, whole)
    if not _carries(base, whole.mean(axis=0)):
        score -= TIPS
    known = sample.normals.any(axis=1)
    if known.any():
        rise = sample.normals[known] @ axis
        around = sample.normals[known][:, np.flatnonzero(axis == 0)]
        score += FACING * float(rise.mean()) + PLUMB * _walls(rise, around)
    return score


def _spread(part: Floats, whole: Floats) -> float:
    """The share of the view from above that a part covers: geometric mean of its outline and its cells."""
    if len(part) < FEW:
        return 0.0
    outline = _outline(part) / max(_outline(whole), 1e-300)
    low, size = whole.min(axis=0), np.ptp(whole, axis=0)
    cells = [_cells((points - low) / np.where(size > 0, size, 1.0)) for points in (part, whole)]
    return float(np.sqrt(min(outline, 1.0) * cells[0] / cells[1]))


def _cells(positions: Floats) -> int:
    """How many cells of a grid over the unit square contain a point."""
    column = np.minimum((positions * CELLS).astype(int), CELLS - 1) @ (1, CELLS)
    return len(np.unique(column))


def _outline(flat: Floats) -> float:
    """The area of the convex hull of points in a plane."""
    try:
        return float(ConvexHull(flat).volume)
    except QhullError:  # they lie on a line
        return 0.0


def _carries(base: Floats, middle: Floats) -> bool:
    """Whether the middle of a body lies over its base."""
    try:
        sides = ConvexHull(base).equations
    except (QhullError, ValueError):
        return False
    return bool((sides[:, :2] @ middle + sides[:, 2]).max() < 0)


def _walls(rise: Floats, around: Floats) -> float:
    """The share of walls: level normals, if they face several sides. On terrain all face one way or the other."""
    level = np.abs(rise) < LEVEL
    if not level.any():
        return 0.0
    angle = 2.0 * np.arctan2(around[level, 1], around[level, 0])  # opposite sides count as one
    one_way = float(np.hypot(np.cos(angle).mean(), np.sin(angle).mean()))
    return float(level.mean()) * (1.0 - one_way)
