"""Heights of misaligned scans: one quadric for all scans around a point, with a separate height for each scan."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
from ...engine.jit import Array, borrow, inline, kernel, next_tile, routine, run
from ...engine.kernels.vec import Vec3, tangents
from ..normals.planes import plane
from ..normals.quadrics import TERMS, solve
from .fits import into_ball

AROUND = 64  # neighbours: of two scans 3 spacings apart, a third of them belongs to the other scan
MOST = 8  # scans considered around a point
FEWEST, BENEATH = 6, 4  # points of a scan in the neighbourhood, and within `WITHIN` of the axis, at least
WITHIN = 0.35  # squared radius within which the ball holds all points of two scans, if at most 0.8 radii apart
SURE, SPACINGS = 3.5, 0.2  # gap in standard errors, and in spacings, above which scans are misaligned
SPREAD, SPREAD_SPACINGS = 0.35, 0.25  # greatest spread of a scan about its height, relative to the gap, or in spacings
SIDE = 0.05  # mean cosine of viewing direction and normal above which the visible side is clear
RIDGE = 1e-3
HALF = 0.5  # share of the neighbours of the same scan that must have a clear move
CHUNK = 512

# One thread's memory: places, the same relative to each scan's mean, weights, scans; terms, coefficients and factor of
# the quadric; variances and axes of the plane; means of terms, and statistics of each scan.
Memory: TypeAlias = tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array, Array, Array]

COUNT, INNER, SQUARE, COSINE, HEIGHT = range(5)  # columns of a scan's statistics


@inline
def _new_memory() -> Memory:
    k = AROUND
    return (
        *(np.empty((k, 3)), np.empty((k, 3)), np.empty(k), np.empty(k, np.int64), np.empty((k, TERMS + 1))),
        *(np.empty(TERMS), np.zeros((TERMS, TERMS)), np.empty((3, 3)), np.empty((3, 3))),
        *(np.empty((MOST, TERMS + 1)), np.empty((MOST, 5))),
    )


@routine
def _sort_out(near: Array, i: int, scans: Array, row: int, slots: Array, w: Array, known: Array) -> int:
    """Number the scans of a row's neighbours, beginning with the row's own; return how many there are.

    near : (m, 64) rows of neighbours, of which near[i] are used
    scans : (n,) scan of each point, negative where unknown
    slots : (64,) receives the number of each neighbour's scan, or -1
    w : (64,) receives 1 for neighbours of scans with at least 6 of them, else 0
    known : (8, 5) receives the number of neighbours of each of at most 8 scans in its first column
    """
    first = np.empty(MOST, np.int64)
    first[0], count = scans[row], 1
    known[:, :] = 0.0
    for j in range(AROUND):
        scan, slot = scans[near[i, j]], 0
        while slot < count and first[slot] != scan:
            slot += 1
        if scan >= 0 and slot == count and count < MOST:
            first[slot] = scan
            count += 1
        slots[j] = slot if scan >= 0 and slot < count else -1
        if slots[j] >= 0:
            known[slot, COUNT] += 1.0
    for j in range(AROUND):
        w[j] = 1.0 if slots[j] >= 0 and known[slots[j], COUNT] >= FEWEST else 0.0
    return count


@routine
def _center(values: Array, columns: int, slots: Array, w: Array, known: Array, means: Array, out: Array) -> int:
    """Subtract from each neighbour's values their mean over the neighbours of the same scan; return 0.

    values, out : (64, c) values of the neighbours; receives the differences
    columns : number of columns, from the first, to treat
    slots, w : (64,) number of each neighbour's scan; 0 if the neighbour is not used
    known : (8, 5) the first column holds the number of neighbours of each scan
    means : (8, c) receives the mean over each scan
    """
    means[:, :] = 0.0
    for j in range(AROUND):
        if w[j] > 0.0:
            for c in range(columns):
                means[slots[j], c] += values[j, c] / known[slots[j], COUNT]
    for j in range(AROUND):
        for c in range(columns):
            out[j, c] = values[j, c] - means[max(slots[j], 0), c]
    return 0


@routine
def _fit(memory: Memory, facing: Array, near: Array, i: int) -> Vec3:
    """Fit one quadric to the neighbours of all scans, with a separate height for each scan; return its plane's normal.

    memory : holds the neighbours, scaled into the unit ball; receives height and residuals of each scan
    facing : (n, 3) unit vectors to the scanner that saw each point
    near : (m, 64) rows of neighbours, of which near[i] are used
    """
    d, centered, w, slots, terms, x, m, a, v, means, known = memory
    _center(d, 3, slots, w, known, means, centered)
    n = plane(centered, w, AROUND, a, v)
    one, two = tangents(n)
    for j in range(AROUND):
        p = d[j, 0] * one[0] + d[j, 1] * one[1] + d[j, 2] * one[2]
        q = d[j, 0] * two[0] + d[j, 1] * two[1] + d[j, 2] * two[2]
        terms[j, 0], terms[j, 1], terms[j, 2] = 0.0, p, q
        terms[j, 3], terms[j, 4], terms[j, 5] = p * p, p * q, q * q
        terms[j, TERMS] = d[j, 0] * n[0] + d[j, 1] * n[1] + d[j, 2] * n[2]
        if w[j] > 0.0:
            known[slots[j], INNER] += 1.0 if p * p + q * q <= WITHIN else 0.0
            side = facing[near[i, j], 0] * n[0] + facing[near[i, j], 1] * n[1] + facing[near[i, j], 2] * n[2]
            known[slots[j], COSINE] += side / known[slots[j], COUNT]
    _center(terms, TERMS + 1, slots, w, known, means, terms)
    solve(terms, w, AROUND, RIDGE, m, x)
    for s in range(MOST):
        known[s, HEIGHT] = means[s, TERMS]
        for b in range(1, TERMS):
            known[s, HEIGHT] -= x[b] * means[s, b]
    for j in range(AROUND):
        if w[j] > 0.0:
            r = terms[j, TERMS]
            for b in range(1, TERMS):
                r -= x[b] * terms[j, b]
            known[slots[j], SQUARE] += r * r / (known[slots[j], COUNT] - 2.0)
    return n


@routine
def _way(known: Array, count: int) -> tuple[bool, float]:
    """Return whether the scans around a point are clearly one surface, and how far the point's scan is from their mean.

    The distance is relative to the radius of the neighbourhood.

    known : (8, 5) statistics of each scan, the point's own first: number of neighbours; number of those near the
        point, measured along the fitted plane; mean square of residuals; mean cosine between the plane's normal and the
        directions to the scanner; height
    count : number of scans
    """
    inner = 0.0
    for s in range(count):
        inner += known[s, INNER]
    spacing = math.sqrt(math.pi * WITHIN / max(inner, 1.0))
    pooled = weights = total = 0.0
    for s in range(count):
        pooled += known[s, SQUARE] / count
    is_off = False
    for s in range(count):
        if s > 0 and (known[s, COUNT] < FEWEST or known[s, INNER] < BENEATH):
            continue
        gap = known[s, HEIGHT] - known[0, HEIGHT]
        error = math.sqrt(known[0, SQUARE] / known[0, COUNT] + known[s, SQUARE] / known[s, COUNT])
        if abs(gap) > max(SURE * error, SPACINGS * spacing):
            spread = math.sqrt(max(known[0, SQUARE], known[s, SQUARE]))
            if spread > max(SPREAD * abs(gap), SPREAD_SPACINGS * spacing) or gap * gap > 1.0 - WITHIN:
                return False, 0.0
            if known[0, COSINE] * known[s, COSINE] <= 0.0 or abs(known[s, COSINE]) < SIDE:
                return False, 0.0
            is_off = True
        weight = known[s, INNER] / (known[s, SQUARE] + pooled + 1e-12)
        weights, total = weights + weight, total + weight * gap
    return True, total / weights if is_off else 0.0


@kernel
def _heights(work: Array, positions: Array, rows: Array, near: Array, scans: Array, facing: Array, out: Array) -> None:
    """Write to out[i] the move of positions[rows[i]] to the mean of the scans around it, and 1 if it is clear.

    It is clear if the scans certainly saw one surface, not two sheets.

    work : gives each thread its next tile, 512 rows
    positions, rows : (n, 3) points, and (m,) the rows
    near : (m, 64) nearest neighbours of these rows
    scans : (n,) scan of each point, negative where unknown
    facing : (n, 3) unit vectors to the scanner that saw each point, 0 where unknown
    out : (m, 4) receives x, y and z of the move, and 1 or 0
    """
    positions, near, facing, out = borrow(positions), borrow(near), borrow(facing), borrow(out)
    memory = _new_memory()
    d, w, slots, known = memory[0], memory[2], memory[3], memory[10]
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            row = rows[i]
            if scans[row] < 0:
                continue
            count = _sort_out(near, i, scans, row, slots, w, known)
            out[i, 3] = 1.0 if count == 1 else 0.0
            if count == 1 or known[0, COUNT] < FEWEST:
                continue
            far = into_ball(positions, row, near, i, AROUND, d)
            n = _fit(memory, facing, near, i)
            clear, way = _way(known, count)
            out[i, 3] = 1.0 if clear else 0.0
            for c in range(3):
                out[i, c] = way * far * n[c]
        tile = next_tile(work)


@kernel
def _even_out(work: Array, moves: Array, near: Array, scans: Array, out: Array) -> None:
    """Write to out[i] the mean move of the neighbours of point i that belong to the same scan.

    work : gives each thread its next tile, 512 points
    moves : (n, 4) move of each point, and 1 where it is clear: the scans around certainly saw one surface
    near : (n, k) rows of neighbours
    scans : (n,) scan of each point, negative where unknown
    out : (n, 3) receives the means of clear moves; zero where fewer than half of these moves are clear
    """
    moves, near, out = borrow(moves), borrow(near), borrow(out)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            same = clear = x = y = z = 0.0
            for j in near[i]:
                if scans[j] == scans[i]:
                    same += 1.0
                    if moves[j, 3] > 0.0:
                        clear += 1.0
                        x, y, z = x + moves[j, 0], y + moves[j, 1], z + moves[j, 2]
            if scans[i] >= 0 and clear >= HALF * same:
                out[i, 0], out[i, 1], out[i, 2] = x / clear, y / clear, z / clear
        tile = next_tile(work)


def heights(positions: Floats, rows: Rows, near: NDArray[np.int32], scans: NDArray[np.int32], facing: Floats) -> Floats:
    """Return the moves that align misaligned scans: of each row to the mean of the scans around it.

    Parameters
    ----------
    positions : (n, 3) float32
    rows : (m,) int64
    near : (m, 64) int32
        Nearest neighbours of these rows.
    scans : (n,) int32
        Scan of each point, negative where unknown.
    facing : (n, 3) float32
        Unit vectors to the scanner that saw each point, 0 where unknown.

    Returns
    -------
    (m, 4) float32
        x, y and z of the move, and 1 where it is clear, as the scans certainly saw one surface, else 0.
    """
    out = np.zeros((len(rows), 4), np.float32)
    run(_heights, -(-len(rows) // CHUNK), positions, rows, near, scans, facing, out)
    return out


def even_out(moves: Floats, near: NDArray[np.int32], scans: NDArray[np.int32]) -> Floats:
    """Average the moves of points over neighbours of the same scan, (n, 3); 0 where less than half are clear.

    moves : (n, 4) move of each point, and 1 where it is clear: the scans around certainly saw one surface
    near : (n, k) rows of neighbours
    scans : (n,) scan of each point, negative where unknown
    """
    out = np.zeros((len(moves), 3), np.float32)
    run(_even_out, -(-len(moves) // CHUNK), moves, near, scans, out)
    return out
