"""Properties of the tile's hits, for shading and for output."""

from __future__ import annotations

import numpy as np

from ...engine.jit import Array, borrow, f32, f64, i64, inline, routine
from ...engine.kernels import scratch as sc
from ...engine.kernels.records import INSTANCE, MATERIAL, MATERIAL_SIZE, OWN_COLOR, PAINT, SHAPE_ROW, World, WorldHit
from ...engine.kernels.scratch import Scratch, load3, store3
from ...engine.kernels.tree import LEAF, SCATTERED, SHEETED, Tree, tree_at
from ...engine.kernels.vec import transform
from ...engine.simd import (
    F16,
    ONE,
    ZERO,
    Bits,
    broadcast16,
    count_trailing_zeros,
    quarters,
    reduce_max,
    repeat4,
    select,
    store,
    vmax,
    vsqrt,
)
from ..intersect.gather import Capsule, list_blocks, nearest_slot
from ..intersect.surface import FourPoints, Sheet, weights_seen
from .paint import Four, paint_four, paint_one
from .space import matrix_at


@inline
def tile_hit(scratch: Scratch, i: int) -> WorldHit:
    """Return the nearest hit of ray i of the tile; t is inf for a miss.

    On a model, colour and splat are those that `describe_tile` has found before.
    """
    wide, numbers, zero = scratch.world, scratch.numbers, (0.0, 0.0, 0.0)
    instance = numbers[sc.INSTANCE_OF + i]
    if instance < 0:
        return WorldHit(np.inf, zero, zero, -1, i64(-1), i64(-1), zero)
    normal, color, local = load3(wide, sc.NORMAL + i), load3(wide, sc.COLOR + i), load3(wide, sc.LOCAL + i)
    return WorldHit(
        wide[sc.NEAREST + i], normal, color, instance, numbers[sc.SLOT_OF + i], numbers[sc.LEAF_OF + i], local
    )


@inline
def next_of_leaf(numbers: Array, left: Bits, i: int) -> int:
    """Return the first of the remaining rays (`left`, bits) if it has hit the same leaf as ray i, else i.

    numbers : `Scratch.numbers`. Such rays of a tile are processed together, up to four.
    """
    k = count_trailing_zeros(left) if left != 0 else i
    same = (
        numbers[sc.INSTANCE_OF + k] == numbers[sc.INSTANCE_OF + i]
        and numbers[sc.LEAF_OF + k] == numbers[sc.LEAF_OF + i]
    )
    return k if same else i


@inline
def list_around(tree: Tree, four: Four, scratch: Scratch) -> FourPoints:
    """List the blocks near four hits in one leaf in `scratch.near`; return the hits in the model's space.

    four : indices of the rays in the tile

    Returns x, y, z, with each hit in a quarter of the lanes.
    """
    wide, numbers = scratch.world, scratch.numbers
    a, b, c, d = (
        load3(wide, sc.LOCAL + four[0]),
        load3(wide, sc.LOCAL + four[1]),
        load3(wide, sc.LOCAL + four[2]),
        load3(wide, sc.LOCAL + four[3]),
    )
    x = quarters(f32(a[0]), f32(b[0]), f32(c[0]), f32(d[0]))
    y = quarters(f32(a[1]), f32(b[1]), f32(c[1]), f32(d[1]))
    z = quarters(f32(a[2]), f32(b[2]), f32(c[2]), f32(d[2]))
    px, py, pz = f32(a[0]), f32(a[1]), f32(a[2])
    spread = reduce_max(vsqrt((x - px) * (x - px) + (y - py) * (y - py) + (z - pz) * (z - pz)))
    leaf = numbers[sc.LEAF_OF + four[0]]
    list_blocks(tree, leaf, Capsule(px, py, pz, ONE, ZERO, ZERO, ZERO, spread), scratch)
    return x, y, z


@inline
def _weigh(
    tree: Tree, points: FourPoints, sheet: Sheet, tone: Array, scratch: Scratch
) -> tuple[F16, F16, F16, F16, F16, F16]:
    """Weigh the splats of the blocks listed in `scratch` at four points; lane 4 r + j is splat j of a block at point r.

    points : x, y, z, a quarter of the lanes for each; tone : linear value of each sRGB level
    sheet : whether two sheets are close together, and the hit's normal, which selects one of them

    Returns in each lane six values: the greatest weight, the index in the list of its block, the sums of weighted red,
    green and blue, and the sum of the weights.
    """
    part = scratch.part
    most = block_of_most = red = green = blue = total = broadcast16(ZERO)
    for k in range(scratch.counts[sc.COUNT_NEAR]):
        block = i64(scratch.near[k])
        w = weights_seen(tree, block, points, sheet, part)
        block_of_most = select(w > most, broadcast16(f32(k)), block_of_most)
        most = vmax(w, most)
        if tree.colors.size > 0:
            for j in range(4):
                packed = tree.colors[4 * block + j]
                part[j], part[4 + j] = tone[packed & 255], tone[(packed >> 8) & 255]
                part[8 + j] = tone[(packed >> 16) & 255]  # a damaged file may have more bits
            red = red + w * repeat4(part, 0)
            green = green + w * repeat4(part, 4)
            blue = blue + w * repeat4(part, 8)
            total = total + w
    return most, block_of_most, red, green, blue, total


@inline
def _describe(world: World, four: Four, scratch: Scratch) -> None:
    """Find colour and splat of four hits in one leaf, and store them in `scratch`.

    The colour is blended with the weights of f; it is 1 if the points have none. The splat is that of greatest weight;
    if all are zero, the nearest one. It is stored as its slot, four times the block plus the position in it.

    four : indices of the rays in the tile
    """
    wide, numbers, part = scratch.world, scratch.numbers, scratch.part
    offset = numbers[sc.INSTANCE_OF + four[0]] * INSTANCE
    tree = tree_at(world.table, i64(world.instances[offset + SHAPE_ROW]))
    v, sheeted = (0.0, 0.0, 0.0), tree.leaves[numbers[sc.LEAF_OF + four[0]] * LEAF + SHEETED] != ZERO
    if sheeted:
        v = transform(matrix_at(world, offset), load3(wide, sc.NORMAL + four[0]))
    points = list_around(tree, four, scratch)
    sums = _weigh(tree, points, (sheeted, v), world.tone, scratch)
    for k in range(6):
        store(part, k * sc.LANES, sums[k])
    for r in range(4):
        i, best = four[r], 4 * r
        red = green = blue = total = 0.0
        for k in range(4 * r, 4 * r + 4):
            best = k if part[k] > part[best] else best
            red, green = red + part[2 * sc.LANES + k], green + part[3 * sc.LANES + k]
            blue, total = blue + part[4 * sc.LANES + k], total + part[5 * sc.LANES + k]
        if part[best] > ZERO:
            numbers[sc.SLOT_OF + i] = i64(scratch.near[int(part[sc.LANES + best])]) * 4 + best % 4
        else:
            x = load3(wide, sc.LOCAL + i)
            slot = nearest_slot(tree, numbers[sc.LEAF_OF + i], f32(x[0]), f32(x[1]), f32(x[2]))
            numbers[sc.SLOT_OF + i] = slot
            if tree.colors.size > 0:
                packed, total = tree.colors[slot], 1.0
                red, green = f64(world.tone[packed & 255]), f64(world.tone[(packed >> 8) & 255])
                blue = f64(world.tone[(packed >> 16) & 255])
        store3(
            wide, sc.COLOR + i, (red / total, green / total, blue / total) if 0.0 < total < np.inf else (1.0, 1.0, 1.0)
        )
    if world.instances[offset + PAINT] >= 0.0:
        paint_four(world, four, points, (sheeted, v), scratch)


@inline
def _describe_scattered(world: World, i: int, scratch: Scratch) -> None:
    """Store the colour and the slot of the scattered point that ray i has hit.

    A slot is four times the block plus the position in it.
    """
    numbers = scratch.numbers
    offset = numbers[sc.INSTANCE_OF + i] * INSTANCE
    tree = tree_at(world.table, i64(world.instances[offset + SHAPE_ROW]))
    slot = numbers[sc.LEAF_OF + i] - SCATTERED
    numbers[sc.SLOT_OF + i] = slot
    color = (1.0, 1.0, 1.0)
    if tree.colors.size > 0:
        packed = tree.colors[slot]
        color = (
            f64(world.tone[packed & 255]),
            f64(world.tone[(packed >> 8) & 255]),
            f64(world.tone[(packed >> 16) & 255]),
        )
    store3(scratch.world, sc.COLOR + i, color)
    if world.instances[offset + PAINT] >= 0.0:
        paint_one(world, i, scratch)


@inline
def material_at(world: World, instance: int) -> int:
    """Return the offset of an instance's material in `World.materials`."""
    return int(world.instances[instance * INSTANCE + MATERIAL]) * MATERIAL_SIZE


@inline
def _shows_colors(world: World, instance: int) -> bool:
    """Return whether a model instance shows the colours of its points, or of an attribute that colours it."""
    if world.materials[material_at(world, instance) + OWN_COLOR] == 0.0:
        return False
    offset = instance * INSTANCE
    tree = tree_at(world.table, i64(world.instances[offset + SHAPE_ROW]))
    return world.instances[offset + PAINT] >= 0.0 or tree.colors.size > 0


@routine
def describe_tile(world: World, seen_only: bool, scratch: Scratch) -> None:
    """Find the colour and the splat of greatest weight where the tile's rays have hit a model; `tile_hit` returns them.

    seen_only : whether only colours are needed, and only those that materials show

    Neighbours that have hit the same leaf are processed together, up to four: this takes 0.6 of the time of one by one.
    """
    scratch, world = borrow(scratch), borrow(world)
    numbers, left = scratch.numbers, i64(0)
    for i in range(sc.TILE):
        numbers[sc.SLOT_OF + i] = -1
        if numbers[sc.INSTANCE_OF + i] >= 0 and numbers[sc.LEAF_OF + i] >= 0:
            if not seen_only or _shows_colors(world, numbers[sc.INSTANCE_OF + i]):
                if numbers[sc.LEAF_OF + i] >= SCATTERED:
                    _describe_scattered(world, i, scratch)
                else:
                    left |= i64(1) << i
            else:
                store3(scratch.world, sc.COLOR + i, (1.0, 1.0, 1.0))
    while left != 0:
        a = count_trailing_zeros(left)
        left &= left - 1
        tree = tree_at(world.table, i64(world.instances[numbers[sc.INSTANCE_OF + a] * INSTANCE + SHAPE_ROW]))
        b = c = d = a
        # Where two sheets are close together, each ray sees its own, so it is processed alone.
        if tree.leaves[numbers[sc.LEAF_OF + a] * LEAF + SHEETED] == ZERO:
            b = next_of_leaf(numbers, left, a)
            left &= ~(i64(1) << b)
            c = next_of_leaf(numbers, left, a)
            left &= ~(i64(1) << c)
            d = next_of_leaf(numbers, left, a)
            left &= ~(i64(1) << d)
        _describe(world, (a, b, c, d), scratch)
