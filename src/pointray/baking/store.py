"""From the light of patches to the records that pictures read: 16 bytes a splat or cell, see `shade/baked.py`.

And to what arrives at a model's splats: from patches, or from what a file keeps, the records.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..engine.jit import run, uncompiled
from ..engine.kernels.records import DIRECT, INDIRECT, RECORD
from ..model.model import Model
from ..shade.rgbe import unpack_rgbe
from .bounces import GRAY, SEES_SKY
from .levels import Spread, at_knots, over_splats
from .pack import CHUNK, pack
from .patches import AROUND, BLOCK_SPLATS
from .planes import Grid
from .solve import Arrived
from .transport import Side

BRIGHTEST = 32768.0  # in the records' unit: the light that is brightest
SKY_STEPS = 65535  # of a share of the sky: what a file counts it in

EVERY = np.zeros(0, np.int32)

Floats = NDArray[np.float32]


class AtSplats(NamedTuple):
    """What arrives at one side of a model's splats, in the order of its tree.

    direct, indirect : (n, 3) float32, W/m2; sky : (n,) float32, the share of the sky that the front sees
    """

    direct: Floats
    indirect: Floats
    sky: Floats


def blend_of(side: Side, level: int) -> tuple[NDArray[np.int32], NDArray[np.uint8], int]:
    """What the light of a side's records is blended from, for a level of detail (0: the model), and their number."""
    patches = side.sheet.patches
    if isinstance(patches, Grid):
        return EVERY, EVERY.view(np.uint8), side.size
    blend = patches.blends[level]
    return blend.around.reshape(-1), blend.weights.reshape(-1), len(blend.weights)


def make_records(
    side: Side, level: int | Spread, arrived: Arrived, unit: float, threads: int | None
) -> NDArray[np.int32]:
    """The records of a side, (n, RECORD): of each slot of its model's level of detail, or of each cell of its plane.

    level : of detail; or the spread of coarser light, of whose knots the records are
    """
    moments = arrived.facts[side.span, GRAY:SEES_SKY]
    values = np.concatenate([arrived.indirect[side.span], arrived.direct[side.span], moments], axis=1)
    if isinstance(level, Spread):
        values = at_knots(level, values)
        around, weights, n = EVERY, EVERY.view(np.uint8), len(values)
    else:
        around, weights, n = blend_of(side, level)
    out = np.zeros((n, RECORD), np.int32)
    run(pack, -(-n // CHUNK), around, weights, values.reshape(-1), 1.0 / unit, out.reshape(-1), threads=threads)
    return out


def at_splats(side: Side, values: Floats) -> Floats:
    """Values of a side's patches, (count, k), at the slots of its model, (n, k)."""
    around, weights, n = blend_of(side, 0)
    around = np.repeat(around.reshape(-1, AROUND), BLOCK_SPLATS, axis=0)
    shares = weights.reshape(n, AROUND).astype(np.float32)
    total = sum(shares[:, k, None] * values[around[:, k]] for k in range(AROUND))
    return np.asarray(total / np.maximum(shares.sum(axis=1, keepdims=True), 1.0), np.float32)


def dark(n: int) -> AtSplats:
    """What arrives at a back that is kept as black."""
    return AtSplats(np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32), np.zeros(n, np.float32))


def from_patches(side: Side, arrived: Arrived) -> AtSplats:
    """What arrives at the splats of a side's model."""
    sky = arrived.facts[side.span, SEES_SKY : SEES_SKY + 1]
    out = at_splats(side, np.concatenate([arrived.direct[side.span], arrived.indirect[side.span], sky], axis=1))
    return AtSplats(out[:, :3], out[:, 3:6], out[:, 6])


def from_records(
    records: NDArray[np.int32], unit: float, sky: NDArray[np.uint16], blocks: NDArray[np.int32] | None
) -> AtSplats:
    """The same from a model's records, to a 256th of the brightest channel.

    sky : see `seen_skies`; blocks : what spreads coarser light over the splats
    """
    unpack = cast(Any, uncompiled(unpack_rgbe))
    codes = [np.stack(unpack(records[:, k]), axis=1) for k in (DIRECT, INDIRECT)]
    direct, indirect = (np.multiply(code, unit, dtype=np.float64).astype(np.float32) for code in codes)
    seen = sky.astype(np.float32) / np.float32(SKY_STEPS)
    if blocks is not None:
        parts = over_splats(blocks, np.concatenate([direct, indirect, seen[:, None]], axis=1))
        direct, indirect, seen = parts[:, :3], parts[:, 3:6], parts[:, 6]
    return AtSplats(direct, indirect, seen)


def seen_skies(
    sides: dict[tuple[int, int], Side], arrived: Arrived, spreads: dict[int, Spread]
) -> dict[int, NDArray[np.uint16]]:
    """The share of the sky that the splats, or knots, of each model see on its front, by the number of the instance.

    It is counted in SKY_STEPS, as a file keeps it. sides : by the numbers of instances and their signs
    """

    def seen(side: Side, spread: Spread | None) -> Floats:
        if spread is None:
            return from_patches(side, arrived).sky
        return at_knots(spread, arrived.facts[side.span, SEES_SKY : SEES_SKY + 1])[:, 0]

    shares = {
        number: seen(side, spreads.get(number))
        for (number, sign), side in sides.items()
        if sign > 0 and not isinstance(side.sheet.patches, Grid)
    }
    return {number: np.rint(np.clip(sky, 0.0, 1.0) * SKY_STEPS).astype(np.uint16) for number, sky in shares.items()}


def at_points(model: Model, values: Floats) -> Floats:
    """Values at the slots of a model at its points; NaN at points that have no splat."""
    used = model.tree.order >= 0
    out = np.full((len(model.points), *values.shape[1:]), np.nan, np.float32)
    out[model.tree.order[used]] = values[used]
    return out


def unit_of(arrived: Arrived) -> float:
    """W/m2 of the records' 1.0: the brightest light is then BRIGHTEST."""
    most = max(float(arrived.indirect.max(initial=0.0)), float(arrived.direct.max(initial=0.0)))
    return most / BRIGHTEST if most > 0.0 else 1.0
