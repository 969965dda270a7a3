"""Reading splats back from a tree, and its extent."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...base.arrays import Doubles, Floats, Rows
from ...engine.jit import Array, borrow, i64, kernel, next_tile, run
from ...engine.kernels.tree import BLOCK, INV_R2, NODE, NX, PX, WIDTH, Tree

CHUNK = 1 << 14  # splats per tile


class Stored(NamedTuple):
    """Splats read back from a tree.

    rows : (m,) int64, the caller's row of each
    positions, normals : (m, 3) float32
    noise : (m,) float32, standard deviation of the noise that was smoothed away, the largest of each block of four
        splats; None if nothing was smoothed
    """

    rows: Rows
    positions: Floats
    normals: Floats
    noise: Floats | None


@kernel
def _unpack(work: Array, blocks: Array, slots: Array, positions: Array, normals: Array) -> None:
    blocks, slots, positions, normals = borrow(blocks), borrow(slots), borrow(positions), borrow(normals)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(slots))):
            slot = i64(slots[i])
            at = slot // 4 * BLOCK + slot % 4
            for c in range(3):
                positions[i, c], normals[i, c] = blocks[at + PX + 4 * c], blocks[at + NX + 4 * c]
        tile = next_tile(work)


def stored_splats(tree: Tree, by_row: bool = True) -> Stored:
    """Read all splats back from a tree, as new arrays. by_row : in the order of their rows, else as stored"""
    slots = np.flatnonzero(tree.order >= 0)
    rows = tree.order[slots].astype(np.int64)
    if by_row and len(rows):
        slot_of = np.full(rows.max() + 1, -1)
        slot_of[rows] = slots
        rows = np.flatnonzero(slot_of >= 0)
        slots = slot_of[rows]
    positions, normals = np.empty((2, len(slots), 3), np.float32)
    run(_unpack, -(-len(slots) // CHUNK), tree.blocks, slots, positions, normals)
    noise = tree.noise[slots // 4] if tree.noise.size else None
    return Stored(rows, positions, normals, noise)


def radii_of(tree: Tree) -> Floats:
    """Return the support radii of all splats of a tree, (m,), in stored order; rounding has changed them slightly."""
    inverse = tree.blocks.reshape(-1, BLOCK)[:, INV_R2 : INV_R2 + 4].reshape(-1)
    return np.asarray(1.0 / np.sqrt(inverse[tree.order >= 0]))


def find_surface_bounds(tree: Tree) -> Doubles | None:
    """Return the box of everything in a tree that rays can hit, (2, 3): least and greatest x, y, z; None if empty.

    Coordinates are relative to the points' origin.
    """
    root = tree.boxes[:NODE].reshape(2, 3, WIDTH)
    bounds = np.stack([root[0].min(axis=1), root[1].max(axis=1)]).astype(np.float64)
    return bounds if (bounds[0] <= bounds[1]).all() else None


def longest_leaf(tree: Tree) -> int:
    """Return the largest number of blocks that a leaf lists, rounded up to a multiple of 16.

    Threads allocate scratch memory for this number.
    """
    return 16 * int(tree.spans[1::2].max(initial=0))
