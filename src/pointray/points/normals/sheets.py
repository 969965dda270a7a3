"""Signs where two sheets of a closed surface lie closer together than their points: by winding numbers.

The winding number (Barill et al. 2018) is 0 outside and 1 inside. The numbers a step in front of a point and a step
behind it add up to 1. Around a thin plate the sum is less, as both positions lie outside; around a thin cavity it is
more. A wrong sign of the sheet itself hardly changes that. So a plate's normals must face away from the other sheet,
and a cavity's towards it; the mean direction to the nearest points tells on which side of the normal the other sheet
is. Edges between points cannot tell this, as most of them lead to the other sheet. A flip stays if it brings the
numbers around it closer to 0 and 1. Where the numbers do not decide, the edges do: by then most of the normals that
they lead to are right.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...jit import Array, borrow, f32, f64, inline, kernel, next_tile, run
from .agreement import agreement

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]

AREA = 8  # the neighbour whose distance gives a point's area
LEAF = 16  # points
STEP = 1.5  # spacings in front and behind: 482 rows of the dragon are flipped with 1, 453 with 1.5, without votes
FAR = 1.5  # a node this many times its radius and a step away is one dipole: 2.0 is no better and takes twice as long
SOFT = 0.5  # spacings within which a dipole is blurred
THICK = 0.1  # residual in spacings above which a point may be of two sheets, as may points on a line
SEEDS = 0.03  # upper limit of the share of points examined first, spread evenly over the thick ones
SAMPLE = 500  # points that tell whether there is an inside
CLOSED = 0.97  # share of them whose numbers must add up to 1 within LOOSE, one spacing away: the bunny's raw scans 0.96
LOOSE = 0.4
RINGS = 2  # rings of neighbours around points whose numbers do not add up
CHUNK = 256
STACK = 64


@kernel
def _spacings(work: Array, positions: Array, near: Array, out: Array) -> int:
    """Compute the square roots of the points' areas."""
    positions, near, out = borrow(positions), borrow(near), borrow(out)
    k = min(AREA, near.shape[1] - 1)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            square = 0.0
            for c in range(3):
                square += (f64(positions[near[i, k], c]) - f64(positions[i, c])) ** 2
            out[i] = math.sqrt(math.pi * square / (k + 0.5))
        tile = next_tile(work)
    return 0


@kernel
def _build(positions: Array, normals: Array, spacing: Array, nodes: Array) -> int:
    """Fill a full binary tree over stretches of the curve: centre, dipole, radius, area; children are 2i, 2i + 1."""
    size, n = len(nodes) // 2, len(positions)
    nodes[:] = 0.0
    for b in range(size):
        t = size + b
        for i in range(b * LEAF, min((b + 1) * LEAF, n)):
            a = spacing[i] * spacing[i]
            nodes[t, 7] += a
            for c in range(3):
                nodes[t, c] += a * positions[i, c]
                nodes[t, 3 + c] += a * normals[i, c]
        for c in range(3):
            nodes[t, c] /= max(nodes[t, 7], 1e-300)
        for i in range(b * LEAF, min((b + 1) * LEAF, n)):
            nodes[t, 6] = max(nodes[t, 6], _distance(positions, i, nodes, t))
    for t in range(size - 1, 0, -1):
        for child in (2 * t, 2 * t + 1):
            nodes[t, 7] += nodes[child, 7]
            for c in range(3):
                nodes[t, c] += nodes[child, 7] * nodes[child, c]
                nodes[t, 3 + c] += nodes[child, 3 + c]
        for c in range(3):
            nodes[t, c] /= max(nodes[t, 7], 1e-300)
        for child in (2 * t, 2 * t + 1):
            if nodes[child, 7] > 0.0:
                nodes[t, 6] = max(nodes[t, 6], nodes[child, 6] + _distance(nodes, child, nodes, t))
    return 0


@inline
def _distance(one: Array, i: int, other: Array, j: int) -> float:
    x, y, z = one[i, 0] - other[j, 0], one[i, 1] - other[j, 1], one[i, 2] - other[j, 2]
    return math.sqrt(x * x + y * y + z * z)


@inline
def _dipole(x: float, y: float, z: float, u: float, v: float, w: float, soft: float) -> float:
    """Solid angle of the dipole (u, v, w) seen from (-x, -y, -z), blurred."""
    square = x * x + y * y + z * z + soft
    return (x * u + y * v + z * w) / (square * math.sqrt(square))


@kernel
def _wind(
    work: Array, rows: Array, positions: Array, normals: Array, spacing: Array, nodes: Array, step: float, out: Array
) -> int:
    """Winding numbers a step in front of the points and a step behind, both in one traversal."""
    positions, normals, spacing, nodes = borrow(positions), borrow(normals), borrow(spacing), borrow(nodes)
    size, n = len(nodes) // 2, len(positions)
    stack = np.empty(STACK, np.int64)
    share = f32(1.0 / (4.0 * math.pi))
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            r = rows[i]
            h = f32(step) * spacing[r]
            soft = (f32(SOFT) * spacing[r]) ** 2
            p, q, s = positions[r, 0], positions[r, 1], positions[r, 2]
            a, b, c = h * normals[r, 0], h * normals[r, 1], h * normals[r, 2]
            front = behind = f32(0.0)
            stack[0], top = 1, 1
            while top > 0:
                top -= 1
                t = stack[top]
                x, y, z = nodes[t, 0] - p, nodes[t, 1] - q, nodes[t, 2] - s
                extent = nodes[t, 6] + h
                if x * x + y * y + z * z > f32(FAR * FAR) * extent * extent:
                    u, v, w = nodes[t, 3], nodes[t, 4], nodes[t, 5]
                    front += _dipole(x - a, y - b, z - c, u, v, w, soft)
                    behind += _dipole(x + a, y + b, z + c, u, v, w, soft)
                elif t < size:
                    stack[top], stack[top + 1] = 2 * t, 2 * t + 1
                    top += 2
                else:
                    for j in range((t - size) * LEAF, min((t - size + 1) * LEAF, n)):
                        x, y, z = positions[j, 0] - p, positions[j, 1] - q, positions[j, 2] - s
                        g = spacing[j] * spacing[j]
                        u, v, w = g * normals[j, 0], g * normals[j, 1], g * normals[j, 2]
                        front += _dipole(x - a, y - b, z - c, u, v, w, soft)
                        behind += _dipole(x + a, y + b, z + c, u, v, w, soft)
            out[i, 0], out[i, 1] = share * front, share * behind
        tile = next_tile(work)
    return 0


@kernel
def _sides(work: Array, rows: Array, positions: Array, normals: Array, near: Array, out: Array) -> int:
    """Mean cosine between each point's normal and the directions to its nearest points."""
    positions, normals, near = borrow(positions), borrow(normals), borrow(near)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            r, total = rows[i], 0.0
            for j in near[r, 1:]:
                square = height = 0.0
                for c in range(3):
                    difference = f64(positions[j, c]) - f64(positions[r, c])
                    square += difference * difference
                    height += difference * normals[r, c]
                total += height / math.sqrt(max(square, 1e-300))
            out[i] = total / (near.shape[1] - 1)
        tile = next_tile(work)
    return 0


@kernel
def _votes(work: Array, rows: Array, positions: Array, normals: Array, near: Array, out: Array) -> int:
    """How clearly each normal agrees with its neighbours'."""
    positions, normals, near = borrow(positions), borrow(normals), borrow(near)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            out[i] = 0.0
            for j in near[rows[i], 1:]:
                out[i] += agreement(positions, normals, rows[i], j)
        tile = next_tile(work)
    return 0


class _Field:
    """The winding numbers of a cloud with its current normals."""

    def __init__(self, positions: Floats, normals: Floats, near: NDArray[np.int32]) -> None:
        size = max(float(np.ptp(positions, axis=0).max()), 1e-30)
        self.positions = (positions - positions[0]) / f32(size)  # no square is too large or too small
        self.normals, self.near = normals, near
        self.spacing = np.empty(len(positions), np.float32)
        run(_spacings, -(-len(positions) // CHUNK), self.positions, near, self.spacing)
        leaves = 1 << max(0, (-(-len(positions) // LEAF) - 1).bit_length())
        self.nodes = np.empty((2 * leaves, 8), np.float32)
        self.build()

    def build(self) -> None:
        _build(self.positions, self.normals, self.spacing, self.nodes)

    def around(self, rows: Rows, step: float = STEP) -> Floats:
        """The winding numbers `step` spacings in front and behind, (m, 2)."""
        out = np.empty((len(rows), 2), np.float32)
        tiles = -(-len(rows) // CHUNK)
        run(_wind, tiles, rows, self.positions, self.normals, self.spacing, self.nodes, step, out)
        return out

    def sides(self, rows: Rows) -> Floats:
        """How far in front the nearest points lie: mean cosines, (m,)."""
        return self._ask(_sides, rows)

    def votes(self, rows: Rows) -> Floats:
        """Sums of the neighbours' signed confidence, (m,)."""
        return self._ask(_votes, rows)

    def _ask(self, ask: Any, rows: Rows) -> Floats:
        out = np.empty(len(rows), np.float32)
        run(ask, -(-len(rows) // CHUNK), rows, self.positions, self.normals, self.near, out)
        return out

    def is_closed(self) -> bool:
        """Whether the numbers add up to 1 nearly everywhere; if so, areas are scaled to make the jump 1."""
        rows = np.random.default_rng(0).permutation(len(self.positions))[:SAMPLE]
        front, behind = self.around(np.sort(rows), 1.0).T
        jump = float(np.median(behind - front))
        if jump < 0.5 or (np.abs((front + behind) / jump - 1) < LOOSE).mean() <= CLOSED:
            return False
        front, behind = self.around(np.sort(rows)).T
        self.spacing /= np.sqrt(np.median(behind - front))
        self.build()
        return True


def part_sheets(positions: Floats, normals: Floats, near: NDArray[np.int32], residuals: Floats) -> None:
    """Turn normals of thin plates and cavities, in place.

    Parameters
    ----------
    positions : (n, 3) float32
        In kd order.
    normals : (n, 3) float32, unit
        With signs from the edges.
    near : (n, k) int32
        Rows of the neighbours, the point itself first.
    residuals : (n,) float32
        Residuals of the fits, in spacings; NaN for fits to points on a line.
    """
    thick = np.flatnonzero(~(residuals <= THICK))
    if not len(thick):
        return
    field = _Field(positions, normals, near)
    if not field.is_closed():
        return
    step = math.ceil(len(thick) / (SEEDS * len(residuals)))
    rows = _suspects(field, np.ascontiguousarray(thick[::step]))
    if len(rows):
        _turn(field, rows)


def _suspects(field: _Field, rows: Rows) -> Rows:
    """Rows whose numbers do not add up to 1, with rings of neighbours around them."""
    found, fresh = np.zeros(len(field.positions), np.bool_), rows
    for _ in range(RINGS):
        odd = fresh[np.abs(field.around(fresh).sum(axis=1) - 1) > LOOSE]
        around = np.unique(field.near[odd]).astype(np.int64)  # one signature of _wind
        fresh = around[~found[around]]
        found[fresh] = True
    return np.flatnonzero(found)


def _energy(numbers: Floats) -> Floats:
    """How far the two numbers are from 0 and 1, squared."""
    squares: Floats = np.minimum(numbers**2, (numbers - 1) ** 2)
    return squares[:, 0] + squares[:, 1]


def _turn(field: _Field, rows: Rows) -> None:
    """Turn wrong normals, and back those that bring the numbers no closer to 0 and 1; where unclear, edges vote."""
    before = field.around(rows)
    excess = before.sum(axis=1) - 1
    turned = rows[(np.abs(excess) > LOOSE) & (excess * field.sides(rows) < 0)]
    field.normals[turned] *= -1
    field.build()
    after = field.around(rows)
    gain = np.zeros(len(field.positions), np.float32)
    gain[rows] = _energy(before) - _energy(after)
    back = turned[gain[field.near[turned]].sum(axis=1) <= 0]
    field.normals[back] *= -1
    excess = (before + after).sum(axis=1) / 2 - 1
    unsure = np.union1d(rows[np.abs(excess) <= LOOSE], back)
    field.normals[unsure[field.votes(unsure) < 0]] *= -1
