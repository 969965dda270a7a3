"""Limits of the gaps that a disc spans: three local spacings; no limit between rims that agree in plane and slope.

A vertex of a point's Voronoi cell lies in the middle of a gap between it and two neighbours. Three such points agree if
each two of them have similar normals and lie on an arc. In disorder, as in a tree crown, a disc does not reach vertices
farther away than half of the limit unless the points agree. The spacing is that of the whole cloud, including scattered
points: a few points of a crown look like a surface, and their discs must not cover the leaves around them.

A point is in disorder if it agrees with few of its neighbours, or if its disc covers scattered points. A folded surface
is not in disorder: the rims of a gap across its edge do not agree, but most neighbours do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats
from ...cloud.neighbors import NeighborTree, distinct
from ...cloud.statistics import CloudStatistics
from ...engine.jit import Array, borrow, f32, f64, i64, inline, keep_alive, kernel, next_tile, run
from ...engine.kernels.vec import dot, load3_flat, sub, tangents
from .closed import NEAREST, distances
from .voronoi import CHUNK, CORNERS, Neighborhood, Vec2, cell_of, mirror, up_to_seam

WIDEST = 3.0  # limit of gaps between rims that do not agree, in local spacings
# Largest reach of a disc in disorder, as a share of the cloud's diagonal: it covers less than 2% of an image that the
# cloud fills. For n points the share is at least 1 / sqrt(n), as few points fill an image only if each covers much of
# it. Up to FEW points have no limit.
LARGEST, FEW = 0.04, 20
SPACING = math.sqrt(math.pi / 8)  # factor from the distance of the 8th neighbour to the spacing of regular points
SLOPE = math.cos(math.radians(35))  # least cosine of the normals of two rims that agree
PLANE = 0.15  # their maximum distance from an arc, as a share of their distance
OBTUSE = math.cos(math.radians(150))  # the largest angle between three points with a gap between them
ALIKE, ROUGH = math.cos(math.radians(45)), 0.2  # like SLOPE and PLANE, for a rough sheet and normals of either sign
# Share of the 20 nearest neighbours on a rough sheet with a point, averaged over the point and these. At gaps of over
# 3 spacings with rims that do not agree, it is below 0.45 at 90% of the points of a tree or shrub.
ORDER = 0.45
# Shares of points in disorder whose discs reach too far. Below SOME these points are treated as surface; above MUCH all
# of the cloud is treated as disorder. Meshes and range scans: up to 0.001, trees: 0.02 to 0.3.
SOME, MUCH = 0.01, 0.03
MIXED = 2  # a disc that covers this many scattered points is in disorder
COMMON = 0.98  # quantile of the spacings that limits all: a few remote points do not get wide discs
PIECE = 1 << 18  # rows at a time

Around = Callable[[NDArray[Any]], NDArray[np.int32]]


@inline
def bend(positions: Array, normals: Array, i: int, j: int) -> tuple[float, float]:
    """Return the cosine between the normals of points i and j, and how far the points are off a common arc.

    The arc is perpendicular to both normals: on it, the line between the points is perpendicular to the sum of the
    normals. The deviation is divided by the distance of the points. The normals may have either sign.
    positions, normals : flat
    """
    d = sub(load3_flat(positions, 3 * j), load3_flat(positions, 3 * i))
    n, m = load3_flat(normals, 3 * i), load3_flat(normals, 3 * j)
    cosine, size = dot(n, m), math.sqrt(dot(d, d))
    off = dot(d, n) + (dot(d, m) if cosine >= 0.0 else -dot(d, m))
    return cosine, 0.5 * abs(off) / size if size > 0.0 else 0.0


@inline
def _agree(positions: Array, normals: Array, i: int, j: int) -> bool:
    """Return whether points i and j, on two sides of a gap, belong to one smooth surface.

    positions, normals : flat

    Their normals differ by at most 35 degrees then, and both are near an arc perpendicular to them.
    """
    cosine, off = bend(positions, normals, i, j)
    return cosine >= SLOPE and off <= PLANE


@inline
def _is_obtuse(a: Vec2, b: Vec2) -> bool:
    """Return whether the triangle of the origin, a and b has an angle over 150 degrees.

    Three points around a gap then lie side by side along its rim, so that the gap is beside them, not between them.
    """
    dot_a, dot_b = a[0] * (a[0] - b[0]) + a[1] * (a[1] - b[1]), b[0] * (b[0] - a[0]) + b[1] * (b[1] - a[1])
    size_a, size_b = math.hypot(a[0], a[1]), math.hypot(b[0], b[1])
    side = math.hypot(a[0] - b[0], a[1] - b[1])
    here = a[0] * b[0] + a[1] * b[1]
    return here < OBTUSE * size_a * size_b or dot_a < OBTUSE * size_a * side or dot_b < OBTUSE * size_b * side


@kernel
def _limit(
    work: Array, cloud: tuple[Array, Array], neighborhood: tuple[Array, Array], limits: Array, reach: Array
) -> None:
    """Write the reach of each row's Voronoi cell: the distance to its farthest vertex that is not across a wide gap.

    cloud : flat positions and normals; neighborhood : rows (m,), and each row with its neighbours (m, k)
    limits : (m,) largest distance of a vertex, half the width of a gap. Farther vertices count only if the points
        around them belong to one smooth surface
    reach : (m,) output
    """
    (positions, normals), (rows, near) = borrow(cloud), borrow(neighborhood)
    limits, reach = borrow(limits), borrow(reach)
    memory = np.empty((2, CORNERS, 3))
    polygons = borrow(memory)
    tile = next_tile(work)
    while tile >= 0:
        for at in range(tile * CHUNK, min((tile + 1) * CHUNK, len(reach))):
            i = i64(rows[at])
            n = load3_flat(normals, 3 * i)
            axes = tangents((f64(n[0]), f64(n[1]), f64(n[2])))
            which, count, _ = cell_of(positions, normals, i, axes, near[at], polygons)
            corners, limit, farthest = polygons[which], f64(limits[at]), 0.0
            for k in range(count):
                last, after = (k - 1 if k > 0 else count - 1), (k + 1 if k + 1 < count else 0)
                one, other = i64(corners[last, 2]), i64(corners[k, 2])
                b, middle = mirror(corners, k, after)
                if other >= 0 and (middle <= limit or _agree(positions, normals, i, other)):
                    farthest = max(farthest, min(middle, max(limit, 0.5 * math.hypot(b[0], b[1]))))
                if one >= 0 and other >= 0:
                    a, _ = mirror(corners, last, k)
                    corner = math.sqrt(corners[k, 0] ** 2 + corners[k, 1] ** 2)
                    corner = up_to_seam((positions, normals), i, one, other, corner)
                    if corner <= limit or (
                        _agree(positions, normals, i, one)
                        and _agree(positions, normals, i, other)
                        and _agree(positions, normals, one, other)
                        and not _is_obtuse(a, b)
                    ):
                        farthest = max(farthest, corner)
            reach[at] = f32(farthest)
        tile = next_tile(work)
    keep_alive(memory)


@kernel
def _count(work: Array, cloud: tuple[Array, Array], neighborhood: tuple[Array, Array], out: Array) -> None:
    """Write the share of each row's neighbours that lie on a rough sheet with it: near an arc, with similar normals.

    cloud : flat positions and normals; neighborhood : rows (m,), and each row with its neighbours (m, k)
    """
    (positions, normals), (rows, near), out = borrow(cloud), borrow(neighborhood), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for at in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            count = 0
            for k in range(1, near.shape[1]):
                cosine, off = bend(positions, normals, i64(rows[at]), i64(near[at, k]))
                if abs(cosine) >= ALIKE and off <= ROUGH:
                    count += 1
            out[at] = f32(count) / f32(near.shape[1] - 1)
        tile = next_tile(work)


def bridged(positions: Floats, normals: Floats, neighborhood: Neighborhood, limits: Floats) -> Floats:
    """Return the reach of Voronoi cells: the distance to the farthest vertex that is not across a wide gap.

    Parameters
    ----------
    positions : (n, 3) float32
        All distinct.
    normals : (n, 3) float32
        Unit normals.
    neighborhood : Neighborhood
        The m points to measure, and their neighbours.
    limits : (m,) float32
        Half the width of the widest gap in the surface that the disc of each of these points may span.

    Returns
    -------
    (m,) float32
        Distance to the farthest vertex or side of the cell that is within the limit, or farther where the points on
        both sides of the gap belong to one smooth surface; 0 if there is none.
    """
    reach = np.empty(len(neighborhood.rows), np.float32)
    flat = np.ascontiguousarray(positions).reshape(-1), np.ascontiguousarray(normals).reshape(-1)
    queried = np.ascontiguousarray(neighborhood.rows, np.int32), np.ascontiguousarray(neighborhood.near)
    run(_limit, -(-len(reach) // CHUNK), flat, queried, np.ascontiguousarray(limits), reach)
    return reach


def is_disordered(positions: Floats, normals: Floats, rows: NDArray[np.int32], around: Around) -> Flags:
    """Return which points lie on smooth sheets with few of their neighbours, as in a tree crown.

    The share of such neighbours is averaged over the point and its neighbours; below 0.45 a point is in disorder.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32
        Unit normals.
    rows : (m,) int32
        The points to examine.
    around : callable
        Returns given rows and their neighbours, (m, k) int32.

    Returns
    -------
    (m,) bool
    """
    out = np.empty(len(rows), np.bool_)
    flat = np.ascontiguousarray(positions).reshape(-1), np.ascontiguousarray(normals).reshape(-1)
    for start in range(0, len(rows), PIECE):
        part = slice(start, start + PIECE)
        some, which = np.unique(around(rows[part]), return_inverse=True)
        queried, shares = np.asarray(some, np.int32), np.empty(len(some), np.float32)
        run(_count, -(-len(some) // CHUNK), flat, (queried, np.ascontiguousarray(around(queried))), shares)
        out[part] = shares[which.reshape(len(rows[part]), -1)].mean(axis=1) < ORDER
    return out


class Limits(NamedTuple):
    """Limits of the gaps in a surface that the discs of n points may span.

    half : (n,) float32, half the width of the widest gap. Wider gaps are spanned only between points of one smooth
        surface
    others : neighbour search over the scattered points of the cloud, or None. The limits hold for discs that cover two
        of these points, and for discs in disorder, as in a tree crown
    """

    half: Floats
    others: NeighborTree | None

    def are_mixed(self, positions: Floats, reach: Floats) -> Flags:
        """Return which discs cover at least two scattered points, (m,).

        positions : (m, 3), the centres of the discs; reach : (m,), their radii
        """
        if self.others is None or not len(positions):
            return np.zeros(len(positions), np.bool_)
        return np.asarray(self.others.query(MIXED, positions).distances[:, -1] < reach)


def find_limits(
    positions: Floats, near: NDArray[np.int32], others: Floats | None, statistics: CloudStatistics
) -> Limits:
    """Find the widest gap that the disc of each point may span: three local spacings, with two upper limits.

    The upper limits are the 98th percentile of these gaps over all points, and a gap twice as wide as `largest_reach`,
    a share of the cloud's diagonal.

    Parameters
    ----------
    positions : (n, 3) float32
        All distinct. Clouds of up to 20 points have no limits.
    near : (n, k) int32
        Rows of each point and its nearest neighbours.
    others : (m, 3) float32, optional
        Scattered points of the same cloud. They get no limits, but count for the local spacing.
    statistics : CloudStatistics
        Of the whole cloud.
    """
    count = len(positions)
    limits = np.full(count, np.inf, np.float32)
    if near.shape[1] <= NEAREST or count + (0 if others is None else len(others)) <= FEW:
        return Limits(limits, None)
    scattered = None if others is None or not len(others) else NeighborTree(others[distinct(others)[0]])
    for start in range(0, count, PIECE):
        part = np.arange(start, min(start + PIECE, count))
        limits[part] = np.float32(0.5 * WIDEST * SPACING) * _eighth(
            positions, Neighborhood(part, near[part]), scattered
        )
    np.minimum(limits, np.float32(statistics.quantile("wide gap", limits, COMMON)), out=limits)
    np.minimum(limits, np.float32(largest_reach(positions, statistics)), out=limits)
    return Limits(limits, scattered)


def largest_reach(positions: Floats, statistics: CloudStatistics) -> float:
    """Return the largest reach of a disc in disorder, as in a tree crown, or the largest radius of a sphere.

    The reach is the distance to the farthest vertex of a Voronoi cell. A disc of this size covers less than 2% of an
    image that the cloud fills, or more in clouds of up to 625 points. For up to 20 points the result is inf.

    positions : (n, 3) of the cloud, or of a part of it; statistics : of the whole cloud
    """
    count = len(positions)
    share = statistics.get_or_compute(
        "reach in diagonals", lambda: max(LARGEST, 1 / math.sqrt(count)) if count > FEW else math.inf
    )
    return share * statistics.diagonal("diagonal", positions)


def _eighth(positions: Floats, neighborhood: Neighborhood, others: NeighborTree | None) -> Floats:
    """Return the distance of each point from its 8th neighbour, (m,), counting the points of `others` too.

    neighborhood : the m points, and their neighbours among `positions`, nearest first
    others : search over further points of the cloud, or None
    """
    eighth = distances(positions, neighborhood, NEAREST)
    if others is None:
        return eighth
    found = others.query(NEAREST, positions[neighborhood.rows]).distances
    beside = np.flatnonzero(found[:, 0] < eighth)
    neighborhood = Neighborhood(neighborhood.rows[beside], neighborhood.near[beside])
    near = [distances(positions, neighborhood, k) for k in range(1, NEAREST + 1)]
    both = np.column_stack([*near, found[beside]])
    eighth[beside] = np.partition(both, NEAREST - 1, axis=1)[:, NEAREST - 1]
    return eighth
