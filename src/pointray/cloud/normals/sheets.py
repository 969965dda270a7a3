"""Signs where two sheets of a closed surface are closer together than their points, by winding numbers.

The winding number (Barill et al. 2018) is 0 outside and 1 inside. The numbers a step in front of a point and a step
behind it add up to 1. Around a thin plate the sum is less, as both positions are outside; around a thin cavity it is
more. Wrong signs of the sheet itself hardly change that. A plate's normals must face away from the other sheet, a
cavity's towards it; the mean direction to the nearest points shows on which side the other sheet lies. Edges between
points cannot decide this, as most of them lead to the other sheet. A flip is kept if it brings the numbers around it
closer to 0 and 1. Where the numbers do not decide, the edges do: by then most of the neighbouring normals are right.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats, Rows
from ...engine.jit import Array, borrow, f64, kernel, next_tile, run
from .agreement import agreement
from .winding import Frame, Splats, Winding, spacings

STEP = 1.5  # spacings in front and behind: without votes 482 rows of the dragon are flipped with 1, 453 with 1.5
THICK = 0.1  # residual in spacings above which a point may be near two sheets, as may points on a line
SEEDS = 0.03  # greatest share of points examined first, spread evenly over the candidates
SAMPLE = 500  # points that decide whether there is an inside
CLOSED = 0.97  # share of them whose numbers add up to 1 within LOOSE, one spacing away: the bunny's raw scans have 0.96
LOOSE = 0.4
RINGS = 2  # rings of neighbours around points whose numbers do not add up to 1
CHUNK = 256


@kernel
def _sides(work: Array, rows: Array, positions: Array, normals: Array, near: Array, out: Array) -> None:
    """Write the mean cosine, -1 to 1, between each point's normal and the directions to its neighbours.

    It shows on which side of the normal a second sheet lies, to which most neighbours belong.

    work : gives each thread its next tile, 256 rows
    rows : (m,) the points
    positions, normals, near : (n, 3), (n, 3), and (n, k) rows of the neighbours, the point itself first
    out : (m,)
    """
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


@kernel
def _votes(work: Array, rows: Array, positions: Array, normals: Array, near: Array, out: Array) -> None:
    """Write how clearly each normal agrees with those of its neighbours: the sum of signed confidences, -1 to 1 each.

    work : gives each thread its next tile, 256 rows
    rows : (m,) the points
    positions, normals, near : (n, 3), (n, 3), and (n, k) rows of the neighbours, the point itself first
    out : (m,)
    """
    positions, normals, near = borrow(positions), borrow(normals), borrow(near)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            out[i] = 0.0
            for j in near[rows[i], 1:]:
                out[i] += agreement(positions, normals, rows[i], j)
        tile = next_tile(work)


def _evaluate(function: Any, rows: Rows, positions: Floats, normals: Floats, near: NDArray[np.int32]) -> Floats:
    out = np.empty(len(rows), np.float32)
    run(function, -(-len(rows) // CHUNK), rows, positions, normals, near, out)
    return out


def is_thick(residuals: Floats) -> Flags:
    """Return which points may be near two sheets, (n,) bool, as a quadric does not fit their neighbours.

    residuals : (n,) RMS residuals of the fitted quadrics, in spacings; NaN for points on a line
    """
    return ~(residuals <= THICK)


def step_of(thick: int, points: int) -> int:
    """Return the step by which candidates are thinned out, so that winding numbers are needed for at most 3% of points.

    Winding numbers, 0 outside a closed surface and 1 inside, take long to compute.

    thick : number of candidates, points that may be near two sheets
    points : number of all points
    """
    return math.ceil(thick / (SEEDS * points))


def sample_of(points: int) -> Rows:
    """Return the rows of at most 500 random points, ascending, which decide whether a cloud encloses a volume.

    points : number of all points
    """
    chosen = np.random.default_rng(0).choice(points, min(SAMPLE, points), replace=False, shuffle=False)
    return np.sort(chosen).astype(np.int64)


def scale_of(numbers: Floats, farther: Floats) -> float | None:
    """Return the divisor of point spacings that makes winding numbers 0 outside the surface and 1 inside.

    Winding numbers are proportional to the points' areas, the squared spacings. None if the surface encloses no volume.

    numbers : (m, 2) winding numbers one spacing in front of sampled points, and behind them
    farther : (m, 2) the same at 1.5 spacings
    """
    front, behind = numbers.T
    jump = float(np.median(behind - front))
    if jump < 0.5 or (np.abs((front + behind) / jump - 1) < LOOSE).mean() <= CLOSED:
        return None
    return float(np.sqrt(np.median(farther[:, 1] - farther[:, 0])))


def is_odd(numbers: Floats) -> Flags:
    """Return which points, (m,) bool, have winding numbers in front and behind that do not add up to 1.

    The winding number is 0 outside a closed surface and 1 inside. At a single sheet the two add up to 1; at two sheets
    they do not.

    numbers : (m, 2)
    """
    return np.asarray(np.abs(numbers.sum(axis=1) - 1) > LOOSE)


def is_wrong(rows: Rows, numbers: Floats, positions: Floats, normals: Floats, near: NDArray[np.int32]) -> Flags:
    """Return which normals must be flipped, (m,) bool, as the other sheet lies on the wrong side of them.

    In a thin plate it must be behind, in a thin cavity in front; winding numbers (1 inside the surface, 0 outside) tell
    which of these it is.

    rows : (m,) the points
    numbers : (m, 2) their winding numbers in front and behind
    positions, normals, near : (n, 3), (n, 3), and (n, k) rows of the neighbours, the point itself first
    """
    excess = numbers.sum(axis=1) - 1
    return np.asarray((np.abs(excess) > LOOSE) & (excess * _evaluate(_sides, rows, positions, normals, near) < 0))


def energy(numbers: Floats) -> Floats:
    """Return the summed squared distances of winding numbers in front and behind, (m, 2), from the nearer of 0 and 1.

    The winding number is 1 inside a closed surface and 0 outside; normals with the right signs give small values.
    """
    squares: Floats = np.minimum(numbers**2, (numbers - 1) ** 2)
    return squares[:, 0] + squares[:, 1]


def is_unsure(before: Floats, after: Floats) -> Flags:
    """Return where winding numbers do not decide whether a normal should be flipped, (m,) bool.

    A winding number is 1 inside a closed surface and 0 outside.

    before, after : (m, 2) winding numbers in front of the points and behind, before and after flipping the normals
    """
    return np.asarray(np.abs((before + after).sum(axis=1) / 2 - 1) <= LOOSE)


def disagrees(rows: Rows, positions: Floats, normals: Floats, near: NDArray[np.int32]) -> Flags:
    """Return which normals, (m,) bool, contradict those of their neighbours.

    The signed confidences, -1 to 1, that a normal and each of these face the same side add up to less than 0.

    rows : (m,) the points
    positions, normals, near : (n, 3), (n, 3), and (n, k) rows of the neighbours, the point itself first
    """
    return np.asarray(_evaluate(_votes, rows, positions, normals, near) < 0)


class _Field:
    """Winding numbers of a whole cloud with its current normals: 0 outside the surface and 1 inside."""

    def __init__(self, positions: Floats, normals: Floats, near: NDArray[np.int32]) -> None:
        frame = Frame(positions[0], float(np.ptp(positions, axis=0).max()))
        self.positions, self.normals, self.near = frame.of(positions), normals, near
        self._spacing = spacings(self.positions, near)
        self.update()

    def update(self) -> None:
        """Rebuild the tree of dipoles, from which winding numbers are summed, with the current normals."""
        self._winding = Winding.of(Splats(self.positions, self.normals, self._spacing))

    def around(self, rows: Rows, step: float = STEP) -> Floats:
        """Return the winding numbers `step` spacings in front of some points and behind them, (m, 2).

        They are 0 outside the surface and 1 inside, once `is_closed` has scaled them.

        rows : (m,) the points
        """
        return self._winding.around(rows, step)

    def is_closed(self) -> bool:
        """Return whether the surface encloses a volume; if so, scale winding numbers to 0 outside and 1 inside.

        It does if the numbers in front of sampled points and behind them add up to 1 nearly everywhere.
        """
        rows = sample_of(len(self.positions))
        scale = scale_of(self.around(rows, 1.0), self.around(rows))
        if scale is None:
            return False
        self._spacing /= np.float32(scale)
        self.update()
        return True


def orient_thin_sheets(positions: Floats, normals: Floats, near: NDArray[np.int32], residuals: Floats) -> None:
    """Flip normals, in place, that face the wrong way where two sheets of a closed surface are close together.

    Neighbours are no guide in such plates and cavities, as many belong to the other sheet. Winding numbers (0 outside
    the surface, 1 inside) decide.

    Parameters
    ----------
    positions : (n, 3) float32
        In kd order.
    normals : (n, 3) float32, unit
        Oriented by those of neighbours.
    near : (n, k) int32
        Rows of the neighbours, the point itself first.
    residuals : (n,) float32
        Residuals of the fits, in spacings; NaN for points on a line.
    """
    thick = np.flatnonzero(is_thick(residuals))
    if not len(thick):
        return
    field = _Field(positions, normals, near)
    if not field.is_closed():
        return
    rows = _suspects(field, np.ascontiguousarray(thick[:: step_of(len(thick), len(residuals))]))
    if len(rows):
        _turn(field, rows)


def _suspects(field: _Field, rows: Rows) -> Rows:
    """Return the rows of points at which winding numbers show two sheets, and of their neighbours.

    At a single sheet, the numbers in front of the point and behind it are 0 and 1.

    rows : (m,) candidates
    """
    found, fresh = np.zeros(len(field.positions), np.bool_), rows
    for _ in range(RINGS):
        odd = fresh[is_odd(field.around(fresh))]
        around = np.unique(field.near[odd]).astype(np.int64)  # int64: keeps a single signature of _wind
        fresh = around[~found[around]]
        found[fresh] = True
    return np.flatnonzero(found)


def _turn(field: _Field, rows: Rows) -> None:
    """Flip wrong normals of some rows, in place, by winding numbers (0 outside the surface, 1 inside).

    Flips that bring the numbers of the point and its neighbours no closer to 0 and 1 are undone. Where the numbers do
    not decide, normals follow those of neighbours.
    """
    before = field.around(rows)
    turned = rows[is_wrong(rows, before, field.positions, field.normals, field.near)]
    field.normals[turned] *= -1
    field.update()
    after = field.around(rows)
    gain = np.zeros(len(field.positions), np.float32)
    gain[rows] = energy(before) - energy(after)
    back = turned[gain[field.near[turned]].sum(axis=1) <= 0]
    field.normals[back] *= -1
    unsure = np.union1d(rows[is_unsure(before, after)], back)
    field.normals[unsure[disagrees(unsure, field.positions, field.normals, field.near)]] *= -1
