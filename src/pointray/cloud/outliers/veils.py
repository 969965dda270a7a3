"""Veils: what a scanner measures between foreground and background, where its beam meets the edge of something.

Seen from the scanner, a surface goes on from each point to some of those beside it: even at a grazing angle, in one
direction. A point of a veil stands by itself between what is nearer and what is farther: hardly any of the points
beside it is about as far. It is sparser than these, too: where all of a body is seen from one place, its back shows
between the points of its front, but they are as dense as each other.

Where an edge runs along a row or column of the scan, the mixed returns make a line, on which each point goes on to two
others. Such a point is far from most beside it, some nearer, some farther, which are not far from most beside them: the
ground at a grazing angle is as steep before and behind, and a wire has nothing nearer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..neighbors import neighbors
from .local_fits import CORE

Floats = NDArray[np.float32]

BESIDE = CORE  # points beside each, as seen from the scanner
STEEP = 4.0  # a surface recedes by no more than this for a step to the side: 76 degrees
MOST = 1  # points beside a point of a veil that go on from it
LINE, SIDES = 3, 2  # points that go on from one of a line, at most; points nearer, and points farther, at least
SPARSE_LINE = 2.0  # and its neighbours in space are so many times as far away as those of the denser side
SPARSE = 2.5  # and its neighbours in space are so many times as far away as those of the points beside it


def veiled(positions: Floats, core: Floats, eye: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which positions stand by themselves between what is nearer and what is farther.

    Parameters
    ----------
    positions : (n, 3) float32
    core : (n,) float32
        Distance to each one's `survey.CORE`-th neighbour.
    eye : (3,) float64
        The scanner, relative to the same origin.
    """
    away = positions - eye
    ranges = np.linalg.norm(away, axis=1)
    directions = (away / np.maximum(ranges, 1e-30)[:, None]).astype(np.float32)
    angles, near = neighbors(directions, BESIDE + 1)
    # A step is as wide as usual even where two points lie in one direction.
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
