"""Distances of points from the blended surface of splats: the error of a subset.

The surface is `apss`, the default of a model, with the formulas of `surface/intersect/surface.py`. Here it is evaluated
at one point at a time; rays evaluate four samples at once and know their voxel. A test compares both.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats
from ...cloud.neighbors import NeighborTree, kd_order
from ...engine.jit import Array, borrow, f32, f64, inline, kernel, next_tile, routine, run
from ...engine.kernels.vec import Vec3, add, dot, length, scale
from .cells import NEIGHBORS
from .grow import at
from .sheets import find_sheets
from .voronoi import Neighborhood

WIDE = 8  # boxes in a box
SHARING = 32  # neighbouring points that share one search for splats
CHUNK = 64  # groups of SHARING points per tile
HOLLOW = 0.9  # |x - P(x)| in local radii beyond which a point is uncovered: most subsets are trimmed at 0.95

Box: TypeAlias = tuple[float, float, float, float, float, float]  # low x y z, high x y z
Gated: TypeAlias = tuple[Array, Array, Array, Array]  # splats: positions, normals, radii, 1 for those on close sheets


class Boxes(NamedTuple):
    """Hierarchy of boxes: around the supports of 8 consecutive splats, around 8 of these boxes, up to one box.

    low, high : (m, 3) float32, corners of the boxes, finest level first
    heads : int64, index of the first box of each level, and the end
    """

    low: Floats
    high: Floats
    heads: NDArray[np.int64]


def _box(low: Floats, high: Floats) -> Boxes:
    lows, highs, heads = [], [], [0]
    while True:
        first = np.arange(0, len(low), WIDE)
        low, high = np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)
        lows.append(low)
        highs.append(high)
        heads.append(heads[-1] + len(low))
        if len(low) == 1:
            return Boxes(np.concatenate(lows), np.concatenate(highs), np.array(heads))


@inline
def _apart(low: Array, high: Array, i: int, box: Box) -> bool:
    """Return whether box i of a hierarchy does not overlap `box`. low, high : corners, (m, 3)"""
    (ax, ay, az), (bx, by, bz) = at(low, i), at(high, i)
    return (ax > box[3]) | (ay > box[4]) | (az > box[5]) | (bx < box[0]) | (by < box[1]) | (bz < box[2])


@routine
def _find(splats: Gated, boxes: Boxes, box: Box, stack: Array, found: Array) -> int:
    """List in `found` the splats whose support overlaps a box (low x, y, z, high x, y, z); return their number.

    splats : positions, normals, radii, and 1 for those on sheets close together
    boxes : hierarchy of boxes around the supports of the splats
    stack : memory
    """
    centers, radii = splats[0], splats[2]
    count, size = 0, 1
    stack[0, 0], stack[0, 1] = 0, len(boxes.heads) - 2
    while size > 0:
        size -= 1
        node, level = stack[size, 0], stack[size, 1]
        if _apart(boxes.low, boxes.high, boxes.heads[level] + node, box):
            continue
        if level > 0:
            for m in range(node * WIDE, min(node * WIDE + WIDE, boxes.heads[level] - boxes.heads[level - 1])):
                stack[size, 0], stack[size, 1] = m, level - 1
                size += 1
            continue
        for j in range(node * WIDE, min(node * WIDE + WIDE, len(radii))):
            square = 0.0
            for c in range(3):
                gap = max(max(box[c] - centers[j, c], centers[j, c] - box[c + 3]), f32(0.0))
                square += gap * gap
            if square < radii[j] * radii[j]:
                found[count] = j
                count += 1
    return count


@routine
def _evaluate(splats: Gated, near: Array, x: Vec3, n: Vec3) -> tuple[float, Vec3, float]:
    """Return f at x, the gradient of f, and the distance of x from the mean centre of the blended splats in mean radii.

    splats : positions, normals, radii, and 1 for those on sheets close together, else 0; a splat with 1 counts only if
        its normal is within 90 degrees of n
    near : rows of the splats to blend
    n : normal of the point at x

    Where no support contains x, f and the distance are inf.
    """
    centers, normals, radii, sheets = splats
    total = square_radius = qn = qq = 0.0
    qx = qy = qz = nx = ny = nz = 0.0
    for j in near:
        (px, py, pz), (a, b, c) = at(centers, j), at(normals, j)
        if sheets[j] != 0 and a * n[0] + b * n[1] + c * n[2] < 0.0:
            continue
        px, py, pz = px - x[0], py - x[1], pz - x[2]
        square, widest = px * px + py * py + pz * pz, f64(radii[j]) * radii[j]
        w = max(1.0 - square / widest, 0.0)
        w *= w
        total, square_radius, qq = total + w, square_radius + w * widest, qq + w * square
        qx, qy, qz = qx + w * px, qy + w * py, qz + w * pz
        nx, ny, nz = nx + w * a, ny + w * b, nz + w * c
        qn += w * (px * a + py * b + pz * c)
    if total <= 0.0:
        return np.inf, (0.0, 0.0, 0.0), np.inf
    s = 1.0 / total
    qx, qy, qz, nx, ny, nz, qn, qq = qx * s, qy * s, qz * s, nx * s, ny * s, nz * s, qn * s, qq * s
    plane, center = qx * nx + qy * ny + qz * nz, qx * qx + qy * qy + qz * qz
    u4 = 0.5 * (qn - plane) / max(qq - center, 0.25 * qq, 1e-300)
    gradient = nx - 2.0 * u4 * qx, ny - 2.0 * u4 * qy, nz - 2.0 * u4 * qz
    return u4 * (2.0 * center - qq) - plane, gradient, math.sqrt(center * total / square_radius)


@routine
def _deviation(splats: Gated, near: Array, x: Vec3, n: Vec3, close: float) -> tuple[float, float]:
    """Return the distances of x from the surface, positive outside, and from the mean centre of the blended splats.

    splats : positions, normals, radii, and 1 for those on sheets close together
    near : rows of the splats near x
    n : normal of the point at x
    close : distances from the surface up to this need no refinement

    The first is f over the length of its gradient. If that exceeds `close`, two secant steps along n find the root of
    f, because the first estimate is wrong by factors at sharp edges. A surface of opposite orientation counts, as it
    does for rays: normals in debris differ from those around. The second result is in mean radii of the blended
    splats; without a root, both are inf.
    """
    f, g, hollow = _evaluate(splats, near, x, n)
    lean = dot(g, n)
    if not f < np.inf or lean == 0.0:
        return np.inf, np.inf
    away = math.copysign(f, f * lean) / length(g)
    if abs(away) <= close:
        return away, hollow
    last, f_last = 0.0, f
    for _ in range(2):
        f_new, g, hollow = _evaluate(splats, near, add(x, scale(n, -away)), n)
        if not f_new < np.inf or f_new == f_last:
            return np.inf, np.inf
        step = -f_new * (away - last) / (f_new - f_last)
        last, f_last, away = away, f_new, away + step
    if abs(away - last) > 0.5 * max(abs(last), close):
        return np.inf, np.inf
    return away, hollow


@inline
def _box_of(positions: Array, first: int, last: int, pad: float) -> tuple[float, float, float, float, float, float]:
    """Return the bounding box of points `first` to `last` - 1 with a margin `pad`: low x, y, z, high x, y, z."""
    x, y, z = positions[first, 0], positions[first, 1], positions[first, 2]
    u, v, w = x, y, z
    for i in range(first + 1, last):
        x, y, z = min(x, positions[i, 0]), min(y, positions[i, 1]), min(z, positions[i, 2])
        u, v, w = max(u, positions[i, 0]), max(v, positions[i, 1]), max(w, positions[i, 2])
    return x - pad, y - pad, z - pad, u + pad, v + pad, w + pad


@kernel
def _survey(
    work: Array, positions: Array, normals: Array, splats: Gated, boxes: Boxes, close: float, out: Array, hollow: Array
) -> None:
    """Write the distance of every point from the surface, with one search for splats for 32 neighbouring points.

    positions, normals : (n, 3) of the points
    splats : positions, normals, radii, and 1 for those on sheets close together
    boxes : hierarchy of boxes around the supports of the splats
    close : distances from the surface up to this need no refinement
    out : (n,) output, signed distances from the surface
    hollow : (n,) output, distance from the mean centre of the blended splats in their mean radii; inf without a surface
    """
    positions, normals, out, hollow = borrow(positions), borrow(normals), borrow(out), borrow(hollow)
    lent, tree = borrow(splats), borrow(boxes)
    found, stack = np.empty(len(lent[2]), np.int32), np.empty((16 * WIDE, 2), np.int64)
    tile = next_tile(work)
    while tile >= 0:
        for first in range(tile * CHUNK * SHARING, min((tile + 1) * CHUNK * SHARING, len(out)), SHARING):
            last = min(first + SHARING, len(out))
            box = _box_of(positions, first, last, 4.0 * close if close < np.inf else 0.0)
            count = _find(lent, tree, box, stack, found)
            for i in range(first, last):
                out[i], hollow[i] = _deviation(lent, found[:count], at(positions, i), at(normals, i), close)
        tile = next_tile(work)


def deviations(
    positions: Floats, normals: Floats, splats: tuple[Floats, Floats, Floats], close: float = np.inf
) -> tuple[Floats, Flags]:
    """Measure the distances of points from the surface of splats, and find the points that it does not cover.

    Parameters
    ----------
    positions, normals : (n, 3) float32
        In an order that keeps neighbours close.
    splats : (m, 3), (m, 3) and (m,) float32
        Positions, normals and support radii.
    close : float
        Distances up to this are computed from f and its gradient, which is fast; larger ones along the normal.

    Returns
    -------
    distances : (n,) float32
        Positive where the point is outside of the surface; 0 where the point is not covered.
    bare : (n,) bool
        True where no support reaches the point, or only rims of supports do, or no surface is found along its normal.
    """
    order = kd_order(splats[0])
    sorted_splats = [np.ascontiguousarray(array[order]) for array in splats]
    positions_of, normals_of, radii = sorted_splats
    near = NeighborTree(positions_of, in_order=True).rows(NEIGHBORS + 1)
    sheets = find_sheets(positions_of, normals_of, radii, near, Neighborhood(np.arange(len(near)), near))
    none = np.zeros(len(order), np.int8)
    boxes = _box(positions_of - radii[:, None], positions_of + radii[:, None])
    out, hollow = np.empty(len(positions), np.float32), np.empty(len(positions), np.float32)
    gated = (*sorted_splats, none if sheets is None else sheets)
    run(_survey, -(-len(out) // (CHUNK * SHARING)), positions, normals, gated, boxes, float(close), out, hollow)
    bare: NDArray[Any] = ~(hollow <= HOLLOW)
    return np.where(bare, f32(0), out), bare
