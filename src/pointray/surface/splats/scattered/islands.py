"""Small groups of points take the class of the points that enclose them: holes of a surface, and plates in a crown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....base.arrays import Floats
from ....engine.jit import Array, borrow, i64, inline, kernel

LINKS = 8  # neighbours of each point
# Links between a group and other points, over all of its own, above which it is enclosed. In scans without normals 90%
# of the surface points classified as scattered are in groups above 0.2; 90% of those in crowns are below 0.12.
CLOSED_IN = 0.2
SPECKS = 8  # smaller groups of scattered points keep their class: isolated points touch everything around them
ISLANDS = 64  # larger groups of surface points keep their class


@inline
def _root(parents: Array, i: int) -> int:
    """Return the root of a point's group (union-find, with path compression). parents : (n,) parent of each point"""
    while parents[i] != i:
        parents[i] = parents[i64(parents[i])]
        i = i64(parents[i])
    return i


@kernel
def _join(surface: Array, near: Array, width: int, parents: Array, sizes: Array, contacts: Array) -> None:
    """Join neighbours of the same class to groups (union-find) and measure how enclosed each group is.

    surface : (n,) class of each point, 1 or 0; near : flat, `width` rows for each point: the point, then its neighbours
    parents : (n,) int32, initially each point itself; becomes the group's root
    sizes : (n,) output, number of points of each group, at the index of its root
    contacts : (n,) output, number of pairs of neighbours with only one in the group, at the index of its root
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


def absorb_islands(surface: Floats, alone: Floats, near: NDArray[np.int32]) -> Floats:
    """Give small groups of points the class of the points that enclose them; return the new class of each point, (n,).

    surface : (n,) class before, 1 for surface points, else 0
    alone : (n,) over 0 for points that never become surface
    near : (n, 17) int32, rows of each point and its nearest neighbours
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
