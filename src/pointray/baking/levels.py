"""Coarser light for scenes whose light would not fit into its memory: one record serves a group of a model's patches.

Records of a coarser level stand at knots: every patch, or every 4th, 16th and so on. A model has one spread a level,
which its instances share: it tells from which four knots the light of each splat is blended, see `records.SPREAD`. So
what a splat costs is paid once a model, and each instance costs as little as its knots.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..cloud.neighbors import NeighborTree
from ..engine.kernels.records import RECORD, SPREAD, SPREAD_RECORDS, SPREAD_SHARES
from ..engine.kernels.tree import EMPTY, Tree
from .patches import BLOCK_SPLATS, PatchSet, blend_for, nearest_blend, splats_of

STEP = 4  # patches of a level for one of the next
LEAST_KNOTS = 64  # there is no level with fewer, but the first
KNOTS = 4  # from which the light of a splat is blended
WHOLE = 255  # the sum of a splat's shares

Ints = NDArray[np.int32]


class Spread(NamedTuple):
    """A level of a model's light.

    blocks : of the model, then of its levels of detail: (blocks * SPREAD,) int32, see `records.SPREAD`
    knot_of : (patches,) int32, the knot whose light each patch has a part in
    knots : how many
    """

    blocks: tuple[Ints, ...]
    knot_of: Ints
    knots: int


class Shape(NamedTuple):
    """What the levels of a model's light cost. records : of the full light; spread : bytes of one spread"""

    records: int
    spread: int
    patches: int


class Wanted(NamedTuple):
    """What an instance of a model wants to keep. shape : which model; sides : that are lit"""

    shape: int
    sides: int


def knots_at(level: int, patches: int) -> NDArray[np.int64]:
    """The patches that are knots of a level from 1 on, increasing."""
    step = STEP ** (level - 1)
    return np.arange(patches)[step // 2 :: step]


def deepest(patches: int) -> int:
    """The coarsest level of a model with so many patches."""
    level = 1
    while len(knots_at(level + 1, patches)) >= LEAST_KNOTS:
        level += 1
    return level


def in_fours(count: int) -> int:
    """The number of records for so many knots: they are read four at a time."""
    return count + -count % 4


def shape_of_trees(trees: Sequence[Tree], patches: int) -> Shape:
    """What the light of a model costs. trees : its own, and those of its levels of detail"""
    slots = sum(tree.order.size for tree in trees)
    return Shape(slots, 4 * SPREAD * (slots // BLOCK_SPLATS), patches)


def _bytes_at(shape: Shape, level: int) -> int:
    """Bytes of one side at a level, without the spread."""
    return 4 * RECORD * (shape.records if level == 0 else in_fours(len(knots_at(level, shape.patches))))


def _total(shapes: Sequence[Shape], wanted: Sequence[Wanted], levels: Sequence[int]) -> int:
    """Bytes of all instances at these levels."""
    spreads = {(item.shape, level) for item, level in zip(wanted, levels, strict=True) if level > 0}
    own = sum(item.sides * _bytes_at(shapes[item.shape], level) for item, level in zip(wanted, levels, strict=True))
    return own + sum(shapes[shape].spread for shape, _ in spreads)


def choose_levels(shapes: Sequence[Shape], wanted: Sequence[Wanted], budget: int) -> list[int] | int:
    """The level of each instance, so that all fit into a budget in bytes; or the least budget, if none do.

    Levels grow coarser for all alike; then those of the smallest instances grow finer again while there is room.
    """
    sides = Counter[int]()
    for item in wanted:
        sides[item.shape] += item.sides
    limits = [deepest(shape.patches) for shape in shapes]
    levels: list[int] = []
    for bound in range(max(limits, default=0) + 1):
        best = [_cheapest(shape, sides[k], min(bound, limits[k])) for k, shape in enumerate(shapes)]
        levels = [best[item.shape] for item in wanted]
        if _total(shapes, wanted, levels) <= budget:
            return _finer(shapes, wanted, levels, budget)
    return _total(shapes, wanted, levels)


def _cheapest(shape: Shape, sides: int, most: int) -> int:
    """The level up to `most` at which all instances of a model take the least; the finest of several."""
    return min(range(most + 1), key=lambda level: sides * _bytes_at(shape, level) + (shape.spread if level else 0))


def _finer(shapes: Sequence[Shape], wanted: Sequence[Wanted], levels: list[int], budget: int) -> list[int]:
    """Levels that are finer where there is room, level by level, the smallest instances first."""
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
    """The spread of a model at a level from 1 on."""
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
    knot_of[rows] = np.arange(len(rows))  # so that none is without a patch
    return Spread(blocks, knot_of, len(rows))


def _spread_over(
    x: NDArray[np.float32],
    n: NDArray[np.float32],
    finder: NeighborTree,
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
) -> Ints:
    """How light at knots is spread over splats at x with normals n, (blocks * SPREAD,)."""
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


def at_knots(spread: Spread, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The light of knots, (count, k): the mean of that of their patches, (patches, k); the count is a multiple of 4."""
    parts, count = np.bincount(spread.knot_of, minlength=spread.knots), in_fours(spread.knots)
    sums = [np.bincount(spread.knot_of, column, count) for column in values.T]
    return (np.stack(sums, axis=1) / np.append(parts, np.ones(count - spread.knots))[:, None]).astype(np.float32)


def over_splats(blocks: Ints, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The light of a tree's slots, (n, k), from that of knots, as pictures blend it."""
    table = blocks.reshape(-1, SPREAD)
    knots = np.repeat(table[:, SPREAD_RECORDS : SPREAD_RECORDS + KNOTS], BLOCK_SPLATS, axis=0)
    shares = np.ascontiguousarray(table[:, SPREAD_SHARES:]).reshape(-1, 1).view(np.uint8).astype(np.float32)
    total = sum(shares[:, k, None] * values[knots[:, k]] for k in range(KNOTS))
    return np.asarray(total / np.float32(WHOLE), np.float32)


def is_spread(blocks: Ints, count: int) -> bool:
    """Whether kernels may read these blocks, for so many records."""
    table = blocks.reshape(-1, SPREAD)
    knots = table[:, SPREAD_RECORDS : SPREAD_RECORDS + KNOTS]
    shares = np.ascontiguousarray(table[:, SPREAD_SHARES:]).view(np.uint8).reshape(-1, KNOTS)
    return bool(((knots >= 0) & (knots < count)).all() and (shares.sum(axis=1, dtype=np.int32) == WHOLE).all())
