"""Small groups of points that something else closes in follow it: holes of a surface, and plates in a crown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....engine.jit import Array, borrow, i64, inline, kernel

Floats = NDArray[np.float32]

LINKS = 8  # neighbours of each point
# Links from a group to others and back, over all of its own, from which it is closed in. In scans without normals 90%
# of the points of a surface that were taken for scattered have over 0.2; of crowns, 90% less than 0.12.
CLOSED_IN = 0.2
SPECKS = 8  # scattered points that are fewer stay: strays are in contact with all that is around them
ISLANDS = 64  # surface points that are fewer than that may follow


@inline
def _root(parents: Array, i: int) -> int:
    """The first point of a point's group; shortens the way to it."""
    while parents[i] != i:
        parents[i] = parents[i64(parents[i])]
        i = i64(parents[i])
    return i


@kernel
def _join(surface: Array, near: Array, width: int, parents: Array, sizes: Array, contacts: Array) -> int:
    """Join neighbours of one kind; count each group's points, and its links with the other kind, at its first point.

    near : flat; parents : (n,) int32, every point its own
    """
    surface, near, parents = borrow(surface), borrow(near), borrow(parents)
    sizes, contacts = borrow(sizes), borrow(contacts)
    for i in range(len(parents)):
        a = _root(parents, i)
        for k in range(i * width + 1, i * width + 1 + LINKS):
            j = i64(near[k])
            if surface[i] == surface[j]:
                b = _root(parents, j)
                parents[max(a, b)] = min(a, b)
                a = min(a, b)
    for i in range(len(parents)):
        a = _root(parents, i)
        parents[i] = a
        sizes[a] += 1
    for i in range(len(parents)):
        for k in range(i * width + 1, i * width + 1 + LINKS):
            j = i64(near[k])
            if surface[i] != surface[j]:
                contacts[i64(parents[i])] += 1
                contacts[i64(parents[j])] += 1
    return 0


def follow_around(surface: Floats, alone: Floats, near: NDArray[np.int32]) -> Floats:
    """Return which points are on a surface, after small groups have followed what closes them in.

    surface : (n,) 1 or 0; alone : (n,) over 0: no surface in any case
    near : (n, 17) int32, each point and its nearest neighbours
    """
    if surface.all():
        return surface
    count = len(surface)
    parents = np.arange(count, dtype=np.int32)
    sizes, contacts = np.zeros((2, count), np.int32)
    _join(surface, near.reshape(-1), near.shape[1], parents, sizes, contacts)
    closed_in = contacts > CLOSED_IN * LINKS * sizes
    turns = closed_in & np.where(surface > 0, sizes < ISLANDS, sizes >= SPECKS)
    turned = turns[parents] & ((surface > 0) | (alone == 0))
    return np.asarray(np.where(turned, 1 - surface, surface), np.float32)
