"""The trees of the parts, over splats that need not fit into memory: together they are the tree of the whole.

A part is an aligned stretch of the kd order. Its tree holds the voxels that the whole's tree has around this stretch,
each with the same blocks: of the part, and of others whose splats reach there. So rays meet in parts what they meet in
one model.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..data import Points
from ..kernels.tree import LONGEST
from ..model_folder import PartFile, write_part
from ..progress import Progress, tell
from ..tree.blocks import PER_BLOCK, make_blocks
from ..tree.build import Splats, Whole, bounds_of, build_tree
from ..tree.leaves import longest_step
from ..tree.parts import without_unused
from ..tree.settings import TreeSettings
from ..tree.top import PER_GROUP, Groups, groups_of, groups_per_root, top_of_part

GROUP = PER_BLOCK * PER_GROUP  # splats
BINS = 1 << 16  # of the upper half of a float's bits, and of the lower


class Trees(NamedTuple):
    """What `write_trees` has written.

    supports : (6,) float32, bounds of all supports; longest : longest step of the samples in any leaf
    """

    parts: list[PartFile]
    supports: NDArray[np.float32]
    longest: float


def least_size(count: int) -> int:
    """The fewest splats that a part of so many may have, a power of two."""
    return GROUP * groups_per_root(-(-count // GROUP))


def write_trees(
    folder: Path,
    id: str,
    points: Points,
    splats: Splats,
    size: int,
    settings: TreeSettings,
    progress: Progress | None = None,
) -> Trees:
    """Write the files of all parts.

    Parameters
    ----------
    points : Points
        A row for each splat.
    splats : Splats
        In kd order; arrays may be mapped.
    size : int
        Splats of a part, a power of two, `least_size` or more.
    """
    count = len(splats.radii)
    stretches = [slice(start, min(start + size, count)) for start in range(0, count, size)]
    some = [_groups_of(part_of(splats, stretch)) for stretch in stretches]
    groups = Groups(*(np.concatenate(arrays) for arrays in zip(*some, strict=True)))
    supports = _around([bounds_of(part_of(splats, stretch)) for stretch in stretches])
    reference = nth_least([splats.radii[stretch] for stretch in stretches], count // 50)
    files, longest, step = [], 0.0, longest_step(settings.samples)
    for number, stretch in enumerate(stretches):
        top, needed = top_of_part(groups, step, range(stretch.start // GROUP, -(-stretch.stop // GROUP)))
        rows = (needed[:, None] * GROUP + np.arange(GROUP)).reshape(-1)
        mine = part_of(splats, rows[rows < count])
        tree = without_unused(build_tree(mine, settings, in_order=True, whole=Whole(top, supports, reference)))
        longest = max(longest, float(tree.head[LONGEST]))
        here = points.positions[stretch]
        bounds = np.stack([here.min(axis=0), here.max(axis=0)]).astype(np.float64) + points.origin
        files.append(write_part(folder, id, number, len(here), bounds, tree))
        tell(progress, (number + 1) / len(stretches))
    return Trees(files, supports, longest)


def part_of(splats: Splats, rows: slice | NDArray[np.int64]) -> Splats:
    """Some of the splats."""
    arrays: list[Any] = [None if array is None else np.ascontiguousarray(array[rows]) for array in splats]
    return Splats(*arrays)


def _groups_of(splats: Splats) -> Groups:
    order = np.arange(len(splats.radii), dtype=np.int32)
    return groups_of(*make_blocks(splats.positions, splats.normals, splats.radii, order))


def _around(boxes: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """The box around boxes, (6,)."""
    each = np.array(boxes)
    return np.concatenate([each[:, :3].min(axis=0), each[:, 3:].max(axis=0)])


def nth_least(chunks: list[NDArray[np.float32]], n: int) -> float:
    """The number that would stand at place n if all, which are positive, were sorted."""
    upper = sum(np.bincount(bits >> 16, minlength=BINS) for bits in _bits_of(chunks))
    high = int(np.searchsorted(np.cumsum(upper), n, side="right"))
    n -= int(np.cumsum(upper)[high - 1]) if high else 0
    lower = sum(np.bincount(bits[bits >> 16 == high] & (BINS - 1), minlength=BINS) for bits in _bits_of(chunks))
    low = int(np.searchsorted(np.cumsum(lower), n, side="right"))
    return float(np.array([high << 16 | low], np.int32).view(np.float32)[0])


def _bits_of(chunks: list[NDArray[np.float32]]) -> Iterator[NDArray[np.int32]]:
    return (np.ascontiguousarray(chunk).view(np.int32) for chunk in chunks)
