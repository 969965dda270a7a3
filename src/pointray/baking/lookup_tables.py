"""The light that pictures read of a bake, in the form in which kernels read it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.jit import Array
from ..engine.kernels.records import (
    BAKED,
    BAKED_BACK,
    BAKED_COUNT,
    BAKED_FRAME,
    BAKED_FRONT,
    BAKED_SPREAD,
    BAKED_SPREAD_COUNT,
    BAKED_UNIT,
    GRID_EDGE,
    GRID_HALF,
    GRID_MIDDLE,
    INSTANCE,
    KIND,
    MODEL,
    SHAPE_ROW,
    SPREAD,
)
from ..scene.world import Snapshot
from .patches import BLOCK_SPLATS
from .planes import Grid

COLUMNS = {1: BAKED_FRONT, -1: BAKED_BACK}  # by the sign of a side


class _Addresses(bytearray):
    """The memory of a table of addresses, with what they point to: as long as the one is there, so is the other."""

    kept: list[NDArray[np.int32]]


class Kept(NamedTuple):
    """The light of all sides of instances, which go by their numbers. Sides are in the order of the instances.

    unit : W/m2 of the records' 1.0
    records : (n, RECORD) int32, by number, sign and level of detail (0: the model itself, or a plane): of each slot of
        the tree, or of each cell of a plane's grid; of coarser light those of its knots, whatever the level of detail
    grids : of planes
    spreads : of instances with coarser light, see `levels.Spread.blocks`; instances of a model share them
    levels : how coarse the light of each instance of a model is, see `levels`; 0: a record for each splat
    """

    unit: float
    records: dict[tuple[int, int, int], NDArray[np.int32]]
    grids: dict[int, Grid]
    spreads: dict[int, tuple[NDArray[np.int32], ...]]
    levels: dict[int, int]

    def tables(self, scene: Snapshot, levels: NDArray[np.int64]) -> tuple[Array, Array]:
        """What kernels read, see `records.BAKED`. levels : (instances,), which level of its model each shows

        Where a model is no longer the one that was baked it is dark: its splats have no records.
        """
        rows, frames = np.zeros((len(levels), BAKED), np.int64), np.zeros((len(levels), BAKED_FRAME))
        memory = _Addresses(rows.nbytes)
        memory.kept = []
        for k, (number, shown, slots) in enumerate(zip(scene.keys, levels, _slots(scene, levels), strict=False)):
            grid, spread, level = self.grids.get(int(number)), self.spreads.get(int(number)), int(shown)
            if spread is not None:
                if level >= len(spread) or spread[level].size // SPREAD * BLOCK_SPLATS != slots:
                    continue
                memory.kept.append(spread[level])
                rows[k, BAKED_SPREAD], rows[k, BAKED_SPREAD_COUNT] = spread[level].ctypes.data, spread[level].size
                level = 0
            if grid is not None:
                frames[k, GRID_MIDDLE : GRID_MIDDLE + 2] = grid.middle
                frames[k, GRID_HALF], frames[k, GRID_EDGE] = grid.half, grid.edge
            frames[k, BAKED_UNIT] = self.unit
            for sign, column in COLUMNS.items():
                records = self.records.get((int(number), sign, level))
                if records is None:
                    continue
                if spread is not None or len(records) == (slots if grid is None else grid.edge**2):
                    memory.kept.append(records)
                    rows[k, column], rows[k, BAKED_COUNT] = records.ctypes.data, len(records)
        memory[:] = rows.tobytes()
        return np.frombuffer(memory, np.int64), frames.reshape(-1)

    def portable(self) -> Kept:
        """This."""
        return self

    def slots_of(self, number: int) -> int:
        """The slots of the model of an instance; or the cells of a plane."""
        spread = self.spreads.get(number)
        return len(self.records[number, 1, 0]) if spread is None else spread[0].size // SPREAD * BLOCK_SPLATS

    @property
    def nbytes(self) -> int:
        """Bytes of the records, and of what spreads them."""
        spreads = {id(spread): sum(blocks.nbytes for blocks in spread) for spread in self.spreads.values()}
        return sum(records.nbytes for records in self.records.values()) + sum(spreads.values())


def _slots(scene: Snapshot, levels: NDArray[np.int64]) -> list[int]:
    """The slots of the tree that each instance shows; 0 for planes."""
    families = [(model, *model.levels) for model in scene.models]
    kinds, shapes = scene.world.instances.reshape(-1, INSTANCE)[:, [KIND, SHAPE_ROW]].astype(int).T
    return [
        families[shape][level].tree.order.size if kind == MODEL else 0
        for kind, shape, level in zip(kinds, shapes, levels, strict=True)
    ]
