"""Trees of the parts, over splats that need not fit into memory; together they equal the tree of the whole model.

A part is an aligned range of the kd order. Its tree holds the voxels that the whole tree has around this range, each
with the same blocks: of the part, and of other parts whose splats reach there. Rays thus have the same hits as in a
single model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles, Floats
from ...cloud.statistics import quantize
from ...engine.kernels.tree import BLOCK, CELL, LEAF, RADIUS, Tree
from ...surface.tree.blocks import PER_BLOCK, make_blocks
from ...surface.tree.build import Splats, WholeModel, bounds_of, build_tree
from ...surface.tree.leaves import longest_step
from ...surface.tree.parts import without_unused
from ...surface.tree.settings import TreeSettings
from ...surface.tree.top import PER_GROUP, Groups, cells_of_parts, cut_top, groups_of, groups_per_root, top_of_part

GROUP = PER_BLOCK * PER_GROUP  # splats
# Radii. Of a statue in 8 parts, every second one a level coarser, 44 of 3,500 lit pixels are dark without a margin; 10,
# 8 and 1 with 0.1, 0.15 and 0.25. 1, 68, 100 and 157 shadowed pixels are lit.
STEP_BESIDE = 0.1
BINS = 1 << 16  # of the upper half of a float's bits, and of the lower half


class Plan(NamedTuple):
    """Values that the trees of all parts share, so that together they equal the tree of the whole model.

    size : number of splats of each part, a power of two; the last part may have fewer
    groups : bounds of each 64 consecutive blocks of the whole model
    supports : (6,) float32, box around all supports; the samples along a ray start where the ray enters this box
    reference : 2% quantile of the model's support radii; sample distances are those for it times powers of two
    """

    size: int
    groups: Groups
    supports: Floats
    reference: float


def least_size(count: int) -> int:
    """Return the least number of splats of a part, a power of two, for a model of `count` splats."""
    return GROUP * groups_per_root(-(-count // GROUP))


def shown(splats: Splats, size: int, part: int) -> tuple[Groups, Floats]:
    """Return the bounds of a part that the trees of other parts need: of each 64 blocks, and (6,) of all its supports.

    splats : splats of all parts, whose fields may be columns on disk; size : number of splats of each part
    """
    mine = part_of(splats, slice(part * size, min((part + 1) * size, len(splats.radii))))
    order = np.arange(len(mine.radii), dtype=np.int32)
    return groups_of(*make_blocks(mine.positions, mine.normals, mine.radii, order)), bounds_of(mine)


def plan_of(parts: list[tuple[Groups, Floats]], radii: Any, size: int) -> Plan:
    """Return the values that the trees of all parts share, from the bounds of each part and the radii of all splats.

    parts : for each part the bounds of each 64 blocks, and (6,) of all its supports, as `shown` returns them
    radii : support radii of all splats, an array or a column on disk; size : number of splats of each part
    """
    groups = Groups(*(np.concatenate(arrays) for arrays in zip(*(groups for groups, _ in parts), strict=True)))
    starts = range(0, len(radii), size)
    reference = nth_least(lambda: (radii[start : start + size] for start in starts), len(radii) // 50)
    return Plan(size, groups, box_around(np.array([bounds for _, bounds in parts])), quantize(reference, is_limit=True))


def tree_of(splats: Splats, plan: Plan, part: int, settings: TreeSettings) -> Tree:
    """Build the tree of a part: over its splats and those of other parts that reach into its space.

    splats : splats of all parts, whose fields may be columns on disk; plan : values that the trees of all parts share
    """
    count, step = len(splats.radii), longest_step(settings.samples)
    part_rows = slice(part * plan.size, min((part + 1) * plan.size, count))
    top, needed = top_of_part(plan.groups, step, range(part_rows.start // GROUP, -(-part_rows.stop // GROUP)))
    rows = (needed[:, None] * GROUP + np.arange(GROUP)).reshape(-1)
    whole = WholeModel(top, plan.supports, plan.reference)
    return without_unused(build_tree(part_of(splats, rows[rows < count]), settings, in_order=True, whole=whole))


def cells_of(plan: Plan) -> Doubles:
    """Return the space of each part, (parts, 6), low x y z, high x y z: cut by the same planes as the whole tree."""
    return cells_of_parts(plan.groups, plan.size // GROUP)


def tree_within(splats: Splats, box: Doubles, shared: tuple[Floats, float], settings: TreeSettings) -> Tree:
    """Build a tree of splats that covers only the space within a box.

    splats : splats in kd order, which may reach beyond the box; box : (6,) low x y z, high x y z
    shared : values that the trees of all parts share: the box around all supports, (6,), where the samples along a ray
        start, and a support radius; distances between samples are those for this radius times powers of two
    """
    groups = groups_of(*make_blocks(*splats[:3], np.arange(len(splats.radii), dtype=np.int32)))
    top = cut_top(groups, longest_step(settings.samples), within=box)
    return without_unused(build_tree(splats, settings, in_order=True, whole=WholeModel(top, *shared)))


def with_margins(tree: Tree, box: Doubles) -> Tree:
    """Return the tree of a level of detail of a part, with a tolerance at the box's faces beyond which other parts lie.

    Beyond a face another level may be shown, whose surface is slightly higher or lower: a shadow ray that starts on the
    lower one would pass through the step between them. In the leaves at the faces `Tree.noise`, by which the start of
    such rays is moved, is at least 0.1 radii.

    box : (6,) low x y z, high x y z, the space of the part
    """
    leaves = tree.leaves.reshape(-1, LEAF)
    voxels, radii = leaves[:, CELL : CELL + 6], leaves[:, RADIUS]
    beside = voxels[:, :3] < box[:3] + radii[:, None]
    beside |= voxels[:, 3:] > box[3:] - radii[:, None]
    rows = np.flatnonzero(beside.any(axis=1) & (tree.spans[1::2] > 0))
    noise = tree.noise.copy() if tree.noise.size else np.zeros(tree.blocks.size // BLOCK, np.float32)
    np.maximum.at(noise, tree.refs[16 * tree.spans[2 * rows]], np.float32(STEP_BESIDE) * radii[rows])
    return tree._replace(noise=noise)


def bounds_about(positions: Floats, origin: Doubles) -> Doubles:
    """Return the bounding box of positions, (2, 3) float64, in world coordinates.

    origin : world position of their origin
    """
    return np.stack([positions.min(axis=0), positions.max(axis=0)]).astype(np.float64) + origin


def part_of(splats: Splats, rows: slice | NDArray[np.int64]) -> Splats:
    """Select some of the splats by their rows, copied from arrays or from columns on disk."""
    arrays: list[Any] = [None if array is None else np.ascontiguousarray(array[rows]) for array in splats]
    return Splats(*arrays)


def box_around(boxes: NDArray[Any]) -> NDArray[Any]:
    """Return the bounding box, (6,), of boxes (n, 6), all as low x y z, high x y z."""
    return np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])


def nth_least(read: Callable[[], Iterable[Floats]], n: int) -> float:
    """Return the n-th (from 0) of many positive values in ascending order, without having all in memory.

    read : yields all values, in chunks; called twice
    """
    upper = sum(np.bincount(bits >> 16, minlength=BINS) for bits in _bits_of(read()))
    high = int(np.searchsorted(np.cumsum(upper), n, side="right"))
    n -= int(np.cumsum(upper)[high - 1]) if high else 0
    lower = sum(np.bincount(bits[bits >> 16 == high] & (BINS - 1), minlength=BINS) for bits in _bits_of(read()))
    low = int(np.searchsorted(np.cumsum(lower), n, side="right"))
    return float(np.array([high << 16 | low], np.int32).view(np.float32)[0])


def _bits_of(chunks: Iterable[Floats]) -> Iterator[NDArray[np.int32]]:
    return (np.ascontiguousarray(chunk).view(np.int32) for chunk in chunks)
