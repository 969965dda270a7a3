"""The implicit surfaces (paper, part I): weighted sums over the splats around a point, and f from these sums.

All sums are of q = p_i - x, never of absolute coordinates, which would cancel in float32. With the weighted means
P - x = E[q], N = E[n]:

    paper   f = (x - P).N                         = -E[q].E[n]                   (Adamson and Alexa 2003)
    imls    f = E[n.(x - p)]                      = -E[q.n]
    apss    f = the sphere fitted with normals at x: -E[q].E[n] - u4 (E[q.q] - 2 E[q].E[q])
            u4 = (E[q.n] - E[q].E[n]) / 2 var(q)                               (Guennebaud and Gross 2007)

`apss` is thus the mean of the other two, whose biases are opposite, plus a curvature term. var(q) is at least
E[q.q] / 4, which changes nothing inside the cloud and keeps the fit stable where x is far from its only two splats. At
a splat's own point, where no other support covers it, q is 0 and so is u4.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from ...engine.jit import Array, f32, i64, inline
from ...engine.kernels.scratch import COUNT_SPLATS, Scratch, slot_of
from ...engine.kernels.tree import BLOCK, IMLS, INV_R2, NX, NY, NZ, PAPER, PX, PY, PZ, Tree
from ...engine.kernels.vec import Vec3
from ...engine.simd import (
    F16,
    ONE,
    ZERO,
    Real,
    broadcast16,
    broadcast_from,
    broadcast_like,
    by_width,
    high_half,
    join_halves,
    low_half,
    number_like,
    repeat4,
    select,
    vmax,
    vsqrt,
)

HALF, TWO = f32(0.5), f32(2.0)
QUARTER = f32(0.25)
NAN = f32(np.nan)
TINIEST = f32(1e-35)  # smallest squared length used as a divisor

FourPoints: TypeAlias = tuple[F16, F16, F16]  # x, y, z, a quarter of the lanes for each point
Sheet: TypeAlias = tuple[bool, Vec3]  # whether sheets are close together, and the hit's normal


class Means(NamedTuple):
    """Weighted means over the splats near sixteen points x, from which f is computed.

    qx, qy, qz : mean of q = p - x, the splats' positions relative to x
    nx, ny, nz : mean of the splats' normals n
    qn, qq : means of the dot products q.n and q.q
    weight : sum of the weights, 0 outside of all supports
    """

    qx: F16
    qy: F16
    qz: F16
    nx: F16
    ny: F16
    nz: F16
    qn: F16
    qq: F16
    weight: F16


@inline
def _sums(scratch: Scratch, x: Real, y: Real, z: Real) -> Means:
    """Compute `sums` at as many points as the vectors x, y, z have lanes. It takes 21 vector instructions a splat."""
    w_sum = number_like(ZERO, x)
    qx_sum = qy_sum = qz_sum = nx_sum = ny_sum = nz_sum = qn_sum = qq_sum = w_sum
    splats, listed = scratch.splats, scratch.listed
    for k in range(scratch.counts[COUNT_SPLATS]):
        offset = i64(listed[k])
        qx, qy, qz = (
            broadcast_like(splats, offset + 4 * PX, x) - x,
            broadcast_like(splats, offset + 4 * PY, x) - y,
            broadcast_like(splats, offset + 4 * PZ, x) - z,
        )
        qq = qx * qx + qy * qy + qz * qz
        w = vmax(ONE - qq * broadcast_like(splats, offset + 4 * INV_R2, x), number_like(ZERO, x))
        w = w * w
        nx, ny, nz = (
            broadcast_like(splats, offset + 4 * NX, x),
            broadcast_like(splats, offset + 4 * NY, x),
            broadcast_like(splats, offset + 4 * NZ, x),
        )
        w_sum = w_sum + w
        qx_sum = qx_sum + w * qx
        qy_sum = qy_sum + w * qy
        qz_sum = qz_sum + w * qz
        nx_sum = nx_sum + w * nx
        ny_sum = ny_sum + w * ny
        nz_sum = nz_sum + w * nz
        qn_sum = qn_sum + w * (qx * nx + qy * ny + qz * nz)
        qq_sum = qq_sum + w * qq
    scale = ONE / w_sum
    return Means(
        qx_sum * scale,
        qy_sum * scale,
        qz_sum * scale,
        nx_sum * scale,
        ny_sum * scale,
        nz_sum * scale,
        qn_sum * scale,
        qq_sum * scale,
        w_sum,
    )


@inline
def _join(low: Means, high: Means) -> Means:
    """Return means at the points of both arguments, those of `low` in the first half of the lanes."""
    return Means(
        join_halves(low.qx, high.qx),
        join_halves(low.qy, high.qy),
        join_halves(low.qz, high.qz),
        join_halves(low.nx, high.nx),
        join_halves(low.ny, high.ny),
        join_halves(low.nz, high.nz),
        join_halves(low.qn, high.qn),
        join_halves(low.qq, high.qq),
        join_halves(low.weight, high.weight),
    )


@inline
def _sums_by_halves(scratch: Scratch, x: Real, y: Real, z: Real) -> Means:
    """Compute `sums` at half of the points at a time."""
    low = _sums(scratch, low_half(x), low_half(y), low_half(z))
    return _join(low, _sums(scratch, high_half(x), high_half(y), high_half(z)))


@inline
def _sums_by_quarters(scratch: Scratch, x: F16, y: F16, z: F16) -> Means:
    """Compute `sums` at a quarter of the points at a time."""
    low = _sums_by_halves(scratch, low_half(x), low_half(y), low_half(z))
    return _join(low, _sums_by_halves(scratch, high_half(x), high_half(y), high_half(z)))


# The weighted means over the splats listed in `scratch`, those near the rays, at sixteen points x, y, z. At a point
# outside all supports the weight is 0 and the means are NaN.
sums = by_width(_sums, _sums_by_halves, _sums_by_quarters)
sums_at_eight = by_width(_sums, _sums, _sums_by_halves)  # the same at eight points


@inline
def value(surface: int, means: Means) -> tuple[Real, Real]:
    """Return f (NaN without support) and u4, the curvature term of the fitted sphere (0 except for apss).

    surface : kind of surface, such as PAPER; means : over the splats, at some points
    """
    qx, qy, qz, nx, ny, nz, qn, qq, weight = means
    plane = qx * nx + qy * ny + qz * nz
    u4 = weight * ZERO
    if surface == PAPER:
        f = ZERO - plane
    elif surface == IMLS:
        f = ZERO - qn
    else:
        center = qx * qx + qy * qy + qz * qz
        u4 = HALF * (qn - plane) / vmax(qq - center, vmax(QUARTER * qq, TINIEST))
        f = u4 * (TWO * center - qq) - plane
    return select(weight > ZERO, f, NAN), u4


@inline
def _weight(scratch: Scratch, offset: int, x: F16, y: F16, z: F16) -> F16:
    """Return the weights of one splat at sixteen points x, y, z, 0 outside of its support.

    offset : where the splat is in `scratch.splats`
    """
    splats = scratch.splats
    qx, qy, qz = (
        broadcast_from(splats, offset + 4 * PX) - x,
        broadcast_from(splats, offset + 4 * PY) - y,
        broadcast_from(splats, offset + 4 * PZ) - z,
    )
    w = vmax(ONE - (qx * qx + qy * qy + qz * qz) * broadcast_from(splats, offset + 4 * INV_R2), broadcast16(ZERO))
    return w * w


@inline
def local_radius(scratch: Scratch, x: F16, y: F16, z: F16) -> F16:
    """Return the root mean square of the support radii around sixteen points x, y, z, weighted as in f.

    The splats are those listed in `scratch`. A mean of 1 / r^2 instead would trim hits where radii differ much.
    """
    weight = square = broadcast16(ZERO)
    for k in range(scratch.counts[COUNT_SPLATS]):
        offset = i64(scratch.listed[k])
        w = _weight(scratch, offset, x, y, z)
        weight = weight + w
        square = square + w * (ONE / broadcast_from(scratch.splats, offset + 4 * INV_R2))
    return vsqrt(square / weight)


@inline
def overhang(tree: Tree, scratch: Scratch, x: F16, y: F16, z: F16) -> tuple[F16, F16]:
    """Return how much sixteen points depend on splats on an open border, and how far they are beyond these splats.

    The first is the share of these splats in the sum of weights. The second is the weighted mean over these splats of
    (x - p).b, where x is the point, p the splat's position and b its direction out of the surface.
    """
    total = share = broadcast16(f32(1e-30))
    out = broadcast16(ZERO)
    splats = scratch.splats
    for k in range(scratch.counts[COUNT_SPLATS]):
        offset = i64(scratch.listed[k])
        w = _weight(scratch, offset, x, y, z)
        total = total + w
        row = 3 * slot_of(scratch, offset)
        bx, by, bz = tree.borders[row], tree.borders[row + 1], tree.borders[row + 2]
        if bx != 0 or by != 0 or bz != 0:
            share = share + w
            qx, qy, qz = (
                x - broadcast_from(splats, offset + 4 * PX),
                y - broadcast_from(splats, offset + 4 * PY),
                z - broadcast_from(splats, offset + 4 * PZ),
            )
            out = out + w * (qx * f32(bx) + qy * f32(by) + qz * f32(bz))
    return share / total, out / (f32(127.0) * share)


@inline
def weights_of_block(tree: Tree, block: int, x: Real, y: Real, z: Real) -> F16:
    """Return the weights of a block's four splats at one point, or at four points: lane 4 r + j for splat j at point r.

    block : number of the block
    x, y, z : one point as numbers (the result is repeated in all quarters), or four points, each in a quarter of the
        lanes
    """
    slot = i64(block) * BLOCK
    qx = repeat4(tree.blocks, slot + PX) - x
    qy = repeat4(tree.blocks, slot + PY) - y
    qz = repeat4(tree.blocks, slot + PZ) - z
    w = vmax(ONE - (qx * qx + qy * qy + qz * qz) * repeat4(tree.blocks, slot + INV_R2), broadcast16(ZERO))
    return w * w


@inline
def weights_seen(tree: Tree, block: int, points: FourPoints, sheet: Sheet, part: Array) -> F16:
    """Return the weights of a block's four splats at four hits: lane 4 r + j for splat j at hit r.

    Where two sheets are close together, splats of the sheet that faces away from the hit's normal get weight 0.

    block : number of the block; part : work space
    points : x, y, z of the hits, a quarter of the lanes for each
    sheet : whether two sheets are close together, and the hit's normal, used only then
    """
    x, y, z = points
    w = weights_of_block(tree, block, x, y, z)
    if sheet[0]:
        for j in range(4):
            row, v = 3 * (4 * i64(block) + j), sheet[1]
            along = tree.facing[row] * v[0] + tree.facing[row + 1] * v[1] + tree.facing[row + 2] * v[2]
            part[j] = ONE if along >= 0.0 else ZERO
        w = w * repeat4(part, 0)
    return w
