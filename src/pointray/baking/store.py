"""From the light of patches to the records that pictures read: 16 bytes a splat or cell, see `shade/baked.py`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import run
from ..kernels.records import RECORD
from .bounces import GRAY, SEES_SKY
from .pack import CHUNK, FOUR, pack
from .patches import AROUND
from .planes import Grid
from .solve import Arrived
from .transport import Side

BRIGHTEST = 32768.0  # in the records' unit: the light that is brightest

EVERY = np.zeros(0, np.int32)


def blend_of(side: Side, level: int) -> tuple[NDArray[np.int32], NDArray[np.float32], int]:
    """What the light of a side's records is blended from, for a level of detail (0: the model), and their number."""
    patches = side.sheet.patches
    if isinstance(patches, Grid):
        return EVERY, EVERY.view(np.float32), side.size
    blend = patches.blends[level]
    return blend.around.reshape(-1), blend.weights.reshape(-1), len(blend.around)


def make_records(side: Side, level: int, arrived: Arrived, unit: float, threads: int | None) -> NDArray[np.int32]:
    """The records of a side, (n, RECORD): of each slot of its model's level, or of each cell of its plane.

    They are read four at a time: black ones fill the last four.
    """
    moments = arrived.facts[side.span, GRAY:SEES_SKY]
    values = np.concatenate([arrived.indirect[side.span], arrived.direct[side.span], moments], axis=1)
    around, weights, n = blend_of(side, level)
    out = np.zeros((-(-n // FOUR) * FOUR, RECORD), np.int32)
    args = around, weights, values.reshape(-1), 1.0 / unit, out[:n].reshape(-1)
    run(pack, -(-n // CHUNK), *args, threads=threads)
    return out


def at_splats(side: Side, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Values of a side's patches, (count, k), at the slots of its model, (n, k)."""
    around, weights, n = blend_of(side, 0)
    around, weights = around.reshape(n, AROUND), weights.reshape(n, AROUND)
    return sum(
        (weights[:, k, None] * values[around[:, k]] for k in range(AROUND)), np.zeros((n, values.shape[1]), np.float32)
    )


def unit_of(arrived: Arrived) -> float:
    """W/m2 of the records' 1.0: the brightest light is then BRIGHTEST."""
    most = max(float(arrived.indirect.max(initial=0.0)), float(arrived.direct.max(initial=0.0)))
    return most / BRIGHTEST if most > 0.0 else 1.0
