"""Patches: a leaf's voxel cut into 4 x 4 columns, each with a slab of its own.

A column is one or two splats wide, so its normals differ less and the surface in it bends less. Its slab is proved like
the leaf's (see `tree/leaves.py`) and is less than half as thick on smooth surfaces. Columns run along the axis w that
is nearest to the leaf's normal; a slab is stored as low <= w + B u + C v <= high.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from ..jit import Array, f64, inline
from ..kernels.tree import COLUMNS, NO_SURFACE, PATCH_B, PATCH_C, PATCH_HIGH, PATCH_LOW
from ..kernels.vec import Vec3

PAD = 0.012  # mean radii: more than the start rule's distance, so that a ray from the surface starts in its slab
MARGIN = 1e-3  # column widths: a splat this far outside a column still counts as over it, against rounding
WORTH = 0.6  # of the leaf slab's thickness: column slabs with a thicker mean cost more time than they save
STEEP = 0.2  # a cosine: a column takes the leaf's normal where its own is farther from the axis

Limits: TypeAlias = tuple[float, float, float, float]  # see `leaves.limits_of`


@inline
def across(mx: float, my: float, mz: float) -> tuple[int, int, int]:
    """The axes (u, v, w) of a leaf's columns: w is nearest to the normal of its slab."""
    x, y, z = abs(mx), abs(my), abs(mz)
    if z >= x and z >= y:
        return 0, 1, 2
    return (1, 2, 0) if x >= y else (2, 0, 1)


@inline
def _over(members: Array, column: Array, out: Array) -> tuple[int, Vec3]:
    """Write to `out` the members whose supports overlap a column; returns how many, and the sum of their normals."""
    count = 0
    sx = sy = sz = 0.0
    for k in range(len(members)):
        distance = 0.0
        for c in range(3):
            d = max(column[c] - members[k, c], members[k, c] - column[3 + c], 0.0)
            distance += d * d
        if distance <= members[k, 6] * members[k, 6]:
            out[count] = k
            count += 1
            sx, sy, sz = sx + members[k, 3], sy + members[k, 4], sz + members[k, 5]
    return count, (sx, sy, sz)


@inline
def slab_along(members: Array, chosen: Array | range, m: Vec3, limits: Limits) -> tuple[float, float]:
    """Least and greatest m.x of any surface of the chosen members: see the head of `tree/leaves.py`."""
    cosine, least, most = 1.0, np.inf, 0.0
    for k in chosen:
        cosine = min(cosine, m[0] * members[k, 3] + m[1] * members[k, 4] + m[2] * members[k, 5])
        least, most = min(least, members[k, 6]), max(most, members[k, 6])
    away = 1.0
    if cosine > 0.0:
        square = cosine * cosine
        far = max(limits[0] + limits[1] / square, limits[2] + limits[3] / square)
        uneven = 0.5 * (least + most) / math.sqrt(least * most)
        away = min(1.0, uneven * math.sqrt(max(0.0, 1.0 - square) * far))
    low, high = np.inf, -np.inf
    for k in chosen:
        height = m[0] * members[k, 0] + m[1] * members[k, 1] + m[2] * members[k, 2]
        low = min(low, height - away * members[k, 6])
        high = max(high, height + away * members[k, 6])
    return low, high


@inline
def _set_column(cell: Array, axes: tuple[int, int, int], i: int, j: int, column: Array) -> None:
    """Set a box to column (i, j) of a cell."""
    for c in range(6):
        column[c] = cell[c]
    for axis, k in ((axes[0], i), (axes[1], j)):
        width = (cell[3 + axis] - cell[axis]) / COLUMNS
        column[axis], column[3 + axis] = cell[axis] + (k - MARGIN) * width, cell[axis] + (k + 1 + MARGIN) * width


@inline
def _normal_of(total: Vec3, w: int, normal: Array) -> Vec3:
    """The unit normal of a column's slab: the sum of its splats' normals, or the leaf's normal where that is steep."""
    length = math.sqrt(total[0] * total[0] + total[1] * total[1] + total[2] * total[2])
    if abs(total[w]) > STEEP * length:
        return total[0] / length, total[1] / length, total[2] / length
    return f64(normal[0]), f64(normal[1]), f64(normal[2])


@inline
def fill_patches(
    members: Array, cell: Array, mean: float, slab: tuple[Array, float, Limits], work: tuple[Array, Array], out: Array
) -> None:
    """Fill a leaf's patches.

    members : rows x, y, z, nx, ny, nz, r; mean : the mean of their radii
    slab : the normal of the leaf's slab, float32 as rays read it; its thickness; limits, see `leaves.limits_of`
    work : an array with a number for each member, and one for a box; out : (64,) float32, see `kernels.tree.PATCH`
    """
    normal, thickness, limits = slab
    chosen, column = work
    u, v, w = axes = across(normal[0], normal[1], normal[2])
    total, full = 0.0, 0
    for i in range(COLUMNS):
        for j in range(COLUMNS):
            at = COLUMNS * i + j
            out[PATCH_B + at] = out[PATCH_C + at] = 0.0
            out[PATCH_LOW + at] = out[PATCH_HIGH + at] = NO_SURFACE
            _set_column(cell, axes, i, j, column)
            count, normals = _over(members, column, chosen)
            if count == 0:
                continue
            m = _normal_of(normals, w, normal)
            low, high = slab_along(members, chosen[:count], m, limits)
            total, full = total + high - low, full + 1
            base = m[0] * cell[0] + m[1] * cell[1] + m[2] * cell[2]
            a, b = (low - PAD * mean - base) / m[w], (high + PAD * mean - base) / m[w]
            out[PATCH_B + at] = m[u] / m[w] * (cell[3 + u] - cell[u]) / COLUMNS
            out[PATCH_C + at] = m[v] / m[w] * (cell[3 + v] - cell[v]) / COLUMNS
            out[PATCH_LOW + at], out[PATCH_HIGH + at] = min(a, b), max(a, b)
    if total > WORTH * full * thickness:
        out[:PATCH_LOW], out[PATCH_LOW:PATCH_HIGH], out[PATCH_HIGH:] = 0.0, -np.inf, np.inf
