"""Which light fits into its memory: how coarse the light of each instance of a scene is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from ..base.memory import available_memory
from ..engine.kernels.records import INSTANCE, RECORD, SHAPE_ROW
from ..engine.kernels.tree import Tree
from ..scene.world import Snapshot
from .levels import Spread, Wanted, choose_levels, make_spread, shape_of_trees
from .patches import PatchSet
from .planes import Grid
from .transport import Side

SHARE = 0.5  # of the memory that is available: what light may take where nothing is said


def spreads_within(
    scene: Snapshot, sides: Sequence[Side], memory: int | None
) -> tuple[dict[int, int], dict[int, Spread]]:
    """How coarse the light of each instance of a model is, by its number; and the spreads of coarser ones.

    sides : all that are lit; memory : bytes for the light; None: SHARE of what is available

    Raises
    ------
    ValueError
        If the memory is too small even for the coarsest light.
    """
    planes = sum(4 * RECORD * side.size for side in sides if isinstance(side.sheet.patches, Grid))
    rows, patches, lit = _models_of(scene, sides)
    trees = {row: _trees_of(scene, row) for row in set(rows.values())}
    shapes = sorted(trees)
    costs = [shape_of_trees(trees[row], len(patches[row].positions)) for row in shapes]
    wanted = [Wanted(shapes.index(rows[instance]), lit[instance]) for instance in rows]
    budget = _budget(memory)
    levels = choose_levels(costs, wanted, budget - planes)
    if isinstance(levels, int) or planes > budget:
        least = planes + (levels if isinstance(levels, int) else 0)
        given = f"memory={memory:,}" if memory is not None else f"the {budget:,} that it may take of what is available"
        raise ValueError(f"the light takes at least {least:,} bytes, more than {given}")
    of = {int(scene.keys[instance]): level for instance, level in zip(rows, levels, strict=True)}
    made: dict[tuple[int, int], Spread] = {}
    spreads = {}
    for (instance, row), level in zip(rows.items(), levels, strict=True):
        if level > 0:
            if (row, level) not in made:
                made[row, level] = make_spread(trees[row], patches[row], level)
            spreads[int(scene.keys[instance])] = made[row, level]
    return of, spreads


def _budget(memory: int | None) -> int:
    if memory is not None:
        return memory
    free = available_memory()
    return 2**62 if free is None else int(free * SHARE)


def _models_of(scene: Snapshot, sides: Sequence[Side]) -> tuple[dict[int, int], dict[int, PatchSet], Counter[int]]:
    """The model of each instance, by its row; the patches of each model; how many sides of each instance are lit."""
    records = scene.world.instances.reshape(-1, INSTANCE)
    rows: dict[int, int] = {}
    patches: dict[int, PatchSet] = {}
    lit = Counter[int]()
    for side in sides:
        found, instance = side.sheet.patches, side.sheet.instance
        if isinstance(found, PatchSet):
            rows[instance] = int(records[instance, SHAPE_ROW])
            patches[rows[instance]] = found
            lit[instance] += 1
    return rows, patches, lit


def _trees_of(scene: Snapshot, row: int) -> list[Tree]:
    """The tree of a model, and those of its levels of detail."""
    model = scene.models[row]
    return [model.tree, *(level.tree for level in model.levels)]


def levels_of(side: Side) -> int:
    """How many trees show a side: of its model, and of its levels of detail; 1 for a plane."""
    patches = side.sheet.patches
    return 1 if isinstance(patches, Grid) else len(patches.blends)


def coarseness(levels: Mapping[int, int]) -> str:
    """In words how coarse the light is; empty where each splat has its own. levels : see `Kept.levels`"""
    counts = Counter(level for level in levels.values() if level > 0)
    if not counts:
        return ""
    finest, coarsest = min(counts), max(counts)
    which = f"level {finest}" if finest == coarsest else f"levels {finest} to {coarsest}"
    return f"{counts.total():,} of {len(levels):,} instances have coarser light ({which})"
