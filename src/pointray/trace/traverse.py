"""A ray through the tree, front to back: eight boxes at once, the nearest child first (paper, part IV)."""

from __future__ import annotations

import numpy as np

from ..jit import inline
from ..records import COUNT_LEAVES, COUNT_NODES, NODE, WIDTH, Hit, Ray
from ..simd import bits, lane, load8, lowest, spread8, vmax, vmin
from .leaf import INF, search_leaf
from .surface import ZERO

TINY = np.float32(1e-20)


@inline
def steady(d):  # type: ignore[no-untyped-def]
    """A direction's component, kept away from zero so that no slab test divides by it."""
    return (TINY if d >= ZERO else -TINY) if abs(d) < TINY else d


@inline
def closest(tree, ray, scratch):  # type: ignore[no-untyped-def]
    """The first hit of a ray with the model. Counts nodes and leaves; leaves the near blocks of the hit in scratch."""
    scratch.lift[0] = ZERO
    ix, iy, iz = ray.ix, ray.iy, ray.iz
    # Rows of the near and far planes of each axis, by the ray's sign: an empty box then always comes out empty.
    nx, ny, nz = (0 if ix > 0 else 3 * WIDTH), (0 if iy > 0 else 3 * WIDTH), (0 if iz > 0 else 3 * WIDTH)
    fx, fy, fz = 3 * WIDTH - nx, 3 * WIDTH - ny, 3 * WIDTH - nz
    stack, stack_near = scratch.stack, scratch.stack_near
    node, top = 0, 0
    while True:
        scratch.counts[COUNT_NODES] += 1
        at = np.int64(node) * NODE
        near = vmax(
            vmax((load8(tree.boxes, at + nx) - ray.ox) * ix, (load8(tree.boxes, at + WIDTH + ny) - ray.oy) * iy),
            vmax((load8(tree.boxes, at + 2 * WIDTH + nz) - ray.oz) * iz, spread8(ray.t_min)),
        )
        far = vmin(
            vmin((load8(tree.boxes, at + fx) - ray.ox) * ix, (load8(tree.boxes, at + WIDTH + fy) - ray.oy) * iy),
            vmin((load8(tree.boxes, at + 2 * WIDTH + fz) - ray.oz) * iz, spread8(ray.t_max)),
        )
        left = bits(near <= far)
        bottom = top
        while left != 0:
            k = lowest(left)
            left &= left - 1
            # Insert by distance: the nearest comes out first.
            enters = lane(near, k)
            j = top
            while j > bottom and stack_near[j - 1] < enters:
                stack[j], stack_near[j] = stack[j - 1], stack_near[j - 1]
                j -= 1
            stack[j], stack_near[j] = tree.children[node * WIDTH + k], enters
            top += 1
        while True:
            if top == 0:
                return Hit(INF, ZERO, ZERO, ZERO, -1)
            top -= 1
            node = stack[top]
            if node >= 0:
                break
            scratch.counts[COUNT_LEAVES] += 1
            hit = search_leaf(tree, ~node, ray, scratch, stack_near[top], INF)
            if hit.leaf >= 0:
                return hit


@inline
def make_ray(o, d, length, side):  # type: ignore[no-untyped-def]
    """A ray in model space of the given length, from float64 origin and unit direction."""
    f32, one = np.float32, np.float32(1.0)
    x, y, z = steady(f32(d[0])), steady(f32(d[1])), steady(f32(d[2]))
    return Ray(f32(o[0]), f32(o[1]), f32(o[2]), x, y, z, one / x, one / y, one / z, ZERO, f32(length), f32(side))
