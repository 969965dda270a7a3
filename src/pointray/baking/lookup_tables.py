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
    """Memory of a table of array addresses; `kept` keeps the arrays alive as long as the table."""

    kept: list[NDArray[np.int32]]


class LightTables(NamedTuple):
    """Baked light as rendering reads it, by instance number.

    unit : irradiance of 1.0 in a record, in W/m2
    records : (n, RECORD) int32 by instance number, sign (1 front, -1 back) and level of detail (0 for the model itself,
        or for a plane): one record for each splat in the tree's order, for each cell of a plane's grid, or fewer in
        coarser light
    grids : the cells of planes
    spreads : interpolation of coarser light, for the model and each level of detail, see `levels.Spread.blocks`;
        instances of a model share them
    levels : coarseness of the light of each instance of a model: 0 is a record per splat, k one per 4^(k - 1) patches
    """

    unit: float
    records: dict[tuple[int, int, int], NDArray[np.int32]]
    grids: dict[int, Grid]
    spreads: dict[int, tuple[NDArray[np.int32], ...]]
    levels: dict[int, int]

    def tables(self, scene: Snapshot, levels: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the arrays through which kernels read the light.

        A model that is not the one that was baked renders black: its splats have no records.

        levels : (instances,), the level of detail that each instance shows

        Returns
        -------
        (instances * 5,) int64
            For each instance (address of the light records of its front, of its back, number of records of a side,
            address and length of the table that interpolates coarser light); valid while this array exists.
        (instances * 5,) float64
            For each instance the grid of a plane, and the unit of the stored irradiance, see `records.BAKED_FRAME`.
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
        """Return this object, which can be pickled. `Baked` has the same method: a scene may hold either."""
        return self

    def slots_of(self, number: int) -> int:
        """Return the number of splats of an instance's model, unused slots included, or of cells of a plane.

        number : of the instance
        """
        spread = self.spreads.get(number)
        return len(self.records[number, 1, 0]) if spread is None else spread[0].size // rec.SPREAD * BLOCK_SPLATS

    @property
    def nbytes(self) -> int:
        """Size in bytes of the light records and of the interpolation tables of coarser light."""
        spreads = {id(spread): sum(blocks.nbytes for blocks in spread) for spread in self.spreads.values()}
        return sum(records.nbytes for records in self.records.values()) + sum(spreads.values())


def _slots(scene: Snapshot, levels: NDArray[np.int64]) -> list[int]:
    """Return the number of splats, unused slots of blocks included, of the tree that each instance shows; 0 for planes.

    levels : (instances,), the level of detail that each instance shows
    """
    families = [(model, *model.levels) for model in scene.models]
    kinds, shapes = scene.world.instances.reshape(-1, rec.INSTANCE)[:, [rec.KIND, rec.SHAPE_ROW]].astype(int).T
    return [
        families[shape][level].tree.order.size if kind == rec.MODEL else 0
        for kind, shape, level in zip(kinds, shapes, levels, strict=True)
    ]
