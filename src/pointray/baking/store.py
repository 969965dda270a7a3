"""Conversion of patch light to the records that rendering reads, 16 bytes per splat or cell, see `shade/baked.py`.

Also returns the light at a model's splats, from patches or from the records in a file.
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
from .levels import Spread, average_at_knots, blend_over_splats
from .pack import CHUNK, pack
from .patches import AROUND, BLOCK_SPLATS
from .planes import Grid
from .solve import ArrivingLight
from .transport import Side

BRIGHTEST = 32768.0  # the brightest light, in the unit of the records
SKY_STEPS = 65535  # steps of a sky fraction in a file

NO_BLEND = np.zeros(0, np.int32)

Floats = NDArray[np.float32]


class SplatLight(NamedTuple):
    """Light that arrives at one side of a model's splats, in the order of its tree.

    direct, indirect : (n, 3) float32, W/m2; sky : (n,) float32, fraction of the sky visible from the front
    """

    direct: Floats
    indirect: Floats
    sky: Floats


def blend_of(side: Side, level: int) -> tuple[NDArray[np.int32], NDArray[np.uint8], int]:
    """Return patches and weights that a side's records are blended from at a level of detail, and their number."""
    patches = side.surface.patches
    if isinstance(patches, Grid):
        return NO_BLEND, NO_BLEND.view(np.uint8), side.size
    blend = patches.blends[level]
    return blend.around.reshape(-1), blend.weights.reshape(-1), len(blend.weights)


def make_records(
    side: Side, level: int | Spread, arrived: ArrivingLight, unit: float, threads: int | None
) -> NDArray[np.int32]:
    """Return the records of a side, (n, RECORD): for each slot of its model's tree, or for each cell of its plane.

    level : level of detail, 0 for the model; or the spread of coarser light, for records of its knots
    """
    moments = arrived.facts[side.span, GRAY:SEES_SKY]
    values = np.concatenate([arrived.indirect[side.span], arrived.direct[side.span], moments], axis=1)
    if isinstance(level, Spread):
        values = average_at_knots(level, values)
        around, weights, n = NO_BLEND, NO_BLEND.view(np.uint8), len(values)
    else:
        around, weights, n = blend_of(side, level)
    out = np.zeros((n, RECORD), np.int32)
    run(pack, -(-n // CHUNK), around, weights, values.reshape(-1), 1.0 / unit, out.reshape(-1), threads=threads)
    return out


def at_splats(side: Side, values: Floats) -> Floats:
    """Interpolate values of a side's patches, (count, k), to the slots of its model, (n, k)."""
    around, weights, n = blend_of(side, 0)
    around = np.repeat(around.reshape(-1, AROUND), BLOCK_SPLATS, axis=0)
    shares = weights.reshape(n, AROUND).astype(np.float32)
    total = sum(shares[:, k, None] * values[around[:, k]] for k in range(AROUND))
    return np.asarray(total / np.maximum(shares.sum(axis=1, keepdims=True), 1.0), np.float32)


def no_light(n: int) -> SplatLight:
    """Return the light of a back side that is black."""
    return SplatLight(np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32), np.zeros(n, np.float32))


def from_patches(side: Side, arrived: ArrivingLight) -> SplatLight:
    """Return the light that arrives at the splats of a side's model."""
    sky = arrived.facts[side.span, SEES_SKY : SEES_SKY + 1]
    out = at_splats(side, np.concatenate([arrived.direct[side.span], arrived.indirect[side.span], sky], axis=1))
    return SplatLight(out[:, :3], out[:, 3:6], out[:, 6])


def from_records(
    records: NDArray[np.int32], unit: float, sky: NDArray[np.uint16], blocks: NDArray[np.int32] | None
) -> SplatLight:
    """Return the light at a model's splats from its records, accurate to 1/256 of the brightest channel.

    sky : see `sky_visibility`; blocks : the spread of coarser light, or None
    """
    unpack = cast(Any, uncompiled(unpack_rgbe))
    codes = [np.stack(unpack(records[:, k]), axis=1) for k in (DIRECT, INDIRECT)]
    direct, indirect = (np.multiply(code, unit, dtype=np.float64).astype(np.float32) for code in codes)
    seen = sky.astype(np.float32) / np.float32(SKY_STEPS)
    if blocks is not None:
        parts = blend_over_splats(blocks, np.concatenate([direct, indirect, seen[:, None]], axis=1))
        direct, indirect, seen = parts[:, :3], parts[:, 3:6], parts[:, 6]
    return SplatLight(direct, indirect, seen)


def sky_visibility(
    sides: dict[tuple[int, int], Side], arrived: ArrivingLight, spreads: dict[int, Spread]
) -> dict[int, NDArray[np.uint16]]:
    """Return the fraction of the sky visible from the front of each model's splats, or knots, by instance number.

    Fractions are in units of 1 / SKY_STEPS, as in a file. sides : by instance number and sign
    """

    def seen(side: Side, spread: Spread | None) -> Floats:
        if spread is None:
            return from_patches(side, arrived).sky
        return average_at_knots(spread, arrived.facts[side.span, SEES_SKY : SEES_SKY + 1])[:, 0]

    shares = {
        number: seen(side, spreads.get(number))
        for (number, sign), side in sides.items()
        if sign > 0 and not isinstance(side.surface.patches, Grid)
    }
    return {number: np.rint(np.clip(sky, 0.0, 1.0) * SKY_STEPS).astype(np.uint16) for number, sky in shares.items()}


def at_points(model: Model, values: Floats) -> Floats:
    """Return values at the points of a model, given those at its slots; NaN at points without a splat."""
    used = model.tree.order >= 0
    out = np.full((len(model.points), *values.shape[1:]), np.nan, np.float32)
    out[model.tree.order[used]] = values[used]
    return out


def choose_unit(arrived: ArrivingLight) -> float:
    """Return W/m2 per 1.0 of the records, so that the brightest light is BRIGHTEST."""
    most = max(float(arrived.indirect.max(initial=0.0)), float(arrived.direct.max(initial=0.0)))
    return most / BRIGHTEST if most > 0.0 else 1.0
