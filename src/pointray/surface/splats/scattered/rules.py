"""Rules for surface points: thresholds on the planes around a point at four scales, and votes of neighbours.

Each measurement is compared as its median over the point and its 8 nearest neighbours, except for the point's own
distance from the planes. Thicknesses and distances are in spacings, see `SPACING`. docs/scatter.md describes how the
thresholds were found and their error rates.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Floats
from ....cloud.normals.fit_batch import Triple, inner, zeros
from ....engine.jit import Array, borrow, f32, inline, kernel, next_tile, run
from ....engine.simd import F16, ONE, ZERO, Mask, gather16, load16, select, store, vabs, vmax, vmin
from ..local_planes import CHUNK, LANES, Xyz, difference, gather_triple, load_triple

Four: TypeAlias = tuple[Array, Array, Array, Array]  # one array per scale
Nine: TypeAlias = tuple[F16, F16, F16, F16, F16, F16, F16, F16, F16]


class Limits(NamedTuple):
    """Thresholds for a point to count as surface, on its neighbours at one scale and the plane fitted to them.

    bend : upper limit of the mean squared sine between the normals of neighbouring planes
    thickness : upper limit of the standard deviation of the neighbours from the plane, in spacings
    offset : upper limit of the distance of the point from the plane, in spacings
    slimness : lower limit of the ratio of the neighbours' second largest variance to their largest, 0 on a line
    """

    bend: float
    thickness: float
    offset: float
    slimness: float


AROUND = 9  # a point and its nearest neighbours, over which medians are taken
VOTERS = 16  # neighbours that vote
SPACING = f32(math.sqrt(math.pi / 8))  # spacing of a regular surface over the distance of the 8th neighbour
NEAR = Limits(0.22, 0.42, 0.7, 0.2)  # of the 8 nearest neighbours
WIDE = Limits(0.15, 0.72, 1.0, 0.27)  # of the 16 nearest neighbours
COARSE = Limits(0.2, 0.55, 1.2, 0.27)  # of every 4th point
COARSEST = Limits(0.2, 0.52, 0.9, 0.27)  # of every 16th point
LINE_COARSE, LINE_COARSEST = 0.2, 0.34  # limits of thickness where the fine scales are too slim: a surface's scan lines
LINE_GAP = 1.9  # reach of every 4th point over that of 16 neighbours, above which lines are wires, not scan lines
STRIP_GAP, STRIP_SLIMNESS, STRIP_COARSE, STRIP_COARSEST = 2.0, 0.42, 0.3, 0.5  # a few wires side by side
ALONE, ALONE_OFF = 1.35, 0.42  # points that are alone: own spacing, and distance from both fine planes, in spacings
ALONE_BOTH = 1.2  # least product of the first, less 1, and the second
KEEP, LOSE = 10, 7  # of 16 neighbours: with at least KEEP surface points a point becomes surface, below LOSE scattered


class Evidence(NamedTuple):
    """Measurements of n points at four scales, from which `judge` finds the points on a surface; (n,) float32 each.

    The scales are the 8 and the 16 nearest neighbours, and every 4th and every 16th point in kd order. At each, planes
    are fitted to the neighbours. The first four fields hold an array for each scale, in this order.

    bends : mean squared sine between the normals of neighbouring planes
    thicknesses : standard deviation of the neighbours from the plane
    slimnesses : second largest variance of the neighbours over the largest, 0 on a line
    offsets : signed distance of the point from the plane, at the coarse scales from that of its part of the kd order
    coarse, coarsest : x, y and z of the planes' normals at the two coarse scales
    reaches : distance of the farthest of the 8 nearest, of the 16 nearest, and of the neighbours among every 4th point
    """

    bends: tuple[Floats, ...]
    thicknesses: tuple[Floats, ...]
    slimnesses: tuple[Floats, ...]
    offsets: tuple[Floats, ...]
    coarse: tuple[Floats, ...]
    coarsest: tuple[Floats, ...]
    reaches: tuple[Floats, ...]


@inline
def _order(a: F16, b: F16) -> tuple[F16, F16]:
    return vmin(a, b), vmax(a, b)


@inline
def _middle(v: Nine) -> F16:
    """Return the median of nine numbers in each lane, with 19 exchanges (Paeth 1990)."""
    a, b, c, d, e, f, g, h, i = v
    (b, c), (e, f), (h, i) = _order(b, c), _order(e, f), _order(h, i)
    (a, b), (d, e), (g, h) = _order(a, b), _order(d, e), _order(g, h)
    (b, c), (e, f), (h, i) = _order(b, c), _order(e, f), _order(h, i)
    d, f = vmax(a, d), vmin(f, i)
    e, h = _order(e, h)
    g, e, c = vmax(d, g), vmax(b, e), vmin(c, f)
    e = vmin(e, h)
    e, c = _order(e, c)
    return vmin(vmax(g, e), c)


@inline
def _median(values: Array, near: Array, start: int, width: int) -> F16:
    """Return the median of values over each of 16 points and its 8 nearest neighbours.

    near : flat, `width` rows for each point: the point, then its neighbours; start : where the 16 points begin in it
    """
    return _middle(
        (
            gather16(values, near, start, width),
            gather16(values, near, start + 1, width),
            gather16(values, near, start + 2, width),
            gather16(values, near, start + 3, width),
            gather16(values, near, start + 4, width),
            gather16(values, near, start + 5, width),
            gather16(values, near, start + 6, width),
            gather16(values, near, start + 7, width),
            gather16(values, near, start + 8, width),
        )
    )


@inline
def _off(xyz: Xyz, normals: Xyz, offsets: Array, own: Triple, near: Array, start: int, width: int) -> F16:
    """Return the distances of 16 points from a plane that belongs to one neighbour each.

    xyz, normals, offsets : of all points: position, normal of a plane near it, and signed distance from that plane
    own : positions of the 16 points; near : flat rows of neighbours, `width` for each point
    start : index in `near` of the first point's neighbour
    """
    away = difference(own, gather_triple(xyz, near, start, width))
    return vabs(inner(away, gather_triple(normals, near, start, width)) + gather16(offsets, near, start, width))


@inline
def _median_off(xyz: Xyz, normals: Xyz, offsets: Array, at: int, near: Array, width: int) -> F16:
    """Return the median distances of 16 points from the planes that belong to them and to their 8 nearest neighbours.

    xyz, normals, offsets : of all points: position, normal of a plane near it, and signed distance from that plane
    at : first of the 16 points; near : flat, `width` rows for each point: the point, then its neighbours
    """
    own, start = load_triple(xyz, at), at * width
    return _middle(
        (
            _off(xyz, normals, offsets, own, near, start, width),
            _off(xyz, normals, offsets, own, near, start + 1, width),
            _off(xyz, normals, offsets, own, near, start + 2, width),
            _off(xyz, normals, offsets, own, near, start + 3, width),
            _off(xyz, normals, offsets, own, near, start + 4, width),
            _off(xyz, normals, offsets, own, near, start + 5, width),
            _off(xyz, normals, offsets, own, near, start + 6, width),
            _off(xyz, normals, offsets, own, near, start + 7, width),
            _off(xyz, normals, offsets, own, near, start + 8, width),
        )
    )


@inline
def _within(limits: Limits, bend: F16, thickness: F16, offset: F16, spacing: F16) -> Mask:
    """Return for which of 16 points the neighbourhood is thin and smooth, and the plane fitted to it is close.

    limits : upper limits of the next three
    bend : mean squared sine between the normals of neighbouring planes
    thickness : standard deviation of the neighbours from the plane
    offset : distance of the point from the plane
    spacing : local distance of points, in which thickness and offset are limited
    """
    thin = thickness < limits.thickness * spacing
    return (bend < limits.bend) & thin & (offset < limits.offset * spacing)


@kernel
def _judge(
    work: Array,
    xyz: Xyz,
    near: Array,
    width: int,
    scales: tuple[Four, Four, Four, Four],
    normals: tuple[Xyz, Xyz],
    reaches: Xyz,
    out: tuple[Array, Array],
) -> None:
    """Write whether each point is on a surface, and whether it is isolated from its neighbours, 1 or 0.

    xyz : x, y and z of n points; near : flat, `width` rows for each point: the point, then its neighbours
    scales : four properties of planes fitted at four scales, an array for each scale, finest first:
        mean squared sine between the normals of neighbouring planes
        standard deviation of the neighbours from the plane
        second largest variance of the neighbours over the largest
        signed distance of the point from the plane
    normals : of the planes at the two coarse scales
    reaches : distances of the farthest neighbours at the three finest scales
    out : outputs, (n,) for both results
    """
    xyz, near, scales, normals, reaches = borrow(xyz), borrow(near), borrow(scales), borrow(normals), borrow(reaches)
    (bends, thicknesses, slimnesses, offsets), (surface, alone) = scales, borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for begin in range(tile * CHUNK, min((tile + 1) * CHUNK, len(surface)), LANES):
            at = min(begin, len(surface) - LANES)
            start, yes, no = at * width, zeros() + ONE, zeros()
            spacing = SPACING * _median(reaches[0], near, start, width)
            wide, far = _median(reaches[1], near, start, width), _median(reaches[2], near, start, width)
            coarse = _median(thicknesses[2], near, start, width)
            coarsest = _median(thicknesses[3], near, start, width)
            slim, slimmer = _median(slimnesses[2], near, start, width), _median(slimnesses[3], near, start, width)
            is_line = _median(slimnesses[0], near, start, width) < NEAR.slimness
            is_line = is_line | (_median(slimnesses[1], near, start, width) < WIDE.slimness)
            is_strip = (far > STRIP_GAP * wide) & (slim < STRIP_SLIMNESS)
            is_strip = is_strip & (coarse > STRIP_COARSE * spacing) & (coarsest > STRIP_COARSEST * spacing)
            off_near, off_wide = vabs(load16(offsets[0], at)), vabs(load16(offsets[1], at))
            bend, thickness = _median(bends[0], near, start, width), _median(thicknesses[0], near, start, width)
            fine = _within(NEAR, bend, thickness, off_near, spacing)
            bend, thickness = _median(bends[1], near, start, width), _median(thicknesses[1], near, start, width)
            fine = fine | _within(WIDE, bend, thickness, off_wide, spacing)
            fine = fine & (select(is_line | is_strip, yes, no) < ONE)
            off = _median_off(xyz, normals[0], offsets[2], at, near, width)
            is_coarse = _within(COARSE, load16(bends[2], at), coarse, off, spacing) & (slim > COARSE.slimness)
            thin = (coarse < LINE_COARSE * spacing) & (far < LINE_GAP * wide)
            is_coarse = is_coarse & (select(thin, no, select(is_line, yes, no)) < ONE)
            off = _median_off(xyz, normals[1], offsets[3], at, near, width)
            is_coarsest = _within(COARSEST, load16(bends[3], at), coarsest, off, spacing)
            is_coarsest = is_coarsest & (slimmer > COARSEST.slimness)
            thin = coarsest < LINE_COARSEST * spacing
            is_coarsest = is_coarsest & (select(thin, no, select(is_line, yes, no)) < ONE)
            store(surface, at, select(fine | is_coarse | is_coarsest, yes, no))
            own, off = load16(reaches[0], at) * SPACING, vmin(off_near, off_wide)
            is_alone = (own > ALONE * spacing) & (off > ALONE_OFF * spacing)
            is_alone = is_alone & ((own - spacing) * off > ALONE_BOTH * spacing * spacing)
            store(alone, at, select(is_alone, yes, no))
        tile = next_tile(work)


@kernel
def _vote(
    work: Array, before: Array, alone: Array, near: Array, width: int, limits: tuple[int, int], out: Array
) -> None:
    """Write which points are on a surface after votes: points take the class of most of their 16 neighbours.

    before : (n,) 1 for surface points, else 0; alone : (n,) over 0 for isolated points, which get 0
    near : flat, `width` rows for each point: the point, then its neighbours
    limits : number of surface points among the neighbours from which a point becomes surface, and below which it
        becomes scattered
    """
    before, alone, near, out = borrow(before), borrow(alone), borrow(near), borrow(out)
    keep, lose = f32(limits[0]), f32(limits[1])
    tile = next_tile(work)
    while tile >= 0:
        for begin in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out)), LANES):
            at, count = min(begin, len(out) - LANES), zeros()
            for j in range(1, VOTERS + 1):
                count = count + gather16(before, near, at * width + j, width)
            voted = select(count >= keep, zeros() + ONE, select(count < lose, zeros(), load16(before, at)))
            store(out, at, select(load16(alone, at) > ZERO, zeros(), voted))
        tile = next_tile(work)


@kernel
def _medians(work: Array, values: Array, near: Array, width: int, out: Array) -> None:
    """Write the median of the values over each point and its 8 nearest neighbours.

    near : flat, `width` rows for each point: the point, then its neighbours
    """
    values, near, out = borrow(values), borrow(near), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for begin in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out)), LANES):
            at = min(begin, len(out) - LANES)
            store(out, at, _median(values, near, at * width, width))
        tile = next_tile(work)


def judge(
    xyz: tuple[Floats, ...], near: NDArray[np.int32], evidence: Evidence, threads: int | None = None
) -> tuple[Floats, Floats]:
    """Return which points are on a surface, from their own neighbourhoods, and which are isolated; 1 or 0, (n,) each.

    xyz : x, y and z of n points; near : (n, k) rows of each point and its neighbours
    evidence : planes fitted to these at four scales
    """
    surface, alone = np.empty((2, len(near)), np.float32)
    normals, tiles = (evidence.coarse, evidence.coarsest), -(-len(near) // CHUNK)
    rest = near.reshape(-1), near.shape[1], evidence[:4], normals, evidence.reaches, (surface, alone)
    run(_judge, tiles, xyz, *rest, threads=threads)
    return surface, alone


def vote(
    surface: Floats, alone: Floats, near: NDArray[np.int32], limits: tuple[int, int], threads: int | None = None
) -> Floats:
    """Return which points are on a surface after one round of votes by their 16 nearest neighbours; 1 or 0, (n,).

    surface : (n,) classes before; alone : (n,) over 0 for isolated points, which get 0
    near : (n, k) rows of neighbours
    limits : number of surface neighbours from which a point becomes surface, and below which it becomes scattered
    """
    out = np.empty(len(near), np.float32)
    run(_vote, -(-len(out) // CHUNK), surface, alone, near.reshape(-1), near.shape[1], limits, out, threads=threads)
    return out


def medians(values: Floats, near: NDArray[np.int32], threads: int | None = None) -> Floats:
    """Return the median of values (n,) over each point and its 8 nearest neighbours, (n,).

    near : (n, k) rows of each point and its neighbours
    """
    out = np.empty(len(near), np.float32)
    run(_medians, -(-len(out) // CHUNK), values, near.reshape(-1), near.shape[1], out, threads=threads)
    return out
