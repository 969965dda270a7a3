"""Lists of the splats near a bundle of rays, which are made once for each voxel and from which f is evaluated.

A bundle is bounded by a capsule: all points within a distance of a segment. Blocks near the rays of a tile are
gathered into working memory; the splats near four of these rays, or near one, are then listed from the copy.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...engine.jit import Array, f32, f64, i64, inline, routine
from ...engine.kernels import scratch as sc
from ...engine.kernels.scratch import Scratch, slot_of
from ...engine.kernels.tree import BLOCK, EMPTY, FAR, GROUP, INV_R2, PX, PY, PZ, Tree
from ...engine.kernels.vec import Vec3
from ...engine.simd import (
    F16,
    INF,
    ONE,
    ZERO,
    Bits,
    Mask,
    Real,
    bits,
    broadcast16,
    broadcast_like,
    count_trailing_zeros,
    load16,
    load_register,
    move4,
    number_like,
    pack,
    reduce_max,
    reduce_min,
    register_lanes,
    select,
    vabs,
    vmax,
    vmin,
    vsqrt,
)
from .refine import Frame
from .surface import HALF

SLACK = f32(1.01)  # factor of radii: bound on the rounding errors of radii and of the rays' positions
SURE = f32(1.0 - 1e-6)  # factor of squared distances from a segment's middle, which cancel if radii are far smaller
NEAR = SLACK * SLACK  # factor of squared radii


class Capsule(NamedTuple):
    """All points within `spread` of a segment that encloses parts of rays, to search for splats near these.

    x, y, z : middle of the segment; dx, dy, dz : unit direction of the segment
    half : half the segment's length
    """

    x: Real
    y: Real
    z: Real
    dx: Real
    dy: Real
    dz: Real
    half: Real
    spread: float


@inline
def segment(o: Vec3, d: Vec3, t_low: float, t_high: float) -> Capsule:
    """Return the capsule of the part of one ray from t_low to t_high; its spread is 0. o, d : origin, unit direction"""
    center = HALF * (t_low + t_high)
    x, y, z = o[0] + center * d[0], o[1] + center * d[1], o[2] + center * d[2]
    return Capsule(x, y, z, d[0], d[1], d[2], HALF * (t_high - t_low), ZERO)


@inline
def around(part: Array, ends: tuple[int, int], frame: Frame, half: F16 | float, active: Mask) -> Capsule:
    """Return a capsule around parts of up to 16 rays, to search for splats near any of them.

    part : `Scratch.part`, with the centres and directions of the rays' parts
    ends : indices in `part` of two rays whose mean is the capsule's axis; along a Morton curve the first and the last
        are at opposite corners
    frame : centres and directions of the rays' parts, as vectors; half : half lengths of the parts
    active : mask of valid lanes
    """
    i, j = ends
    px, py, pz = (
        part[sc.AT_X + i] + part[sc.AT_X + j],
        part[sc.AT_Y + i] + part[sc.AT_Y + j],
        part[sc.AT_Z + i] + part[sc.AT_Z + j],
    )
    ax, ay, az = (
        part[sc.AT_DX + i] + part[sc.AT_DX + j],
        part[sc.AT_DY + i] + part[sc.AT_DY + j],
        part[sc.AT_DZ + i] + part[sc.AT_DZ + j],
    )
    scale = ONE / f32(math.sqrt(ax * ax + ay * ay + az * az))
    px, py, pz, ax, ay, az = HALF * px, HALF * py, HALF * pz, ax * scale, ay * scale, az * scale
    # Centres and half lengths are split into components across the axis and along it.
    x, y, z = frame.x - px, frame.y - py, frame.z - pz
    turn = frame.dx * ax + frame.dy * ay + frame.dz * az
    ux, uy, uz = half * frame.dx, half * frame.dy, half * frame.dz
    along, length = x * ax + y * ay + z * az, half * turn
    ux, uy, uz = ux - length * ax, uy - length * ay, uz - length * az
    x, y, z = x - along * ax, y - along * ay, z - along * az
    aside = vsqrt(x * x + y * y + z * z) + vsqrt(ux * ux + uy * uy + uz * uz)
    near = reduce_min(select(active, along - vabs(length), broadcast16(INF)))
    far = reduce_max(select(active, along + vabs(length), broadcast16(-INF)))
    spread = reduce_max(select(active, aside, broadcast16(ZERO)))
    half, middle = HALF * (far - near), HALF * (far + near)
    return Capsule(px + middle * ax, py + middle * ay, pz + middle * az, ax, ay, az, half, spread)


@inline
def _distances(capsule: Capsule, x: Real, y: Real, z: Real) -> Real:
    """Return lower bounds of the squared distances of points from a capsule's segment, tight except for rounding."""
    x, y, z = x - capsule.x, y - capsule.y, z - capsule.z
    along = x * capsule.dx + y * capsule.dy + z * capsule.dz
    beyond = vmax(vabs(along) - capsule.half, number_like(ZERO, x))
    return SURE * (x * x + y * y + z * z) - along * along + beyond * beyond


@inline
def list_blocks(tree: Tree, leaf: int, capsule: Capsule, scratch: Scratch) -> None:
    """Write the numbers of a leaf's blocks whose bounding sphere meets a capsule around rays to `scratch.near`."""
    first, count = tree.spans[2 * leaf], tree.spans[2 * leaf + 1]
    n = 0
    for group in range(first, first + count):
        offset = i64(group) * GROUP
        square = _distances(
            capsule, load16(tree.spheres, offset), load16(tree.spheres, offset + 16), load16(tree.spheres, offset + 32)
        )
        limit = SLACK * load16(tree.spheres, offset + 48) + capsule.spread  # NaN in an empty slot
        n += pack(square < limit * limit, tree.refs, i64(group) * 16, scratch.near, n)
    scratch.counts[sc.COUNT_NEAR] = n


@routine
def nearest_slot(tree: Tree, leaf: int, x: float, y: float, z: float) -> int:
    """Return the slot of the splat nearest to the point x, y, z, in units of its radius, among those that a leaf lists.

    It replaces the splat of most weight if all weights are zero: rounding can move a hit to the rim of all supports. A
    slot is four times the block plus the position in it.
    """
    best, nearest = i64(-1), np.inf
    first, count = tree.spans[2 * leaf], tree.spans[2 * leaf + 1]
    for k in range(16 * i64(first), 16 * (i64(first) + count)):
        if np.isnan(tree.spheres[k // 16 * GROUP + 48 + k % 16]):
            continue  # an empty slot
        block = i64(tree.refs[k])
        for j in range(4):
            offset = block * BLOCK + j
            dx, dy, dz = tree.blocks[offset + PX] - x, tree.blocks[offset + PY] - y, tree.blocks[offset + PZ] - z
            away = f64(dx * dx + dy * dy + dz * dz) * f64(tree.blocks[offset + INV_R2])
            away = away if tree.blocks[offset + PX] < FAR else np.inf
            if best < 0 or away < nearest:
                best, nearest = 4 * block + j, away
    return best


@inline
def lists_sheets(tree: Tree, scratch: Scratch) -> bool:
    """Return whether a splat in `scratch.listed`, those near the rays, is on a sheet with another one close by."""
    for k in range(scratch.counts[sc.COUNT_SPLATS]):
        row = 3 * slot_of(scratch, i64(scratch.listed[k]))
        if (tree.facing[row] | tree.facing[row + 1] | tree.facing[row + 2]) != 0:
            return True
    return False


@inline
def keep_sheet(tree: Tree, scratch: Scratch, frame: Frame, sought_side: float, rays: Bits) -> Bits:
    """Keep in `scratch.listed` only the splats of sheets that a ray sees, where two sheets are close together.

    The ray is the first of `rays`. Returns those of `rays` that see the same sheets, as 4 bits.

    frame : four rays; rays : 4 bits, those still to be searched for
    sought_side : 1 to see splats that face a ray, -1 to see splats that face away
    """
    first, n = count_trailing_zeros(rays), 0
    for k in range(scratch.counts[sc.COUNT_SPLATS]):
        offset = i64(scratch.listed[k])
        row = 3 * slot_of(scratch, offset)
        along = frame.dx * tree.facing[row] + frame.dy * tree.facing[row + 1] + frame.dz * tree.facing[row + 2]
        seeing = bits(along * sought_side <= ZERO)
        if (seeing >> first) & 1 != 0:
            rays &= seeing
            scratch.listed[n] = offset
            n += 1
        else:
            rays &= ~seeing
    scratch.counts[sc.COUNT_SPLATS] = n
    return rays


@inline
def gather(tree: Tree, scratch: Scratch) -> None:
    """Copy the splats of the blocks in `scratch.near` to `scratch.splats`, in groups of 16 that are tested at once.

    Empty slots hold splats far away.
    """
    n = scratch.counts[sc.COUNT_NEAR]
    for k in range(n):
        block, offset = i64(scratch.near[k]) * BLOCK, k // 4 * sc.GATHERED + k % 4 * 4
        for row in range(7):
            move4(tree.blocks, block + 4 * row, scratch.splats, offset + 16 * row)
    for k in range(n, (n + 3) // 4 * 4):
        offset = k // 4 * sc.GATHERED + k % 4 * 4
        for i in range(4):
            scratch.splats[offset + i] = EMPTY
            scratch.splats[offset + 4 * INV_R2 + i] = ONE


@inline
def list_splats(scratch: Scratch, capsule: Capsule) -> None:
    """List in `scratch.listed` the splats whose support meets a part of one ray, given as a capsule without spread.

    It selects from those that `gather` has copied to `scratch`.
    """
    n, splats = 0, scratch.splats
    for group in range((scratch.counts[sc.COUNT_NEAR] + 3) // 4):
        offset = group * sc.GATHERED
        x, y, z = load16(splats, offset + 4 * PX), load16(splats, offset + 4 * PY), load16(splats, offset + 4 * PZ)
        near = _distances(capsule, x, y, z) * load16(splats, offset + 4 * INV_R2) < NEAR
        n += pack(near, scratch.offsets, group * sc.LANES, scratch.listed, n)
    scratch.counts[sc.COUNT_SPLATS] = n


@inline
def list_splats_of(scratch: Scratch, first: int, end: int) -> None:
    """List in `scratch.listed` the splats whose support meets one of the rays `first` to `end` - 1 in `scratch.part`.

    It selects from those that `gather` has copied to `scratch`.
    """
    n, splats, part = 0, scratch.splats, scratch.part
    for k in range(0, (4 * scratch.counts[sc.COUNT_NEAR] + 15) // 16 * 16, register_lanes()):
        offset = k // sc.LANES * sc.GATHERED + k % sc.LANES
        x, y, z = (
            load_register(splats, offset + 4 * PX),
            load_register(splats, offset + 4 * PY),
            load_register(splats, offset + 4 * PZ),
        )
        square = number_like(INF, x)
        for i in range(first, end):
            ray = Capsule(
                broadcast_like(part, sc.AT_X + i, x),
                broadcast_like(part, sc.AT_Y + i, x),
                broadcast_like(part, sc.AT_Z + i, x),
                broadcast_like(part, sc.AT_DX + i, x),
                broadcast_like(part, sc.AT_DY + i, x),
                broadcast_like(part, sc.AT_DZ + i, x),
                broadcast_like(part, sc.AT_HALF + i, x),
                ZERO,
            )
            square = vmin(square, _distances(ray, x, y, z))
        near = square * load_register(splats, offset + 4 * INV_R2) < NEAR
        n += pack(near, scratch.offsets, k, scratch.listed, n)
    scratch.counts[sc.COUNT_SPLATS] = n
