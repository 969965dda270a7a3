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
    permute16,
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
    """Return the low edge of a leaf's voxel along an axis, and the width of its columns."""
    low, high = tree.leaves[leaf * LEAF + CELL + axis], tree.leaves[leaf * LEAF + CELL + 3 + axis]
    return low, (high - low) * f32(1.0 / COLUMNS) + THIN


@inline
def _begin(coordinate: F16, inverse: F16) -> tuple[F16, F16, F16, F16]:
    """Prepare a walk of 16 rays through a leaf's columns along one axis.

    coordinate : of the rays' positions, in column widths; inverse : of their directions

    Returns the rays' columns (0 to 3), the faces through which they leave these (0 low, 1 high), the steps to their
    next columns (-1 or 1), and the last columns on their way (0 or 3).
    """
    ahead = inverse > ZERO
    column = trunc(vmin(vmax(coordinate, broadcast16(ZERO)), broadcast16(LAST)))
    side = select(ahead, broadcast16(ONE), broadcast16(ZERO))
    return column, side, side + side - ONE, LAST * side


@inline
def _in_columns(tree: Tree, leaf: int, axes: Axes, rays: Along[Real], enter: Real) -> Along[Real]:
    """Transform rays to units of column widths along u and v, relative to the voxel's low corner.

    axes : of the leaf's columns; rays : origins and directions along these, and inverse directions along u and v
    enter : t where they enter the voxel

    Returns positions at `enter`, directions, and inverse directions along u and v.
    """
    (ou, ov, ow), (du, dv, dw), (iu, iv) = rays
    (low_u, wide_u), (low_v, wide_v) = _edge(tree, leaf, axes[0]), _edge(tree, leaf, axes[1])
    low_w = _edge(tree, leaf, axes[2])[0]
    per_u, per_v = ONE / wide_u, ONE / wide_v
    u, v, w = (ou + enter * du - low_u) * per_u, (ov + enter * dv - low_v) * per_v, ow + enter * dw - low_w
    return (u, v, w), (du * per_u, dv * per_v, dw), (iu * wide_u, iv * wide_v)


@inline
def _in_slab(
    slopes: tuple[F16, F16], borders: tuple[F16, F16], position: tuple[Real, Real, Real], d: tuple[Real, Real, Real]
) -> tuple[F16, F16]:
    """Return t where rays enter and leave the slabs of columns, relative to where they enter the voxel.

    slopes : B and C of slabs low <= w + B u + C v <= high; borders : low and high
    position, d : positions and directions of the rays along u, v (in column widths) and w
    """
    height, rise = (
        position[2] + slopes[0] * position[0] + slopes[1] * position[1],
        d[2] + slopes[0] * d[0] + slopes[1] * d[1],
    )
    rise = ONE / select(vabs(rise) < broadcast16(FLAT), broadcast16(FLAT), rise)
    x, y = (borders[0] - height) * rise, (borders[1] - height) * rise
    return vmin(x, y), vmax(x, y)


@inline
def narrow(tree: Tree, leaf: int, axes: Axes, rays: Along[F16], interval: tuple[F16, F16]) -> tuple[F16, F16]:
    """Return the part (low, high) of 16 rays' intervals in which the surface can be; low > high if there is none.

    axes : of the leaf's columns; rays : origins and directions along these, and inverse directions along u and v
    interval : t between which the rays are in the leaf's box and slab

    It is the part in the slabs of the columns that each ray crosses. Either all columns of a leaf have a slab or none
    do: then intervals are returned unchanged.
    """
    patch = leaf * PATCH
    if not tree.patches[patch + PATCH_LOW] > -INF:
        return interval
    enter, length = interval[0], interval[1] - interval[0]
    position, d, (iu, iv) = _in_columns(tree, leaf, axes, rays, enter)
    u, v = position[0], position[1]
    (i, side_u, next_u, end_u), (j, side_v, next_v, end_v) = _begin(u, iu), _begin(v, iv)
    inside, first, last = broadcast16(ZERO), broadcast16(INF), broadcast16(-INF)
    for _ in range(MOST):
        column = f32(COLUMNS) * i + j
        slopes = permute16(tree.patches, patch + PATCH_B, column), permute16(tree.patches, patch + PATCH_C, column)
        borders = (
            permute16(tree.patches, patch + PATCH_LOW, column),
            permute16(tree.patches, patch + PATCH_HIGH, column),
        )
        # The outermost columns end with the voxel, except for rounding.
        out_u = select((end_u - i) * next_u > ZERO, (i + side_u - u) * iu, broadcast16(INF))
        out_v = select((end_v - j) * next_v > ZERO, (j + side_v - v) * iv, broadcast16(INF))
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

    coordinate : of the ray's position, in column widths; inverse : of its direction; column : 0 to 3, one for each lane
    """
    outside = broadcast16(INF if inverse > ZERO else -INF)
    low = select(column > ZERO, (column - coordinate) * inverse, ZERO - outside)
    high = select(column < broadcast16(LAST), (column + ONE - coordinate) * inverse, outside)
    return vmin(low, high), vmax(low, high)


@inline
def narrow_one(
    tree: Tree, leaf: int, axes: Axes, ray: Along[float], interval: tuple[float, float]
) -> tuple[float, float]:
    """Return the part (low, high) of one ray's interval in which the surface can be; low > high if there is none.

    axes : of the leaf's columns; ray : origin and direction along these, and inverse direction along u and v
    interval : t between which the ray is in the leaf's box and slab

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
