"""Creases: two or three planes through a point's neighbours, where no quadric fits.

The surface of a polyhedral solid is where the largest of the heights above its planes is zero. Candidate planes are
fitted around some neighbours. The two, then three, candidates are chosen whose solid is closest to all neighbours, with
signs that say which side is inside. Then each neighbour is assigned to a plane, and the planes are fitted again.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
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
from . import candidates
from .candidates import Neighbors
from .solids import choose_third, choose_two, score

MODEL = 14  # floats of a crease: number of planes, 0 for none; three planes; its weight relative to others
CUT = 3.0  # standard deviations beyond which a neighbour belongs to no plane
POOR = 3.0  # mean square, relative to the noise's, above which the candidates form no crease
THIRD = 0.75  # a third plane must reduce the sum of squares to at most this share
ROUNDS = 4
LEAST = 8  # neighbours of a plane, at least
# A neighbour belongs to a plane if it is this many standard deviations below the others. Assigning it to the highest
# plane would lift the planes by 0.03 spacings (noise of 0.3), as points displaced by noise would count.
APART = 1.0
FITS = 0.9  # mean square of residuals, relative to the noise's, up to which a quadric fits: planes have 0.64 +- 0.14
DETAIL = 0.15  # as in `fit`
PROOF = 30.0  # planes must be better than a quadric by this sum of squares, relative to the noise's
CHUNK = 256


@inline
def _highest(memory: Neighbors, at: int) -> tuple[F16, F16, F16]:
    """Find for each of sixteen neighbours the plane that it is highest above, among the two or three chosen ones.

    Returns the number of that plane, from 0; the height above it; the second largest of the heights. Heights are
    signed distances. A point on a solid bounded by these planes lies on the one that it is highest above.

    at : index of the first of the sixteen neighbours
    """
    place = candidates.load_places(memory, at)
    a, b = candidates.height(memory.chosen, 0, place), candidates.height(memory.chosen, 1, place)
    c = candidates.height(memory.chosen, 2, place)
    high, low = vmax(a, b), vmin(a, b)
    which = select(c > high, broadcast16(f32(2.0)), select(b > a, broadcast16(ONE), zeros()))
    return which, vmax(high, c), vmax(low, vmin(high, c))


@routine
def _refine(count: int, sigma: float, memory: Neighbors) -> bool:
    """Assign the neighbours to the `count` chosen planes and fit these again, up to four times.

    Returns False if fewer than 8 neighbours lie on one of the planes, else True.

    sigma : noise (standard deviation of the points from the surface), relative to the farthest neighbour's distance
    """
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
    """Assign each neighbour to the plane that it lies on, or to none; return how many assignments changed.

    It lies on a plane if it is within 3 `sigma` of it and at least 1 `sigma` below the others.

    sigma : noise (standard deviation of the points from the surface), relative to the farthest neighbour's distance
    """
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
    """Sum up the neighbours assigned to chosen plane `a`, for a new fit; return their number."""
    members = 0
    total = x = y = z = xx = xy = xz = yy = yz = zz = zeros()
    for at in range(0, len(memory.weights), LANES):
        mine = vabs(load16(memory.owner, at) - f32(a)) <= ZERO
        members += count_bits(bits(mine))
        w = select(mine, load16(memory.weights, at), zeros())
        p, q, r = candidates.load_places(memory, at)
        wp, wq, wr = w * p, w * q, w * r
        total, x, y, z = total + w, x + wp, y + wq, z + wr
        xx, xy, xz = xx + wp * p, xy + wp * q, xz + wp * r
        yy, yz, zz = yy + wq * q, yz + wq * r, zz + wr * r
    candidates.store_sums(memory.sums, a, (x, y, z), (xx, xy, xz), ((yy, yz, zz), total))
    return members


@inline
def _fit_again(count: int, memory: Neighbors) -> None:
    """Replace the `count` chosen planes by planes fitted to the summed neighbours of each; keep the sides they face."""
    chosen, planes = memory.chosen, memory.again
    candidates.fit_lanes(memory.sums, planes)
    for a in range(count):
        along = ZERO
        for c in range(3):
            along += planes[LANES * c + a] * chosen[LANES * c + a]
        for c in range(4):
            chosen[LANES * c + a] = planes[LANES * c + a] if along >= ZERO else -planes[LANES * c + a]


@inline
def _error(count: int, memory: Neighbors) -> tuple[float, float, float]:
    """Estimate how well `count` planes fit the neighbours of a point.

    Returns the mean square of the residuals, corrected for the fitted parameters; the variance of the planes' position
    along their normals, if the noise has variance 1; the effective number of neighbours. Lengths are relative to the
    farthest neighbour's distance.
    """
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
    """Choose and fit two or three planes that meet in an edge or a corner near a point whose neighbours are loaded.

    The planes are left in `memory.chosen`. Returns the number of planes, 0 if none fit; the mean square of the
    residuals; the variance of the planes' position along their normals, if the noise has variance 1; the effective
    number of neighbours.

    k : number of neighbours
    sigma : noise (standard deviation of the points from the surface), relative to the farthest neighbour's distance
    """
    cut = (CUT * sigma) ** 2
    candidates.find_candidates(k, memory)
    samples = score(k, memory)
    two = choose_two(samples, cut, memory)
    poor = POOR * sigma * sigma * samples
    if two > 2.0 * poor:
        return 0, 0.0, 0.0, 0.0
    three = choose_third(k, cut, memory)
    if min(two, three) > poor:
        return 0, 0.0, 0.0, 0.0
    count = 3 if three < THIRD * two else 2
    if count == 2:
        choose_two(samples, cut, memory)
    sound = _refine(count, sigma, memory)
    if not sound and count == 3:
        count = 2
        choose_two(samples, cut, memory)
        sound = _refine(count, sigma, memory)
    if not sound:
        return 0, 0.0, 0.0, 0.0
    return count, *_error(count, memory)


@inline
def store_model(memory: Neighbors, count: int, unit: float, weight: float, out: Array) -> None:
    """Write a crease (planes that meet in an edge or a corner) to `out`, a row of 14 floats.

    The row holds the number of planes, three planes as x, y, z of the normal and offset, and the weight.

    count : number of planes, 2 or 3
    unit : distance of the farthest neighbour, to which the fitted offsets are relative
    weight : weight of this crease where a point moves by the mean of its moves onto several creases
    """
    out[0], out[MODEL - 1] = count, weight
    for a in range(count):
        for c in range(4):
            out[1 + 4 * a + c] = memory.chosen[LANES * c + a] * (unit if c == 3 else 1.0)


@kernel
def _fit(work: Array, positions: Array, rows: Array, near: Array, errors: Array, residuals: Array, out: Array) -> None:
    """Write the best crease (two or three planes that meet) of each row to `out` where it fits better than a quadric.

    work : gives each thread its next tile, 256 rows
    positions, rows : (n, 3) points, and (m,) the rows to fit
    near : (m, k) nearest neighbours of these rows
    errors : (m, 2) noise, and estimated error of the quadric fitted to the row's neighbours, in the points' unit
    residuals : (m,) RMS residuals of a quadric through all k neighbours; NaN where they lie on a line
    out : (m, 14) receives the number of planes; x, y, z of the normal and the offset of each of three; the weight of
        the crease in the mean of several
    """
    positions, rows, near = borrow(positions), borrow(rows), borrow(near)
    errors, residuals, out = borrow(errors), borrow(residuals), borrow(out)
    most = near.shape[1]
    memory = candidates.new_neighbors(most)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            if not residuals[i] ** 2 >= FITS * f64(errors[i, 0]) ** 2:
                continue
            unit = candidates.load_neighbors(positions, rows[i], near, i, memory)
            square, least, residual = (errors[i, 0] / unit) ** 2, (errors[i, 1] / unit) ** 2, residuals[i] / unit
            count, apart, variance, points = crease(most, math.sqrt(square), memory)
            better = count > 0 and variance * square + DETAIL * max(apart - square, 0.0) < least
            if better and points * (residual * residual - apart) > PROOF * square:
                store_model(memory, count, unit, (square / max(apart, 0.25 * square)) ** 2, out[i])
        tile = next_tile(work)


def fit_creases(positions: Floats, rows: Rows, near: NDArray[np.int32], errors: Floats) -> Floats:
    """Fit two or three planes that meet in an edge or a corner to the neighbours of points on which no quadric fits.

    Returns (m, 14) float32: number of planes; for each of three planes x, y, z of its normal, and its offset for
    positions relative to the point; weight of this crease in the mean of several. Zero where planes fit no better than
    the quadric.

    positions : (n, 3)
    rows : (m,) the points to fit
    near : (m, k) their nearest neighbours, themselves included
    errors : (m, 2) noise, and estimated error of the quadric fitted before, in the points' unit
    """
    out = np.zeros((len(rows), MODEL), np.float32)
    if near.shape[1] >= 2 * LEAST:
        residuals = fit_residuals(positions, rows, near, near.shape[1])
        run(_fit, -(-len(rows) // CHUNK), positions, rows, near, errors, residuals, out)
    return out
