"""The implicit surfaces (paper, part I): weighted sums over the splats around a point, and f from them.

All sums run over q = p_i - x, never over absolute coordinates, which would cancel in float32. With the weighted means
P - x = E[q], N = E[n]:

    paper   f = (x - P).N                         = -E[q].E[n]                   (Adamson and Alexa 2003)
    imls    f = E[n.(x - p)]                      = -E[q.n]
    apss    f = the sphere fitted with normals at x: -E[q].E[n] - u4 (E[q.q] - 2 E[q].E[q])
            u4 = (E[q.n] - E[q].E[n]) / 2 var(q)                               (Guennebaud and Gross 2007)

`apss` is thus the mean of the other two, whose biases are opposite, and a term of curvature. var(q) is taken at least
E[q.q] / 4, which changes nothing inside of the cloud and keeps the fit tame where two splats are seen from afar.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inline
from ..records import BLOCK, IMLS, INV_R2, NX, NY, NZ, PAPER, PX, PY, PZ
from ..scratch import COUNT_NEAR
from ..simd import bits, lane, lowest, repeat4, select, spread16, sum_quarters, vmax

ZERO, HALF, ONE, TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
QUARTER = np.float32(0.25)
NAN = np.float32(np.nan)


@inline
def sums(tree, scratch, x, y, z):  # type: ignore[no-untyped-def]
    """Weighted means over the near splats at four points, one a quarter: q (3), n (3), q.n, q.q, and the weight.

    22 vector instructions a block of 4 splats at 4 points. A point that no support reaches has weight 0, means NaN.
    """
    w_sum = spread16(ZERO)
    qx_sum = qy_sum = qz_sum = nx_sum = ny_sum = nz_sum = qn_sum = qq_sum = w_sum
    blocks, near = tree.blocks, scratch.near
    for k in range(scratch.counts[COUNT_NEAR]):
        slot = np.int64(near[k]) * BLOCK
        qx = repeat4(blocks, slot + PX) - x
        qy = repeat4(blocks, slot + PY) - y
        qz = repeat4(blocks, slot + PZ) - z
        qq = qx * qx + qy * qy + qz * qz
        w = vmax(ONE - qq * repeat4(blocks, slot + INV_R2), spread16(ZERO))
        w = w * w
        nx, ny, nz = repeat4(blocks, slot + NX), repeat4(blocks, slot + NY), repeat4(blocks, slot + NZ)
        w_sum = w_sum + w
        qx_sum = qx_sum + w * qx
        qy_sum = qy_sum + w * qy
        qz_sum = qz_sum + w * qz
        nx_sum = nx_sum + w * nx
        ny_sum = ny_sum + w * ny
        nz_sum = nz_sum + w * nz
        qn_sum = qn_sum + w * (qx * nx + qy * ny + qz * nz)
        qq_sum = qq_sum + w * qq
    w_sum = sum_quarters(w_sum)
    scale = ONE / w_sum
    return (
        sum_quarters(qx_sum) * scale,
        sum_quarters(qy_sum) * scale,
        sum_quarters(qz_sum) * scale,
        sum_quarters(nx_sum) * scale,
        sum_quarters(ny_sum) * scale,
        sum_quarters(nz_sum) * scale,
        sum_quarters(qn_sum) * scale,
        sum_quarters(qq_sum) * scale,
        w_sum,
    )


@inline
def value(surface, means):  # type: ignore[no-untyped-def]
    """f (NaN without support) and u4, the curvature term of the fitted sphere (0 but for apss)."""
    qx, qy, qz, nx, ny, nz, qn, qq, weight = means
    plane = qx * nx + qy * ny + qz * nz
    u4 = weight * ZERO
    if surface == PAPER:
        f = ZERO - plane
    elif surface == IMLS:
        f = ZERO - qn
    else:
        center = qx * qx + qy * qy + qz * qz
        u4 = HALF * (qn - plane) / vmax(qq - center, QUARTER * qq)
        f = u4 * (TWO * center - qq) - plane
    return select(weight > ZERO, f, spread16(NAN)), u4


@inline
def normal(surface, means):  # type: ignore[no-untyped-def]
    """Unit normal at the first of the four points: the mean normal, for apss the gradient of the fitted sphere."""
    _, u4 = value(surface, means)
    bend = TWO * lane(u4, 0)
    nx = lane(means[3], 0) - bend * lane(means[0], 0)
    ny = lane(means[4], 0) - bend * lane(means[1], 0)
    nz = lane(means[5], 0) - bend * lane(means[2], 0)
    length = math.sqrt(max(nx * nx + ny * ny + nz * nz, np.float32(1e-30)))
    return nx / length, ny / length, nz / length


@inline
def offset(means):  # type: ignore[no-untyped-def]
    """|x - P(x)| at the first of the four points: how far outside of its splats' middle the point lies."""
    qx, qy, qz = lane(means[0], 0), lane(means[1], 0), lane(means[2], 0)
    return math.sqrt(qx * qx + qy * qy + qz * qz)


@inline
def weights_of_block(tree, block, x, y, z):  # type: ignore[no-untyped-def]
    """Weights of one block's splats at a point, in lanes 0..3 (repeated in the other quarters)."""
    slot = np.int64(block) * BLOCK
    qx = repeat4(tree.blocks, slot + PX) - x
    qy = repeat4(tree.blocks, slot + PY) - y
    qz = repeat4(tree.blocks, slot + PZ) - z
    w = vmax(ONE - (qx * qx + qy * qy + qz * qz) * repeat4(tree.blocks, slot + INV_R2), spread16(ZERO))
    return w * w


@inline
def local_radius(tree, scratch, x, y, z):  # type: ignore[no-untyped-def]
    """Support radius at a point: r^2 averaged with the surface's weights (1 / r^2 trims where radii differ much)."""
    weight = square = spread16(ZERO)
    for k in range(scratch.counts[COUNT_NEAR]):
        w = weights_of_block(tree, scratch.near[k], x, y, z)
        weight = weight + w
        square = square + w / repeat4(tree.blocks, np.int64(scratch.near[k]) * BLOCK + INV_R2)
    return math.sqrt(lane(sum_quarters(square), 0) / lane(sum_quarters(weight), 0))


@inline
def overhang(tree, scratch, x, y, z):  # type: ignore[no-untyped-def]
    """Share of the weight at a point that belongs to splats on an open border, and how far it lies out of them.

    The distance is the weighted mean of (x - p).b over those splats, b the direction out of the surface.
    """
    total, share, out = np.float32(1e-30), np.float32(1e-30), ZERO
    for k in range(scratch.counts[COUNT_NEAR]):
        block = np.int64(scratch.near[k])
        weights = weights_of_block(tree, block, x, y, z)
        left = bits(weights > ZERO) & 15
        while left != 0:
            j = lowest(left)
            left &= left - 1
            w, at = lane(weights, j), 3 * (block * 4 + j)
            total += w
            bx, by, bz = tree.borders[at], tree.borders[at + 1], tree.borders[at + 2]
            if bx != 0 or by != 0 or bz != 0:
                slot = block * BLOCK + j
                share += w
                out += w * (
                    (x - tree.blocks[slot + PX]) * np.float32(bx)
                    + (y - tree.blocks[slot + PY]) * np.float32(by)
                    + (z - tree.blocks[slot + PZ]) * np.float32(bz)
                )
    return share / total, out / (np.float32(127.0) * share)


@inline
def blend(tree, scratch, table, x, y, z):  # type: ignore[no-untyped-def]
    """Linear colour (by the surface's own weights; 1 without colours) and slot of most weight at a surface point.

    table : (256,) float32, linear value of each sRGB level
    """
    red = green = blue = total = ZERO
    most, best = ZERO, np.int64(-1)
    for k in range(scratch.counts[COUNT_NEAR]):
        block = scratch.near[k]
        weights = weights_of_block(tree, block, x, y, z)
        left = bits(weights > ZERO) & 15
        while left != 0:
            j = lowest(left)
            left &= left - 1
            w = lane(weights, j)
            slot = np.int64(block) * 4 + j
            if w > most:
                most, best = w, slot
            if tree.colors.size > 0:
                packed = tree.colors[slot]
                red += w * table[packed & 255]
                green += w * table[(packed >> 8) & 255]
                blue += w * table[packed >> 16]
                total += w
    if total > ZERO:
        return red / total, green / total, blue / total, best
    return ONE, ONE, ONE, best
