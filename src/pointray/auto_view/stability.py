"""How well a body would stand: a broad base or feet, a small top, the middle above the base."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SLAB = 0.05  # share of the height that counts as the base and as the top
TIP = 0.015  # share of the height that counts as the lowest and as the highest
CELLS = 32  # across the view from above
FEW = 10  # points in a slab that are too few to judge
TIPS = 0.5  # penalty for an axis along which the body would fall over
FEET_CELLS, MOST_FEET = 20, 12  # cells across the view that separate feet, and the most feet
DENSE = 3  # points in a cell, on average, without which a rim may look like feet
THIN = 4.0  # a plate on its edge: height over this many times its thickness
LINE = 1e-5  # share of the squared size: an outline with less area is a line, of float32 coordinates
# Directions in a plane, (32, 2). SciPy's convex hull takes as long, and a fifth of a second to import.
AROUND = np.stack([np.cos(np.arange(32) * (np.pi / 16)), np.sin(np.arange(32) * (np.pi / 16))], axis=1)


class Ends(NamedTuple):
    """The ends of a body along an axis, as positions across it, (n, 2) each.

    Attributes
    ----------
    low, high, whole : (n, 2) float64
        The points near either end, and all.
    lowest, highest : (n, 2) float64
        Those at the very ends.
    height : float
    """

    low: Floats
    high: Floats
    whole: Floats
    lowest: Floats
    highest: Floats
    height: float

    @classmethod
    def of(cls, positions: Floats, axis: int) -> Ends:
        """The ends of points (n, 3) along axis 0, 1 or 2."""
        height, across = positions[:, axis], np.delete(positions, axis, axis=1)
        low, high, size = height.min(), height.max(), float(np.ptp(height))
        near = {share: (height <= low + share * size, height >= high - share * size) for share in (SLAB, TIP)}
        (base, top), (lowest, highest) = ([across[rows] for rows in near[share]] for share in (SLAB, TIP))
        return cls(base, top, across, lowest, highest, size)

    def stances(self) -> tuple[float, float]:
        """Scores of the body as it is and upside down: 1 for a cone, -1 or less for one on its tip."""
        whole = _outline_and_cells(self.whole, self.whole)
        low, high = (_spread(end, self.whole, whole) for end in (self.low, self.high))
        middle = self.whole.mean(axis=0)
        falls = [0.0 if carries(end, middle) else TIPS for end in (self.low, self.high)]
        return low - high - falls[0], high - low - falls[1]

    def flatness(self) -> float:
        """How much wider the lowest points are than the highest, from -1 to 1: bodies are flat below, or cut off."""
        area = max(outline(self.whole), 1e-300)
        low, high = (min(outline(tip) / area, 1.0) if len(tip) else 0.0 for tip in (self.lowest, self.highest))
        thickness = float(np.ptp(self.whole, axis=0).min())
        return float(np.sqrt(low) - np.sqrt(high)) * min(THIN * thickness / (self.height or 1.0), 1.0)

    def feet(self) -> float:
        """How much better the body stands on feet as it is than upside down, from -1 to 1."""
        return _feet(self.low, self.whole) - _feet(self.high, self.whole)


def _spread(part: Floats, whole: Floats, of_whole: tuple[float, int]) -> float:
    """The share of the view from above that a part covers: geometric mean of its outline and its cells."""
    if len(part) < FEW:
        return 0.0
    area, cells = _outline_and_cells(part, whole)
    return float(np.sqrt(min(area / max(of_whole[0], 1e-300), 1.0) * cells / of_whole[1]))


def _outline_and_cells(part: Floats, whole: Floats) -> tuple[float, int]:
    """The area of a part's outline, and how many cells of a grid over the whole contain a point of it."""
    size = np.ptp(whole, axis=0)
    unit = (part - whole.min(axis=0)) / np.where(size > 0, size, 1.0)
    column = np.minimum((unit * CELLS).astype(int), CELLS - 1) @ (1, CELLS)
    return outline(part), int(np.count_nonzero(np.bincount(column)))


def outline(flat: Floats) -> float:
    """The area of the polygon of those points in a plane that are farthest in some direction; 0 if it is a line."""
    flat = flat - flat.mean(axis=0)
    reach = AROUND[:, :1] * flat[:, 0] + AROUND[:, 1:] * flat[:, 1]  # no matrix product: threads of BLAS cost 10 ms
    x, y = flat[reach.argmax(axis=1)].T
    area = 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    return area if area > LINE * float((flat[:, 0] ** 2 + flat[:, 1] ** 2).max()) else 0.0


def carries(base: Floats, middle: Floats) -> bool:
    """Whether the middle of a body lies over its base: seen from it, the base leaves no gap of half a turn."""
    if len(base) == 0 or outline(base) == 0:
        return False
    x, y = (base - middle).T
    angles = np.sort(np.arctan2(y, x))
    return bool(np.diff(angles, append=angles[:1] + 2 * np.pi).max() < np.pi)


def _feet(base: Floats, whole: Floats) -> float:
    """How much wider the outline of an end is than its area, as shares of the whole; 0 if it is not a few feet."""
    if len(base) < FEW or not carries(base, whole.mean(axis=0)):
        return 0.0
    low, size = whole.min(axis=0), float(np.ptp(whole, axis=0).max()) or 1.0
    taken, everywhere = (_grid((points - low) / size) for points in (base, whole))
    if len(base) < DENSE * taken.sum() or not 2 <= _count_islands(taken) <= MOST_FEET:
        return 0.0
    return max(outline(base) / max(outline(whole), 1e-300) - float(taken.sum() / everywhere.sum()), 0.0)


def _grid(unit: Floats) -> NDArray[np.bool_]:
    """The cells of the unit square that hold points, with an empty rim."""
    cells = np.zeros((FEET_CELLS + 2, FEET_CELLS + 2), bool)
    cells[tuple(np.minimum(unit * FEET_CELLS, FEET_CELLS - 1).astype(int).T + 1)] = True
    return cells


def _count_islands(cells: NDArray[np.bool_]) -> int:
    """The number of connected groups of cells, corners included; the rim is empty."""
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
