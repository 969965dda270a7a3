"""Creases: two or three planes through a point's neighbours, where no quadric fits.

The surface of a solid of planes is where the largest of their heights is zero. Candidates are fitted around places
among the neighbours. Those two, then three, are chosen whose solid lies closest to all neighbours, with signs that tell
which side of each is inside. Then each neighbour is taken for the plane that it belongs to, and the planes are fitted
again.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...engine.jit import Array, borrow, f32, f64, inline, kernel, next_tile, routine, run
from ...engine.simd import (
    F16,
    ONE,
    ZERO,
    bits,
    broadcast16,
    count_bits,
    lane,
    load16,
    select,
    store,
    sum_over_lanes,
    vabs,
    vmax,
    vmin,
)
from ..normals.fit_batch import LANES, zeros
from ..normals.jets import fit_residuals
from .candidates import (
    Neighbors,
    find_candidates,
    fit_lanes,
    height,
    load_neighbors,
    load_places,
    new_neighbors,
    store_sums,
)
from .solids import choose_third, choose_two, judge

Floats = NDArray[np.float32]

MODEL = 14  # numbers of a crease: how many planes, 0 for none; three planes; its weight beside others
CUT = 3.0  # standard deviations beyond which a neighbour belongs to none
POOR = 3.0  # mean square in the noise's that no candidates leave where there is a crease
THIRD = 0.75  # share of the squares that a third plane must leave at most
ROUNDS = 4
LEAST = 8  # neighbours of a plane
# Standard deviations below the other planes from which a neighbour belongs to one: all that belong to the highest one
# lift the planes by 0.03 spacings (noise of 0.3), as those count that noise has pushed out.
APART = 1.0
FITS = 0.9  # mean square of residuals in the noise's up to which a quadric fits: planes leave 0.64 +- 0.14
DETAIL = 0.15  # as in `fit`
PROOF = 30.0  # squares, in the noise's, by which planes must be closer than a quadric
CHUNK = 256


@inline
def _highest(memory: Neighbors, at: int) -> tuple[F16, F16, F16]:
    """The plane that sixteen neighbours belong to, their heights over it, and over the next one."""
    place = load_places(memory, at)
    a, b, c = height(memory.chosen, 0, place), height(memory.chosen, 1, place), height(memory.chosen, 2, place)
    high, low = vmax(a, b), vmin(a, b)
    which = select(c > high, broadcast16(f32(2.0)), select(b > a, broadcast16(ONE), zeros()))
    return which, vmax(high, c), vmax(low, vmin(high, c))


@routine
def _refine(count: int, sigma: float, memory: Neighbors) -> bool:
    """Fit the planes again to those neighbours that belong to each; False if one of them has too few."""
    store(memory.owner, 0, broadcast16(f32(-2.0)))
    for _ in range(ROUNDS):
        if _assign(sigma, memory) == 0:
            break
        for a in range(count):
            if _sum_up(a, memory) < LEAST:
                return False
        _fit_again(count, memory)
    return True


@inline
def _assign(sigma: float, memory: Neighbors) -> int:
    """Write which plane each neighbour belongs to; returns how many do not belong to the same as before."""
    changed = 0
    for at in range(0, len(memory.weights), LANES):
        which, top, second = _highest(memory, at)
        mine = (vabs(top) < f32(CUT * sigma)) & (second < f32(-APART * sigma)) & (load16(memory.weights, at) > ZERO)
        owner, before = select(mine, which, broadcast16(f32(-1.0))), load16(memory.owner, at)
        changed += count_bits(bits(vabs(owner - before) > ZERO))
        store(memory.owner, at, owner)
    return changed


@inline
def _sum_up(a: int, memory: Neighbors) -> int:
    """Sum up the neighbours that belong to a plane; returns how many."""
    members = 0
    total = x = y = z = xx = xy = xz = yy = yz = zz = zeros()
    for at in range(0, len(memory.weights), LANES):
        mine = vabs(load16(memory.owner, at) - f32(a)) <= ZERO
        members += count_bits(bits(mine))
        w = select(mine, load16(memory.weights, at), zeros())
        p, q, r = load_places(memory, at)
        wp, wq, wr = w * p, w * q, w * r
        total, x, y, z = total + w, x + wp, y + wq, z + wr
        xx, xy, xz = xx + wp * p, xy + wp * q, xz + wp * r
        yy, yz, zz = yy + wq * q, yz + wq * r, zz + wr * r
    store_sums(memory.sums, a, (x, y, z), (xx, xy, xz), ((yy, yz, zz), total))
    return members


@inline
def _fit_again(count: int, memory: Neighbors) -> None:
    """Replace the chosen planes by those of the sums, which look to the same sides."""
    chosen, planes = memory.chosen, memory.again
    fit_lanes(memory.sums, planes)
    for a in range(count):
        along = ZERO
        for c in range(3):
            along += planes[LANES * c + a] * chosen[LANES * c + a]
        for c in range(4):
            chosen[LANES * c + a] = planes[LANES * c + a] if along >= ZERO else -planes[LANES * c + a]


@inline
def _error(count: int, memory: Neighbors) -> tuple[float, float, float]:
    """The mean square of the residuals, the height's variance for unit noise, and how many neighbours count."""
    sums = squares = rest = zeros()
    for at in range(0, len(memory.weights), LANES):
        _, top, _ = _highest(memory, at)
        w = load16(memory.weights, at)
        sums, squares, rest = sums + w, squares + w * w, rest + w * top * top
    total, square = f64(lane(sum_over_lanes(sums), 0)), f64(lane(sum_over_lanes(rest), 0))
    effective = total * total / lane(sum_over_lanes(squares), 0)
    return square / total * effective / max(effective - 3.0 * count, 1.0), 3.0 / effective * count, effective


@routine
def crease(k: int, sigma: float, memory: Neighbors) -> tuple[int, float, float, float]:
    """Fit planes. Returns how many, and what `_error` does; 0 where there are none."""
    cut = (CUT * sigma) ** 2
    find_candidates(k, memory)
    judges = judge(k, memory)
    two = choose_two(judges, cut, memory)
    poor = POOR * sigma * sigma * judges
    if two > 2.0 * poor:
        return 0, 0.0, 0.0, 0.0
    three = choose_third(k, cut, memory)
    if min(two, three) > poor:
        return 0, 0.0, 0.0, 0.0
    count = 3 if three < THIRD * two else 2
    if count == 2:
        choose_two(judges, cut, memory)
    sound = _refine(count, sigma, memory)
    if not sound and count == 3:
        count = 2
        choose_two(judges, cut, memory)
        sound = _refine(count, sigma, memory)
    if not sound:
        return 0, 0.0, 0.0, 0.0
    return count, *_error(count, memory)


@inline
def store_model(memory: Neighbors, count: int, unit: float, weight: float, out: Array) -> None:
    """Write the number of planes, and the planes."""
    out[0], out[MODEL - 1] = count, weight
    for a in range(count):
        for c in range(4):
            out[1 + 4 * a + c] = memory.chosen[LANES * c + a] * (unit if c == 3 else 1.0)


@kernel
def _fit(work: Array, positions: Array, rows: Array, near: Array, errors: Array, residuals: Array, out: Array) -> int:
    """Write the best crease of each row to out, if it is better than a quadric.

    errors : (m, 2), noise, and error of the quadric
    residuals : (m,), root mean squares of what a quadric through all neighbours leaves; NaN where they are on a line
    """
    positions, rows, near = borrow(positions), borrow(rows), borrow(near)
    errors, residuals, out = borrow(errors), borrow(residuals), borrow(out)
    most = near.shape[1]
    memory = new_neighbors(most)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            if not residuals[i] ** 2 >= FITS * f64(errors[i, 0]) ** 2:
                continue
            unit = load_neighbors(positions, rows[i], near, i, memory)
            square, least, residual = (errors[i, 0] / unit) ** 2, (errors[i, 1] / unit) ** 2, residuals[i] / unit
            count, apart, variance, points = crease(most, math.sqrt(square), memory)
            better = count > 0 and variance * square + DETAIL * max(apart - square, 0.0) < least
            if better and points * (residual * residual - apart) > PROOF * square:
                store_model(memory, count, unit, (square / max(apart, 0.25 * square)) ** 2, out[i])
        tile = next_tile(work)
    return 0


def fit_creases(positions: Floats, rows: NDArray[np.int64], near: NDArray[np.int32], errors: Floats) -> Floats:
    """The planes around some points, (m, MODEL) float32, zero where there are none that are better than a quadric."""
    out = np.zeros((len(rows), MODEL), np.float32)
    if near.shape[1] >= 2 * LEAST:
        residuals = fit_residuals(positions, rows, near, near.shape[1])
        run(_fit, -(-len(rows) // CHUNK), positions, rows, near, errors, residuals, out)
    return out
