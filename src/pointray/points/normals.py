"""Normals: estimated where a cloud has none, mended where some are missing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from ..data import Points
from ..neighbors import distinct, neighbors

NEIGHBORS = 16  # points that a plane is fitted to
MENDING = 8  # good normals that stand in for a missing one
PROPAGATION = 8  # of the neighbours, how many a sign may pass to

Floats = NDArray[np.float32]
_near = neighbors  # `neighbors` is also the name of a public parameter

_CHUNK = 1 << 15


def estimate_normals(points: Points, neighbors: int | None = None, viewpoint: ArrayLike | None = None) -> Points:
    """Normals of planes fitted to the nearest neighbours, turned to agree with each other.

    Parameters
    ----------
    points : Points
    neighbors : int, optional
        How many points a plane is fitted to, the point itself included. None: 16.
    viewpoint : (3,) array_like, optional
        World position of the scanner: every normal is turned towards it. None: the signs pass from point to point
        along a minimum spanning tree, from the highest point of each connected part, whose normal is turned up.

    Returns
    -------
    Points
        The same points with unit normals, (n, 3) float32; rows that are not finite have the normal 0.

    Raises
    ------
    ValueError
        If fewer than three places are taken, `neighbors` is less than 3, or the viewpoint is not three numbers.

    References
    ----------
    Hoppe, DeRose, Duchamp, McDonald, Stuetzle: Surface Reconstruction from Unorganized Points (1992), section 3.
    """
    k = NEIGHBORS if neighbors is None else neighbors
    if k < 3:
        raise ValueError(f"a plane needs at least 3 neighbors, not {neighbors}")
    eye = None if viewpoint is None else _check_viewpoint(viewpoint) - points.origin
    finite = np.flatnonzero(points.finite)
    rows, places = distinct(points.positions[finite])
    if len(rows) < 3:
        raise ValueError(f"a plane needs at least 3 points: {len(points):,} points take {len(rows)} different places")
    positions = points.positions[finite][rows]
    _, near = _near(positions, k)
    unit = _fit_planes(positions, near)
    sign = _propagate(positions, unit, near) if eye is None else np.sum(unit * (eye - positions), axis=1)
    unit[sign < 0] *= -1
    normals = np.zeros_like(points.positions)
    normals[finite] = unit[places]
    return points.with_normals(normals)


def mend_normals(points: Points) -> tuple[Points, str | None]:
    """The points with unit normals wherever the position is finite, and what had to be done for it.

    Parameters
    ----------
    points : Points

    Returns
    -------
    points : Points
        A missing normal (zero, NaN or infinite) is the mean of the good ones nearest to it; if none is good, all are
        estimated. Rows that are not finite have the normal 0.
    message : str or None
        None: all normals were good.
    """
    finite = points.finite
    if points.normals is None:
        return estimate_normals(points), "the points have no normals: estimated from their neighbours"
    unit, good = _normalise(points.normals)
    lost = finite & ~good
    if not (finite & good).any():
        return estimate_normals(points), "all normals are zero or not finite: estimated from the points' neighbours"
    unit[~(finite & good)] = 0
    if lost.any():
        unit[lost] = _mean_of_nearest(points.positions, unit, np.flatnonzero(finite & good), lost)
    message = f"{lost.sum():,} of {len(points):,} normals are zero or not finite: taken from their neighbours"
    return points.with_normals(unit), message if lost.any() else None


def _check_viewpoint(viewpoint: ArrayLike) -> NDArray[np.float64]:
    eye = np.asarray(viewpoint, np.float64)
    if eye.shape != (3,) or not np.isfinite(eye).all():
        raise ValueError(f"viewpoint must be three finite numbers, not {eye.tolist()}")
    return eye


def _normalise(normals: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Unit vectors, and which of them mean something."""
    wide = normals.astype(np.float64)  # no square of a float32 is too large or too small
    length = np.sqrt(np.einsum("ij,ij->i", wide, wide))
    good = np.isfinite(length) & (length > 0)
    return (wide / np.where(good, length, 1)[:, None]).astype(np.float32), good


def _mean_of_nearest(positions: Floats, unit: Floats, good: NDArray[Any], lost: NDArray[np.bool_]) -> Floats:
    good = good[distinct(positions[good])[0]]  # a thousand points at one place make the search crawl
    _, near = neighbors(positions[good], MENDING, positions[lost])
    nearest = unit[good][near]
    mean, sound = _normalise(nearest.mean(axis=1))
    mean[~sound] = nearest[~sound, 0]  # they cancel out
    return mean


def _fit_planes(positions: Floats, near: NDArray[np.int32]) -> Floats:
    """The direction of least spread of each row's neighbours, (n, 3): unit, of either sign."""
    unit = np.empty_like(positions)
    for start in range(0, len(near), _CHUNK):
        part = slice(start, start + _CHUNK)
        offsets = positions[near[part]] - positions[part, None]  # first to the point: large coordinates cancel
        offsets -= offsets.mean(axis=1, keepdims=True)
        spread = np.matmul(offsets.transpose(0, 2, 1), offsets).astype(np.float64)
        unit[part] = np.linalg.eigh(spread)[1][:, :, 0]
    return unit


def _propagate(positions: Floats, unit: Floats, near: NDArray[np.int32]) -> NDArray[np.float32]:
    """(n,) float32: 1, or -1 where the normal has to be turned so that neighbours agree and the tops point up."""
    n = len(positions)
    tree = _spanning_tree(unit, near[:, 1 : PROPAGATION + 1])
    seeds, sign = _highest(positions, unit, connected_components(tree, directed=False)[1])
    # One more node, tied to the seed of each part, makes one tree of all of them.
    root = coo_array((np.ones(len(seeds)), (np.full(len(seeds), n), seeds)), shape=(n + 1, n + 1))
    tree.resize((n + 1, n + 1))
    _, parent = breadth_first_order(tree + root, n, directed=False)
    parent[n] = n
    turn = np.ones(n + 1, np.float32)
    inner = parent[:n] < n
    turn[:n][inner] = np.where(np.einsum("ij,ij->i", unit[inner], unit[parent[:n][inner]]) < 0, -1, 1)
    turn[seeds] = sign
    # The sign of a point is the product along its way to the root: each pass doubles the part that is done.
    while (parent < n).any():
        turn *= turn[parent]
        parent = parent[parent]
    return turn[:n]


def _spanning_tree(unit: Floats, near: NDArray[np.int32]) -> Any:
    """The tree over the neighbours whose normals differ least."""
    n, k = near.shape
    one, other = np.repeat(np.arange(n, dtype=np.int32), k), near.ravel()
    differ = 1 - np.abs(np.einsum("ij,ij->i", unit[one], unit[other]))
    weight = np.maximum(differ, 0) + np.float32(1e-6)  # 0 would be no edge
    graph = coo_array((weight, (one, other)), shape=(n, n)).tocsr()
    return minimum_spanning_tree(graph)  # takes an edge that is there both ways for one


def _highest(positions: Floats, unit: Floats, part: NDArray[np.int32]) -> tuple[NDArray[Any], NDArray[np.float32]]:
    """The highest point of each part, and the sign that turns its normal up (or out, where it lies level)."""
    order = np.argsort(positions[:, 2], kind="stable")
    seeds = np.empty(part.max() + 1, np.int64)
    seeds[part[order]] = order  # the last one stays
    count = np.bincount(part)
    middle = np.stack([np.bincount(part, weights=column) / count for column in positions.T], axis=1)
    out = positions[seeds] - middle
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-30)
    up = np.sum(unit[seeds] * (np.array([0, 0, 1]) + 0.5 * out), axis=1)
    return seeds, np.where(up < 0, -1, 1).astype(np.float32)
