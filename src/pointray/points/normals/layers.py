"""Signs of normals in noise and layers: planes through many points agree, and the normals follow the planes around.

Where points scatter by a good part of their spacing, or lie in layers, an edge to a neighbour says little about the
surface, and a quadric through few points is tilted. A plane through 64 points is not, and points moved onto their
planes lie in one layer again. Of 15 range scans of the dragon 0.2% are flipped; with single normals 4.4%.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...jit import Array, borrow, f64, kernel, next_tile, run
from .planes import plane

Floats = NDArray[np.float32]

NOISY = 0.3  # noise in spacings from which planes are asked: range scans 0.38 and 0.51, a layered wall 0.45, Lucy 0.1
SIZE = 64  # points of a plane: with 32, one of four ways to pass signs on left 4% of the dragon's scans flipped
KEPT = 33  # neighbours that signs pass to: a layered wall has 4.1% flipped, with 17 5.1%
AROUND = 17  # planes whose mean direction gives a normal its sign
CHUNK = 1024


@kernel
def _lay(work: Array, positions: Array, rows: Array, near: Array, planes: Array, moved: Array) -> int:
    """Write the normal of the plane through the neighbours of positions[rows[i]], and the point moved onto it."""
    positions, near, planes, moved = borrow(positions), borrow(near), borrow(planes), borrow(moved)
    most = near.shape[1]
    d, w, a, v = np.empty((most, 3)), np.empty(most), np.empty((3, 3)), np.empty((3, 3))
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            r, farthest = rows[i], 1e-300
            for j in range(most):
                w[j] = 0.0
                for c in range(3):
                    d[j, c] = f64(positions[near[i, j], c]) - f64(positions[r, c])
                    w[j] += d[j, c] * d[j, c]
                farthest = max(farthest, w[j])
            total = height = 0.0
            for j in range(most):
                w[j] = math.exp(-w[j] / farthest)
            n = plane(d, w, most, a, v)
            for j in range(most):
                total += w[j]
                height += w[j] * (d[j, 0] * n[0] + d[j, 1] * n[1] + d[j, 2] * n[2])
            for c in range(3):
                planes[r, c] = n[c]
                moved[r, c] = positions[r, c] + height / total * n[c]
        tile = next_tile(work)
    return 0


@kernel
def _sides(work: Array, normals: Array, planes: Array, near: Array, signs: Array) -> int:
    """Write 1 or -1: the sign with which each normal faces the side of the planes around it."""
    normals, planes, near, signs = borrow(normals), borrow(planes), borrow(near), borrow(signs)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(signs))):
            total = 0.0
            for q in range(min(AROUND, near.shape[1])):
                for c in range(3):
                    total += normals[i, c] * planes[near[i, q], c]
            signs[i] = -1 if total < 0.0 else 1
        tile = next_tile(work)
    return 0


class Layers:
    """Planes through the neighbours of points along a Morton curve, for `fit_normals` to fill if the points are noisy.

    Attributes
    ----------
    noisy : bool
        Whether the others are there.
    planes : (n, 3) float32, unit
    moved : (n, 3) float32
        The points, moved onto their planes.
    near : (n, min(KEPT, n)) int32
        Neighbours that signs may pass to.
    """

    def __init__(self, positions: Floats) -> None:
        self._positions, self.noisy = positions, False

    def wanted(self, noise: float) -> int:
        """How many neighbours of each point are wanted, at this noise in spacings; 0: none."""
        if noise < NOISY:
            return 0
        n, self.noisy = len(self._positions), True
        self.planes, self.moved = np.empty_like(self._positions), np.empty_like(self._positions)
        self.near = np.empty((n, min(KEPT, n)), np.int32)
        return SIZE

    def lay(self, part: slice, found: NDArray[np.int32]) -> None:
        """Fit the planes of some points to their neighbours."""
        rows, table = np.arange(part.start, part.start + len(found)), np.ascontiguousarray(found[:, :SIZE])
        run(_lay, -(-len(rows) // CHUNK), self._positions, rows, table, self.planes, self.moved)
        self.near[part] = found[:, : self.near.shape[1]]

    def sides(self, normals: Floats) -> NDArray[np.int8]:
        """Signs, (n,), with which normals face the sides of the planes around them."""
        signs = np.empty(len(normals), np.int8)
        run(_sides, -(-len(signs) // CHUNK), normals, self.planes, self.near, signs)
        return signs
