"""Tables through which kernels read baked light."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.jit import Array
from ..engine.kernels import records as rec
from ..scene.world import Snapshot
from .patches import BLOCK_SPLATS
from .planes import Grid

COLUMNS = {1: rec.BAKED_FRONT, -1: rec.BAKED_BACK}  # by the sign of a side


class _Addresses(bytearray):
    """Memory of a table of addresses, which keeps the arrays they point to alive."""

    kept: list[NDArray[np.int32]]


class LightTables(NamedTuple):
    """Light of all sides of instances, by instance number. Sides are in the order of the instances.

    unit : W/m2 per 1.0 of the records
    records : (n, RECORD) int32 by instance number, sign and level of detail (0 for the model itself, or for a plane):
        of each slot of the tree, or of each cell of a plane's grid; for coarser light, of its knots
    grids : of planes
    spreads : of instances with coarser light, see `levels.Spread.blocks`; instances of a model share them
    levels : level of the light of each instance of a model, see `levels`; 0 is a record per splat
    """

    unit: float
    records: dict[tuple[int, int, int], NDArray[np.int32]]
    grids: dict[int, Grid]
    spreads: dict[int, tuple[NDArray[np.int32], ...]]
    levels: dict[int, int]

    def tables(self, scene: Snapshot, levels: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the tables that kernels read, see `records.BAKED`.

        levels : (instances,), the level of detail that each instance shows

        A model that is not the one that was baked renders black: its splats have no records.
        """
        rows, frames = np.zeros((len(levels), rec.BAKED), np.int64), np.zeros((len(levels), rec.BAKED_FRAME))
        memory = _Addresses(rows.nbytes)
        memory.kept = []
        for k, (number, shown, slots) in enumerate(zip(scene.keys, levels, _slots(scene, levels), strict=False)):
            grid, spread, level = self.grids.get(int(number)), self.spreads.get(int(number)), int(shown)
            if spread is not None:
                if level >= len(spread) or spread[level].size // rec.SPREAD * BLOCK_SPLATS != slots:
                    continue
                memory.kept.append(spread[level])
                rows[k, rec.BAKED_SPREAD], rows[k, rec.BAKED_SPREAD_COUNT] = (
                    spread[level].ctypes.data,
                    spread[level].size,
                )
                level = 0
            if grid is not None:
                frames[k, rec.GRID_MIDDLE : rec.GRID_MIDDLE + 2] = grid.middle
                frames[k, rec.GRID_HALF], frames[k, rec.GRID_EDGE] = grid.half, grid.edge
            frames[k, rec.BAKED_UNIT] = self.unit
            for sign, column in COLUMNS.items():
                records = self.records.get((int(number), sign, level))
                if records is None:
                    continue
                if spread is not None or len(records) == (slots if grid is None else grid.edge**2):
                    memory.kept.append(records)
                    rows[k, column], rows[k, rec.BAKED_COUNT] = records.ctypes.data, len(records)
        memory[:] = rows.tobytes()
        return np.frombuffer(memory, np.int64), frames.reshape(-1)

    def portable(self) -> LightTables:
        """Return this object."""
        return self

    def slots_of(self, number: int) -> int:
        """Return the number of slots of an instance's model, or of cells of a plane."""
        spread = self.spreads.get(number)
        return len(self.records[number, 1, 0]) if spread is None else spread[0].size // rec.SPREAD * BLOCK_SPLATS

    @property
    def nbytes(self) -> int:
        """Size in bytes of the records and spreads."""
        spreads = {id(spread): sum(blocks.nbytes for blocks in spread) for spread in self.spreads.values()}
        return sum(records.nbytes for records in self.records.values()) + sum(spreads.values())


def _slots(scene: Snapshot, levels: NDArray[np.int64]) -> list[int]:
    """Return the number of slots of the tree that each instance shows; 0 for planes."""
    families = [(model, *model.levels) for model in scene.models]
    kinds, shapes = scene.world.instances.reshape(-1, rec.INSTANCE)[:, [rec.KIND, rec.SHAPE_ROW]].astype(int).T
    return [
        families[shape][level].tree.order.size if kind == rec.MODEL else 0
        for kind, shape, level in zip(kinds, shapes, levels, strict=True)
    ]
