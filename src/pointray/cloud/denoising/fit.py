"""Fits of the local surface: as many neighbours as the noise requires and the shape allows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
from ...engine.jit import Array, borrow, f32, f64, inline, kernel, next_tile, routine, run
from ...engine.simd import INF, ONE, Mask, bits, broadcast16, load16, select, store, vmax, vsqrt
from ..normals.fit_batch import LANES, FitBatch16, inner, load_place, load_point, new_fit_batch, zeros
from ..normals.jet import AXIS, HEIGHT, LINE, NORMAL, RESIDUAL, SLIM, SLIM_VARIANCE, SLOPE, SPREAD, jet, take_triple

SIZES = 16, 32, 64, 128  # neighbourhood sizes to choose from, including the point itself
# Mean square of residuals that noise alone leaves, and the weight of the excess, which is detail. Intersecting
# confidence intervals (Goldenshluger and Nemirovski 1997) are no better: at 0.1 spacings the statue's error is 0.079
# with them and 0.064 here; at 1 spacing the dragon's is 0.36 and 0.31.
SEEN, DETAIL = 0.64, 0.15
WIDE = 5.0  # radius in standard deviations of the noise below which a neighbourhood has no reliable direction
FEWEST = 6  # neighbours
# A fit to half the neighbours has at least this many times the variance. It is not tried where that alone is too much,
# which saves a tenth of the time, noisy models.
HALVED = 1.8
CHUNK = 512
LOUDEST = f32(1e15)  # noise, in distances of the farthest neighbour, whose square float32 can hold
# Rows of results in each lane: the move onto the surface, its normal and the plane's; what the largest quadric leaves
# beyond noise; the error; and the squared noise, which is an input.
SHIFT, BEYOND, ERROR, SQUARE, FOUND = 0, 9, 10, 11, 12


@kernel
def _fit(
    work: Array, positions: Array, rows: Array, near: Array, normals: Array, sizes: Array, noise: Array, out: Array
) -> None:
    """Fit quadrics of several sizes to the neighbours of each row; write the result of the best one to `out`.

    work : gives each thread its next tile, 512 rows
    positions, rows : (n, 3) points, and (m,) the rows to fit
    near : (m, k) nearest neighbours of these rows, themselves first
    normals : (n, 3), or (0, 3) if unknown; neighbours that face the opposite side are skipped
    sizes : numbers of neighbours to try, ascending
    noise : (m,) standard deviation of the distance from the surface
    out : (m, 11) receives x, y, z of the move onto the quadric, of its normal there, and of the normal of a plane
        through the neighbours; the residual, beyond the noise, of the quadric through most neighbours; the estimated
        error of the best quadric
    """
    positions, rows, near = borrow(positions), borrow(rows), borrow(near)
    normals, noise, out = borrow(normals), borrow(noise), borrow(out)
    memory, found = new_fit_batch(near.shape[1]), np.zeros(LANES * FOUND, np.float32)
    same = np.empty((1, near.shape[1]), np.int32)
    tile = next_tile(work)
    while tile >= 0:
        stop = min((tile + 1) * CHUNK, len(out))
        for first in range(tile * CHUNK, stop, LANES):
            for lane in range(LANES):
                i = min(first + lane, stop - 1)
                count = _same_side(normals, rows[i], near, i, same)
                load_point(positions, rows[i], same, 0, count - 1, lane, memory)
                memory.counts[lane] = count
                found[LANES * SQUARE + lane] = min(noise[i] / memory.units[lane], LOUDEST) ** 2
            _choose(sizes, memory, found)
            for lane in range(min(LANES, stop - first)):
                for c in range(SQUARE):
                    unit = ONE if SHIFT + 3 <= c < BEYOND else memory.units[lane]
                    out[first + lane, c] = found[LANES * c + lane] * unit
        tile = next_tile(work)


@inline
def _same_side(normals: Array, row: int, near: Array, i: int, same: Array) -> int:
    """List the neighbours near[i] of a row that face its side; return their number.

    same : (1, k) receives them; the rest is filled with the last one
    """
    count = 0
    same[0, 0] = row
    for j in range(near.shape[1]):
        other, cosine = near[i, j], 0.0
        if len(normals) > 0:
            for c in range(3):
                cosine += f64(normals[row, c]) * f64(normals[other, c])
        if cosine >= 0.0:
            same[0, count] = other
            count += 1
    for j in range(max(count, 1), near.shape[1]):
        same[0, j] = same[0, j - 1]
    return count


@routine
def _choose(sizes: Array, memory: FitBatch16, found: Array) -> None:
    """Find the quadric with the least error in each of 16 lanes, from the largest number of neighbours down.

    sizes : numbers of neighbours to try, ascending
    memory : neighbours of 16 points, scaled so that the farthest one is at distance 1
    found : (12 * 16,) receives the move onto the quadric, its normal, the plane's normal, the residual beyond noise of
        the quadric through most neighbours, and the estimated error; the last row holds the squared noise. Lengths are
        in the unit of the scaled neighbours
    """
    square, counts = load16(found, LANES * SQUARE), load16(memory.counts, 0)
    least, left = broadcast16(INF), zeros()
    for c in range(SQUARE):
        store(found, LANES * c, zeros())
    going = counts >= f32(FEWEST)
    for s in range(len(sizes) - 1, -1, -1):
        k, largest = sizes[s], s == len(sizes) - 1
        tried = going
        if not largest:
            last = load_place(memory.places, k - 1)
            going = going & ((counts <= f32(k)) | (inner(last, last) >= WIDE * WIDE * square))
            tried = going & (counts > f32(k))
        if bits(tried) == 0:
            continue
        jet(k, LINE if largest else SLIM, memory)
        spread = load16(memory.results, LANES * SPREAD) * square
        residual = load16(memory.results, LANES * RESIDUAL)
        tried = tried & (load16(memory.results, LANES * SLOPE) < SLIM_VARIANCE)
        if largest:
            left = select(tried, residual * residual, left)
        error = spread + DETAIL * vmax(residual * residual - SEEN * square, zeros())
        better = tried & (error < least)
        least = select(better, error, least)
        _take(better, memory.results, found)
        going = going ^ (tried & (least <= HALVED * spread))
    store(found, LANES * BEYOND, vsqrt(vmax(left - SEEN * square, zeros())))
    store(found, LANES * ERROR, vsqrt(least))


@inline
def _take(mask: Mask, results: Array, found: Array) -> None:
    """Keep the results of a fit in the lanes of `mask`: the move onto the quadric, its normal, and the plane's normal.

    results : results of the last fit, one row of 16 lanes for each number
    found : receives them, in the rows for move, normal and plane's normal
    """
    n = load16(results, LANES * NORMAL), load16(results, LANES * (NORMAL + 1)), load16(results, LANES * (NORMAL + 2))
    a = load16(results, LANES * AXIS), load16(results, LANES * (AXIS + 1)), load16(results, LANES * (AXIS + 2))
    along = load16(results, LANES * HEIGHT) * inner(n, a)
    for c in range(3):
        store(found, LANES * (SHIFT + c), select(mask, along * n[c], load16(found, LANES * (SHIFT + c))))
    take_triple(mask, results, NORMAL, found, SHIFT + 3, found, SHIFT + 3)
    take_triple(mask, results, AXIS, found, SHIFT + 6, found, SHIFT + 6)


def fit_surface(
    positions: Floats, rows: Rows, near: NDArray[np.int32], normals: Floats | None, noise: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Fit a quadric to the neighbours of each row, as many as its noise requires and the shape allows.

    Parameters
    ----------
    positions : (n, 3) float32
    rows : (m,) int64
    near : (m, k) int32
        Neighbours of each of these rows, nearest first, including itself.
    normals : (n, 3) float32 or None
        Known normals: neighbours that face the opposite side are not used.
    noise : (m,) float32
        Standard deviation of the distance from the surface, in the unit of the positions.

    Returns
    -------
    shifts, normals, planes : (m, 3) float32
        The move of each row onto its quadric, the unit normal there, and the unit normal of the plane through the
        neighbours. 0 where the neighbours lie on a line.
    errors : (m, 2) float32
        Residual, beyond noise, of the quadric through most neighbours, and estimated error of the chosen one, in the
        same unit.
    """
    out = np.zeros((len(rows), 11), np.float32)
    known = np.zeros((0, 3), np.float32) if normals is None else normals
    sizes = np.array([k for k in SIZES if k <= near.shape[1]] or [near.shape[1]])
    run(_fit, -(-len(rows) // CHUNK), positions, rows, near, known, sizes, noise, out)
    return out[:, :3], out[:, 3:6], out[:, 6:9], out[:, 9:]
