"""Stability of an object on an axis: a broad base or feet, a small top, the centre above the base."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..base.arrays import Doubles, Flags

SLAB = 0.05  # share of the height that counts as the base and as the top
TIP = 0.015  # share of the height that counts as the lowest and as the highest points
CELLS = 32  # across the view along the axis
FEW = 10  # points in a slab that are too few to judge
TIPS = 0.5  # penalty for an axis on which the object would fall over
FEET_CELLS, MOST_FEET = 20, 12  # cells across the view that separate feet; largest number of feet
DENSE = 3  # smallest mean number of points per cell; with fewer, a rim may look like feet
THIN = 4.0  # plate on its edge: height over this many times its thickness
LINE = 1e-5  # an outline with less than this share of the squared size is a line in float32 coordinates
# Directions in a plane, (32, 2). SciPy's convex hull takes as long and needs 0.2 s to import.
AROUND = np.stack([np.cos(np.arange(32) * (np.pi / 16)), np.sin(np.arange(32) * (np.pi / 16))], axis=1)


class Ends(NamedTuple):
    """Points near the two ends of an object along an axis, to judge on which end it stands.

    Attributes
    ----------
    low, high, whole : (n, 2) float64
        Points in the lowest and in the highest 5% of the height, and all points: coordinates across the axis.
    lowest, highest : (n, 2) float64
        Points in the lowest and in the highest 1.5% of the height.
    height : float
        Extent along the axis.
    """

    low: Doubles
    high: Doubles
    whole: Doubles
    lowest: Doubles
    highest: Doubles
    height: float

    @classmethod
    def of(cls, positions: Doubles, axis: int) -> Ends:
        """Return the points near the ends of an object along axis 0, 1 or 2. positions : (n, 3), all its points"""
        height, across = positions[:, axis], np.delete(positions, axis, axis=1)
        low, high, size = height.min(), height.max(), float(np.ptp(height))
        near = {share: (height <= low + share * size, height >= high - share * size) for share in (SLAB, TIP)}
        (base, top), (lowest, highest) = ([across[rows] for rows in near[share]] for share in (SLAB, TIP))
        return cls(base, top, across, lowest, highest, size)

    def stances(self) -> tuple[float, float]:
        """Return two scores of how stably the object stands: on its low end, and upside down on its high end.

        A score is 1 for a cone on its base, and -1 or less for a cone on its tip.
        """
        whole = _outline_and_cells(self.whole, self.whole)
        low, high = (_spread(end, self.whole, whole) for end in (self.low, self.high))
        middle = self.whole.mean(axis=0)
        falls = [0.0 if carries(end, middle) else TIPS for end in (self.low, self.high)]
        return low - high - falls[0], high - low - falls[1]

    def flatness(self) -> float:
        """Return how much wider the object is at its very bottom than at its very top, from -1 to 1.

        Bases are flat or cut off, tops seldom.
        """
        area = max(outline(self.whole), 1e-300)
        low, high = (min(outline(tip) / area, 1.0) if len(tip) else 0.0 for tip in (self.lowest, self.highest))
        thickness = float(np.ptp(self.whole, axis=0).min())
        return float(np.sqrt(low) - np.sqrt(high)) * min(THIN * thickness / (self.height or 1.0), 1.0)

    def feet(self) -> float:
        """Return how much better the object stands on feet as it is than upside down, from -1 to 1; 0 without feet."""
        return _feet(self.low, self.whole) - _feet(self.high, self.whole)


def _spread(part: Doubles, whole: Doubles, of_whole: tuple[float, int]) -> float:
    """Return the share of an object, seen along an axis, that the points of a part of it cover, from 0 to 1.

    The result is the geometric mean of two shares: of the outline's area and of the occupied cells.

    part, whole : (n, 2), points of the part, and all points of the object
    of_whole : (area of the outline, number of occupied cells) of all points
    """
    if len(part) < FEW:
        return 0.0
    area, cells = _outline_and_cells(part, whole)
    return float(np.sqrt(min(area / max(of_whole[0], 1e-300), 1.0) * cells / of_whole[1]))


def _outline_and_cells(part: Doubles, whole: Doubles) -> tuple[float, int]:
    """Return the area of a part's outline, and the number of cells that it occupies in a 32 x 32 grid over the whole.

    part, whole : (n, 2), points of the part, and all
    """
    size = np.ptp(whole, axis=0)
    unit = (part - whole.min(axis=0)) / np.where(size > 0, size, 1.0)
    column = np.minimum((unit * CELLS).astype(int), CELLS - 1) @ (1, CELLS)
    return outline(part), int(np.count_nonzero(np.bincount(column)))


def outline(flat: Doubles) -> float:
    """Return the area of the polygon through the extreme points in 32 directions; 0 if it is a line.

    The polygon approximates the convex hull. flat : (n, 2)
    """
    flat = flat - flat.mean(axis=0)
    reach = AROUND[:, :1] * flat[:, 0] + AROUND[:, 1:] * flat[:, 1]  # a matrix product's BLAS threads cost 10 ms
    x, y = flat[reach.argmax(axis=1)].T
    area = 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    return area if area > LINE * float((flat[:, 0] ** 2 + flat[:, 1] ** 2).max()) else 0.0


def carries(base: Doubles, middle: Doubles) -> bool:
    """Return whether an object with its centre over `middle` stands on its base without falling over.

    Each half circle around the centre must contain points of the base.

    base : (n, 2), its lowest points, seen along the vertical; middle : (2,)
    """
    if len(base) == 0 or outline(base) == 0:
        return False
    x, y = (base - middle).T
    angles = np.sort(np.arctan2(y, x))
    return bool(np.diff(angles, append=angles[:1] + 2 * np.pi).max() < np.pi)


def _feet(base: Doubles, whole: Doubles) -> float:
    """Return how much an end of an object looks like 2 to 12 feet on which it can stand, from 0 to 1.

    Feet enclose a large outline but occupy few cells: the result is the difference of both as shares of the whole.

    base, whole : (n, 2), points of the end, and all
    """
    if len(base) < FEW or not carries(base, whole.mean(axis=0)):
        return 0.0
    low, size = whole.min(axis=0), float(np.ptp(whole, axis=0).max()) or 1.0
    taken, everywhere = (_grid((points - low) / size) for points in (base, whole))
    if len(base) < DENSE * taken.sum() or not 2 <= _count_islands(taken) <= MOST_FEET:
        return 0.0
    return max(outline(base) / max(outline(whole), 1e-300) - float(taken.sum() / everywhere.sum()), 0.0)


def _grid(unit: Doubles) -> Flags:
    """Return the occupied cells of a grid over the unit square, with an empty border. unit : (n, 2), positions in it"""
    cells = np.zeros((FEET_CELLS + 2, FEET_CELLS + 2), bool)
    cells[tuple(np.minimum(unit * FEET_CELLS, FEET_CELLS - 1).astype(int).T + 1)] = True
    return cells


def _count_islands(cells: Flags) -> int:
    """Count groups of occupied cells that are connected by edges or corners. cells : (m, m), with an empty border"""
    left, count = cells.copy(), 0
    while left.any():
        island = np.zeros_like(left)
        island.flat[left.argmax()] = True
        before = 0
        while (size := int(island.sum())) > before:
            before = size
            for axis in (0, 1):
                island = island | np.roll(island, 1, axis) | np.roll(island, -1, axis)
            island &= cells
        left &= ~island
        count += 1
    return count
