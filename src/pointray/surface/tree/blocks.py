"""Blocks of four splats, in an order that keeps neighbours together."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats
from ...engine.jit import Array, f32, kernel, next_tile, run
from ...engine.kernels.tree import BLOCK, EMPTY, INV_R2, NX, PX

PER_BLOCK = 4
CHUNK = 4096  # blocks per tile


@kernel
def _fill_blocks(
    work: Array, order: Array, positions: Array, normals: Array, radii: Array, out: tuple[Array, Array]
) -> None:
    """Copy splats into blocks of four and bound each block by a sphere; write both to `out`.

    order : rows of the splats; the first four form block 0, and so on
    out : (blocks, bounds), where
        `blocks` has 28 numbers per block, 7 rows (position x y z, normal x y z, 1 / radius^2) of 4 splats
        `bounds` has 4 numbers per block, centre and radius of a sphere around its splats' supports
    """
    blocks, bounds = out
    tile = next_tile(work)
    while tile >= 0:
        for b in range(tile * CHUNK, min((tile + 1) * CHUNK, bounds.size // 4)):
            count = min(PER_BLOCK, order.size - b * PER_BLOCK)
            for k in range(PER_BLOCK):
                i = order[b * PER_BLOCK + k] if k < count else -1
                for c in range(3):
                    blocks[b * BLOCK + PX + 4 * c + k] = positions[i, c] if i >= 0 else EMPTY
                    blocks[b * BLOCK + NX + 4 * c + k] = normals[i, c] if i >= 0 else f32(0.0)
                blocks[b * BLOCK + INV_R2 + k] = f32(1.0) / (radii[i] * radii[i]) if i >= 0 else f32(1.0)
            for c in range(3):
                least, greatest = np.inf, -np.inf
                for k in range(count):
                    i = order[b * PER_BLOCK + k]
                    least = min(least, positions[i, c] - radii[i])
                    greatest = max(greatest, positions[i, c] + radii[i])
                bounds[b * 4 + c] = 0.5 * (least + greatest)
            radius = 0.0
            for k in range(count):
                i = order[b * PER_BLOCK + k]
                square = 0.0
                for c in range(3):
                    d = positions[i, c] - bounds[b * 4 + c]
                    square += d * d
                radius = max(radius, math.sqrt(square) + radii[i])
            bounds[b * 4 + 3] = radius * (1.0 + 1e-6)
        tile = next_tile(work)


def make_blocks(
    positions: Floats, normals: Floats, radii: Floats, order: NDArray[np.int32], threads: int | None = None
) -> tuple[Floats, Floats]:
    """Pack splats into blocks of four in the given order, and bound each block by a sphere.

    Parameters
    ----------
    positions, normals : (n, 3) float32
    radii : (n,) float32
        Support radii.
    order : (n,) int32
        Rows of the splats, neighbours together.

    Returns
    -------
    blocks : (b * 28,) float32
        For each block 7 rows of 4: x, y and z of position and normal, 1 / radius^2. Empty slots hold a splat far away.
    bounds : (b * 4,) float32
        Centre and radius of spheres that enclose the supports of the blocks' splats.
    """
    count = -(-len(order) // PER_BLOCK)
    blocks = np.empty(count * BLOCK, np.float32)
    bounds = np.empty(count * 4, np.float32)
    run(_fill_blocks, -(-count // CHUNK), order, positions, normals, radii, (blocks, bounds), threads=threads)
    return blocks, bounds
