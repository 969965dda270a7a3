"""Refinement of triangles where the surface bends sharply, so that darts reach the bottom of every crease."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Flags
from ..engine.jit import Array, borrow, kernel, next_tile, run
from .clay import Solid
from .solids import NEARLY, settle

BEND = np.cos(np.radians(20.0))  # cosine between a face and the mean of the faces at its corner
SAG = 0.2  # distance of the surface from the middle of an edge, in units of the spacing
LEVELS = 5
_CHUNK = 1024


@kernel
def settle_all(work: Array, solid: Solid, points: Array) -> None:
    """Move all points, (n, 3) float64, onto the surface of a solid, in place, to about 1e-6."""
    solid = borrow(solid)
    t = next_tile(work)
    while t >= 0:
        for i in range(t * _CHUNK, min((t + 1) * _CHUNK, points.shape[0])):
            x, y, z, _ = settle(solid, points[i, 0], points[i, 1], points[i, 2], 2, NEARLY)
            points[i, 0], points[i, 1], points[i, 2] = x, y, z
        t = next_tile(work)


def settled(solid: Solid, points: Doubles) -> Doubles:
    """Move points, (n, 3) float64, onto the surface of a solid, in place and to about 1e-6; return them."""
    run(settle_all, -(-len(points) // _CHUNK), solid, points)
    return points


def _bent(vertices: Doubles, faces: NDArray[np.int32]) -> Flags:
    """Return which faces lie in a crease, (t,) bool.

    A crease is at a corner where a face deviates by over 20 degrees from the mean of those that meet there.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    means = np.stack([np.bincount(faces.ravel(), np.repeat(normals[:, k], 3), len(vertices)) for k in range(3)], axis=1)
    means = means / np.maximum(np.linalg.norm(means, axis=1, keepdims=True), 1e-300)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    least = np.ones(len(vertices))
    for k in range(3):
        np.minimum.at(least, faces[:, k], (normals * means[faces[:, k]]).sum(axis=1))
    return np.asarray((least < BEND)[faces].any(axis=1))


def areas(corners: Doubles) -> Doubles:
    """Return the areas, (t,), of triangles given by their corners, (t, 3, 3)."""
    edges = corners[:, 1:] - corners[:, :1]
    return np.asarray(0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1))


def refine_creases(solid: Solid, vertices: Doubles, faces: NDArray[np.int32], n: int) -> Doubles:
    """Cut the triangles of a mesh into four where the surface bends sharply, so that creases are filled with points.

    This is repeated, at most five times, where an edge is longer than the spacing of n points on the surface, and its
    middle is farther from the surface than a fifth of that spacing.

    Parameters
    ----------
    vertices : (v, 3) float64
    faces : (f, 3) int32
    n : int
        Number of points to be spread over the triangles.

    Returns
    -------
    (t, 3, 3) float64
        Corners of all triangles, on the surface.
    """
    spacing = float(np.sqrt(areas(vertices[faces]).sum() / n))
    bent = _bent(vertices, faces)
    done, rest = [faces[~bent]], faces[bent]
    for _ in range(LEVELS):
        ends, sides = edges_of(rest, len(vertices))
        middles = 0.5 * (vertices[ends[:, 0]] + vertices[ends[:, 1]])
        long = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1) > spacing
        needed = np.zeros(len(ends), np.bool_)
        needed[sides[long[sides].any(axis=1)]] = True
        found = middles.copy()
        found[needed] = settled(solid, middles[needed])
        off = np.linalg.norm(found - middles, axis=1) > SAG * spacing
        cut = (long & off)[sides].any(axis=1)
        done.append(rest[~cut])
        rest = quarter(rest[cut], sides[cut] + len(vertices))
        vertices = np.concatenate([vertices, found])
    return np.asarray(vertices[np.concatenate([*done, rest])])


def edges_of(faces: NDArray[np.int32], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the distinct edges of triangles, (e, 2) vertices, and the numbers of the three edges of each face, (t, 3).

    count : number of vertices
    """
    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64), axis=1)
    keys, sides = np.unique(pairs[:, 0] * count + pairs[:, 1], return_inverse=True)
    return np.stack([keys // count, keys % count], axis=1), sides.reshape(-1, 3)


def quarter(faces: NDArray[np.int32], middles: NDArray[np.int64]) -> NDArray[np.int32]:
    """Cut each triangle into four at the midpoints of its sides; return the vertices of the small ones, (4 t, 3).

    middles : (t, 3) vertex in the middle of each side: of corners 0 and 1, 1 and 2, 2 and 0
    """
    (a, b, c), (ab, bc, ca) = faces.T, middles.T
    return np.concatenate([np.stack(f, axis=1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]).astype(
        np.int32
    )
