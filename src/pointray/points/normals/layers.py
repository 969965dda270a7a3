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
from ...neighbors import neighbor_chunks
from .jets import CHUNK, noise_of
from .orientation import orient
from .planes import plane

Floats = NDArray[np.float32]

NOISY = 0.3  # noise in spacings from which planes are asked: range scans 0.38 and 0.51, a layered wall 0.45, Lucy 0.1
SIZE = 64  # points of a plane: with 32, one of four ways to pass signs on left 4% of the dragon's scans flipped
KEPT = 33  # neighbours that signs pass to: a layered wall has 4.1% flipped, with 17 5.1%
AROUND = 17  # planes whose mean direction gives a normal its sign
SAMPLE = 100_000  # residuals that tell the noise


def is_noisy(residuals: Floats) -> bool:
    """Whether the residuals of `fit_normals` show that points scatter too much for edges between single ones."""
    return noise_of(residuals[:: -(-len(residuals) // SAMPLE)]) >= NOISY


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


def orient_layers(positions: Floats, normals: Floats) -> NDArray[np.int8]:
    """Signs, (n,) int8, as of `orient`, of the normals of noisy or layered points along a Morton curve."""
    n = len(positions)
    planes, moved = np.empty_like(positions), np.empty_like(positions)
    kept = np.empty((n, min(KEPT, n)), np.int32)
    for part, found in neighbor_chunks(positions, SIZE):
        rows = np.arange(part.start, part.start + len(found))
        run(_lay, -(-len(rows) // CHUNK), positions, rows, found, planes, moved)
        kept[part] = found[:, : kept.shape[1]]
    planes *= orient(moved, planes, kept)[:, None]
    signs = np.empty(n, np.int8)
    run(_sides, -(-n // CHUNK), normals, planes, kept, signs)
    return signs
