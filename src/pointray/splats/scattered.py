"""Scattered points: how large their spheres are, and in which direction their neighbourhood lies open."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arguments import check_choice, check_positive
from ..choices import SCATTER
from ..data import Points
from ..kernels.tree import DISCS, SPHERES
from ..neighbors import NeighborTree, distinct, kd_order, take
from ..points.normals.estimate import estimate_normals
from ..points.usual import Usual
from ..tree.build import Splats
from .gaps import largest_reach

NEIGHBORS = 8  # whose distances give the local spacing
AROUND = 24  # neighbours that the direction of a neighbourhood follows from
SIZE = 0.35  # a radius, in local spacings
CLOSEST = 0.75  # the most, in distances to the nearest other place: spheres overlap by up to a half
LEAST = 0.5  # the least of a chosen radius that is left, however close the nearest place is: double points stay visible
WIDEST = 1.5  # the most, in radii of the neighbours: isolated points are not drawn much larger than others
LARGEST = 0.98  # share of all places whose radii limit those of the others: a few points far off are no balloons
PIECE = 1 << 18  # rows whose neighbours are held at once

Floats = NDArray[np.float32]


class Drawing(NamedTuple):
    """How scattered points are drawn.

    scatter : "spheres", "discs", "surface" (as all others) or "none" (left out)
    size : factor for their radii
    """

    scatter: str = "surface"
    size: float = 1.0

    @property
    def kind(self) -> int:
        """SPHERES or DISCS."""
        return DISCS if self.scatter == "discs" else SPHERES


def check_drawing(scatter: str, scatter_size: float) -> Drawing:
    """Check the parameters `scatter` and `scatter_size` of `Model`."""
    return Drawing(check_choice(scatter, "scatter", SCATTER), check_positive(scatter_size, "scatter_size"))


def check_mask(mask: ArrayLike | None, count: int) -> NDArray[np.bool_] | None:
    """Check a mask of scattered points: `count` bools, or None."""
    if mask is None:
        return None
    try:
        checked = np.asarray(mask)
    except ValueError as error:  # of rows of several lengths
        raise ValueError(f"_scattered must be {count} bools: {error}") from None
    if checked.dtype != np.bool_ or checked.shape != (count,):
        raise ValueError(f"_scattered must be {count} bools, not {checked.dtype} of shape {checked.shape}")
    return checked


def make_scattered(
    points: Points, mask: NDArray[np.bool_], rows: NDArray[np.int32], drawing: Drawing, given: Floats | None = None
) -> Splats:
    """Return the scattered points among some points, with radii and directions.

    A sphere's direction is the mean one of its neighbourhood, from the middle of the neighbours outwards; a disc's is
    its normal, which is estimated where the points have none.

    Parameters
    ----------
    points : Points
        All points, also those of the surface: they are neighbours too.
    mask : (n,) bool
        Which of them are scattered, at least one.
    rows : (n,) int32
        The caller's row of each point.
    drawing : Drawing
        How they are drawn.
    given : (n,) float32, optional
        Radii of all points. None: 0.35 of the mean distance to the 8 nearest other places, limited by the neighbours,
        by the 98th percentile of all, and so that none covers 2% of a picture of the cloud.

    Raises
    ------
    ValueError
        If all positions are equal and no radii are given.
    """
    some, positions = np.flatnonzero(mask), points.positions
    first, ids = distinct(positions)
    if len(first) > 1:
        chosen, outwards = _at_places(take(positions, first))
        radii, directions = chosen[ids] if given is None else given, outwards[ids]
    elif given is None:
        raise ValueError("points: all are at one place, so that no radius can be chosen: give radii")
    else:
        radii, directions = given, np.tile(np.array([0, 0, 1], np.float32), (len(positions), 1))
    if drawing.kind == DISCS:
        directions = np.asarray((points if points.normals is not None else estimate_normals(points)).normals)
    return Splats(
        positions[some],
        unit_vectors(directions[some]),
        np.asarray(radii[some] * np.float32(drawing.size), np.float32),
        rows[some],
        None if points.colors is None else points.colors[some],
    )


def _at_places(places: Floats) -> tuple[Floats, Floats]:
    """Radii (m,) and directions (m, 3) at different places."""
    order = kd_order(places)
    x = take(places, order)
    tree, count = NeighborTree(x, in_order=True), min(AROUND + 1, len(x))
    radii, outwards = np.empty(len(x), np.float32), np.empty_like(x)
    near = np.empty((len(x), min(NEIGHBORS, len(x) - 1)), np.int32)
    for start in range(0, len(x), PIECE):
        part = slice(start, start + PIECE)
        found = tree.query(count, x[part])
        distances = found.distances[:, 1 : NEIGHBORS + 1]
        spacing = distances.mean(axis=1)
        radii[part] = SIZE * np.minimum(spacing, np.maximum(CLOSEST / SIZE * distances[:, 0], LEAST * spacing))
        near[part] = found.indices[:, 1 : NEIGHBORS + 1]
        outwards[part] = unit_vectors(x[part] - x[found.indices].mean(axis=1))
    limited, directions = np.empty_like(radii), np.empty_like(outwards)
    limited[order] = np.minimum(radii, WIDEST * np.median(radii[near], axis=1))
    np.minimum(
        limited, np.float32(min(float(np.quantile(limited, LARGEST)), largest_reach(places, Usual()))), out=limited
    )
    directions[order] = unit_vectors(outwards + outwards[near].sum(axis=1))
    return limited, directions


def unit_vectors(vectors: Floats) -> Floats:
    """Vectors of unit length; up where there is no direction."""
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    known = size > 0
    out = np.divide(vectors, size, out=np.zeros_like(vectors), where=known)
    out[~known[:, 0], 2] = 1.0
    return np.asarray(out, np.float32)
