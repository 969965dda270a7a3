"""From the light of patches to the records that pictures read: 16 bytes a splat or cell, see `shade/baked.py`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import run
from ..kernels.records import RECORD
from .bounces import BANDS as BAND_FACTS
from .pack import CHUNK, pack
from .patches import AROUND, BLOCK_SPLATS
from .planes import Grid
from .solve import Arrived
from .transport import Side

BRIGHTEST = 32768.0  # in the records' unit: the light that is brightest

EVERY = np.zeros(0, np.int32)


def blend_of(side: Side, level: int) -> tuple[NDArray[np.int32], NDArray[np.uint8], int]:
    """What the light of a side's records is blended from, for a level of detail (0: the model), and their number."""
    patches = side.sheet.patches
    if isinstance(patches, Grid):
        return EVERY, EVERY.view(np.uint8), side.size
    blend = patches.blends[level]
    return blend.around.reshape(-1), blend.weights.reshape(-1), len(blend.weights)


def make_records(side: Side, level: int, arrived: Arrived, unit: float, threads: int | None) -> NDArray[np.int32]:
    """The records of a side, (n, RECORD): of each slot of its model's level, or of each cell of its plane."""
    bands = arrived.facts[side.span, BAND_FACTS : BAND_FACTS + 8]
    values = np.concatenate([arrived.indirect[side.span], arrived.direct[side.span], bands], axis=1)
    around, weights, n = blend_of(side, level)
    out = np.zeros((n, RECORD), np.int32)
    run(pack, -(-n // CHUNK), around, weights, values.reshape(-1), 1.0 / unit, out.reshape(-1), threads=threads)
    return out


def at_splats(side: Side, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Values of a side's patches, (count, k), at the slots of its model, (n, k)."""
    around, weights, n = blend_of(side, 0)
    around = np.repeat(around.reshape(-1, AROUND), BLOCK_SPLATS, axis=0)
    shares = weights.reshape(n, AROUND).astype(np.float32)
    total = sum(shares[:, k, None] * values[around[:, k]] for k in range(AROUND))
    return np.asarray(total / np.maximum(shares.sum(axis=1, keepdims=True), 1.0), np.float32)


def unit_of(arrived: Arrived) -> float:
    """W/m2 of the records' 1.0: the brightest light is then BRIGHTEST."""
    most = max(float(arrived.indirect.max(initial=0.0)), float(arrived.direct.max(initial=0.0)))
    return most / BRIGHTEST if most > 0.0 else 1.0
