"""Detection of the outside: votes of the outermost points of a cloud or group; detection of inward normals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles, Flags, Floats, Rows
from ...engine.jit import Array, i64, kernel

Groups = NDArray[np.int32]

DIRECTIONS = 64  # directions in which the outermost points of a group vote
RIM = 0.01  # share of points that count as outermost in a direction: single ones are trees, wires and strays
UPWARD = 0.5  # additional weight of upward normals: terrain has no outside
SAMPLE = 50_000  # points of a group that are examined
INWARD = 0.95  # share of inward votes of an inverted model: closed scans have 1, a room seen by its scanner 0.81
DEEP = 0.2  # mean of these votes: closed scans have at least 0.36
LARGE = 1000  # groups with at least so many points are decided by their outermost points


class Sample(NamedTuple):
    """Points that decide which way groups of consistent normals face: each n-th point of a group, all of a small one.

    groups : (s,) int32, group of each point
    positions : (s, 3) float32
    normals : (s, 3) float32, consistent within each group
    """

    groups: Groups
    positions: Floats
    normals: Floats

    def only(self, rows: Flags) -> Sample:
        """Return the points for which `rows`, (s,) bool, is true."""
        return Sample(self.groups[rows], self.positions[rows], self.normals[rows])


@kernel
def _choose(groups: Array, steps: Array, left: Array, rows: Array) -> int:
    """List each steps[g]-th row of every group g; return the number of rows listed.

    groups : (n,) group of each row
    left : (g,) rows of each group to skip before its first listed row; updated
    rows : receives the rows
    """
    found = 0
    for i in range(len(groups)):
        g = i64(groups[i])
        if left[g] == 0:
            rows[found] = i
            found += 1
            left[g] = steps[g]
        left[g] -= 1
    return found


def even_directions(count: int) -> Doubles:
    """Return unit vectors spread evenly over the sphere, (count, 3): a Fibonacci spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (1 + 5**0.5) * np.arange(count)
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


def outward_votes(positions: Floats, normals: Floats) -> Doubles:
    """Return how far outward the outermost points face in each of 64 directions, (64,): mean cosines, -1 to 1.

    positions, normals : (n, 3); 1% of the points are outermost in a direction
    """
    x, unit = positions.astype(np.float64), normals.astype(np.float64)
    rim = max(1, int(RIM * len(x)))
    votes = np.empty(DIRECTIONS)
    for k, direction in enumerate(even_directions(DIRECTIONS)):
        outermost = np.argpartition(x @ direction, -rim)[-rim:]
        votes[k] = (unit[outermost] @ direction).mean()
    return votes


def looks_inward(positions: Floats, normals: Floats) -> bool:
    """Return whether the outermost points face inward in nearly all directions, as in a model with inverted normals.

    positions, normals : (n, 3)
    """
    step = -(-len(positions) // SAMPLE)
    votes = outward_votes(positions[::step], normals[::step])
    return bool((votes < 0).mean() > INWARD and votes.mean() < -DEEP)


def take_sample(
    positions: Floats,
    normals: Floats,
    signs: NDArray[np.int8],
    groups: Groups,
    sizes: Rows,
    earlier: Rows | None = None,
) -> Sample:
    """Select the points that decide whether groups of consistent normals face outward: each n-th of a large group.

    Parameters
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32, unit
    signs : (n,) int8
        1 or -1, which make the normals consistent within each group.
    groups : (n,) int32
        Group of each point.
    sizes : (g,) int64
        Number of points of each group in the whole cloud.
    earlier : (g,) int64, optional
        Number of points of each group in earlier parts of the cloud. None: the points are the whole cloud.
    """
    steps = -(-sizes // SAMPLE)
    left = np.zeros_like(sizes) if earlier is None else -earlier % steps
    here = sizes if earlier is None else np.bincount(groups, minlength=len(sizes))
    rows = np.empty(int(np.maximum(-(-(here - left) // steps), 0).sum()), np.int64)
    _choose(groups, steps, left, rows)
    return Sample(groups[rows], positions[rows], normals[rows] * signs[rows, None])


def inward_of(samples: Sequence[Sample], sizes: Rows) -> Flags:
    """Return which groups of normals must be inverted, (g,) bool, since their outermost points face inward.

    The mean upward component counts as well: terrain has no outside.

    Parameters
    ----------
    samples : sequence of Sample
        Of the parts of the cloud, in order. A group without points is not inverted.
    sizes : (g,) int64
        Number of points of each group.
    """
    groups, positions, normals = (np.concatenate(arrays) for arrays in zip(*samples, strict=True))
    order = np.argsort(groups, kind="stable")
    found, starts, points = np.unique(groups[order], return_index=True, return_counts=True)
    inward, is_small = np.zeros(len(sizes), np.bool_), sizes[found] < LARGE
    if is_small.any():
        rows = order[sizes[groups[order]] < LARGE]
        inward[found[is_small]] = _small_inward(positions[rows], normals[rows], points[is_small])
    weight = 1 + UPWARD * even_directions(DIRECTIONS)[:, 2]
    for k in np.flatnonzero(~is_small):
        rows = order[starts[k] : starts[k] + points[k]]
        x, unit = positions[rows], normals[rows]
        out = weight @ outward_votes(x, unit) / DIRECTIONS
        inward[found[k]] = out + unit[:, 2].mean(dtype=np.float64) < 0
    return inward


def _small_inward(positions: Floats, normals: Floats, points: Rows) -> Flags:
    """Return which small groups of normals must be inverted, (g,) bool; as there are many, sums are computed at once.

    positions, normals : (s, 3) sorted by group
    points : number of points of each group
    """
    starts = np.cumsum(points) - points
    # Dot products of normals and offsets from the mean, and the upward components.
    x, unit = positions.astype(np.float64), normals.astype(np.float64)
    x -= np.repeat(np.add.reduceat(x, starts) / points[:, None], points, axis=0)
    out = np.add.reduceat(np.einsum("ij,ij->i", x, unit), starts)
    size = np.sqrt(np.add.reduceat(np.einsum("ij,ij->i", x, x), starts) * points)
    return np.asarray(out + UPWARD * size * np.add.reduceat(unit[:, 2], starts) / points < 0)


def inward_groups(positions: Floats, normals: Floats, signs: NDArray[np.int8], groups: Groups) -> Flags:
    """Return which connected groups of normals of a whole cloud face inward and must be inverted, (g,) bool.

    positions, normals : (n, 3)
    signs : (n,) 1 or -1, which make the normals consistent within each group
    groups : (n,) group of each point, numbered from 0
    """
    sizes = np.bincount(groups)
    return inward_of([take_sample(positions, normals, signs, groups, sizes)], sizes)
