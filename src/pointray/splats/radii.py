"""Radii for points that come without: as small as covers the surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..neighbors import distinct, morton_order, neighbors

Floats = NDArray[np.float32]

RANK = 8  # the neighbour that a radius reaches to
SCALE = 1.0  # times the distance to it: 8.3 splats over a point of the surface, one point in 10^5 uncovered
STRAY = 4.0  # a radius is at most this many times the usual one around it
WIDEST = 4.0  # and at most this many times that of the sparsest hundredth: a stray group is usual to itself
CLUMP = 0.1  # points this much closer than usual count as one


def choose_radii(positions: Floats) -> Floats:
    """Radii that cover the surface about eight times.

    A radius is the distance to the 8th neighbour, or its mean over the neighbours where that is more (the count in a
    small disc is noisy). Points at the same place, or in a clump much smaller than the spacing, count as one; a stray
    point far away gets a radius like those of its nearest neighbours.

    Parameters
    ----------
    positions : (n, 3) float32
        Finite.

    Returns
    -------
    (n,) float32
        In the unit of the positions, greater than 0.

    Raises
    ------
    ValueError
        If all points are at one place: nothing says how large a splat is.
    """
    order = morton_order(positions)  # neighbours in space are near in memory: half the time
    path = positions[order]
    rows, places = distinct(path)
    if len(rows) < 2:
        what = "one point says" if len(positions) == 1 else f"{len(positions):,} points at one place say"
        raise ValueError(f"{what} nothing about the spacing: give radii")
    reach = _reach(path[rows])
    usual = float(np.quantile(reach, 0.25))
    if reach.min() < CLUMP * usual:
        merged, members = distinct(path[rows], CLUMP * usual)
        if len(merged) > 1:
            reach, places = _reach(path[rows][merged]), members[places]
    radii = np.empty(len(positions), np.float32)
    radii[order] = (np.float32(SCALE) * reach)[places]
    return radii


def _reach(positions: Floats) -> Floats:
    """The distance to the 8th neighbour: smoothed, but never less, and no outliers."""
    distances, near = neighbors(positions, RANK + 1)
    raw = distances[:, -1]
    others = raw[near[:, 1:]]
    raw = np.minimum(raw, np.float32(STRAY) * np.median(others, axis=1))
    raw = np.minimum(raw, np.float32(WIDEST * np.quantile(raw, 0.99)))
    return np.asarray(np.maximum(raw, raw[near].mean(axis=1)))


def check_radii(radii: ArrayLike, n: int) -> Floats:
    """The caller's radii as (n,) float32; ValueError names the first row that is no radius."""
    array = np.asarray(radii)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"radii must be numbers, not {array.dtype}")
    if array.shape != (n,):
        raise ValueError(f"radii must have the shape ({n},), one for each point, not {array.shape}")
    with np.errstate(over="ignore"):
        narrow = np.ascontiguousarray(array, np.float32)
    bad = ~((narrow > 0) & np.isfinite(narrow))
    if bad.any():
        row = int(bad.argmax())
        raise ValueError(f"radii must be finite and greater than 0; row {row} is {array[row]}")
    return narrow
