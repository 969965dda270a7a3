"""Intersection of rays with scattered points, drawn as spheres or as single flat discs, in one leaf.

The discriminant is computed from the vector between the ray and the centre, not from the difference of two large
squares (Haines et al., Precision Improvements for Ray/Sphere Intersection, Ray Tracing Gems, 2019, chapter 7).

Start rule, see `meet_sphere` and `meet_disc`: a ray that starts on a sphere or a disc does not hit it, in any
direction, because shading normals are blended and a ray may begin below the exact horizon. Only a ray that starts on
the inner side (`Ray.side` is -1: light that enters glass) hits the far side of the sphere. A ray that starts deeper
inside also hits the far side. A ray cut by a clip plane starts on nothing.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from ...engine.jit import Array, f32, i64, inline
from ...engine.kernels import scratch as sc, tree as tr
from ...engine.kernels.scratch import Scratch, store3
from ...engine.kernels.tree import Hit, Ray, Tree
from ...engine.kernels.vec import Vec3
from ...engine.simd import (
    F8,
    INF,
    ONE,
    ZERO,
    Bits,
    Real,
    bits,
    broadcast8,
    count_trailing_zeros,
    join2,
    lane,
    load16,
    select,
    vabs,
    vsqrt,
)

Three: TypeAlias = tuple[Real, Real, Real]

# A ray starts on a sphere from 1% of the radius below it to 0.2% above. The latter is small, because a ray that starts
# on another surface touching the sphere must still hit it.
BELOW, ABOVE = f32(1.0 - 0.99**2), f32(1.002**2 - 1.0)  # squared radii
FLAT2 = f32(0.01**2)  # squared radii: distance from a disc's plane within which a ray starts on it


@inline
def approach(to: Three, d: Three, square: Real) -> tuple[Real, Real]:
    """Return t of the point of a ray nearest to a sphere's centre, and the squared half chord, below 0 for a miss.

    to : vector from the ray's origin to the centre; d : unit direction; square : squared radius
    It serves one ray and eight spheres, or one sphere and sixteen rays.
    """
    along = to[0] * d[0] + to[1] * d[1] + to[2] * d[2]
    x, y, z = to[0] - along * d[0], to[1] - along * d[1], to[2] - along * d[2]
    return along, square - (x * x + y * y + z * z)


@inline
def meet_sphere(chord: tuple[Real, Real], start: tuple[Real, Real], square: Real) -> Real:
    """Return t where a ray hits a sphere, inf for a miss. A ray that starts on the sphere only hits it from inside.

    chord : (t, half^2), t of the ray's point nearest to the centre and the squared half chord, from `approach`
    start : (begin, side), t where the ray begins, negative if it starts on no surface; and -1 if it starts inside
    square : squared radius
    """
    (along, rest), (begin, side) = chord, start
    half = vsqrt(rest)
    ahead = along - vabs(begin)
    near, anywhere = ahead * ahead, begin < ZERO
    inside = near < select(anywhere, rest, rest - BELOW * square)
    outside = near > select(anywhere, rest, rest + ABOVE * square)
    far = inside | ((near <= rest + ABOVE * square) & (side < ZERO) & (begin >= ZERO))
    meets = (rest >= ZERO) & (inside | ((far | outside) & (ahead > ZERO)))
    return select(meets, along + select(far, half, ZERO - half), INF)


@inline
def meet_disc(to: Three, d: Three, begin: Real, disc: tuple[Real, Real, Real, Real]) -> Real:
    """Return t where a ray hits a flat disc, inf for a miss. A ray that starts on the disc does not hit it.

    to : vector from the ray's origin to the disc's centre; d : unit direction
    begin : t where the ray begins, negative if it starts on no surface
    disc : normal x, y, z and squared radius
    """
    mx, my, mz, square = disc
    rise = mx * d[0] + my * d[1] + mz * d[2]
    height = mx * to[0] + my * to[1] + mz * to[2]
    t = height / rise
    x, y, z = to[0] - t * d[0], to[1] - t * d[1], to[2] - t * d[2]
    above = height - vabs(begin) * rise
    away = (begin < ZERO) | (above * above > FLAT2 * square)
    return select((x * x + y * y + z * z <= square) & (t >= vabs(begin)) & away, t, INF)


@inline
def _row(tree: Tree, at: int) -> F8:
    """Load a row of two consecutive blocks: one number for each of eight splats. at : its offset in the first block"""
    return join2(tree.blocks, at, at + tr.BLOCK)


@inline
def nearest_of_leaf(tree: Tree, block: int, ray: Ray, nearest: float, slot: int) -> tuple[float, int]:
    """Return t and slot of a ray's nearest hit so far, after testing the eight scattered points of a leaf.

    block : first of the leaf's two blocks
    nearest, slot : t and slot of the nearest hit before, or t where the search ends and -1

    A slot is four times the block plus the position in it. Of points at the same t the first slot wins.
    """
    at = block * tr.BLOCK
    to = _row(tree, at + tr.PX) - ray.ox, _row(tree, at + tr.PY) - ray.oy, _row(tree, at + tr.PZ) - ray.oz
    d, square, begin = (ray.dx, ray.dy, ray.dz), ONE / _row(tree, at + tr.INV_R2), broadcast8(ray.t_min)
    if tree.head[tr.SCATTER] == tr.SPHERES:
        t = meet_sphere(approach(to, d, square), (begin, broadcast8(ray.side)), square)
    else:
        t = meet_disc(to, d, begin, (_row(tree, at + tr.NX), _row(tree, at + tr.NY), _row(tree, at + tr.NZ), square))
    left = bits(t <= nearest)
    while left != 0:
        k = count_trailing_zeros(left)
        left &= left - 1
        if lane(t, k) < nearest or (lane(t, k) == nearest and 4 * block + k < slot):
            nearest, slot = lane(t, k), 4 * block + k
    return nearest, slot


@inline
def begin_scattered(rows: Array, numbers: Array, length: int, span: tuple[int, int]) -> None:
    """Reset the hits of a tile's rays with scattered points, before a model is traversed.

    rows, numbers : `Scratch.model` and `Scratch.numbers`
    length : offset in `rows` of the row that says how far each ray is followed
    span : first ray, and the end
    """
    for k in range(span[0], span[1]):
        rows[sc.SCATTER_T + k] = rows[sc.HIT_T + k] = INF
        rows[sc.SCATTER_END + k] = rows[length + k]
        numbers[sc.SCATTER_SLOT + k] = -1


@inline
def search_leaf(tree: Tree, block: int, passing: Bits, v: int, scratch: Scratch) -> Bits:
    """Find the nearest hits of 16 rays with the scattered points of a leaf, and store them in `scratch`.

    block : first of the leaf's two blocks; v : index in the tile of the first of the 16 rays
    passing : 16 bits, the rays to test

    Returns the rays with a new hit, as 16 bits, and perhaps some with one at the same t.
    """
    rows, numbers = scratch.model, scratch.numbers
    ox, oy, oz = load16(rows, sc.OX + v), load16(rows, sc.OY + v), load16(rows, sc.OZ + v)
    d = load16(rows, sc.DX + v), load16(rows, sc.DY + v), load16(rows, sc.DZ + v)
    begin, side, found = load16(rows, sc.BEGIN + v), load16(rows, sc.SIDE + v), i64(0)
    for j in range(4 * tr.LEAF_BLOCKS):
        at = (block + j // 4) * tr.BLOCK + j % 4
        if tree.blocks[at + tr.PX] > tr.FAR:
            break
        to = tree.blocks[at + tr.PX] - ox, tree.blocks[at + tr.PY] - oy, tree.blocks[at + tr.PZ] - oz
        square = ONE / tree.blocks[at + tr.INV_R2]
        if tree.head[tr.SCATTER] == tr.SPHERES:
            chord = approach(to, d, square)
            if bits(chord[1] >= ZERO) & passing == 0:  # saves 6% of the time in distant views; no gain for one ray
                continue
            t = meet_sphere(chord, (begin, side), square)
        else:
            m = tree.blocks[at + tr.NX], tree.blocks[at + tr.NY], tree.blocks[at + tr.NZ]
            t = meet_disc(to, d, begin, (*m, square))
        left, slot = bits(t <= load16(rows, sc.SCATTER_END + v)) & passing, 4 * block + j
        found |= left
        while left != 0:
            k = count_trailing_zeros(left) + v
            left &= left - 1
            t_k = lane(t, k - v)
            if t_k < rows[sc.SCATTER_END + k] or slot < numbers[sc.SCATTER_SLOT + k]:
                rows[sc.SCATTER_T + k] = rows[sc.SCATTER_END + k] = t_k
                numbers[sc.SCATTER_SLOT + k] = slot
    return found


@inline
def hit_scattered(tree: Tree, slot: int, t: float, o: Vec3, d: Vec3) -> Hit:
    """Return a ray's hit with a scattered point. The normal is exact; that of a sphere points outwards.

    slot : of the point, four times its block plus the position in the block; t : t of the hit
    o, d : origin and unit direction of the ray
    """
    at = slot // 4 * tr.BLOCK + slot % 4
    if tree.head[tr.SCATTER] == tr.SPHERES:
        # From the ray's nearest point to the centre: differences of small vectors, at any distance from the origin.
        x, y, z = tree.blocks[at + tr.PX] - o[0], tree.blocks[at + tr.PY] - o[1], tree.blocks[at + tr.PZ] - o[2]
        along = x * d[0] + y * d[1] + z * d[2]
        x, y, z = x - along * d[0], y - along * d[1], z - along * d[2]
        rest = t - along
        nx, ny, nz = rest * d[0] - x, rest * d[1] - y, rest * d[2] - z
    else:
        nx, ny, nz = tree.blocks[at + tr.NX], tree.blocks[at + tr.NY], tree.blocks[at + tr.NZ]
    size = ONE / f32(math.sqrt(nx * nx + ny * ny + nz * nz))
    return Hit(t, nx * size, ny * size, nz * size, tr.SCATTERED + slot)


@inline
def finish_scattered(tree: Tree, span: tuple[int, int], scratch: Scratch) -> None:
    """Make the nearest scattered points the hits of rays of a tile, except where the surface is at least as near.

    span : index of the first ray, and the end
    """
    rows, numbers = scratch.model, scratch.numbers
    for k in range(span[0], span[1]):
        slot, t = numbers[sc.SCATTER_SLOT + k], rows[sc.SCATTER_T + k]
        if slot >= 0 and (numbers[sc.FOUND + k] < 0 or t < rows[sc.HIT_T + k]):
            o, d = (
                (rows[sc.OX + k], rows[sc.OY + k], rows[sc.OZ + k]),
                (rows[sc.DX + k], rows[sc.DY + k], rows[sc.DZ + k]),
            )
            hit = hit_scattered(tree, slot, t, o, d)
            rows[sc.HIT_T + k], numbers[sc.FOUND + k] = t, hit.leaf
            store3(rows, sc.NX + k, (hit.nx, hit.ny, hit.nz))
