"""Colour by an attribute: lookup of the splats' values, or of the position, in a colour map at hits."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ...engine.jit import f64, i64, inline
from ...engine.kernels import records as rec, scratch as sc
from ...engine.kernels.records import World
from ...engine.kernels.scratch import Scratch, load3, store3
from ...engine.kernels.tree import Tree, tree_at
from ...engine.kernels.vec import Vec3, add, dot, load3_flat, scale
from ...engine.simd import F16, ONE, ZERO, broadcast16, repeat4, store
from ..intersect.surface import FourPoints, Sheet, weights_seen

SLACK = 1e-3  # share of one colour of the map: a blend of equal values must not round down into the previous colour

Four: TypeAlias = tuple[int, int, int, int]  # rays of the tile


@inline
def _map_color(world: World, paint: int, map_position: float) -> Vec3:
    """Return the colour of a colour map at a position from 0 to its number of colours; for NaN that of missing values.

    paint : offset in `World.paints` of the record of the attribute that the map colours
    """
    count, first = int(world.paints[paint + rec.PAINT_COUNT]), int(world.paints[paint + rec.PAINT_COLORS])
    k = count
    if map_position == map_position:
        k = int(min(max(map_position + SLACK, 0.0), count - 1.0))
    return load3_flat(world.map_colors, first + 3 * k)


@inline
def _blend(
    world: World, paint: int, tree: Tree, points: FourPoints, sheet: Sheet, scratch: Scratch
) -> tuple[F16, F16, F16]:
    """Sum an attribute's values over the splats of the blocks listed in `scratch`, weighted as in f, at four points.

    paint : offset of the attribute's record in `World.paints`; points : x, y, z, a quarter of the lanes for each
    sheet : whether two sheets are close together, and the hit's normal, which selects one of them

    Returns three vectors, to be summed over each quarter: the weights, the weights of splats with a value, and the
    weights times positions in the colour map.
    """
    part, first = scratch.part, int(world.paints[paint + rec.PAINT_POSITIONS])
    total = known = map_position = broadcast16(ZERO)
    for k in range(scratch.counts[sc.COUNT_NEAR]):
        block = i64(scratch.near[k])
        w = weights_seen(tree, block, points, sheet, part)
        total = total + w
        for j in range(4):
            value = world.map_positions[first + 4 * block + j]
            good = value == value
            part[j], part[4 + j] = (value if good else ZERO), (ONE if good else ZERO)
        map_position = map_position + w * repeat4(part, 0)
        known = known + w * repeat4(part, 4)
    return total, known, map_position


@inline
def _blended(sums: tuple[F16, F16, F16], r: int, own: float, scratch: Scratch) -> float:
    """Return the position in the colour map at point r of four; NaN if splats without a value have most of the weight.

    sums : from `_blend`
    own : position in the colour map of the splat that was hit, which is used if all weights are zero
    """
    part = scratch.part
    for k in range(3):
        store(part, k * sc.LANES, sums[k])
    total = known = map_position = 0.0
    for k in range(4 * r, 4 * r + 4):
        total, known, map_position = total + part[k], known + part[sc.LANES + k], map_position + part[2 * sc.LANES + k]
    if not total > 0.0:
        return own
    return map_position / known if known > 0.0 and 2.0 * known >= total else np.nan


@inline
def paint_four(world: World, four: Four, points: FourPoints, sheet: Sheet, scratch: Scratch) -> None:
    """Set the colours of four hits on one instance that is coloured by an attribute.

    four : indices of the rays in the tile, whose splats are known and whose blocks are listed in `scratch`
    points : x, y, z of the hits, a quarter of the lanes for each
    sheet : whether two sheets are close together, and the hit's normal, which selects one of them
    """
    offset = scratch.numbers[sc.INSTANCE_OF + four[0]] * rec.INSTANCE
    tree = tree_at(world.table, i64(world.instances[offset + rec.SHAPE_ROW]))
    paint = int(world.instances[offset + rec.PAINT]) * rec.PAINT_SIZE
    kind = world.paints[paint + rec.PAINT_KIND]
    sums = broadcast16(ZERO), broadcast16(ZERO), broadcast16(ZERO)
    if kind == rec.BLENDED:
        sums = _blend(world, paint, tree, points, sheet, scratch)
    for r in range(4):
        i, own = four[r], np.nan
        if kind != rec.BY_COORDINATE:
            own = _own_position(world, paint, i, scratch)
        _paint(world, paint, i, _blended(sums, r, own, scratch) if kind == rec.BLENDED else own, scratch)


@inline
def _own_position(world: World, paint: int, i: int, scratch: Scratch) -> float:
    """Return the position in the colour map of the value of the splat that ray i has hit.

    paint : offset of the attribute's record in `World.paints`
    """
    return f64(world.map_positions[int(world.paints[paint + rec.PAINT_POSITIONS]) + scratch.numbers[sc.SLOT_OF + i]])


@inline
def _paint(world: World, paint: int, i: int, map_position: float, scratch: Scratch) -> None:
    """Set the colour of ray i's hit from a position in the colour map.

    paint : offset of the attribute's record in `World.paints`
    map_position : NaN for a missing value; ignored for colour by coordinate, which follows from the hit's position
    """
    wide = scratch.world
    if world.paints[paint + rec.PAINT_KIND] == rec.BY_COORDINATE:
        x = add(load3(wide, sc.ORIGIN + i), scale(load3(wide, sc.DIRECTION + i), wide[sc.NEAREST + i]))
        map_position = dot(load3_flat(world.paints, paint + rec.PAINT_ALONG), x) + world.paints[paint + rec.PAINT_START]
    store3(wide, sc.COLOR + i, _map_color(world, paint, map_position))


@inline
def paint_one(world: World, i: int, scratch: Scratch) -> None:
    """Set the colour of ray i's hit on an instance that is coloured by an attribute, from one splat's value.

    It is the value of the splat that was hit, which `scratch` holds already. Colour by coordinate uses the hit's
    position instead.
    """
    paint = int(world.instances[scratch.numbers[sc.INSTANCE_OF + i] * rec.INSTANCE + rec.PAINT]) * rec.PAINT_SIZE
    own = np.nan
    if world.paints[paint + rec.PAINT_KIND] != rec.BY_COORDINATE:
        own = _own_position(world, paint, i, scratch)
    _paint(world, paint, i, own, scratch)
