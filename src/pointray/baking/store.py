"""Conversion of patch light to the records that rendering reads, 16 bytes per splat or cell, see `shade/baked.py`.

Also returns the light at a model's splats, from patches or from the records in a file.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Floats
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


class SplatLight(NamedTuple):
    """Light that arrives at one side of a model's n splats, in the order of its tree.

    direct, indirect : (n, 3) float32, W/m2, from lights; from surfaces and the sky
    sky : (n,) float32, fraction of the sky visible from the front
    """

    direct: Floats
    indirect: Floats
    sky: Floats


def blend_of(side: Side, level: int) -> tuple[NDArray[np.int32], NDArray[np.uint8], int]:
    """Return how the light of a side's patches is interpolated to its splats: (patches, weights, number of splats).

    patches : flat, for each block of splats the indices of AROUND patches; empty for a plane
    weights : flat, for each splat the AROUND weights of these patches; empty for a plane
    number of splats : for a plane that of its cells, which are the patches themselves

    level : level of detail of the model, 0 for the model itself
    """
    patches = side.surface.patches
    if isinstance(patches, Grid):
        return NO_BLEND, NO_BLEND.view(np.uint8), side.size
    blend = patches.blends[level]
    return blend.around.reshape(-1), blend.weights.reshape(-1), len(blend.weights)


def make_records(
    side: Side, level: int | Spread, arrived: ArrivingLight, unit: float, threads: int | None
) -> NDArray[np.int32]:
    """Encode the light of a side of an instance as 16-byte records, (n, RECORD) int32.

    There is one for each splat in the order of the model's tree, for each cell of a plane, or fewer for coarser light.

    level : level of detail, 0 for the model itself; or the interpolation of coarser light, for its records
    arrived : light at all patches; unit : W/m2 of irradiance 1.0 in a record
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
    """Interpolate values of the patches of an instance's side, (size, k), to the splats of its model, (n, k)."""
    around, weights, n = blend_of(side, 0)
    around = np.repeat(around.reshape(-1, AROUND), BLOCK_SPLATS, axis=0)
    shares = weights.reshape(n, AROUND).astype(np.float32)
    total = sum(shares[:, k, None] * values[around[:, k]] for k in range(AROUND))
    return np.asarray(total / np.maximum(shares.sum(axis=1, keepdims=True), 1.0), np.float32)


def no_light(n: int) -> SplatLight:
    """Return zero light at n splats: that of a back side which was not baked because it is nearly dark."""
    return SplatLight(np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32), np.zeros(n, np.float32))


def from_patches(side: Side, arrived: ArrivingLight) -> SplatLight:
    """Interpolate the light at the patches of an instance's side to the splats of its model, in their order."""
    sky = arrived.facts[side.span, SEES_SKY : SEES_SKY + 1]
    out = at_splats(side, np.concatenate([arrived.direct[side.span], arrived.indirect[side.span], sky], axis=1))
    return SplatLight(out[:, :3], out[:, 3:6], out[:, 6])


def from_records(
    records: NDArray[np.int32], unit: float, sky: NDArray[np.uint16], blocks: NDArray[np.int32] | None
) -> SplatLight:
    """Decode the light at a model's splats from its 16-byte records, accurate to 1/256 of the brightest channel.

    unit : W/m2 of irradiance 1.0 in a record; sky : (records,), visible fraction of the sky in 65535ths
    blocks : (blocks * SPREAD,), interpolation of coarser light to the splats; None for a record per splat
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
    """Return the fraction of the sky visible from the front of each model's splats, by instance number.

    Values are uint16 in 65535ths, as in a file: one for each splat in the tree's order, or for each record of coarser
    light.

    sides : sides that receive light, by instance number and sign; spreads : interpolation of coarser light
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
    """Reorder values of splats, (slots, ...) in the tree's order, to the order of the model's points, (n, ...).

    NaN at points without a splat.
    """
    used = model.tree.order >= 0
    out = np.full((len(model.points), *values.shape[1:]), np.nan, np.float32)
    out[model.tree.order[used]] = values[used]
    return out


def choose_unit(arrived: ArrivingLight) -> float:
    """Return the irradiance in W/m2 of 1.0 in a light record, so that the brightest light is stored as BRIGHTEST.

    arrived : light at all patches
    """
    most = max(float(arrived.indirect.max(initial=0.0)), float(arrived.direct.max(initial=0.0)))
    return most / BRIGHTEST if most > 0.0 else 1.0
