"""Veils: mixed returns between foreground and background, where the scanner's beam hits the edge of an object.

Seen from the scanner, a surface continues from each point to some adjacent points, at grazing angles at least in one
direction. A point of a veil is isolated between nearer and farther points: hardly any adjacent point has about the same
range. It is also sparser than these: where a whole body is seen from one place, its back shows between the points of
its front, but both are equally dense.

Where an edge runs along a row or column of the scan, mixed returns form a line, on which each point continues to two
others. Such a point is far from most adjacent points, some nearer, some farther, while these are not far from their
own: ground at a grazing angle is equally steep in front and behind, and a wire has nothing nearer.
"""

from __future__ import annotations

import numpy as np

from ...base.arrays import Doubles, Flags, Floats
from ..neighbors import neighbors
from .local_fits import CORE

BESIDE = CORE  # adjacent points, as seen from the scanner
STEEP = 4.0  # greatest slope of a surface along the ray, for a step to the side: 76 degrees
MOST = 1  # adjacent points that a point of a veil continues to, at most
LINE, SIDES = 3, 2  # the same on a line; nearer, and farther, adjacent points, at least
SPARSE_LINE = 2.0  # least ratio of distances to neighbours in space, to those of the denser side, on a line
SPARSE = 2.5  # least ratio of distances to neighbours in space, to those of adjacent points


def find_veils(positions: Floats, core: Floats, eye: Doubles) -> Flags:
    """Return which positions, (n,) bool, are mixed returns: isolated between foreground and background of a scanner.

    Parameters
    ----------
    positions : (n, 3) float32
    core : (n,) float32
        Distance of each to its eighth neighbour.
    eye : (3,) float64
        The scanner, relative to the origin of the positions.
    """
    away = positions - eye
    ranges = np.linalg.norm(away, axis=1)
    directions = (away / np.maximum(ranges, 1e-30)[:, None]).astype(np.float32)
    angles, near = neighbors(directions, BESIDE + 1)
    # At least the median step, even where two points lie in the same direction.
    sideways = np.maximum(angles, np.median(angles[:, 1:], axis=1, keepdims=True)) * ranges[:, None]
    beyond = ranges[near] - ranges[:, None]
    is_other = near != np.arange(len(positions))[:, None]
    goes_on = ((np.abs(beyond) <= STEEP * sideways) & is_other).sum(axis=1)
    around = np.sort(core[near[:, 1:]], axis=1)
    alone = (goes_on <= MOST) & (core > SPARSE * around[:, BESIDE // 2])
    between = np.minimum((beyond < -STEEP * sideways).sum(axis=1), (beyond > STEEP * sideways).sum(axis=1)) >= SIDES
    jump = np.partition(np.where(is_other, np.abs(beyond), np.inf), LINE, axis=1)[:, LINE]
    even = np.median(jump[near[:, 1:]], axis=1)
    in_line = (goes_on <= LINE) & between & (jump > STEEP * even) & (core > SPARSE_LINE * around[:, 1])
    return np.asarray(alone | in_line)
