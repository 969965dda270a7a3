"""Which side is outside: the outermost points of a cloud or a group tell, also whether all normals face inwards."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .orientation import Signs, agree

Floats = NDArray[np.float32]

DIRECTIONS = 64  # directions in which the outermost points of a group vote
RIM = 0.01  # share of the points that count as outermost in a direction: single ones are trees, wires and strays
UPWARD = 0.5  # how much more upward normals count: terrain has no outside
SAMPLE = 50_000  # points of a group that are examined
INWARD = 0.95  # share of inward votes of a flipped model: closed scans have 1, a room seen by its scanner 0.81
DEEP = 0.2  # mean of these votes: closed scans have at least 0.36
LARGE = 1000  # points of a group from which its outermost points vote


def even_directions(count: int) -> NDArray[np.float64]:
    """Directions spread evenly over the sphere, (count, 3): a Fibonacci spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (1 + 5**0.5) * np.arange(count)
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


def outward_votes(positions: Floats, normals: Floats) -> NDArray[np.float64]:
    """How far outward the outermost points face in each of `even_directions(DIRECTIONS)`: mean cosines, -1 to 1."""
    step = -(-len(positions) // SAMPLE)
    x, unit = positions[::step].astype(np.float64), normals[::step].astype(np.float64)
    count = max(1, int(RIM * len(x)))
    directions = even_directions(DIRECTIONS)
    votes = np.empty(DIRECTIONS)
    for k, direction in enumerate(directions):
        height = x @ direction
        rim = np.argpartition(height, -count)[-count:]
        votes[k] = (unit[rim] @ direction).mean()
    return votes


def looks_inward(positions: Floats, normals: Floats) -> bool:
    """Whether the outermost points face inwards in all directions, as in a closed model with flipped normals."""
    votes = outward_votes(positions, normals)
    return bool((votes < 0).mean() > INWARD and votes.mean() < -DEEP)


def inward_groups(positions: Floats, normals: Floats, groups: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which groups must be turned, by votes of their outermost points and the mean normal's upward part."""
    sizes = np.bincount(groups)
    inward = np.zeros(len(sizes), np.bool_)
    small = np.flatnonzero(sizes < LARGE)
    if len(small):
        inward[small] = _small_inward(positions, normals, groups, sizes)
    weight = 1 + UPWARD * even_directions(DIRECTIONS)[:, 2]
    for g in np.flatnonzero(sizes >= LARGE):
        rows = np.flatnonzero(groups == g) if len(sizes) > 1 else slice(None)
        out = weight @ outward_votes(positions[rows], normals[rows]) / DIRECTIONS
        inward[g] = out + normals[rows, 2].mean() < 0
    return inward


def _small_inward(
    positions: Floats, normals: Floats, groups: NDArray[np.int64], sizes: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """`inward_groups` for the small ones: there are many, so their sums are taken at once."""
    rows = np.flatnonzero(sizes[groups] < LARGE)
    rows = rows[np.argsort(groups[rows], kind="stable")]
    count = sizes[sizes < LARGE]
    starts = np.cumsum(count) - count
    # The normals times the offsets from the middle, and the upward parts.
    x, unit = positions[rows].astype(np.float64), normals[rows].astype(np.float64)
    x -= np.repeat(np.add.reduceat(x, starts) / count[:, None], count, axis=0)
    out = np.add.reduceat(np.einsum("ij,ij->i", x, unit), starts)
    size = np.sqrt(np.add.reduceat(np.einsum("ij,ij->i", x, x), starts) * count)
    return np.asarray(out + UPWARD * size * np.add.reduceat(unit[:, 2], starts) / count < 0)


def orient(positions: Floats, normals: Floats, near: NDArray[np.int32]) -> Signs:
    """Signs, (n,) int8, so that normals agree with their neighbours' and face outward, or up if there is no outside.

    Positions lie in kd order; parameters are as in `agree`.
    """
    signs, groups = agree(positions, normals, near)
    inward = inward_groups(positions, normals * signs[:, None], groups)
    signs[inward[groups]] *= -1
    return signs
