"""Closed Voronoi cells without special cases, which are nearly all, measured 16 points at a time.

A neighbour at b in the tangent plane (see `voronoi`) becomes the point q = 2 b / |b|^2: a position x is closer to the
origin where x.q < 1. The vertices of the cell correspond to the edges of the convex hull of these points. A walk around
the hull (Jarvis 1973) starts at the nearest neighbour and visits about six of them; lanes are points. Rare cases are
left to `voronoi.measure_cells`: open cells, corners of three sheets, folds that bring a neighbour closer.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats
from ...engine.jit import Array, borrow, f32, i64, inline, keep_alive, kernel, next_tile, run
from ...engine.simd import (
    F16,
    I16,
    ONE,
    ZERO,
    Mask,
    bits,
    broadcast16,
    gather_rows8,
    lane,
    load16,
    mask16,
    one_bit,
    select,
    store,
    vabs,
    vmax,
    vmin,
    vsqrt,
)
from .borders import FOLD
from .voronoi import OTHER_SHEET, Neighborhood

OPEN, CLOSED, UNSURE = 0, 1, 2  # a cell's state: more neighbours could change it; they could not; not measured here
STEPS = 14  # fewer than one cell in a million has more sides, for random points
SHARP = 0.01  # sine of the angle between two sides below which float32 cannot resolve their intersection
HALF_FOLD = math.cos(math.radians(22.5))  # of two normals 45 degrees apart, one is 22.5 from any third
AWAY = math.cos(math.radians(149))  # cosine of opposite normals, slightly above `sheets.OPPOSED`
SECTORS = 32  # around a point, see `_sector`
EMPTY = 8  # whole sectors in any gap of 115 degrees, which is at least 9.8 sectors wide
NEAREST = 8  # nearest neighbours, over which medians are taken
# Cells wider than this share of the distance to the 8th neighbour may be at a border; regular points: 0.46, random: 0.6
WIDE = 0.5
TINY = f32(1e-30)
ALL = 0xFFFF
CHUNK = 2048

Three16 = tuple[F16, F16, F16]


@inline
def _dot16(a: Three16, b: Three16) -> F16:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def _tangents16(n: Three16) -> tuple[Three16, Three16]:
    """Return two unit vectors perpendicular to each of 16 unit normals and to each other."""
    sign = select(n[2] >= ZERO, broadcast16(ONE), -ONE)
    a = -ONE / (sign + n[2])
    b = n[0] * n[1] * a
    return (sign * n[0] * n[0] * a + ONE, sign * b, -ONE * sign * n[0]), (b, n[1] * n[1] * a + sign, -ONE * n[1])


@inline
def _sector(x: F16, y: F16) -> F16:
    """Return in which of 32 sectors around the origin each direction (x, y) lies, 0 to 31, with a fraction.

    Sectors divide the square |x| + |y| = 1 evenly, which is faster than dividing the circle.
    """
    share = y / vmax(vabs(x) + vabs(y), broadcast16(f32(1e-30)))
    turn = select(x >= ZERO, share + ONE, f32(3.0) - share)
    return vmin(turn * f32(SECTORS / 4), broadcast16(f32(SECTORS - 1)))


@inline
def _unfolded16(d: Three16, normals: tuple[Three16, Three16], axes: tuple[Three16, Three16]) -> tuple[F16, F16, F16]:
    """Return x, y and squared distance of 16 neighbours across creases, unfolded into the points' tangent planes.

    d : offsets from the points to their neighbours; normals : of the points, and of the neighbours
    axes : two tangents of each point, the axes of x and y

    All three are 0 for neighbours on another sheet.
    """
    n, m = normals
    u, v = axes
    cosine = _dot16(n, m)
    sine = vsqrt(vmax(ONE - cosine * cosine, broadcast16(f32(1e-12))))
    a, b = _dot16(m, u) / sine, _dot16(m, v) / sine
    across, along = (_dot16(d, m) - _dot16(d, n)) / sine, _dot16(d, v) * a - _dot16(d, u) * b
    x, y = across * a - along * b, across * b + along * a
    same = cosine >= f32(OTHER_SHEET)
    return select(same, x, ZERO), select(same, y, ZERO), select(same, x * x + y * y, ZERO)


@inline
def _note_fold(seen: tuple[Mask, Mask, Three16], folded: Mask, m: Three16) -> tuple[Mask, Mask, Three16]:
    """Record the normals of neighbours across a crease, to find corners where three sheets may meet.

    seen : results so far for 16 points:
        mask of the points where three sheets may meet
        mask of the points with a neighbour across a crease
        normal of the first such neighbour
    folded : mask of the points whose next neighbour is across a crease
    m : normals of these next neighbours

    Returns the new `seen`.
    """
    meeting, known, first = seen
    meeting = meeting | (folded & known & (_dot16(first, m) <= f32(HALF_FOLD)))
    new = mask16(bits(folded) & ~bits(known))
    first = select(new, m[0], first[0]), select(new, m[1], first[1]), select(new, m[2], first[2])
    return meeting, known | folded, first


@inline
def _place_neighbors(
    table: Array, own: tuple[Three16, Three16, F16], neighborhood: tuple[Array, int, int], memory: Array
) -> tuple[tuple[F16, F16, F16, F16], tuple[F16, Mask], tuple[I16, Mask, Mask]]:
    """Map each neighbour of 16 points to the tangent plane, and write its inverse to memory.

    The inverse of a neighbour at b is q = 2 b / |b|^2: a position x is closer to the point than to b where x.q < 1.

    table : position, normal and two zeros of each point of the cloud
    own : positions and normals of the 16 points, and the factor that scales the last neighbour's distance to 1
    neighborhood : rows of neighbours, flat; start of the 16 points' neighbours in it; number of rows for each point
    memory : for neighbour k, q.x of the 16 points at 32 k and q.y at 32 k + 16

    Returns three tuples, with a value for each of the 16 points in every element:
        q of the nearest neighbour: x, y, |q|^2, and the neighbour's index k
        largest squared distance of a neighbour across a crease that gets closer when the crease is laid flat, else 0;
            mask of the points where three sheets may meet
        bits of the sectors, of 32 around the point, that hold neighbours; mask of the points whose first 8 neighbours
            are on their own sheet; mask of the points with a neighbour that may have the opposite normal
    """
    at, n, shrink = own
    near, start, width = neighborhood
    axes, zero = _tangents16(n), broadcast16(ZERO)
    best, best_x, best_y, best_k, nearer = zero, zero, zero, zero, zero
    seen = zero > ONE, zero > ONE, (zero, zero, zero)
    alike, away = zero < ONE, zero > ONE
    sectors = select(zero > ONE, one_bit(zero), 0)
    for k in range(1, width):
        x, y, z, mx, my, mz, _, _ = gather_rows8(table, near, start + k, width)
        d, m = ((x - at[0]) * shrink, (y - at[1]) * shrink, (z - at[2]) * shrink), (mx, my, mz)
        cosine, square = _dot16(n, m), _dot16(d, d)
        u, v = _dot16(d, axes[0]), _dot16(d, axes[1])
        flat = u * u + v * v
        sectors = sectors | select(flat > ZERO, one_bit(_sector(u, v)), 0)
        scale = f32(2.0) / vmax(vsqrt(flat) * vsqrt(square), broadcast16(TINY))
        qx, qy = u * scale, v * scale
        smooth = cosine > f32(FOLD)
        if bits(smooth) != ALL:
            fold = _unfolded16(d, (n, m), axes)
            scale = f32(2.0) / vmax(fold[2], broadcast16(TINY))
            qx, qy = select(smooth, qx, fold[0] * scale), select(smooth, qy, fold[1] * scale)
            same = cosine >= f32(OTHER_SHEET)
            folded = mask16(bits(same) & ~bits(smooth))
            nearer = select(folded & (fold[2] < square), vmax(nearer, square), nearer)
            seen = _note_fold(seen, folded, m)
            away = away | (cosine < f32(AWAY))
            if k <= NEAREST:
                alike = alike & same
        store(memory, 32 * k, qx)
        store(memory, 32 * k + 16, qy)
        size = qx * qx + qy * qy
        larger = size > best
        best, best_k = select(larger, size, best), select(larger, zero + f32(k), best_k)
        best_x, best_y = select(larger, qx, best_x), select(larger, qy, best_y)
    return (best_x, best_y, best, best_k), (nearer, seen[0]), (sectors, alike, away)


@inline
def _walk(first: tuple[F16, F16, F16, F16], width: int, memory: Array) -> tuple[F16, Mask, Mask]:
    """Find the farthest vertices of the Voronoi cells of 16 points, by a walk around the vertices of each cell.

    first : x and y of the nearest neighbour's inverse, its square, and the neighbour's index
    width : number of neighbours plus one
    memory : inverses q = 2 b / |b|^2 of the neighbours at b, for neighbour k x at 32 k and y at 32 k + 16

    Returns for each of the 16 points:
        squared distance to the farthest vertex, in units in which the last neighbour is at distance 1
        mask of closed cells, which no farther neighbour could change
        mask of cells that need a more exact method
    """
    cx, cy, size, ck = first
    start, zero = ck, broadcast16(ZERO)
    x, y = cx / size, cy / size  # the midpoint of the point and its nearest neighbour
    active, closed, sharp, far = size > ZERO, zero > ONE, zero > ONE, zero
    for _ in range(STEPS):
        if bits(active) == 0:
            break
        # Along the side of neighbour c, the next side is the first that cuts the line: the least over / turn.
        over, turn, bx, by, bk = zero + ONE, zero, zero, zero, zero
        number = zero
        for k in range(1, width):
            number = number + ONE
            qx, qy = load16(memory, 32 * k), load16(memory, 32 * k + 16)
            left, cross = vmax(ONE - (x * qx + y * qy), zero), cx * qy - cy * qx
            sooner = (left * turn < over * cross) & (ck != number)
            over, turn, bk = select(sooner, left, over), select(sooner, cross, turn), select(sooner, number, bk)
            bx, by = select(sooner, qx, bx), select(sooner, qy, by)
        x, y = (by - cy) / turn, (cx - bx) / turn
        square, next_size = x * x + y * y, bx * bx + by * by
        sharp = sharp | (active & (turn * turn < f32(SHARP * SHARP) * (size * next_size)))
        within = active & (square <= f32(0.25))  # the last neighbour is at distance 1: none beyond it clips this vertex
        far = select(within, vmax(square, far), far)
        active = within & (bk != start)
        closed = closed | (within & (bk <= start) & (bk >= start))
        cx, cy, ck, size = bx, by, bk, next_size
    return far, closed, active | sharp


@inline
def _gap_possible(sectors: int) -> bool:
    """Return whether 8 consecutive sectors of 32 around a point hold no neighbour, so that the surface may end there.

    sectors : one bit for each sector, set if it holds a neighbour
    """
    empty = i64(sectors) & 0xFFFFFFFF ^ 0xFFFFFFFF
    empty |= (empty & (1 << EMPTY) - 1) << SECTORS
    empty &= empty >> 1
    empty &= empty >> 2
    return empty & empty >> 4 != 0


@inline
def _away(table: Array, at: Three16, near: Array, start: int, width: int) -> F16:
    """Return the distances of 16 points from one neighbour each.

    table : position, normal and two zeros of each point of the cloud; at : positions of the 16 points
    near : flat rows of neighbours, `width` for each point
    start : index in `near` of the first point's neighbour
    """
    x, y, z, _, _, _, _, _ = gather_rows8(table, near, start, width)
    d = x - at[0], y - at[1], z - at[2]
    return vsqrt(_dot16(d, d))


@kernel
def _measure_closed(work: Array, table: Array, rows: Array, neighborhood: tuple[Array, int], out: Closed) -> None:
    """Measure Voronoi cells of points, 16 at a time: write the distance to the farthest vertex and other properties.

    table : position, normal and two zeros of each point of the cloud
    rows : (m,) the points to measure, at least 16
    neighborhood : flat rows of each of these points and its neighbours, and their number for each point
    out : output, arrays of m; cells that need a slower method get the state UNSURE
    """
    table, rows = borrow(table), borrow(rows)
    (near, width), (reach, state, gap, fourth, one_sheet, facing) = borrow(neighborhood), borrow(out)
    memory = np.empty(32 * (width + 1), np.float32)
    scratch = borrow(memory)
    tile = next_tile(work)
    while tile >= 0:
        for begin in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows)), 16):
            first = min(begin, len(rows) - 16)
            x, y, z, nx, ny, nz, _, _ = gather_rows8(table, rows, first, 1)
            last = _away(table, (x, y, z), near, first * width + width - 1, width)
            own = (x, y, z), (nx, ny, nz), ONE / last
            largest, (nearer, meeting), (sectors, alike, away) = _place_neighbors(
                table, own, (near, first * width, width), scratch
            )
            far, closed, doubtful = _walk(largest, width, scratch)
            reaches = vsqrt(far) * last
            store(reach, first, reaches)
            store(fourth, first, _away(table, own[0], near, first * width + 4, width))
            unsure = bits(doubtful) | bits(closed & (meeting | (nearer > f32(4.0) * far)))
            wide = bits(reaches > f32(WIDE) * _away(table, own[0], near, first * width + 8, width))
            for k in range(16):
                bit = 1 << k
                known = CLOSED if bits(closed) & bit != 0 else OPEN
                state[first + k] = UNSURE if unsure & bit != 0 else known
                one_sheet[first + k] = bits(alike) & bit != 0
                facing[first + k] = bits(away) & bit != 0
                odd = (unsure | wide) & bit != 0
                gap[first + k] = (known == OPEN or odd) and _gap_possible(lane(sectors, k))
        tile = next_tile(work)
    keep_alive(memory)


class Closed(NamedTuple):
    """Voronoi cells of m points, as far as the fast method can measure them.

    reach : (m,) float32, distance from the point to the farthest vertex of its cell, where the cell is CLOSED
    state : (m,) uint8, CLOSED; OPEN, if farther neighbours could change the cell; UNSURE, if it needs a slower method
    gap : (m,) bool, whether the surface may end at the point
    fourth : (m,) float32, distance to the 4th neighbour
    one_sheet : (m,) bool, whether the first 8 neighbours are on the point's own sheet
    facing : (m,) bool, whether a neighbour may have the opposite normal
    """

    reach: Floats
    state: NDArray[np.uint8]
    gap: Flags
    fourth: Floats
    one_sheet: Flags
    facing: Flags


def distances(positions: Floats, neighborhood: Neighborhood, k: int) -> Floats:
    """Return the distances of points from their k-th neighbours, (m,); 1 is the nearest, -1 the last one listed."""
    away = positions[neighborhood.near[:, k]] - positions[neighborhood.rows]
    return np.sqrt(np.einsum("ij,ij->i", away, away))


def room_for(count: int) -> Closed:
    """Return a `Closed` with uninitialized arrays for `count` cells."""
    kinds = np.float32, np.uint8, np.bool_, np.float32, np.bool_, np.bool_
    return Closed(*(np.empty(count, kind) for kind in kinds))  # type: ignore[arg-type]


def measure_closed(table: Floats, neighborhood: Neighborhood) -> Closed:
    """Return the distance to the farthest vertex of each point's Voronoi cell, and other properties of the cells.

    table : position, normal and two zeros of each point of the cloud
    neighborhood : points to measure, and their neighbours

    Special cases get the state UNSURE and are left to the slower `measure_cells`. With fewer than 16 points, or up to 8
    columns of neighbours, all cells are UNSURE.
    """
    count, width = neighborhood.near.shape
    out = room_for(count)
    if count < 16 or width <= NEAREST:
        out.state[:], out.gap[:], out.one_sheet[:], out.facing[:] = UNSURE, True, False, True
        places = table.reshape(-1, 8)[:, :3]
        out.fourth[:] = distances(places, neighborhood, min(4, width - 1))
        return out
    flat = np.ascontiguousarray(neighborhood.near).reshape(-1)
    run(_measure_closed, -(-count // CHUNK), table, neighborhood.rows, (flat, width), out)
    return out


@kernel
def _pack(work: Array, positions: Array, normals: Array, out: Array) -> None:
    """Write position, normal and two zeros of each point to a row of eight numbers. out : (n, 8)"""
    positions, normals, out = borrow(positions), borrow(normals), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            for c in range(3):
                out[i, c], out[i, 3 + c] = positions[i, c], normals[i, c]
            out[i, 6] = out[i, 7] = 0.0
        tile = next_tile(work)


def pack_table(positions: Floats, normals: Floats) -> Floats:
    """Pack (n, 3) positions, (n, 3) normals and two zeros into rows of eight, flat, to load a point at once."""
    out = np.empty((len(positions), 8), np.float32)
    run(_pack, -(-len(out) // CHUNK), np.ascontiguousarray(positions), np.ascontiguousarray(normals), out)
    return out.reshape(-1)
