"""Patches: a leaf's voxel is divided into 4 x 4 columns, each with its own slab.

A column is one or two splats wide, so its normals differ less and the surface in it is flatter. Its slab is proved like
the leaf's (see `tree/leaves.py`) and is less than half as thick on smooth surfaces. Columns run along the axis w that
is closest to the leaf's normal; a slab is stored as low <= w + B u + C v <= high.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from ...engine.jit import Array, f32, inline
from ...engine.kernels.tree import COLUMNS, NO_SURFACE, PATCH_B, PATCH_C, PATCH_HIGH, PATCH_LOW
from ...engine.kernels.vec import Vec3
from ...engine.simd import (
    F16,
    INF,
    ONE,
    ZERO,
    Mask,
    bits,
    broadcast16,
    broadcast_from,
    count_bits,
    fours,
    lane,
    load16,
    mask16,
    quarters,
    reduce_max,
    reduce_min,
    select,
    store,
    vabs,
    vmax,
    vmin,
    vsqrt,
)
from .near import sum_of

PAD = f32(0.012)  # mean radii: more than the start rule's distance, so that a ray from the surface starts in its slab
MARGIN = f32(1e-3)  # column widths: splats this far outside of a column count as over it, against rounding
WORTH = 0.6  # column slabs with a mean thickness above this share of the leaf slab's cost more time than they save
STEEP = f32(0.2)  # least cosine of a column's normal with the axis; otherwise the leaf's normal is used
ROUNDING = f32(4e-7)  # maximum rounding error of a squared cosine
HALF, TINY = f32(0.5), f32(1e-20)
LANES = 16
PARTS = 7  # rows of `Members`: x y z, nx ny nz, r
N, R = 3, 6  # first row of the normals; row of the radii

Limits: TypeAlias = tuple[float, float, float, float]  # see `leaves.limits_of`


class Members(NamedTuple):
    """Splats over a voxel, relative to its least corner, where float32 is precise enough wherever the voxel is.

    rows : (7 * room,) float32; row k, which starts at k * room, holds x, y, z, nx, ny, nz or r of all splats
    room : length of a row, at least number + 16
    number : number of splats
    """

    rows: Array
    room: int
    number: int


@inline
def across(mx: float, my: float, mz: float) -> tuple[int, int, int]:
    """Return the axes (u, v, w) of a leaf's columns, which run along w: the axis closest to the slab's normal.

    mx, my, mz : this normal
    """
    x, y, z = abs(mx), abs(my), abs(mz)
    if z >= x and z >= y:
        return 0, 1, 2
    return (1, 2, 0) if x >= y else (2, 0, 1)


@inline
def live(members: Members, first: int) -> Mask:
    """Return a mask of the lanes that hold a splat in a vector of splats `first` to `first` + 15.

    The last vector of a voxel's splats may be partly empty.
    """
    return mask16((1 << min(members.number - first, LANES)) - 1)


@inline
def sum_of_row(members: Members, row: int) -> float:
    """Return the sum of a row over all splats. row : 0 to 6 for x, y, z, nx, ny, nz, r"""
    total, zero, start = broadcast16(ZERO), broadcast16(ZERO), row * members.room
    for first in range(0, members.number, LANES):
        total = total + select(live(members, first), load16(members.rows, start + first), zero)
    return sum_of(total)


@inline
def along(members: Members, row: int, first: int, m: Vec3) -> F16:
    """Return the dot products of m with positions or normals of 16 splats, from number `first` on.

    row : first row of `Members.rows` to read, 0 for the positions, 3 for the normals
    """
    rows, room = members.rows, members.room
    x, y, z = load16(rows, row * room + first), load16(rows, (row + 1) * room + first), (row + 2) * room + first
    return m[0] * x + m[1] * y + m[2] * load16(rows, z)


@inline
def _away(cosine: F16, least: F16, most: F16, limits: Limits) -> F16:
    """Return the largest distance of surface from its splats along a direction, in radii, at most 1, for 16 columns.

    cosine : least cosine between each column's direction and the normals of its splats
    least, most : least and largest support radius of each column's splats
    limits : the numbers a, b, d, e of `leaves.limits_of`, from which this distance follows
    """
    square = vmax(cosine * cosine, broadcast16(TINY))
    far = vmax(f32(limits[0]) + f32(limits[1]) / square, f32(limits[2]) + f32(limits[3]) / square)
    uneven = HALF * (least + most) / vsqrt(least * most)
    one = broadcast16(ONE)
    sine = vsqrt(vmax(ONE + ROUNDING - square, broadcast16(ROUNDING)) * far)
    return select(cosine > ZERO, vmin(uneven * sine, one), one)


@inline
def slab_along(members: Members, m: Vec3, limits: Limits) -> tuple[float, float]:
    """Return the slab across a direction m that encloses all surface of a voxel: the least and the largest m.x in it.

    members : splats over the voxel; positions x are relative to the voxel's least corner
    m : unit vector
    limits : the numbers of `leaves.limits_of`, which bound how far surface can be from its splats
    """
    inf = broadcast16(INF)
    cosine, least, most, radii = broadcast16(ONE), inf, broadcast16(ZERO), R * members.room
    for first in range(0, members.number, LANES):
        there, r = live(members, first), load16(members.rows, radii + first)
        cosine = select(there, vmin(along(members, N, first, m), cosine), cosine)
        least, most = select(there, vmin(r, least), least), select(there, vmax(r, most), most)
    least, most = broadcast16(reduce_min(least)), broadcast16(reduce_max(most))
    away = lane(_away(broadcast16(reduce_min(cosine)), least, most, limits), 0)
    low, high = inf, -ONE * inf
    for first in range(0, members.number, LANES):
        there, height = live(members, first), along(members, 0, first, m)
        reach = away * load16(members.rows, radii + first)
        low, high = select(there, vmin(height - reach, low), low), select(there, vmax(height + reach, high), high)
    return reduce_min(low), reduce_max(high)


@inline
def _over(members: Members, cell: Array, axes: tuple[int, int, int], words: Array) -> tuple[int, F16, F16, F16]:
    """Find which of a voxel's 4 x 4 columns each splat's support overlaps, and sum the normals of each column's splats.

    members : splats over the voxel; cell : the voxel's box
    axes : (u, v, w), columns run along w
    words : output, for each splat the columns that its support overlaps, as bits

    Returns the union of all words, and the sums of the normals' components along u, v and w. Lanes are columns: 4
    along v in each of 4 quarters along u.
    """
    u, v, w = axes
    rows, room, zero = members.rows, members.room, broadcast16(ZERO)
    wide, long = (cell[3 + u] - cell[u]) / f32(COLUMNS), (cell[3 + v] - cell[v]) / f32(COLUMNS)
    i, j = quarters(ZERO, ONE, f32(2.0), f32(3.0)), fours(ZERO, ONE, f32(2.0), f32(3.0))
    u_low, u_high, v_low, v_high = i - MARGIN, i + (ONE + MARGIN), j - MARGIN, j + (ONE + MARGIN)
    u_low, u_high, v_low, v_high = u_low * wide, u_high * wide, v_low * long, v_high * long
    sum_u, sum_v, sum_w, full = zero, zero, zero, 0
    for k in range(members.number):
        x, y, r = broadcast_from(rows, u * room + k), broadcast_from(rows, v * room + k), rows[R * room + k]
        du, dv = vmax(vmax(u_low - x, x - u_high), zero), vmax(vmax(v_low - y, y - v_high), zero)
        dw = max(-rows[w * room + k], rows[w * room + k] - (cell[3 + w] - cell[w]), ZERO)
        over = du * du + dv * dv <= r * r - dw * dw
        word = bits(over)
        words[k] = word
        full |= word
        sum_u = sum_u + select(over, broadcast_from(rows, (N + u) * room + k), zero)
        sum_v = sum_v + select(over, broadcast_from(rows, (N + v) * room + k), zero)
        sum_w = sum_w + select(over, broadcast_from(rows, (N + w) * room + k), zero)
    return full, sum_u, sum_v, sum_w


@inline
def _slabs(
    members: Members, axes: tuple[int, int, int], words: Array, m: tuple[F16, F16, F16], limits: Limits
) -> tuple[F16, F16]:
    """Return for each of a voxel's 4 x 4 columns (lanes) the least and the largest m.x of any surface in it.

    members : splats over the voxel; positions x are relative to the voxel's least corner
    axes : (u, v, w), columns run along w
    words : for each splat the columns that its support overlaps, as bits
    m : components along u, v, w of a unit vector for each column
    limits : the numbers of `leaves.limits_of`, which bound how far surface can be from its splats
    """
    u, v, w = axes
    rows, room, inf = members.rows, members.room, broadcast16(INF)
    cosine, least, most = broadcast16(ONE), inf, broadcast16(ZERO)
    for k in range(members.number):
        over, r = mask16(words[k]), broadcast_from(rows, R * room + k)
        nu, nv = broadcast_from(rows, (N + u) * room + k), broadcast_from(rows, (N + v) * room + k)
        c = m[0] * nu + m[1] * nv + m[2] * broadcast_from(rows, (N + w) * room + k)
        cosine = select(over, vmin(c, cosine), cosine)
        least, most = select(over, vmin(r, least), least), select(over, vmax(r, most), most)
    away = _away(cosine, least, most, limits)
    low, high = inf, -ONE * inf
    for k in range(members.number):
        over, reach = mask16(words[k]), away * broadcast_from(rows, R * room + k)
        x, y = broadcast_from(rows, u * room + k), broadcast_from(rows, v * room + k)
        height = m[0] * x + m[1] * y + m[2] * broadcast_from(rows, w * room + k)
        low, high = select(over, vmin(height - reach, low), low), select(over, vmax(height + reach, high), high)
    return low, high


@inline
def fill_patches(
    members: Members, cell: Array, mean: float, slab: tuple[Vec3, float, Limits], words: Array, out: Array
) -> None:
    """Compute the slabs of a leaf's 4 x 4 columns; infinite ones, if they are not much thinner than the leaf's slab.

    members : splats over the voxel; mean : their mean radius
    cell : the voxel's box
    slab : (normal, thickness, limits), where
        `normal` and `thickness` are those of the leaf's slab
        `limits` are the numbers of `leaves.limits_of`, which bound how far surface can be from its splats
    words : work space, one number per splat
    out : (64,) float32, B, C, low and high of 16 slabs low <= w + B u + C v <= high
    """
    normal, thickness, limits = slab
    u, v, w = axes = across(normal[0], normal[1], normal[2])
    full, mu, mv, mw = _over(members, cell, axes, words)
    # A column's normal is the mean of its splats' normals, or the leaf's normal if that mean is steep.
    length = vsqrt(mu * mu + mv * mv + mw * mw)
    upright, scale = vabs(mw) > STEEP * length, ONE / vmax(length, broadcast16(TINY))
    mu = select(upright, mu * scale, broadcast16(normal[u]))
    mv = select(upright, mv * scale, broadcast16(normal[v]))
    mw = select(upright, mw * scale, broadcast16(normal[w]))
    low, high = _slabs(members, axes, words, (mu, mv, mw), limits)
    there, zero, none = mask16(full), broadcast16(ZERO), broadcast16(NO_SURFACE)
    if sum_of(select(there, high - low, zero)) > WORTH * count_bits(full) * thickness:
        out[:PATCH_LOW], out[PATCH_LOW:PATCH_HIGH], out[PATCH_HIGH:] = 0.0, -np.inf, np.inf
        return
    pad, rise = PAD * f32(mean), ONE / mw
    a, b = (low - pad) * rise, (high + pad) * rise
    store(out, PATCH_B, select(there, mu * rise * ((cell[3 + u] - cell[u]) / f32(COLUMNS)), zero))
    store(out, PATCH_C, select(there, mv * rise * ((cell[3 + v] - cell[v]) / f32(COLUMNS)), zero))
    store(out, PATCH_LOW, select(there, vmin(a, b), none))
    store(out, PATCH_HIGH, select(there, vmax(a, b), none))
