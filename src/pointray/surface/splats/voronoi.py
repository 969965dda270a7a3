"""Voronoi cells in tangent planes: a splat must reach the farthest vertex of its cell (paper, part II).

A neighbour is mapped into the tangent plane with its direction and its distance in space preserved, so that noise does
not bring it closer. A neighbour past a fold is unfolded. A neighbour with the opposite normal is on another sheet and
bounds no cell. Cells are clipped from a square; vertices on its sides do not count, as the surface ends there.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats
from ...engine.jit import Array, borrow, f64, i64, inline, keep_alive, kernel, next_tile, run
from ...engine.kernels.vec import Vec3, add, cross, dot, length, load3_flat, scale, sub, tangents
from .borders import FOLD

OTHER_SHEET = math.cos(math.radians(145))  # cosine of two normals below which points lie on different sheets
BORDER = 1.3  # at a possible border, gaps up to this many typical widths are closed; wider ones if a point is ahead
AHEAD = math.cos(math.radians(60))  # a point within this angle of a gap's direction lies ahead
FLAT = 0.05  # sine of the angle between a seam and a plane below which their intersection is too far away to count
SHARED = 1e-5  # tolerance in bisector distances for vertices on a bisector; regular grids have four points at a vertex
CORNERS = 64  # maximum number of corners of a polygon; no cell is bounded by more neighbours
CHUNK = 2048

Vec2: TypeAlias = tuple[float, float]  # in a tangent plane


@inline
def _unfolded(positions: Array, normals: Array, i: int, j: int, axes: tuple[Vec3, Vec3]) -> Vec2:
    """Return the position of point j in the tangent plane of point i, or (0, 0) if it is on another sheet.

    positions, normals : flat; axes : two tangents of point i, the axes of the result

    A fold consists of two planes at an angle. The offset along the crease is kept. The offset across the crease becomes
    the distance over both planes, (p_j - p_i).(n_j - n_i) / sin(angle), in the direction in which n_j leans. Without a
    fold, j keeps its distance in space and the direction of its projection.
    """
    at = load3_flat(positions, 3 * j)
    d = sub((f64(at[0]), f64(at[1]), f64(at[2])), load3_flat(positions, 3 * i))
    n, m = load3_flat(normals, 3 * i), load3_flat(normals, 3 * j)
    cosine = dot(n, m)
    flat_u, flat_v = dot(d, axes[0]), dot(d, axes[1])
    if cosine > FOLD:
        flat = flat_u * flat_u + flat_v * flat_v
        stretch = math.sqrt(dot(d, d) / flat) if flat > 0.0 else 0.0
        return flat_u * stretch, flat_v * stretch
    if cosine < OTHER_SHEET:
        return 0.0, 0.0
    sine = math.sqrt(1.0 - cosine * cosine)
    u, v = dot(m, axes[0]) / sine, dot(m, axes[1]) / sine
    across = (dot(d, m) - dot(d, n)) / sine
    along = flat_v * u - flat_u * v
    return across * u - along * v, across * v + along * u


@inline
def _cut(polygons: Array, which: int, count: int, a: float, b: float, j: int) -> int:
    """Clip a polygon to the points closer to the origin than to (a, b), the position of point j; return its new size.

    polygons : two polygons. Polygon `which`, with `count` corners, is clipped into the other one. Each row holds x and
        y of a corner, and the point whose bisector the side from that corner lies on, -1 for a side of the initial
        square

    (Arrays that inlined functions return are freed too early.)
    """
    limit = 0.5 * (a * a + b * b)
    edge = SHARED * limit
    kept, corners, spare = 0, polygons[which], polygons[1 - which]
    before = a * corners[count - 1, 0] + b * corners[count - 1, 1] - limit
    for k in range(count):
        here = a * corners[k, 0] + b * corners[k, 1] - limit
        if (here > edge) != (before > edge) and kept < CORNERS:
            last = k - 1 if k > 0 else count - 1
            share = before / (before - here)
            spare[kept, 0] = corners[last, 0] + share * (corners[k, 0] - corners[last, 0])
            spare[kept, 1] = corners[last, 1] + share * (corners[k, 1] - corners[last, 1])
            spare[kept, 2] = j if here > edge else corners[last, 2]
            kept += 1
        if here <= edge and kept < CORNERS:
            for c in range(3):
                spare[kept, c] = corners[k, c]
            kept += 1
        before = here
    return kept


@inline
def _is_cut(corners: Array, count: int, a: float, b: float) -> bool:
    """Return whether a corner of a polygon is closer to (a, b) than to the origin, so that it must be clipped.

    corners : rows that begin with x, y; count : number of corners

    This test comes before `_cut`, because most neighbours clip nothing.
    """
    limit = 0.5 * (a * a + b * b)
    farthest = -np.inf
    for k in range(count):
        farthest = max(farthest, a * corners[k, 0] + b * corners[k, 1])
    return farthest - limit > SHARED * limit


@inline
def _square(positions: Array, i: int, j: int) -> float:
    """Return the squared distance of points i and j. positions : flat"""
    at = load3_flat(positions, 3 * j)
    d = sub((f64(at[0]), f64(at[1]), f64(at[2])), load3_flat(positions, 3 * i))
    return dot(d, d)


@inline
def cell_of(
    positions: Array, normals: Array, i: int, axes: tuple[Vec3, Vec3], near: Array, polygons: Array
) -> tuple[int, int, float]:
    """Clip a square in the tangent plane of point i to its Voronoi cell.

    positions, normals : flat; axes : tangents of point i
    near : row i, then the rows of the neighbours of point i, nearest first
    polygons : memory for two polygons of 64 rows: x and y of a corner relative to point i, and the row of the neighbour
        whose bisector the side from that corner lies on, -1 for a side of the square

    Returns the index of the polygon that is the cell, its number of corners, and the largest squared distance of a
    corner from point i.
    """
    side = math.sqrt(_square(positions, i, i64(near[len(near) - 1])))
    for k in range(4):
        polygons[0, k, 0] = side if k == 0 or k == 3 else -side
        polygons[0, k, 1] = side if k < 2 else -side
        polygons[0, k, 2] = -1.0
    which, count, square = 0, 4, 2.0 * side * side
    for k in range(1, len(near)):
        if _square(positions, i, i64(near[k])) > 4.0 * square:
            break
        a, b = _unfolded(positions, normals, i, i64(near[k]), axes)
        if (a != 0.0 or b != 0.0) and _is_cut(polygons[which], count, a, b):
            count = _cut(polygons, which, count, a, b, near[k])
            which, square = 1 - which, 0.0
            for c in range(count):
                square = max(square, polygons[which, c, 0] ** 2 + polygons[which, c, 1] ** 2)
    return which, count, square


@inline
def mirror(corners: Array, k: int, after: int) -> tuple[Vec2, float]:
    """Mirror the origin at a side of a Voronoi cell, which gives the position of the neighbour behind that side.

    corners : rows that begin with x, y, relative to the cell's point; k, after : corners at both ends of the side

    Also return the distance of the side from the origin.
    """
    x, y = corners[k, 0], corners[k, 1]
    dx, dy = corners[after, 0] - x, corners[after, 1] - y
    t = -(x * dx + y * dy) / max(dx * dx + dy * dy, 1e-300)
    near = min(max(t, 0.0), 1.0)
    return (2.0 * (x + t * dx), 2.0 * (y + t * dy)), math.sqrt((x + near * dx) ** 2 + (y + near * dy) ** 2)


@inline
def _lies_ahead(b: Vec2, ahead: Vec2) -> bool:
    """Return whether point b of a tangent plane lies within 60 degrees of `ahead`, the unit direction of a gap."""
    return b[0] * ahead[0] + b[1] * ahead[1] > AHEAD * math.sqrt(b[0] * b[0] + b[1] * b[1])


@inline
def _nearer_until(start: Vec3, direction: Vec3, d: Vec3) -> float:
    """Return how far a line from `start` along a unit direction stays closer to the origin than to d; may be inf."""
    ahead = dot(direction, d)
    return max(0.5 * dot(d, d) - dot(start, d), 0.0) / ahead if ahead > 0.0 else np.inf


@inline
def up_to_seam(cloud: tuple[Array, Array], i: int, one: int, other: int, distance: float) -> float:
    """Return the distance to a vertex of a Voronoi cell, reduced at a corner where three sheets meet.

    cloud : flat positions and normals; i : the cell's point; one, other : the neighbours between which the vertex lies
    distance : from point i to the vertex, in the tangent plane

    At the corner of a cube there are 270 degrees of surface; unfolded, they leave a quarter of the plane empty. The
    surface ends at the seam of the two other sheets: the cell extends to the corner, and along the seam until one of
    the neighbours is closer.
    """
    positions, normals = cloud
    n, a, b = load3_flat(normals, 3 * i), load3_flat(normals, 3 * one), load3_flat(normals, 3 * other)
    if dot(n, a) > FOLD or dot(n, b) > FOLD or dot(a, b) > FOLD:
        return distance
    at, p, q = load3_flat(positions, 3 * i), load3_flat(positions, 3 * one), load3_flat(positions, 3 * other)
    here = f64(at[0]), f64(at[1]), f64(at[2])
    d, e, seam = sub(p, here), sub(q, here), cross(a, b)
    volume = dot(n, seam)
    if abs(volume) < FLAT * length(seam):
        return distance
    corner = scale(add(scale(cross(b, n), dot(a, d)), scale(cross(n, a), dot(b, e))), 1.0 / volume)
    side = dot(seam, sub(add(d, e), scale(corner, 2.0)))
    direction = scale(seam, math.copysign(1.0, side) / length(seam))
    along = min(_nearer_until(corner, direction, d), _nearer_until(corner, direction, e))
    return (
        min(distance, max(length(corner), length(add(corner, scale(direction, along))))) if along < np.inf else distance
    )


@inline
def _reach(
    cloud: tuple[Array, Array], i: int, corners: Array, count: int, known: tuple[float, Array, float], ahead: Vec2
) -> tuple[float, bool]:
    """Return the distance to the farthest vertex of a Voronoi cell, and whether its point is on no open border.

    cloud : flat positions and normals; i : the cell's point
    corners : `count` corners of the cell: x, y, and the neighbour behind the side from that corner
    known : three values:
        median over the 8 nearest points of point i of the distance to the farthest vertex of their cells
        that median for every point, (n,), or empty
        largest distance of a vertex that counts, divided by the median
    ahead : direction of a possible gap in the surface, or zero

    Farther vertices lie across wide gaps and do not count. Each side also counts with its point closest to point i.
    """
    own, typical, void = known
    within, beyond, closed, facing = 0.0, 0.0, True, False
    for k in range(count):
        last, after = (k - 1 if k > 0 else count - 1), (k + 1 if k + 1 < count else 0)
        x, y = corners[k, 0], corners[k, 1]
        distance, at, here = math.sqrt(x * x + y * y), own, 0.0
        one, other = i64(corners[last, 2]), i64(corners[k, 2])
        if other >= 0:
            b, here = mirror(corners, k, after)
            beyond = max(beyond, min(here, void * own))
            within = max(within, min(here, BORDER * own))
        outward = x * ahead[0] + y * ahead[1] > 0.0
        if one >= 0 and other >= 0:
            distance = up_to_seam(cloud, i, one, other, distance)
            if len(typical) > 0:
                at = max(at, f64(typical[one]), f64(typical[other]))
            if distance <= void * at:
                beyond = max(beyond, distance)
                a, _ = mirror(corners, last, k)
                facing = facing or (outward and (_lies_ahead(a, ahead) or _lies_ahead(b, ahead)))
            if distance <= BORDER * at or not outward:
                within = max(within, min(distance, void * at))
            else:
                closed = False
        elif outward:
            closed = False
    on_border = (ahead[0] != 0.0 or ahead[1] != 0.0) and not closed and not facing
    return within if on_border else beyond, not on_border


@kernel
def _measure(
    work: Array,
    positions: Array,
    normals: Array,
    rows: Array,
    near: Array,
    known: tuple[Array, Array, float],
    out: tuple[Array, Array],
) -> None:
    """Write the distance to the farthest vertex of each row's Voronoi cell, and whether the cell is closed.

    A closed cell is one that no farther neighbour could change. If the medians are given, the second result is whether
    the point is on no open border.

    rows : (m,) the points; near : (m, k) each point, then its neighbours, nearest first
    known : three values:
        outward directions at possible gaps, flat; may be empty
        (n,) for every point the median, over its 8 nearest points, of the distance to the farthest vertex of their
            cells; may be empty
        largest distance of a vertex that counts, divided by that median; farther ones lie across wide gaps
    out : (m,) for both results
    """
    positions, normals, rows = borrow(positions), borrow(normals), borrow(rows)
    near, (gaps, typical, void), (reach, closed) = borrow(near), borrow(known), borrow(out)
    memory = np.empty((2, CORNERS, 3))
    polygons = borrow(memory)
    tile = next_tile(work)
    while tile >= 0:
        for at in range(tile * CHUNK, min((tile + 1) * CHUNK, len(reach))):
            i = i64(rows[at])
            n = load3_flat(normals, 3 * i)
            axes = tangents((f64(n[0]), f64(n[1]), f64(n[2])))
            which, count, square = cell_of(positions, normals, i, axes, near[at], polygons)
            own, ahead = np.inf, (0.0, 0.0)
            if len(typical) > 0:
                gap = load3_flat(gaps, 3 * i)
                ahead = dot(gap, axes[0]), dot(gap, axes[1])
                own = f64(typical[i])
            limits = own, typical, void
            reach[at], closed[at] = _reach((positions, normals), i, polygons[which], count, limits, ahead)
            if len(typical) == 0:
                closed[at] = 4.0 * square <= _square(positions, i, i64(near[at, near.shape[1] - 1]))
        tile = next_tile(work)
    keep_alive(memory)


class Neighborhood(NamedTuple):
    """Points and their nearest neighbours, as row numbers of a cloud.

    rows : (m,) int32 or int64, the points; near : (m, k) int32, each point first, then its neighbours, nearest first
    """

    rows: NDArray[np.integer[Any]]
    near: NDArray[np.int32]


def measure_cells(
    positions: Floats,
    normals: Floats,
    neighborhood: Neighborhood,
    gaps: Floats | None = None,
    typical: Floats | None = None,
    void: float = np.inf,
) -> tuple[Floats, Flags]:
    """Measure Voronoi cells in tangent planes: the distance to the farthest vertex, which a splat must reach.

    Parameters
    ----------
    positions : (n, 3) float32
        All distinct.
    normals : (n, 3) float32
        Unit normals.
    neighborhood : Neighborhood
        The m points to measure, and their neighbours.
    gaps : (n, 3) float32, optional
        Outward direction for points on a possible border, else zero.
    typical : (n,) float32, optional
        Median, over the 8 nearest points of each point, of the distance to the farthest vertex of their cells. None:
        every vertex counts. Otherwise a vertex counts if its distance is at most `void` (in the direction of a gap,
        1.3) times the median of this point or of one of the two points that share the vertex, where the surface may
        continue more sparsely.
    void : float
        Largest distance of a vertex that counts, divided by the median. A vertex lies in the middle of a gap, so that
        wider gaps stay open.

    Returns
    -------
    reach : (m,) float32
        Distance to the farthest vertex; 0 where no neighbour bounds the cell.
    closed : (m,) bool
        With `gaps` and `typical`, whether the point is on no open border; else whether no farther neighbour could
        change the cell.
    """
    reach, closed = np.empty(len(neighborhood.rows), np.float32), np.empty(len(neighborhood.rows), np.bool_)
    none = np.empty(0, np.float32)
    flat = np.ascontiguousarray(positions).reshape(-1), np.ascontiguousarray(normals).reshape(-1)
    near = np.ascontiguousarray(neighborhood.near)
    known = (none, none, void) if typical is None or gaps is None else (gaps.reshape(-1), typical, void)
    run(_measure, -(-len(reach) // CHUNK), *flat, neighborhood.rows, near, known, (reach, closed))
    return reach, closed
