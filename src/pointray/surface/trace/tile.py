"""Traversal of the tree by coherent rays together (paper, part IV), which search the leaves in groups of four.

Nodes are tested with interval arithmetic: the least and greatest origin and inverse direction of the rays bound where
any of them enters and leaves a box. A leaf's box, voxel and slab are tested for sixteen rays at once, and only rays
that pass all three tests search it. Hits are those of `traverse.closest`.
"""

from __future__ import annotations

from ...engine.jit import Array, f32, i32, i64, inline
from ...engine.kernels import scratch as sc, tree as tr
from ...engine.kernels.scratch import Scratch
from ...engine.kernels.tree import Ray, Tree, tree_at
from ...engine.simd import (
    ONE,
    ZERO,
    Bits,
    bits,
    broadcast8,
    broadcast16,
    count_trailing_zeros,
    lane,
    load8,
    load16,
    load_register,
    prefetch,
    reduce_max,
    reduce_min,
    register_lanes,
    select,
    store,
    vabs,
    vmax,
    vmin,
)
from ..intersect.columns import FLAT
from ..intersect.leaf import search_alone, search_together, together
from ..intersect.march import NO_LIFT
from ..intersect.scattered import begin_scattered, finish_scattered, search_leaf
from .traverse import ROUNDING, Planes, far_planes, insert, near_planes, prefetch_child, prefetch_columns, walk_begin

ALL = -1  # all rays, as bits of an int64
# Longest sample steps after which a ray that starts on the surface is certainly not lifted any more (start rule).
LIFTED = f32(8.0)


@inline
def bits_of_row(rows: Array, row: int) -> Bits:
    """Return the rays of a tile whose number in a row is not negative, as bits.

    rows : `Scratch.model`; row : offset of the row in it
    """
    word = i64(0)
    for k in range(0, sc.TILE, sc.LANES):
        word |= bits(load16(rows, row + k) >= ZERO) << k
    return word


@inline
def range_of(rows: Array, row: int, span: tuple[int, int]) -> tuple[float, float]:
    """Return the least and the greatest number in a row of `Scratch.model`, among a range of a tile's rays.

    rows : `Scratch.model`; row : offset of the row in `rows`
    span : first ray, and the end, multiples of 16
    """
    low = high = load16(rows, row + span[0])
    for k in range(span[0] + sc.LANES, span[1], sc.LANES):
        numbers = load16(rows, row + k)
        low, high = vmin(low, numbers), vmax(high, numbers)
    return reduce_min(low), reduce_max(high)


@inline
def bounds_of_planes(rows: Array, row: int, inverse: int, span: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return bounds of rays along one axis, for tests of all of them against a box at once.

    rows : `Scratch.model`; span : first ray of the tile, and the end
    row, inverse : offsets in `rows` of the rows with the origins' and the inverse directions' components

    Returns four numbers: the origin that enters boxes first, the one that leaves them last, and the least and the
    greatest inverse direction.
    """
    low, high = range_of(rows, row, span)
    slow, fast = range_of(rows, inverse, span)
    return (high, low, slow, fast) if slow > ZERO else (low, high, slow, fast)


@inline
def tile_ray(rows: Array, i: int) -> Ray:
    """Return ray i of the tile in the current model's space. rows : `Scratch.model`"""
    return Ray(
        rows[sc.OX + i],
        rows[sc.OY + i],
        rows[sc.OZ + i],
        rows[sc.DX + i],
        rows[sc.DY + i],
        rows[sc.DZ + i],
        rows[sc.IX + i],
        rows[sc.IY + i],
        rows[sc.IZ + i],
        rows[sc.BEGIN + i],
        rows[sc.END + i],
        rows[sc.SIDE + i],
    )


@inline
def _leaf_intervals(tree: Tree, leaf: int, box: int, planes: tuple[Planes, Planes, float], rows: Array, v: int) -> Bits:
    """Test rays of the tile, from v on as many as fill a register, against a leaf's voxel, box and slab.

    Returns as bits those that pass all three.

    Rows ENTER to LAST of `rows` receive t where each ray enters and leaves the voxel, and between which the surface
    can be.

    box : offset of the leaf's tight box in `Tree.boxes`; rows : `Scratch.model`
    planes : (near, far, begin), which planes of a box the rays enter and leave through, as rows of lo x y z, hi x y z;
        and t where the traversal starts
    """
    near, far, begin = planes
    ox, oy, oz = load_register(rows, sc.OX + v), load_register(rows, sc.OY + v), load_register(rows, sc.OZ + v)
    ix, iy, iz = load_register(rows, sc.IX + v), load_register(rows, sc.IY + v), load_register(rows, sc.IZ + v)
    offset, leaves, boxes = leaf * tr.LEAF, tree.leaves, tree.boxes
    length = load_register(rows, sc.LENGTH + v)
    enter = vmax(
        vmax((leaves[offset + tr.CELL + near[0]] - ox) * ix, (leaves[offset + tr.CELL + near[1]] - oy) * iy),
        vmax((leaves[offset + tr.CELL + near[2]] - oz) * iz, begin),
    )
    leave = vmin(
        vmin((leaves[offset + tr.CELL + far[0]] - ox) * ix, (leaves[offset + tr.CELL + far[1]] - oy) * iy),
        vmin((leaves[offset + tr.CELL + far[2]] - oz) * iz, length),
    )
    first = vmax(
        vmax((boxes[box + near[0] * tr.WIDTH] - ox) * ix, (boxes[box + near[1] * tr.WIDTH] - oy) * iy),
        vmax((boxes[box + near[2] * tr.WIDTH] - oz) * iz, enter),
    )
    inside = first <= vmin(
        vmin((boxes[box + far[0] * tr.WIDTH] - ox) * ix, (boxes[box + far[1] * tr.WIDTH] - oy) * iy),
        vmin((boxes[box + far[2] * tr.WIDTH] - oz) * iz, leave),
    )
    mx, my, mz = leaves[offset + tr.SLAB], leaves[offset + tr.SLAB + 1], leaves[offset + tr.SLAB + 2]
    height = mx * ox + my * oy + mz * oz
    rise = (
        mx * load_register(rows, sc.DX + v) + my * load_register(rows, sc.DY + v) + mz * load_register(rows, sc.DZ + v)
    )
    rise = ONE / select(vabs(rise) < FLAT, FLAT, rise)
    a, b = (leaves[offset + tr.SLAB_LO] - height) * rise, (leaves[offset + tr.SLAB_HI] - height) * rise
    first, last = vmax(first, vmin(a, b)), vmin(leave, vmax(a, b))
    store(rows, sc.ENTER + v, enter)
    store(rows, sc.LEAVE + v, leave)
    store(rows, sc.FIRST + v, first)
    store(rows, sc.LAST + v, last)
    return bits(inside & (first <= last))


@inline
def _search(tree: Tree, leaf: int, passing: Bits, scratch: Scratch) -> Bits:
    """Search a leaf for hits of the `passing` rays (bits of the tile) and store these in `scratch`.

    Returns the rays that must be traced singly, by the start rule, as bits of the tile.
    """
    if together(tree):
        return search_together(tree, leaf, passing, scratch)
    rows = scratch.model
    lifted = i64(0)
    while passing != 0:
        i = count_trailing_zeros(passing)
        passing &= passing - 1
        interval = rows[sc.ENTER + i], rows[sc.LEAVE + i], rows[sc.FIRST + i], rows[sc.LAST + i]
        hit, lift = search_alone(tree, leaf, tile_ray(rows, i), interval, NO_LIFT, scratch)
        if lift.height != ZERO:
            lifted |= i64(1) << i
        if hit.leaf >= 0:
            rows[sc.HIT_T + i], rows[sc.NX + i], rows[sc.NY + i], rows[sc.NZ + i] = hit.t, hit.nx, hit.ny, hit.nz
            rows[sc.LENGTH + i] = rows[sc.ENTER + i]
            scratch.numbers[sc.FOUND + i] = leaf
    return lifted


@inline
def _prefetch_search(tree: Tree, child: int) -> None:
    """Prefetch the data that a search of the next leaf reads first. child : entry of `Tree.children`, perhaps a leaf"""
    if child < 0 and i64(~child) < tr.SCATTERED:
        first, count = tree.spans[2 * ~child], tree.spans[2 * ~child + 1]
        for group in range(first, first + count):
            for k in range(0, tr.GROUP, 16):
                prefetch(tree.spheres, i64(group) * tr.GROUP + k)
            prefetch(tree.refs, i64(group) * 16)
        prefetch_columns(tree, ~child)


@inline
def _search_scattered(
    tree: Tree, block: int, box: int, planes: tuple[Planes, Planes, float], span: tuple[int, int], scratch: Scratch
) -> bool:
    """Search a leaf of scattered points for the rays that pass through its box; return whether any hits.

    block : first of the leaf's two blocks; box : offset of the leaf's box in `Tree.boxes`
    planes : (near, far, begin), which planes of a box the rays enter and leave through, as rows of lo x y z, hi x y z;
        and t where the traversal starts
    span : first ray of the tile, and the end
    """
    near, far, begin = planes
    rows, boxes, found = scratch.model, tree.boxes, i64(0)
    for v in range(span[0], span[1], sc.LANES):
        ox, oy, oz = load16(rows, sc.OX + v), load16(rows, sc.OY + v), load16(rows, sc.OZ + v)
        ix, iy, iz = load16(rows, sc.IX + v), load16(rows, sc.IY + v), load16(rows, sc.IZ + v)
        enter = vmax(
            vmax((boxes[box + near[0] * tr.WIDTH] - ox) * ix, (boxes[box + near[1] * tr.WIDTH] - oy) * iy),
            vmax((boxes[box + near[2] * tr.WIDTH] - oz) * iz, broadcast16(begin)),
        )
        leave = vmin(
            vmin((boxes[box + far[0] * tr.WIDTH] - ox) * ix, (boxes[box + far[1] * tr.WIDTH] - oy) * iy),
            vmin((boxes[box + far[2] * tr.WIDTH] - oz) * iz, load16(rows, sc.SCATTER_END + v)),
        )
        passing = bits(enter <= leave)
        if passing != 0:
            found |= search_leaf(tree, block, passing, v, scratch)
    return found != 0


@inline
def _shorten(tree: Tree, span: tuple[int, int], any_hit: bool, scratch: Scratch) -> float:
    """End the rays at their hits, in a tree with scattered points; return the greatest t at which one of them ends.

    Scattered points are searched up to the nearest hit, and the surface up to one step beyond the nearest scattered
    point that is hit: a shorter ray hits what the whole one does.

    span : first ray of the tile, and the end
    any_hit : whether a ray with a hit certainly before its end is finished; see `_end_where_hit`
    """
    rows, longest = scratch.model, tree.head[tr.LONGEST]
    ended = broadcast16(-ONE)
    farthest = ended
    for v in range(span[0], span[1], sc.LANES):
        surface, scattered = load16(rows, sc.HIT_T + v), load16(rows, sc.SCATTER_T + v)
        length, end = load16(rows, sc.LENGTH + v), vmin(load16(rows, sc.SCATTER_END + v), surface)
        length = vmin(length, scattered + longest)
        if any_hit:
            lifted = surface < load16(rows, sc.BEGIN + v) + LIFTED * longest
            certain = select(lifted & (load16(rows, sc.BEGIN + v) >= ZERO), scattered, vmin(surface, scattered))
            sure = certain < (ONE - ROUNDING) * load16(rows, sc.END + v) - (longest + longest)
            length = select(sure, ended, length)
        end = select(length < ZERO, ended, end)
        store(rows, sc.LENGTH + v, length)
        store(rows, sc.SCATTER_END + v, end)
        farthest = vmax(farthest, vmax(length, end))
    return reduce_max(farthest)


@inline
def _end_where_hit(tree: Tree, span: tuple[int, int], scratch: Scratch) -> None:
    """End the rays that have a hit, for occlusion, unless it is so close to the ray's end that it is uncertain.

    span : first ray of the tile, and the end

    A hit counts as certain two sample steps before the stored end, which is one step beyond the ray's own: another
    voxel may find the same root up to a step farther along the ray. Close to the start of a ray on the surface, a hit
    is certain only after the search of the leaf where it starts, which may follow: such a ray is ended at its hit.
    """
    rows, longest = scratch.model, tree.head[tr.LONGEST]
    steps = longest + longest
    for k in range(span[0], span[1]):
        sure = (scratch.numbers[sc.FOUND + k] >= 0) & (rows[sc.HIT_T + k] < (ONE - ROUNDING) * rows[sc.END + k] - steps)
        begin = rows[sc.BEGIN + k]
        sure &= (begin < ZERO) | (rows[sc.HIT_T + k] > begin + LIFTED * longest)
        rows[sc.LENGTH + k] = -ONE if sure else rows[sc.LENGTH + k]


@inline
def _walk_begin(tree: Tree, rows: Array, span: tuple[int, int]) -> float:
    """Return t where the traversal of a range of the tile's rays begins: a sample step before the first of them begins.

    rows : `Scratch.model`, in which t where a ray begins is negative if it starts on no surface
    span : first ray, and the end
    """
    low, high = range_of(rows, sc.BEGIN, span)
    return walk_begin(tree, low if low >= ZERO else min(high, ZERO))


@inline
def closest_of_tile(table: Array, model: int, span: tuple[int, int], any_hit: bool, scratch: Scratch) -> Bits:
    """Find the first hits of rays of the tile with a model, together; they are stored in `scratch` (HIT_T, NX, FOUND).

    table : addresses of all models' arrays; model : index of the model
    span : first ray of the tile, and the end; any_hit : whether any hit that is certainly before a ray's end suffices

    Returns the rays (as bits) that the caller must trace singly, by the start rule: its effect depends on the order of
    the leaves. Their hits here do not count.
    """
    tree = tree_at(table, model)
    rows = scratch.model
    x = bounds_of_planes(rows, sc.OX, sc.IX, span)
    y = bounds_of_planes(rows, sc.OY, sc.IY, span)
    z = bounds_of_planes(rows, sc.OZ, sc.IZ, span)
    near_rows = near_planes(x[2], y[2], z[2])
    begin = _walk_begin(tree, rows, span)
    planes = near_rows, far_planes(near_rows), begin
    px, py, pz = planes[0][0] * tr.WIDTH, planes[0][1] * tr.WIDTH, planes[0][2] * tr.WIDTH
    qx, qy, qz = planes[1][0] * tr.WIDTH, planes[1][1] * tr.WIDTH, planes[1][2] * tr.WIDTH
    stack, stack_near = scratch.stack, scratch.stack_near
    farthest, scattered = range_of(rows, sc.LENGTH, span)[1], tree.head[tr.SCATTER] > ZERO
    if scattered:
        begin_scattered(rows, scratch.numbers, sc.LENGTH, span)
    node, top, lifted = 0, 0, i64(0)
    while True:
        scratch.counts[sc.COUNT_NODES] += 1
        offset = i64(node) * tr.NODE
        ax, bx = load8(tree.boxes, offset + px) - x[0], load8(tree.boxes, offset + qx) - x[1]
        ay, by = load8(tree.boxes, offset + py) - y[0], load8(tree.boxes, offset + qy) - y[1]
        az, bz = load8(tree.boxes, offset + pz) - z[0], load8(tree.boxes, offset + qz) - z[1]
        near = vmax(
            vmax(vmin(ax * x[2], ax * x[3]), vmin(ay * y[2], ay * y[3])),
            vmax(vmin(az * z[2], az * z[3]), broadcast8(begin)),
        )
        far = vmin(
            vmin(vmax(bx * x[2], bx * x[3]), vmax(by * y[2], by * y[3])),
            vmin(vmax(bz * z[2], bz * z[3]), broadcast8(farthest)),
        )
        left = bits(near <= far)
        bottom = top
        while left != 0:
            k = count_trailing_zeros(left)
            left &= left - 1
            top = insert(stack, stack_near, bottom, top, i32(node * tr.WIDTH + k), lane(near, k))
            prefetch_child(tree, tree.children[node * tr.WIDTH + k])
        while True:
            if top == 0:
                if scattered:
                    finish_scattered(tree, span, scratch)
                return lifted
            top -= 1
            if stack_near[top] > farthest:
                continue
            slot = i64(stack[top])
            node = tree.children[slot]
            if node >= 0:
                break
            scratch.counts[sc.COUNT_LEAVES] += 1
            leaf = i64(~node)
            if top > 0:
                _prefetch_search(tree, tree.children[i64(stack[top - 1])])
            box = slot // tr.WIDTH * tr.NODE + slot % tr.WIDTH
            if leaf >= tr.SCATTERED:
                if _search_scattered(tree, leaf - tr.SCATTERED, box, planes, span, scratch):
                    farthest = _shorten(tree, span, any_hit, scratch)
                continue
            passing = i64(0)
            for v in range(span[0], span[1], register_lanes()):
                passing |= _leaf_intervals(tree, leaf, box, planes, rows, v) << v
            if passing != 0:
                lifted |= _search(tree, leaf, passing, scratch)
                if scattered:
                    farthest = _shorten(tree, span, any_hit, scratch)
                    continue
                if any_hit:
                    _end_where_hit(tree, span, scratch)
                farthest = range_of(rows, sc.LENGTH, span)[1]
