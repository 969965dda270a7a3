"""Fit of baked light into a memory budget: the level of the light of each instance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from ..base.memory import available_memory
from ..engine.kernels.records import INSTANCE, RECORD, SHAPE_ROW
from ..engine.kernels.tree import Tree
from ..scene.world import Snapshot
from .levels import LitInstance, Spread, choose_levels, light_cost, make_spread
from .patches import PatchSet
from .planes import Grid
from .transport import Side

SHARE = 0.5  # fraction of available memory that the light may take by default


def spreads_within(
    scene: Snapshot, sides: Sequence[Side], memory: int | None
) -> tuple[dict[int, int], dict[int, Spread]]:
    """Choose how coarse the light of each instance must be to fit into memory, and how splats interpolate it.

    sides : all lit sides of instances; memory : bytes for the light, None for a fraction SHARE of the available memory

    Returns
    -------
    dict of int
        By instance number, for instances of models: 0 for a light record per splat, k for one per 4^(k - 1) patches.
    dict of Spread
        By instance number, for instances with k >= 1: from which records each splat's light is interpolated.

    Raises
    ------
    ValueError
        If the memory is too small even for the coarsest light.
    """
    planes = sum(4 * RECORD * side.size for side in sides if isinstance(side.surface.patches, Grid))
    rows, patches, lit = _models_of(scene, sides)
    trees = {row: _trees_of(scene, row) for row in set(rows.values())}
    shapes = sorted(trees)
    costs = [light_cost(trees[row], len(patches[row].positions)) for row in shapes]
    wanted = [LitInstance(shapes.index(rows[instance]), lit[instance]) for instance in rows]
    budget = _budget(memory)
    levels = choose_levels(costs, wanted, budget - planes)
    if isinstance(levels, int) or planes > budget:
        least = planes + (levels if isinstance(levels, int) else 0)
        given = f"memory={memory:,}" if memory is not None else f"the {budget:,} bytes it may take of available memory"
        raise ValueError(f"the baked light needs at least {least:,} bytes, more than {given}")
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
    """Find the models that receive light.

    Returns
    -------
    dict of int
        Index in `scene.models` of the model of each instance, by the instance's row.
    dict of PatchSet
        The patches of each model, by its index.
    Counter
        Number of lit sides, 1 or 2, of each instance, by its row.
    """
    records = scene.world.instances.reshape(-1, INSTANCE)
    rows: dict[int, int] = {}
    patches: dict[int, PatchSet] = {}
    lit = Counter[int]()
    for side in sides:
        found, instance = side.surface.patches, side.surface.instance
        if isinstance(found, PatchSet):
            rows[instance] = int(records[instance, SHAPE_ROW])
            patches[rows[instance]] = found
            lit[instance] += 1
    return rows, patches, lit


def _trees_of(scene: Snapshot, row: int) -> list[Tree]:
    """Return the tree of model `row` of a scene and those of its levels of detail."""
    model = scene.models[row]
    return [model.tree, *(level.tree for level in model.levels)]


def count_trees(side: Side) -> int:
    """Return how many trees need light for a side of an instance: model and levels of detail, or 1 for a plane."""
    patches = side.surface.patches
    return 1 if isinstance(patches, Grid) else len(patches.blends)


def describe_coarseness(levels: Mapping[int, int]) -> str:
    """Return text that says how many instances have less than one light record per splat; empty if none have.

    levels : by instance number, 0 for a record per splat, k for one per 4^(k - 1) patches
    """
    counts = Counter(level for level in levels.values() if level > 0)
    if not counts:
        return ""
    finest, coarsest = min(counts), max(counts)
    which = f"level {finest}" if finest == coarsest else f"levels {finest} to {coarsest}"
    return f"{counts.total():,} of {len(levels):,} instances have coarser light ({which})"
