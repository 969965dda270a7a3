"""Signs of normals in noisy and layered clouds, from planes through many points.

Where noise is a good part of the spacing, or points lie in layers, an edge to a neighbour says little about the
surface, and a quadric through few points is tilted. A plane through 64 points is not, and points moved onto their
planes form one layer again. Signs propagate between planes, and normals follow the planes around them. Of 15 range
scans of the dragon 0.2% are flipped; with single normals 4.4%.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats
from ...engine.jit import Array, borrow, kernel, next_tile, run
from ...engine.simd import store
from .axes import fit_plane
from .fit_batch import LANES, inner, load_point, new_fit_batch
from .jet import store_triple

NOISY = 0.3  # noise in spacings from which planes are used: range scans 0.38 and 0.51, a layered wall 0.45, Lucy 0.1
SIZE = 64  # points of a plane: with 32, one of four variants of propagation left 4% of the dragon's scans flipped
KEPT = 33  # neighbours along which signs propagate: 4.1% of a layered wall are flipped; with 17, 5.1%
AROUND = 17  # planes whose mean direction decides the sign of a normal
CHUNK = 1024


@kernel
def _lay(work: Array, positions: Array, rows: Array, near: Array, planes: Array, moved: Array) -> None:
    """Fit a plane to the neighbours of each row; write its normal, and the point moved onto it.

    work : gives each thread its next tile, 1024 rows
    positions, rows : (n, 3) points, and (m,) the rows to fit
    near : (m, k) nearest neighbours of these rows
    planes, moved : (n, 3) receive the normals, and the moved points, at these rows
    """
    positions, rows, near = borrow(positions), borrow(rows), borrow(near)
    planes, moved = borrow(planes), borrow(moved)
    memory = new_fit_batch(near.shape[1])
    tile = next_tile(work)
    while tile >= 0:
        stop = min((tile + 1) * CHUNK, len(rows))
        for first in range(tile * CHUNK, stop, LANES):
            for lane in range(LANES):
                i = min(first + lane, stop - 1)
                load_point(positions, rows[i], near, i, near.shape[1] - 1, lane, memory)
            plane = fit_plane(near.shape[1], memory)
            store_triple(memory, 0, plane.normal)
            store(memory.results, 3 * LANES, inner(plane.normal, plane.mean))
            for lane in range(min(LANES, stop - first)):
                r, height = rows[first + lane], memory.results[3 * LANES + lane] * memory.units[lane]
                for c in range(3):
                    planes[r, c] = memory.results[LANES * c + lane]
                    moved[r, c] = positions[r, c] + height * planes[r, c]
        tile = next_tile(work)


@kernel
def _sides(work: Array, normals: Array, planes: Array, near: Array, signs: Array) -> None:
    """Write the sign, 1 or -1, with which each normal faces the same side as the planes of its neighbours.

    work : gives each thread its next tile, 1024 rows
    normals, planes : (m, 3) normals, and (n, 3) unit normals of the planes
    near : (m, k) rows of the planes of each point's neighbours
    signs : (m,) int8
    """
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


class Layers:
    """Planes through the neighbours of points in kd order, which show the side of noisy normals.

    Points moved onto planes through 64 neighbours form a single layer, whose normals agree more reliably with those of
    neighbours. `fit_normals` fills it.

    Attributes
    ----------
    noisy : bool
        Whether the points are so noisy that planes are fitted; otherwise the other attributes do not exist.
    planes : (n, 3) float32, unit
        Normals of the planes.
    moved : (n, 3) float32
        Points moved onto their planes.
    near : (n, min(33, n)) int32
        Neighbours of each point, itself first, with whose planes its own is made consistent.
    """

    def __init__(self, positions: Floats) -> None:
        self._positions, self.noisy = positions, False

    def needed(self, noise: float) -> int:
        """Return how many neighbours of each point are needed: 64 if planes are fitted, 0 if the noise is too small.

        noise : standard deviation of the points from the surface, in spacings
        """
        if noise < NOISY:
            return 0
        n, self.noisy = len(self._positions), True
        self.planes, self.moved = np.empty_like(self._positions), np.empty_like(self._positions)
        self.near = np.empty((n, min(KEPT, n)), np.int32)
        return SIZE

    def add_neighbors(self, part: slice, found: NDArray[np.int32]) -> None:
        """Fit planes to the neighbours of some points: `found`, (m, k) rows, of the m points in the range `part`."""
        rows, table = np.arange(part.start, part.start + len(found)), np.ascontiguousarray(found[:, :SIZE])
        run(_lay, -(-len(rows) // CHUNK), self._positions, rows, table, self.planes, self.moved)
        self.near[part] = found[:, : self.near.shape[1]]


def signs_facing(normals: Floats, planes: Floats, near: NDArray[np.int32]) -> NDArray[np.int8]:
    """Return the signs, (m,) of 1 or -1, with which normals face the same side as the planes of their neighbours.

    Parameters
    ----------
    normals : (m, 3) float32
    planes : (n, 3) float32
        Normals of the planes, oriented.
    near : (m, k) int32
        Rows of the planes of each point's neighbours, its own first.
    """
    signs = np.empty(len(normals), np.int8)
    run(_sides, -(-len(signs) // CHUNK), normals, planes, near, signs)
    return signs
