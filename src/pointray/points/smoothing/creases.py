"""Creases: two or three planes through a point's neighbours, where no quadric fits.

The surface of a solid of planes is where the largest of their heights is zero. Candidates are fitted around places
among the neighbours. Those two, then three, are chosen whose solid lies closest to all neighbours, with signs that tell
which side of each is inside. Then each neighbour is taken for the plane that it belongs to, and the planes are fitted
again.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...jit import Array, borrow, f64, inline, kernel, next_tile, routine, run
from ..normals.jets import LINE, jet, jet_memory
from ..normals.planes import plane

Floats = NDArray[np.float32]

# One thread's memory: candidates; chosen planes (normal and offset); weights; the plane that each neighbour belongs to;
# matrix and axes of a plane; how many are chosen; the neighbours of a candidate.
CreaseMemory: TypeAlias = tuple[Array, Array, Array, Array, Array, Array, Array, Array]

MODEL = 14  # numbers of a crease: how many planes, 0 for none; three planes; its weight beside others
CANDIDATES = 9
NARROW = 0.52  # radius of a candidate's neighbours, in that of all
JUDGES = 31  # neighbours by which candidates are chosen: with 21 edges of a cube are 0.41 spacings off, with 64 0.38
BLUNT = 0.9  # cosine of the angle between planes from which they are one
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
def crease_memory(most: int) -> CreaseMemory:
    """Memory for at most so many neighbours."""
    return (
        np.empty((CANDIDATES, 4)),
        np.empty((3, 4)),
        np.empty(most),
        np.empty(most),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.zeros(1, np.int64),
        np.empty((most, 3)),
    )


@inline
def _height(planes: Array, a: int, d: Array, j: int) -> float:
    return planes[a, 0] * d[j, 0] + planes[a, 1] * d[j, 1] + planes[a, 2] * d[j, 2] + planes[a, 3]


@routine
def _through(d: Array, w: Array, k: int, planes: Array, at: int, memory: CreaseMemory) -> float:
    """Fit planes[at] to weighted neighbours; returns the sum of weights."""
    n = plane(d, w, k, memory[4], memory[5])
    total = offset = 0.0
    for j in range(k):
        total += w[j]
        offset -= w[j] * (n[0] * d[j, 0] + n[1] * d[j, 1] + n[2] * d[j, 2])
    planes[at, 0], planes[at, 1], planes[at, 2], planes[at, 3] = n[0], n[1], n[2], offset / total
    return total


@routine
def _candidates(d: Array, k: int, memory: CreaseMemory) -> None:
    """Planes around the point, and around neighbours that are far from all before."""
    planes, _, w, away, _, _, _, beside = memory
    width = NARROW * NARROW * (d[k - 1, 0] ** 2 + d[k - 1, 1] ** 2 + d[k - 1, 2] ** 2)
    for j in range(k):
        away[j] = np.inf
    place = 0
    for a in range(CANDIDATES):
        farthest, following, count = -1.0, 0, 0
        for j in range(k):
            square = (d[j, 0] - d[place, 0]) ** 2 + (d[j, 1] - d[place, 1]) ** 2 + (d[j, 2] - d[place, 2]) ** 2
            if square < width:
                w[count] = (1.0 - square / width) ** 2
                beside[count, 0], beside[count, 1], beside[count, 2] = d[j, 0], d[j, 1], d[j, 2]
                count += 1
            away[j] = min(away[j], square)
            if away[j] > farthest:
                farthest, following = away[j], j
        _through(beside, w, count, planes, a, memory)
        place = following


@inline
def _cosine(planes: Array, a: int, b: int) -> float:
    return planes[a, 0] * planes[b, 0] + planes[a, 1] * planes[b, 1] + planes[a, 2] * planes[b, 2]


@inline
def _take(planes: Array, at: int, found: Array, a: int, sign: float) -> None:
    for c in range(4):
        planes[at, c] = sign * found[a, c]


@routine
def _choose_two(d: Array, k: int, cut: float, memory: CreaseMemory) -> float:
    """The two candidates, with signs, whose solid lies closest to the neighbours; returns the sum of squares."""
    found, chosen = memory[0], memory[1]
    least, stride = np.inf, max(k // JUDGES, 1)
    one, two, sign_one, sign_two = 0, 0, 1.0, 1.0
    for a in range(CANDIDATES):
        for b in range(a):
            if abs(_cosine(found, a, b)) > BLUNT:
                continue
            convex = concave = up = down = 0.0
            for j in range(0, k, stride):
                p, q = _height(found, a, d, j), _height(found, b, d, j)
                convex += min(max(p, q) ** 2, cut)
                concave += min(min(p, q) ** 2, cut)
                up += min(max(p, -q) ** 2, cut)
                down += min(max(-p, q) ** 2, cut)
            best = min(convex, concave, up, down)
            if best < least:
                least, one, two = best, a, b
                sign_one = 1.0 if best in (convex, up) else -1.0
                sign_two = 1.0 if best in (convex, down) else -1.0
    _take(chosen, 0, found, one, sign_one)
    _take(chosen, 1, found, two, sign_two)
    return least


@routine
def _replace(d: Array, k: int, at: int, cut: float, memory: CreaseMemory) -> float:
    """Replace one of three planes by the candidate with which their solid comes closest; returns the sum of squares."""
    found, chosen = memory[0], memory[1]
    one, two = (at + 1) % 3, (at + 2) % 3
    least, best, sign, stride = np.inf, 0, 1.0, max(k // JUDGES, 1)
    for a in range(CANDIDATES):
        if max(abs(_cos_to(found, a, chosen, one)), abs(_cos_to(found, a, chosen, two))) > BLUNT:
            continue
        up = down = 0.0
        for j in range(0, k, stride):
            p, q = max(_height(chosen, one, d, j), _height(chosen, two, d, j)), _height(found, a, d, j)
            up += min(max(p, q) ** 2, cut)
            down += min(max(p, -q) ** 2, cut)
        if min(up, down) < least:
            least, best, sign = min(up, down), a, 1.0 if up < down else -1.0
    if least < np.inf:
        _take(chosen, at, found, best, sign)
    return least


@routine
def _choose_third(d: Array, k: int, cut: float, memory: CreaseMemory) -> float:
    """The candidate that makes the solid of two planes come closest, then better ones than these two."""
    least = _replace(d, k, 2, cut, memory)
    if least < np.inf:
        for at in range(2):
            least = min(least, _replace(d, k, at, cut, memory))
    return least


@inline
def _cos_to(one: Array, a: int, two: Array, b: int) -> float:
    return one[a, 0] * two[b, 0] + one[a, 1] * two[b, 1] + one[a, 2] * two[b, 2]


@routine
def _highest(planes: Array, count: int, d: Array, j: int) -> tuple[int, float, float]:
    """The plane that neighbour j belongs to, its height over it, and over the next one."""
    which, top, second = 0, -np.inf, -np.inf
    for a in range(count):
        h = _height(planes, a, d, j)
        if h > top:
            which, top, second = a, h, top
        elif h > second:
            second = h
    return which, top, second


@routine
def _refine(d: Array, k: int, count: int, sigma: float, memory: CreaseMemory) -> bool:
    """Fit the planes again to those neighbours that belong to each; False if one of them has too few."""
    chosen, w, owner = memory[1], memory[2], memory[3]
    far = d[k - 1, 0] ** 2 + d[k - 1, 1] ** 2 + d[k - 1, 2] ** 2
    for _ in range(ROUNDS):
        for j in range(k):
            which, top, second = _highest(chosen, count, d, j)
            owner[j] = which if abs(top) < CUT * sigma and second < -APART * sigma else -1
        for a in range(count):
            before = (chosen[a, 0], chosen[a, 1], chosen[a, 2])
            members = 0
            for j in range(k):
                mine = owner[j] == a
                members += 1 if mine else 0
                r = (d[j, 0] ** 2 + d[j, 1] ** 2 + d[j, 2] ** 2) / far
                w[j] = math.exp(-r) if mine else 0.0
            if members < LEAST:
                return False
            _through(d, w, k, chosen, a, memory)
            if chosen[a, 0] * before[0] + chosen[a, 1] * before[1] + chosen[a, 2] * before[2] < 0.0:
                for c in range(4):
                    chosen[a, c] = -chosen[a, c]
    return True


@routine
def _error(d: Array, k: int, count: int, sigma: float, memory: CreaseMemory) -> tuple[float, float, float]:
    """The mean square of the residuals, the height's variance for unit noise, and how many neighbours count."""
    chosen = memory[1]
    far = d[k - 1, 0] ** 2 + d[k - 1, 1] ** 2 + d[k - 1, 2] ** 2
    total = squares = square = 0.0
    for j in range(k):
        _, top, _ = _highest(chosen, count, d, j)
        w = math.exp(-(d[j, 0] ** 2 + d[j, 1] ** 2 + d[j, 2] ** 2) / far)
        total += w
        squares += w * w
        square += w * top * top
    effective = total * total / squares
    return square / total * effective / max(effective - 3.0 * count, 1.0), 3.0 / effective * count, effective


@routine
def crease(d: Array, k: int, sigma: float, memory: CreaseMemory) -> tuple[float, float, float]:
    """Fit planes. Returns what `_error` does; the mean square is inf where there are none."""
    memory[6][0] = 0
    cut = (CUT * sigma) ** 2
    _candidates(d, k, memory)
    two = _choose_two(d, k, cut, memory)
    poor = POOR * sigma * sigma * ((k - 1) // max(k // JUDGES, 1) + 1)
    if two > 2.0 * poor:
        return np.inf, 1.0, 0.0
    three = _choose_third(d, k, cut, memory)
    if min(two, three) > poor:
        return np.inf, 1.0, 0.0
    count = 3 if three < THIRD * two else 2
    if count == 2:
        _choose_two(d, k, cut, memory)
    sound = _refine(d, k, count, sigma, memory)
    if not sound and count == 3:
        count = 2
        _choose_two(d, k, cut, memory)
        sound = _refine(d, k, count, sigma, memory)
    if not sound:
        return np.inf, 1.0, 0.0
    memory[6][0] = count
    return _error(d, k, count, sigma, memory)


@inline
def store_model(memory: CreaseMemory, weight: float, out: Array) -> None:
    """Write the number of planes, and the planes."""
    count = memory[6][0]
    out[0], out[MODEL - 1] = count, weight
    for a in range(count):
        for c in range(4):
            out[1 + 4 * a + c] = memory[1][a, c]


@kernel
def _fit(work: Array, positions: Array, rows: Array, near: Array, errors: Array, out: Array) -> int:
    """Write the best crease of each row to out, if it is better than a quadric.

    errors : (m, 2), noise, and error of the quadric
    """
    positions, near, out = borrow(positions), borrow(near), borrow(out)
    most = near.shape[1]
    d = np.empty((most, 3))
    memory, jets = crease_memory(most), jet_memory(most)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            for j in range(most):
                for c in range(3):
                    d[j, c] = f64(positions[near[i, j], c]) - f64(positions[rows[i], c])
            square, least = f64(errors[i, 0]) ** 2, f64(errors[i, 1]) ** 2
            if most < 2 * LEAST:
                continue
            _, residual, _ = jet(d, most, LINE, jets)
            if residual * residual < FITS * square:
                continue
            apart, variance, points = crease(d, most, math.sqrt(square), memory)
            better = variance * square + DETAIL * max(apart - square, 0.0) < least
            if better and points * (residual * residual - apart) > PROOF * square:
                store_model(memory, (square / max(apart, 0.25 * square)) ** 2, out[i])
        tile = next_tile(work)
    return 0


def fit_creases(positions: Floats, rows: NDArray[np.int64], near: NDArray[np.int32], errors: Floats) -> Floats:
    """The planes around some points, (m, MODEL) float32, zero where there are none that are better than a quadric."""
    out = np.zeros((len(rows), MODEL), np.float32)
    run(_fit, -(-len(rows) // CHUNK), positions, rows, near, errors, out)
    return out
