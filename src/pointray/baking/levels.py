"""Coarser light, for scenes whose light would not fit into memory: one record serves a group of a model's patches.

Records of a coarser level are stored at knots: every patch, or every 4th, 16th and so on. Each level of a model has one
spread, shared by its instances, with the four knots from which the light of each splat is blended (see
`records.SPREAD`). The cost per splat is therefore paid once per model, and each instance costs only its knots.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Floats
from ..cloud.neighbors import NeighborTree
from ..engine.kernels.records import RECORD, SPREAD, SPREAD_RECORDS, SPREAD_SHARES
from ..engine.kernels.tree import EMPTY, Tree
from .patches import BLOCK_SPLATS, PatchSet, blend_for, nearest_blend, splats_of

STEP = 4  # patches of a level per patch of the next one
LEAST_KNOTS = 64  # minimum for levels above 1
KNOTS = 4  # blended for each splat
WHOLE = 255  # sum of a splat's blend weights

Ints = NDArray[np.int32]


class Spread(NamedTuple):
    """Interpolation of a model's coarser light: which of the few records are blended for each splat, and their weights.

    Records are stored at knots, which are every patch of the model, or every 4th, 16th and so on.

    blocks : of the model, then of its levels of detail: (blocks * SPREAD,) int32, four knots for each block of splats,
        and their weights for each splat, see `records.SPREAD`
    knot_of : (patches,) int32, the knot to whose light each patch contributes; knots : their number
    """

    blocks: tuple[Ints, ...]
    knot_of: Ints
    knots: int


class LightCost(NamedTuple):
    """Size of the light of a model's instances, from which their level of coarseness is chosen.

    records : number of records of a side at the finest level, one per splat; patches : number of patches of the model
    spread : bytes of the table that interpolates a coarser level, which instances share
    """

    records: int
    spread: int
    patches: int


class LitInstance(NamedTuple):
    """Instance of a model, for which memory for light is planned.

    shape : index of the model; sides : number of sides that receive light, 1 or 2
    """

    shape: int
    sides: int


def knots_at(level: int, patches: int) -> NDArray[np.int64]:
    """Return the patches at which records of light are stored at a coarse level: every 4^(level - 1)-th, increasing.

    level : at least 1; patches : number of patches of the model
    """
    step = STEP ** (level - 1)
    return np.arange(patches)[step // 2 :: step]


def coarsest_level(patches: int) -> int:
    """Return the coarsest level of a model's light, at least 1; levels above 1 have at least LEAST_KNOTS records.

    patches : number of patches of the model; level k stores a record for every 4^(k - 1) of them
    """
    level = 1
    while len(knots_at(level + 1, patches)) >= LEAST_KNOTS:
        level += 1
    return level


def padded_count(count: int) -> int:
    """Return a number of light records rounded up to a multiple of 4, because they are read four at a time."""
    return count + -count % 4


def light_cost(trees: Sequence[Tree], patches: int) -> LightCost:
    """Return the size of a model's light, to choose its coarseness.

    trees : of the model, and of its levels of detail; patches : number of patches of the model
    """
    slots = sum(tree.order.size for tree in trees)
    return LightCost(slots, 4 * SPREAD * (slots // BLOCK_SPLATS), patches)


def _bytes_at(shape: LightCost, level: int) -> int:
    """Return the bytes of the light records of one side of an instance, without tables that interpolate coarser light.

    shape : numbers of records and patches of its model; level : 0 for a record per splat, k for one per 4^(k - 1)
        patches
    """
    return 4 * RECORD * (shape.records if level == 0 else padded_count(len(knots_at(level, shape.patches))))


def _total(shapes: Sequence[LightCost], wanted: Sequence[LitInstance], levels: Sequence[int]) -> int:
    """Return the bytes of all instances' light, including the tables that interpolate coarser light.

    shapes : size of the light of each model; wanted : instances
    levels : of each instance's light, 0 for a record per splat, k for one per 4^(k - 1) patches
    """
    spreads = {(item.shape, level) for item, level in zip(wanted, levels, strict=True) if level > 0}
    own = sum(item.sides * _bytes_at(shapes[item.shape], level) for item, level in zip(wanted, levels, strict=True))
    return own + sum(shapes[shape].spread for shape, _ in spreads)


def choose_levels(shapes: Sequence[LightCost], wanted: Sequence[LitInstance], budget: int) -> list[int] | int:
    """Choose how coarse each instance's light is so that all fit into a memory budget.

    All levels are coarsened together; then those of the smallest instances are refined while there is room.

    shapes : size of the light of each model; wanted : instances; budget : bytes

    Returns
    -------
    list of int, or int
        For each instance 0 for a record per splat, or k for one per 4^(k - 1) patches. If even the coarsest light does
        not fit: the bytes that it takes.
    """
    sides = Counter[int]()
    for item in wanted:
        sides[item.shape] += item.sides
    limits = [coarsest_level(shape.patches) for shape in shapes]
    levels: list[int] = []
    for bound in range(max(limits, default=0) + 1):
        best = [_cheapest_level(shape, sides[k], min(bound, limits[k])) for k, shape in enumerate(shapes)]
        levels = [best[item.shape] for item in wanted]
        if _total(shapes, wanted, levels) <= budget:
            return _refine_levels(shapes, wanted, levels, budget)
    return _total(shapes, wanted, levels)


def _cheapest_level(shape: LightCost, sides: int, most: int) -> int:
    """Return the level, 0 to `most`, at which a model's instances take the least memory; the finest on a tie.

    shape : size of the model's light; sides : number of lit sides of all its instances
    """
    return min(range(most + 1), key=lambda level: sides * _bytes_at(shape, level) + (shape.spread if level else 0))


def _refine_levels(
    shapes: Sequence[LightCost], wanted: Sequence[LitInstance], levels: list[int], budget: int
) -> list[int]:
    """Make the light of instances finer where the budget has room, level by level, the smallest instances first.

    shapes : size of the light of each model
    wanted : the instances
    levels : coarseness of each instance's light, 0 for a record per splat, k for one per 4^(k - 1) patches; changed in
        place
    budget : bytes for the light of all instances together

    Returns
    -------
    list of int
        `levels`.
    """
    used = Counter((item.shape, level) for item, level in zip(wanted, levels, strict=True))
    total = _total(shapes, wanted, levels)
    order = sorted(range(len(wanted)), key=lambda k: (wanted[k].sides * _bytes_at(shapes[wanted[k].shape], 0), k))
    for level in reversed(range(max(levels, default=0))):
        for k in order:
            item, before = wanted[k], levels[k]
            if before <= level:
                continue
            shape = shapes[item.shape]
            change = item.sides * (_bytes_at(shape, level) - _bytes_at(shape, before))
            change += shape.spread * ((level > 0 and not used[item.shape, level]) - (used[item.shape, before] == 1))
            if total + change <= budget:
                used[item.shape, before] -= 1
                used[item.shape, level] += 1
                levels[k], total = level, total + change
    return levels


def make_spread(trees: Sequence[Tree], patches: PatchSet, level: int) -> Spread:
    """Build the interpolation of a model's coarser light from few records to all splats.

    trees : of the model, and of its levels of detail; level : k >= 1 for a record per 4^(k - 1) patches
    """
    rows = knots_at(level, len(patches.positions))
    positions, normals = patches.positions[rows], patches.normals[rows]
    finder = NeighborTree(positions)
    blocks = tuple(_spread_over(*splats_of(tree)[:2], finder, positions, normals) for tree in trees)
    if level == 1:
        return Spread(blocks, np.arange(len(rows), dtype=np.int32), len(rows))
    count = len(patches.positions)
    empty = -count % BLOCK_SPLATS
    x = np.concatenate([patches.positions, np.full((empty, 3), EMPTY, np.float32)])
    n = np.concatenate([patches.normals, np.zeros((empty, 3), np.float32)])
    knot_of = blend_for(x, n, finder, positions, normals).patch_of[:count]
    knot_of[rows] = np.arange(len(rows))  # every knot has at least its own patch
    return Spread(blocks, knot_of, len(rows))


def _spread_over(x: Floats, n: Floats, finder: NeighborTree, positions: Floats, normals: Floats) -> Ints:
    """Return for each block of splats the four knots from which light is interpolated, and the splats' weights.

    Knots are the patches at which coarser light is stored.

    x, n : positions and normals of the splats, (slots, 3)
    finder : search tree over the knots
    positions, normals : of the knots, (knots, 3)

    Returns
    -------
    (blocks * SPREAD,) int32
        For each block its four knots, then for each of its four splats an int32 of four bytes, the weights of the
        knots in 255ths.
    """
    blend = blend_for(x, n, finder, positions, normals)
    knots, weights = nearest_blend(x, n, blend, (positions, normals), KNOTS)
    total = weights.sum(axis=1, keepdims=True, dtype=np.int64)
    shares = weights.astype(np.int64) * WHOLE // np.maximum(total, 1)
    most = np.arange(len(shares)), weights.argmax(axis=1)
    shares[most] += WHOLE - shares.sum(axis=1)
    out = np.empty((len(knots), SPREAD), np.int32)
    out[:, SPREAD_RECORDS : SPREAD_RECORDS + KNOTS] = knots
    out[:, SPREAD_SHARES:] = shares.astype(np.uint8).view("<i4").reshape(-1, BLOCK_SPLATS)
    return out.reshape(-1)


def average_at_knots(spread: Spread, values: Floats) -> Floats:
    """Average light over groups of patches: return the mean over the patches of each knot, (knots, k).

    Knots are the patches at which coarser light is stored. Rows are padded to a multiple of 4.

    values : (patches, k)
    """
    parts, count = np.bincount(spread.knot_of, minlength=spread.knots), padded_count(spread.knots)
    sums = [np.bincount(spread.knot_of, column, count) for column in values.T]
    return (np.stack(sums, axis=1) / np.append(parts, np.ones(count - spread.knots))[:, None]).astype(np.float32)


def blend_over_splats(blocks: Ints, values: Floats) -> Floats:
    """Interpolate coarser light to the splats of a tree as rendering does: return (slots, k).

    blocks : (blocks * SPREAD,), the four records that each block blends, and weights; values : (records, k)
    """
    table = blocks.reshape(-1, SPREAD)
    knots = np.repeat(table[:, SPREAD_RECORDS : SPREAD_RECORDS + KNOTS], BLOCK_SPLATS, axis=0)
    shares = np.ascontiguousarray(table[:, SPREAD_SHARES:]).reshape(-1, 1).view(np.uint8).astype(np.float32)
    total = sum(shares[:, k, None] * values[knots[:, k]] for k in range(KNOTS))
    return np.asarray(total / np.float32(WHOLE), np.float32)


def is_valid_spread(blocks: Ints, count: int) -> bool:
    """Return whether an interpolation table from a file is safe for kernels: valid indices, weights of sum 255.

    blocks : (blocks * SPREAD,), for each block four indices of records, and their weights for each splat
    count : number of light records
    """
    table = blocks.reshape(-1, SPREAD)
    knots = table[:, SPREAD_RECORDS : SPREAD_RECORDS + KNOTS]
    shares = np.ascontiguousarray(table[:, SPREAD_SHARES:]).view(np.uint8).reshape(-1, KNOTS)
    return bool(((knots >= 0) & (knots < count)).all() and (shares.sum(axis=1, dtype=np.int32) == WHOLE).all())
