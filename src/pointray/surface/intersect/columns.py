"""Intervals of rays in the columns of a voxel, each of which has a slab of its own (`tree/columns.py`)."""

from __future__ import annotations

from typing import TypeAlias, TypeVar

from ...engine.jit import f32, inline
from ...engine.kernels.tree import CELL, COLUMNS, LEAF, PATCH, PATCH_B, PATCH_C, PATCH_HIGH, PATCH_LOW, SLAB, Tree
from ...engine.simd import (
    F16,
    INF,
    ONE,
    ZERO,
    Real,
    bits,
    broadcast16,
    fours,
    load16,
    look_up,
    number_like,
    quarters,
    reduce_max,
    reduce_min,
    select,
    trunc,
    vabs,
    vmax,
    vmin,
)
from ..tree.columns import across

FLAT = f32(1e-6)  # smallest slope used as a divisor in a slab test
THIN = f32(1e-20)  # smallest column width used as a divisor
LAST = f32(COLUMNS - 1)
MOST = 2 * COLUMNS - 1  # largest number of columns that a ray can cross

Axes: TypeAlias = tuple[int, int, int]
_R = TypeVar("_R")
# Rays along the axes of a leaf's columns: origins and directions along u, v, w, inverse directions along u and v.
Along: TypeAlias = tuple[tuple[_R, _R, _R], tuple[_R, _R, _R], tuple[_R, _R]]


@inline
def axes_of(tree: Tree, leaf: int) -> Axes:
    """Return the axes (u, v, w) of a leaf's columns; w, along which they run, is closest to the normal of its slab."""
    offset = leaf * LEAF + SLAB
    return across(tree.leaves[offset], tree.leaves[offset + 1], tree.leaves[offset + 2])


@inline
def _edge(tree: Tree, leaf: int, axis: int) -> tuple[float, float]:
    """Return the low edge of a leaf's voxel along an axis, and the width along it of the leaf's 4 x 4 columns."""
    low, high = tree.leaves[leaf * LEAF + CELL + axis], tree.leaves[leaf * LEAF + CELL + 3 + axis]
    return low, (high - low) * f32(1.0 / COLUMNS) + THIN


@inline
def _begin(coordinate: Real, inverse: Real) -> tuple[Real, Real, Real, Real]:
    """Prepare a walk of rays through a leaf's 4 x 4 columns along one axis.

    coordinate : the rays' positions on the axis, in column widths from the voxel's low corner
    inverse : inverse of the rays' direction along the axis

    Returns four vectors, a ray in each lane: index of the first column, 0 to 3; the face through which the ray leaves a
    column, 0 for the low one, 1 for the high one; the step to the next column, -1 or 1; index of the last one, 0 or 3.
    """
    ahead = inverse > ZERO
    column = trunc(vmin(vmax(coordinate, ZERO), LAST))
    side = select(ahead, number_like(ONE, inverse), ZERO)
    return column, side, side + side - ONE, LAST * side


@inline
def _in_columns(tree: Tree, leaf: int, axes: Axes, rays: Along[Real], enter: Real) -> Along[Real]:
    """Transform rays to units of column widths along u and v, relative to the low corner of a leaf's voxel.

    axes : (u, v, w) of the leaf's columns, which run along w
    rays : origins and directions along u, v, w, and inverse directions along u and v
    enter : t where the rays enter the voxel

    Returns the rays' positions at `enter` and directions along u, v, w, and inverse directions along u and v.
    """
    (ou, ov, ow), (du, dv, dw), (iu, iv) = rays
    (low_u, wide_u), (low_v, wide_v) = _edge(tree, leaf, axes[0]), _edge(tree, leaf, axes[1])
    low_w = _edge(tree, leaf, axes[2])[0]
    per_u, per_v = ONE / wide_u, ONE / wide_v
    u, v, w = (ou + enter * du - low_u) * per_u, (ov + enter * dv - low_v) * per_v, ow + enter * dw - low_w
    return (u, v, w), (du * per_u, dv * per_v, dw), (iu * wide_u, iv * wide_v)


@inline
def _in_slab(
    slopes: tuple[Real, Real], borders: tuple[Real, Real], position: tuple[Real, Real, Real], d: tuple[Real, Real, Real]
) -> tuple[Real, Real]:
    """Return t where rays enter and leave the slabs of columns, relative to t where they enter the voxel.

    slopes, borders : (B, C) and (low, high) of slabs low <= w + B u + C v <= high
    position, d : positions (where the rays enter the voxel) and directions along u, v (in column widths) and w
    """
    height, rise = (
        position[2] + slopes[0] * position[0] + slopes[1] * position[1],
        d[2] + slopes[0] * d[0] + slopes[1] * d[1],
    )
    rise = ONE / select(vabs(rise) < FLAT, FLAT, rise)
    x, y = (borders[0] - height) * rise, (borders[1] - height) * rise
    return vmin(x, y), vmax(x, y)


@inline
def narrow(tree: Tree, leaf: int, axes: Axes, rays: Along[Real], interval: tuple[Real, Real]) -> tuple[Real, Real]:
    """Narrow the intervals of rays in a leaf to the slabs of the columns that they cross; low > high for a miss.

    Where the leaf's columns have no slabs of their own, intervals are returned unchanged.

    axes : (u, v, w) of the leaf's columns, which run along w
    rays : origins and directions along u, v, w, and inverse directions along u and v
    interval : t (low, high) between which each ray is in the leaf's box and slab
    """
    patch = leaf * PATCH
    if not tree.patches[patch + PATCH_LOW] > -INF:
        return interval
    enter, length = interval[0], interval[1] - interval[0]
    position, d, (iu, iv) = _in_columns(tree, leaf, axes, rays, enter)
    u, v = position[0], position[1]
    (i, side_u, next_u, end_u), (j, side_v, next_v, end_v) = _begin(u, iu), _begin(v, iv)
    inside, first, last = number_like(ZERO, u), number_like(INF, u), number_like(-INF, u)
    for _ in range(MOST):
        column = f32(COLUMNS) * i + j
        slopes = look_up(tree.patches, patch + PATCH_B, column), look_up(tree.patches, patch + PATCH_C, column)
        borders = (look_up(tree.patches, patch + PATCH_LOW, column), look_up(tree.patches, patch + PATCH_HIGH, column))
        # The outermost columns end with the voxel, except for rounding.
        out_u = select((end_u - i) * next_u > ZERO, (i + side_u - u) * iu, INF)
        out_v = select((end_v - j) * next_v > ZERO, (j + side_v - v) * iv, INF)
        out = vmin(vmin(out_u, out_v), length)
        near, far = _in_slab(slopes, borders, position, d)
        near, far = vmax(inside, near), vmin(out, far)
        met = near <= far
        first, last = select(met, vmin(first, near), first), select(met, vmax(last, far), last)
        going = out < length
        if bits(going) == 0:
            break
        go_v = (out_v < out_u) & going
        i, j = select(going ^ go_v, i + next_u, i), select(go_v, j + next_v, j)
        inside = vmax(inside, out)
    return enter + first, enter + last


@inline
def _across(coordinate: float, inverse: float, column: F16) -> tuple[F16, F16]:
    """Return t where one ray enters and leaves columns along one axis; the outermost columns are unbounded outward.

    coordinate : the ray's position on the axis, in column widths from the voxel's low corner
    inverse : inverse of the ray's direction along the axis; column : index of the column, 0 to 3, in each lane
    """
    outside = broadcast16(INF if inverse > ZERO else -INF)
    low = select(column > ZERO, (column - coordinate) * inverse, ZERO - outside)
    high = select(column < broadcast16(LAST), (column + ONE - coordinate) * inverse, outside)
    return vmin(low, high), vmax(low, high)


@inline
def narrow_one(
    tree: Tree, leaf: int, axes: Axes, ray: Along[float], interval: tuple[float, float]
) -> tuple[float, float]:
    """Narrow the interval of one ray in a leaf to the slabs of the columns that it crosses; low > high for a miss.

    axes : (u, v, w) of the leaf's columns, which run along w
    ray : origin and direction along u, v, w, and inverse direction along u and v
    interval : t (low, high) between which the ray is in the leaf's box and slab

    All columns are tested at once, one a lane. With 16 equal rays in `narrow`, column by column, bounces took 1.02 (a
    million points) to 1.05 times as long (32,000).
    """
    patch = leaf * PATCH
    if not tree.patches[patch + PATCH_LOW] > -INF:
        return interval
    enter, length = interval[0], interval[1] - interval[0]
    position, d, inverse = _in_columns(tree, leaf, axes, ray, enter)
    two, three = f32(2.0), f32(3.0)
    enter_u, leave_u = _across(position[0], inverse[0], quarters(ZERO, ONE, two, three))
    enter_v, leave_v = _across(position[1], inverse[1], fours(ZERO, ONE, two, three))
    slopes = load16(tree.patches, patch + PATCH_B), load16(tree.patches, patch + PATCH_C)
    borders = load16(tree.patches, patch + PATCH_LOW), load16(tree.patches, patch + PATCH_HIGH)
    near, far = _in_slab(slopes, borders, position, d)
    near = vmax(vmax(enter_u, enter_v), vmax(near, broadcast16(ZERO)))
    far = vmin(vmin(leave_u, leave_v), vmin(far, broadcast16(length)))
    met = near <= far
    first, last = reduce_min(select(met, near, broadcast16(INF))), reduce_max(select(met, far, broadcast16(-INF)))
    return enter + first, enter + last
