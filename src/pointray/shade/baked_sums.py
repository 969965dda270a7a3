"""Blending of baked light from records, at four points at once.

A record holds indirect and direct irradiance (`rgbe.py`) and the moments of the indirect light (`baked_code.py`).
Records are read in groups of four: a block of splats, or four consecutive cells of a plane. `Scratch.near` lists the
groups; `Scratch.splats` holds 16 weights a group, lane 4 r + j for record j at point r. Sums go to `Scratch.part`: the
weights at point r to SUM_WEIGHTS + 4 r, others as `_store` writes them.
"""

from __future__ import annotations

from typing import TypeAlias

from ..engine.jit import Array, f32, f64, i64, inline
from ..engine.kernels import records as rec, scratch as sc
from ..engine.kernels.scratch import Scratch, store3
from ..engine.kernels.vec import add, scale
from ..engine.simd import F16, ZERO, broadcast16, columns, load16_int, repeat4, store, sums_of_fours
from .baked_code import COLORS, MOMENTS_OF_GRAY, REACH_1, REACH_2, REACH_COLOR, unpack_moments
from .rgbe import unpack_four

Sums: TypeAlias = tuple[F16, F16, F16, F16]  # of four points
FOUR = 4 * rec.RECORD  # length of a group of records
ONE_SHARE = f32(1.0 / 255.0)  # see `records.SPREAD_SHARES`
# Offsets of the sums: four vectors of moments, indirect irradiance, direct irradiance, weights.
SUM_MOMENTS, SUM_LIGHT, SUM_DIRECT, SUM_WEIGHTS = 0, 4 * sc.LANES, 5 * sc.LANES, 6 * sc.LANES


@inline
def list_record(four: int, r: int, k: int, share: float, scratch: Scratch) -> None:
    """Add `share` to the weight of a light record at one of the four surface points that are looked up at once.

    The weight is kept in `Scratch.splats`. `Scratch.near` lists the needed records in groups of four consecutive ones;
    the record's group is appended if it is not yet listed.

    four : index of the group; k : index of the record in the group, 0 to 3
    r : index of the point, 0 to 3
    """
    count, at = scratch.counts[sc.COUNT_NEAR], 0
    while at < count and i64(scratch.near[at]) != four:  # neighbours on a plane mostly share their cells
        at += 1
    if at == count:
        scratch.near[count] = four
        store(scratch.splats, count * sc.LANES, broadcast16(ZERO))
        scratch.counts[sc.COUNT_NEAR] = count + 1
    scratch.splats[at * sc.LANES + 4 * r + k] += f32(share)


@inline
def spread_out(spread: Array, scratch: Scratch) -> None:
    """Replace the weights of splats (`Scratch.splats`) by those of the light records from which each is interpolated.

    This is for coarser light, which has fewer records than splats.

    spread : for each block four records and their weights, see `records.SPREAD`
    """
    blocks, splats, count = scratch.listed, scratch.splats, scratch.counts[sc.COUNT_NEAR]
    kept = splats.size - count * sc.LANES  # the buffer holds four times as many, plus these
    for m in range(count):
        blocks[m] = scratch.near[m]
        for lane in range(sc.LANES):
            splats[kept + m * sc.LANES + lane] = splats[m * sc.LANES + lane]
    scratch.counts[sc.COUNT_NEAR] = 0
    for m in range(count):
        at, weights = i64(blocks[m]) * rec.SPREAD, kept + m * sc.LANES
        for k in range(4):
            record = i64(spread[at + rec.SPREAD_RECORDS + k])
            for r in range(4):
                share = ZERO
                for j in range(4):
                    part = (i64(spread[at + rec.SPREAD_SHARES + j]) >> (8 * k)) & 255
                    share += splats[weights + 4 * r + j] * f32(part)
                if share > ZERO:
                    list_record(record // 4, r, record % 4, share * ONE_SHARE, scratch)


@inline
def _add(sums: Sums, value: F16, weights: Array, at: int) -> Sums:
    """Add the values of four light records, times their weights at four surface points, to the sums of these points.

    sums : one vector for each point, laid out like `value`
    value : a quarter of the vector for each component, such as red, with a lane for each record
    weights : from index `at` 16 weights, for each point those of the four records
    """
    return (
        sums[0] + value * repeat4(weights, at),
        sums[1] + value * repeat4(weights, at + 4),
        sums[2] + value * repeat4(weights, at + 8),
        sums[3] + value * repeat4(weights, at + 12),
    )


@inline
def _store(to: int, sums: Sums, scratch: Scratch) -> None:
    """Store the sums of four surface points in `Scratch.part`: component q at point r at index `to` + 4 q + r.

    sums : one vector for each point, with a quarter for each component, whose four lanes are added up
    """
    store(scratch.part, to, sums_of_fours(sums[0], sums[1], sums[2], sums[3]))


@inline
def sum_light(records: Array, column: int, to: int, scratch: Scratch) -> None:
    """Sum the irradiance of the light records listed in `Scratch.near`, weighted for each of four surface points.

    records : all light records of one side of an instance, flat int32
    column : which irradiance of a record, INDIRECT or DIRECT
    to : index in `Scratch.part` at which the sums are stored: red at the four points, green, blue
    """
    zero = broadcast16(ZERO)
    sums = zero, zero, zero, zero
    for k in range(scratch.counts[sc.COUNT_NEAR]):
        words = columns(load16_int(records, i64(scratch.near[k]) * FOUR))
        light = unpack_four(words[rec.INDIRECT] if column == rec.INDIRECT else words[rec.DIRECT])
        sums = _add(sums, light, scratch.splats, k * sc.LANES)
    _store(to, sums, scratch)


@inline
def sum_moments(records: Array, scratch: Scratch) -> None:
    """Sum the indirect irradiance and its spherical harmonics over light records, weighted for four surface points.

    `Scratch.near` lists the records. The sums are stored in `Scratch.part`, from SUM_LIGHT and SUM_MOMENTS.

    records : flat int32
    """
    zero = broadcast16(ZERO)
    sums = a = b = c = d = (zero, zero, zero, zero)
    for k in range(scratch.counts[sc.COUNT_NEAR]):
        words, at = columns(load16_int(records, i64(scratch.near[k]) * FOUR)), k * sc.LANES
        light = unpack_four(words[rec.INDIRECT])
        values = unpack_moments(light, words[rec.MOMENTS], words[rec.MOMENTS + 1])
        sums = _add(sums, light, scratch.splats, at)
        a, b = _add(a, values[0], scratch.splats, at), _add(b, values[1], scratch.splats, at)
        c, d = _add(c, values[2], scratch.splats, at), _add(d, values[3], scratch.splats, at)
    _store(SUM_LIGHT, sums, scratch)
    _store(SUM_MOMENTS, a, scratch)
    _store(SUM_MOMENTS + sc.LANES, b, scratch)
    _store(SUM_MOMENTS + 2 * sc.LANES, c, scratch)
    _store(SUM_MOMENTS + 3 * sc.LANES, d, scratch)


@inline
def store_light(i: int, r: int, unit_of: float, also_direct: bool, scratch: Scratch) -> None:
    """Store the irradiance at surface point i of the tile: the weighted sum of light records, divided by the weights.

    The result is in rows ARRIVING of the scratch.

    r : which of the four points in `Scratch.part` this is, 0 to 3
    unit_of : irradiance of 1.0 in a record, W/m2
    also_direct : whether to add the direct light
    """
    part = scratch.part
    share = unit_of / f64(part[SUM_WEIGHTS + 4 * r])
    light = f64(part[SUM_LIGHT + r]), f64(part[SUM_LIGHT + 4 + r]), f64(part[SUM_LIGHT + 8 + r])
    if also_direct:
        direct = f64(part[SUM_DIRECT + r]), f64(part[SUM_DIRECT + 4 + r]), f64(part[SUM_DIRECT + 8 + r])
        light = add(light, direct)
    store3(scratch.shading_points, sc.ARRIVING + i, scale(light, share))


@inline
def store_moments(i: int, r: int, unit_of: float, scratch: Scratch) -> None:
    """Store the spherical harmonics of the light at surface point i of the tile: a weighted mean of light records.

    The result is in rows ARRIVING_MOMENTS and ARRIVING_COLORS of the scratch.

    r : which of the four points in `Scratch.part` this is, 0 to 3
    unit_of : irradiance of 1.0 in a record, W/m2
    """
    part, points, at = scratch.part, scratch.shading_points, SUM_MOMENTS + r
    share = unit_of / f64(part[SUM_WEIGHTS + 4 * r])
    for k in range(MOMENTS_OF_GRAY):
        points[sc.ARRIVING_MOMENTS + k * sc.TILE + i] = f64(part[at + 4 * k]) * share * (REACH_1 if k < 3 else REACH_2)
    for c in range(2):
        for k in range(COLORS):
            value = f64(part[at + (2 + c) * sc.LANES + 4 * k]) * share * REACH_COLOR
            points[sc.ARRIVING_COLORS + (COLORS * c + k) * sc.TILE + i] = value
