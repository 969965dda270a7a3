"""Traversal of the BVH over all instances by the rays of a tile, nearest instance first.

Each box is tested against exactly the rays that have entered its parent's box, sixteen at once; so rays in very
different directions are no slower than if each were traced singly.
"""

from __future__ import annotations

from ...engine.jit import f32, i64, inline
from ...engine.kernels import scratch as sc
from ...engine.kernels.records import INSTANCE, KIND, MODEL, TOP_BOUNDS, TOP_CENTER, TOP_NODE, World
from ...engine.kernels.scratch import Scratch, load3, store3
from ...engine.kernels.tree import Ray
from ...engine.kernels.vec import load3_flat
from ...engine.simd import INF, ONE, ZERO, Bits, bits, broadcast16, load16, mask16, reduce_min, select, vmax, vmin
from .space import WorldRay, into_model
from .tile import ALL, bits_of_row
from .traverse import make_ray


@inline
def begin_walk(world: World, scratch: Scratch) -> int:
    """Push the first entries on the stack of the traversal of instances; return the number of entries.

    The entry is the root of the BVH with all rays that enter it; if there are few models, each of them is an entry.
    """
    if world.top_children.size > 0:
        rays = _rays_to_top(world, scratch)
        scratch.top_what[0], scratch.top_rays[0], scratch.top_near[0] = 0, rays, ZERO
        return 1 if rays != 0 else 0
    count = 0
    for k in range(world.instances.size // INSTANCE - 1, -1, -1):
        if world.instances[k * INSTANCE + KIND] == MODEL:
            scratch.top_what[count], scratch.top_rays[count], scratch.top_near[count] = ~k, ALL, ZERO
            count += 1
    return count


@inline
def _rays_to_top(world: World, scratch: Scratch) -> Bits:
    """Transform the tile's rays into the frame of the BVH over the instances, starting at its bounds.

    Returns those that enter the bounds, as bits.
    """
    x, y, z = load3_flat(world.top, TOP_CENTER)
    matrix = (1.0, 0.0, 0.0, -x), (0.0, 1.0, 0.0, -y), (0.0, 0.0, 1.0, -z)
    bounds = load3_flat(world.top, TOP_BOUNDS), load3_flat(world.top, TOP_BOUNDS + 3)
    wide, rows = scratch.world, scratch.model
    for i in range(sc.TILE):
        ray: WorldRay | Ray
        ray = (load3(wide, sc.ORIGIN + i), load3(wide, sc.DIRECTION + i), wide[sc.T_MIN + i], wide[sc.NEAREST + i])
        start, d, low, high, speed, _ = into_model(matrix, bounds, ray, (0.0, 0.0))
        wide[sc.TOP_LOW + i], wide[sc.TOP_SPEED + i] = low, speed
        ray = make_ray(start, d, high - low, 1.0)
        store3(rows, sc.TOP_OX + i, (ray.ox, ray.oy, ray.oz))
        store3(rows, sc.TOP_IX + i, (ray.ix, ray.iy, ray.iz))
        rows[sc.TOP_LENGTH + i] = f32(high - low) if low <= high else -ONE
    return bits_of_row(rows, sc.TOP_LENGTH)


@inline
def shorten(world: World, scratch: Scratch) -> None:
    """End the tile's rays at their nearest hits for the rest of the BVH's traversal, after an instance was traced."""
    if world.top_children.size > 0:
        wide, rows = scratch.world, scratch.model
        for i in range(sc.TILE):
            rows[sc.TOP_LENGTH + i] = f32(wide[sc.NEAREST + i] * wide[sc.TOP_SPEED + i] - wide[sc.TOP_LOW + i])


@inline
def _enter(world: World, offset: int, rays: Bits, scratch: Scratch) -> tuple[Bits, float]:
    """Return the rays that enter a box before they end, as bits of the tile, and the least t at which one does.

    offset : where the box begins in `World.top_boxes`; rays : bits of the rays to test
    """
    boxes, rows = world.top_boxes, scratch.model
    entering, nearest = i64(0), INF
    for v in range(0, sc.TILE, sc.LANES):
        word = (rays >> v) & 0xFFFF
        if word == 0:
            continue
        ox, oy, oz = (
            load16(rows, sc.TOP_OX + v),
            load16(rows, sc.TOP_OX + sc.TILE + v),
            load16(rows, sc.TOP_OX + 2 * sc.TILE + v),
        )
        ix, iy, iz = (
            load16(rows, sc.TOP_IX + v),
            load16(rows, sc.TOP_IX + sc.TILE + v),
            load16(rows, sc.TOP_IX + 2 * sc.TILE + v),
        )
        ax, bx = (boxes[offset] - ox) * ix, (boxes[offset + 3] - ox) * ix
        ay, by = (boxes[offset + 1] - oy) * iy, (boxes[offset + 4] - oy) * iy
        az, bz = (boxes[offset + 2] - oz) * iz, (boxes[offset + 5] - oz) * iz
        near = vmax(vmax(vmin(ax, bx), vmin(ay, by)), vmax(vmin(az, bz), broadcast16(ZERO)))
        far = vmin(vmin(vmax(ax, bx), vmax(ay, by)), vmin(vmax(az, bz), load16(rows, sc.TOP_LENGTH + v)))
        word &= bits(near <= far)
        if word != 0:
            nearest = min(nearest, reduce_min(select(mask16(word), near, broadcast16(INF))))
            entering |= word << v
    return entering, nearest


@inline
def open_node(world: World, node: int, rays: Bits, top: int, scratch: Scratch) -> int:
    """Push on the stack the children, which rays enter, of a node of the BVH over the instances, the nearer one last.

    rays : those that enter the node, as bits; top : number of entries on the stack

    Returns the new number of entries.
    """
    offset = node * TOP_NODE
    a, near_a = _enter(world, offset, rays, scratch)
    b, near_b = _enter(world, offset + TOP_NODE // 2, rays, scratch)
    what_a, what_b = world.top_children[2 * node], world.top_children[2 * node + 1]
    if near_a < near_b:
        a, near_a, what_a, b, near_b, what_b = b, near_b, what_b, a, near_a, what_a
    if a != 0:
        scratch.top_what[top], scratch.top_rays[top], scratch.top_near[top] = what_a, a, near_a
        top += 1
    if b != 0:
        scratch.top_what[top], scratch.top_rays[top], scratch.top_near[top] = what_b, b, near_b
        top += 1
    return top


@inline
def still_open(world: World, top: int, scratch: Scratch) -> Bits:
    """Return the rays of a stack entry that have no hit before the first of them enters the entry's box, as bits.

    top : index of the entry in the stack
    """
    rays, near = scratch.top_rays[top], scratch.top_near[top]
    if world.top_children.size == 0:
        return rays
    left = i64(0)
    for v in range(0, sc.TILE, sc.LANES):
        word = (rays >> v) & 0xFFFF
        if word != 0:
            left |= (word & bits(load16(scratch.model, sc.TOP_LENGTH + v) >= broadcast16(near))) << v
    return left
