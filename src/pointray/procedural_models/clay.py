"""Clay: a solid made of strokes that add, carve, cut or emboss material, always with rounded edges.

A stroke is a row of a table. All strokes blend over a finite width, so that the strokes that matter within a small
cell can be listed exactly (`cells`), and hundreds of strokes cost no more than the ten that are near.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles
from ..engine.jit import Array, inline, routine
from ..engine.kernels.vec import Vec3
from .reliefs import relief
from .smooth import blend, step

# Columns of a stroke. Tubes store their three control points and radii in place of centre, axes and size; reliefs store
# the number of repeats in VEIN, their region in SIZE and their amplitude in ROUND.
KIND, OP, WIDTH, COLOR, VEIN, CENTER, AXES, SIZE, ROUND, SCALE, COLUMNS = 0, 1, 2, 3, 6, 7, 10, 19, 22, 23, 24
POINTS, RADII = 7, 16

ELLIPSOID, TUBE, BOX, DRUM, RING = 0, 1, 2, 3, 4
ADD, CARVE, CUT, RELIEF, PAINT = 0, 1, 2, 3, 4

FAR = 10.0  # the field before the first stroke


class Solid(NamedTuple):
    """A solid with a smooth surface, in the form that kernels take.

    It is a sphere, a torus, a lattice, or clay: a sculpture made of strokes, which are shapes that add, carve, cut,
    emboss or paint clay one after the other. Only clay uses the other fields. Each cell of a grid has a list of the
    strokes that can change the surface inside it: `items[starts[l] : starts[l + 1]]` with `l = lists[cell]`. List 0
    holds every stroke and is used outside the cells.

    kind : SPHERE, TORUS, LATTICE or CLAY
    table : (strokes, COLUMNS), one row per stroke
    lists : (nx, ny, nz) number of each cell's list
    starts : (number of lists + 1,); items : numbers of strokes, list after list
    origin : (3,) lower corner of the cells; cell : edge of a cell
    """

    kind: int
    table: Doubles  # (strokes, COLUMNS)
    lists: NDArray[np.int32]  # (nx, ny, nz)
    starts: NDArray[np.int32]  # (number of lists + 1,)
    items: NDArray[np.int32]  # stroke numbers
    origin: Doubles  # (3,) lower corner of the cells
    cell: float  # edge of a cell


@inline
def local(table: Array, i: int, x: float, y: float, z: float) -> Vec3:
    """Return the coordinates of a point relative to the centre of stroke i and along its axes.

    table : (strokes, COLUMNS), one row per stroke, a shape that adds or removes clay
    """
    x, y, z = x - table[i, CENTER], y - table[i, CENTER + 1], z - table[i, CENTER + 2]
    u = table[i, AXES] * x + table[i, AXES + 1] * y + table[i, AXES + 2] * z
    v = table[i, AXES + 3] * x + table[i, AXES + 4] * y + table[i, AXES + 5] * z
    w = table[i, AXES + 6] * x + table[i, AXES + 7] * y + table[i, AXES + 8] * z
    return u, v, w


@inline
def ellipsoid(u: float, v: float, w: float, a: float, b: float, c: float) -> float:
    """Return the first-order distance to an ellipsoid, with exact slope on its surface (Quilez, "Ellipsoid SDF").

    u, v, w : position relative to its centre, along its axes; a, b, c : radii along the axes
    """
    p, q, r = u / a, v / b, w / c
    k0 = sqrt(p * p + q * q + r * r)
    p, q, r = p / a, q / b, r / c
    k1 = sqrt(p * p + q * q + r * r)
    return k0 * (k0 - 1.0) / (k1 + 1e-12)


@inline
def _box(u: float, v: float, w: float, a: float, b: float, c: float, rounding: float) -> float:
    u, v, w = abs(u) - a + rounding, abs(v) - b + rounding, abs(w) - c + rounding
    p, q, r = max(u, 0.0), max(v, 0.0), max(w, 0.0)
    return sqrt(p * p + q * q + r * r) + min(max(u, max(v, w)), 0.0) - rounding


@inline
def _drum(u: float, v: float, w: float, radius: float, height: float, rounding: float) -> float:
    u, w = sqrt(u * u + v * v) - radius + rounding, abs(w) - height + rounding
    p, r = max(u, 0.0), max(w, 0.0)
    return sqrt(p * p + r * r) + min(max(u, w), 0.0) - rounding


@inline
def _cosine_of_third(cosine: float) -> float:
    """Return cos(acos(x) / 3) to 3e-5, which solves a cubic equation with three real roots. cosine : x, -1 to 1

    It is a Newton step on 4 y^3 - 3 y = x, from a parabola in sqrt(1 + x).
    """
    w = sqrt(1.0 + cosine)
    y = 0.5 + w * (0.40824829 - 0.03872338 * w)
    return y - (4.0 * y * y * y - 3.0 * y - cosine) / max(12.0 * y * y - 3.0, 1e-6)


@inline
def _foot(a2: float, ab: float, b2: float, da: float, db: float) -> float:
    """Return the parameter, 0 to 1, of the point of a quadratic Bezier curve that is nearest to a point x.

    With p(t) = A + 2 a t + b t^2 and d = A - x, the arguments are the products a.a, a.b, b.b, d.a and d.b (Quilez,
    "Quadratic Bezier SDF").
    """
    k = 1.0 / b2
    kx, ky, kz = k * ab, k * (2.0 * a2 + db) / 3.0, k * da
    p = ky - kx * kx
    q = kx * (2.0 * kx * kx - 3.0 * ky) + kz
    h = q * q + 4.0 * p * p * p
    if h >= 0.0:
        m = (max(0.5 * (abs(q) + sqrt(h)), 1e-300)) ** (1.0 / 3.0)  # one of two cube roots, whose product is -p
        root = p / m - m if q > 0.0 else m - p / m
        t = min(max(root - kx, 0.0), 1.0)
    else:
        z = sqrt(-p)
        m = _cosine_of_third(min(max(q / (p * z * 2.0), -1.0), 1.0))
        n = sqrt(max(1.0 - m * m, 0.0)) * 1.7320508075688772
        t = min(max((m + m) * z - kx, 0.0), 1.0)
        s = min(max((-n - m) * z - kx, 0.0), 1.0)
        # |p(t) - d|^2 / 2 without its constant, to choose the nearer of two
        ft = t * (2.0 * da + t * (2.0 * a2 + db + t * (2.0 * ab + 0.5 * b2 * t)))
        fs = s * (2.0 * da + s * (2.0 * a2 + db + s * (2.0 * ab + 0.5 * b2 * s)))
        t = s if fs < ft else t
    for _ in range(2):  # the closed form loses digits where the curve is nearly straight
        value = da + t * (2.0 * a2 + db + t * (3.0 * ab + b2 * t))
        rise = 2.0 * a2 + db + t * (6.0 * ab + 3.0 * b2 * t)
        if rise > 1e-3 * a2:
            t = min(max(t - value / rise, 0.0), 1.0)
    return t


@inline
def _tube(table: Array, i: int, x: float, y: float, z: float) -> float:
    """Return the distance from a point to a bent tube, negative inside.

    Its radius has zero slope at both ends, so the caps join without a crease.

    table : (strokes, COLUMNS), one row per shape of a sculpture; i : row of the tube
    """
    px, py, pz = table[i, POINTS], table[i, POINTS + 1], table[i, POINTS + 2]
    ax, ay, az = table[i, POINTS + 3] - px, table[i, POINTS + 4] - py, table[i, POINTS + 5] - pz
    bx, by, bz = table[i, POINTS + 6] - px - 2.0 * ax, table[i, POINTS + 7] - py - 2.0 * ay, 0.0
    bz = table[i, POINTS + 8] - pz - 2.0 * az
    dx, dy, dz = px - x, py - y, pz - z
    t = _foot(
        ax * ax + ay * ay + az * az,
        ax * bx + ay * by + az * bz,
        bx * bx + by * by + bz * bz,
        dx * ax + dy * ay + dz * az,
        dx * bx + dy * by + dz * bz,
    )
    dx, dy, dz = dx + t * (2.0 * ax + t * bx), dy + t * (2.0 * ay + t * by), dz + t * (2.0 * az + t * bz)
    bulge = 16.0 * t * t * (1.0 - t) * (1.0 - t)
    radius = table[i, RADII] + step(t) * (table[i, RADII + 1] - table[i, RADII]) + bulge * table[i, RADII + 2]
    return sqrt(dx * dx + dy * dy + dz * dz) - radius


@routine
def shape(table: Array, i: int, x: float, y: float, z: float) -> float:
    """Return the signed distance to the shape of stroke i (ellipsoid, tube, box, cylinder or ring), without blending.

    table : (strokes, COLUMNS), one row per stroke, a shape that adds or removes clay
    """
    kind = int(table[i, KIND])
    if kind == TUBE:
        return _tube(table, i, x, y, z)
    u, v, w = local(table, i, x, y, z)
    a, b, c = table[i, SIZE], table[i, SIZE + 1], table[i, SIZE + 2]
    if kind == ELLIPSOID:
        return ellipsoid(u, v, w, a, b, c)
    if kind == BOX:
        return _box(u, v, w, a, b, c, table[i, ROUND])
    if kind == DRUM:
        return _drum(u, v, w, a, c, table[i, ROUND])
    ring = sqrt(u * u + v * v) - a
    return sqrt(ring * ring + w * w) - c


@inline
def fade(d: float, width: float) -> float:
    """Return 1 inside a region, 0 farther than `width` outside, and a smooth transition between.

    d : distance to the region
    """
    return step(1.0 - d / width)


@routine
def height(table: Array, i: int, x: float, y: float, z: float) -> float:
    """Return the height that a relief, which displaces a sculpture's surface, adds at a point; 0 outside its region.

    table : (strokes, COLUMNS), one row per stroke of the sculpture; i : row of the relief
    """
    u, v, w = local(table, i, x, y, z)
    region = fade(ellipsoid(u, v, w, table[i, SIZE], table[i, SIZE + 1], table[i, SIZE + 2]), table[i, WIDTH])
    if region == 0.0:
        return 0.0
    scale = table[i, SCALE]
    return region * table[i, ROUND] * relief(int(table[i, KIND]), u / scale, v / scale, w / scale, table[i, VEIN])


@inline
def list_of(solid: Solid, x: float, y: float, z: float) -> int:
    """Return the number of the list of strokes (shapes that add or remove clay) that matter near a point.

    List 0 holds all strokes; it is the one outside the grid whose cells have lists of their own.
    """
    lists = solid.lists
    u, v, w = (x - solid.origin[0]) / solid.cell, (y - solid.origin[1]) / solid.cell, (z - solid.origin[2]) / solid.cell
    if u >= 0.0 and v >= 0.0 and w >= 0.0 and u < lists.shape[0] and v < lists.shape[1] and w < lists.shape[2]:
        return int(lists[int(u), int(v), int(w)])
    return 0


@routine
def work_clay(solid: Solid, x: float, y: float, z: float) -> float:
    """Evaluate the field of a solid made of clay at a point: zero on its surface, negative inside.

    The strokes (shapes) near the point add, carve, cut or displace clay one after the other.
    """
    table = solid.table
    which = list_of(solid, x, y, z)
    f = FAR
    for j in range(solid.starts[which], solid.starts[which + 1]):
        i = solid.items[j]
        op = int(table[i, OP])
        if op == ADD:
            f = blend(f, shape(table, i, x, y, z), table[i, WIDTH])
        elif op == CARVE:
            f = -blend(-f, shape(table, i, x, y, z), table[i, WIDTH])
        elif op == CUT:
            f = -blend(-f, -shape(table, i, x, y, z), table[i, WIDTH])
        elif op == RELIEF:
            f -= height(table, i, x, y, z)
    return f
