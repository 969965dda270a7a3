"""Triangle mesh of a solid, fine enough to spread points over: surface nets (Gibson 1998), moved onto the surface."""

from __future__ import annotations

from math import ceil, sqrt
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Floats
from ..engine.jit import Array, borrow, inline, kernel, next_tile, run
from .clay import Solid
from .solids import NEARLY, field, settle

BLOCK_EDGE = 8  # cells along a block's edge; blocks far from the surface are skipped whole
PART_EDGE = 2  # cells along the edge of a block's parts; in parts far from the surface only the sign is stored
FAR_INSIDE, FAR_OUTSIDE = -1.0, 1.0  # the field where it is not evaluated

Cell: TypeAlias = tuple[int, int, int]  # position in the grid


class Grid(NamedTuple):
    """Grid of cubic cells around a solid, and the solid's field at the corners of the cells.

    low : (3,) lower corner; cell : edge of a cell
    values : (nx + 1, ny + 1, nz + 1), the field; far from the surface only its sign, as -1 inside and 1 outside
    """

    low: Doubles  # (3,)
    cell: float
    values: Floats  # (nx + 1, ny + 1, nz + 1)


@kernel
def _near(work: Array, solid: Solid, grid: Grid, near: Array) -> None:
    """Mark the blocks of 8 x 8 x 8 grid cells that the surface may pass through.

    near : (blocks along x, y, z) bool, written
    """
    solid, half = borrow(solid), 0.5 * BLOCK_EDGE * grid.cell
    i = next_tile(work)
    while i >= 0:
        for j in range(near.shape[1]):
            for k in range(near.shape[2]):
                x = grid.low[0] + (2 * i + 1) * half
                f = field(solid, x, grid.low[1] + (2 * j + 1) * half, grid.low[2] + (2 * k + 1) * half)
                near[i, j, k] = abs(f) < 2.0 * sqrt(3.0) * half
        i = next_tile(work)


@kernel
def _find_parts(work: Array, solid: Solid, grid: Grid, blocks: Array, near: Array) -> None:
    """Mark the parts of each block that the surface may pass through.

    A block has 8 x 8 x 8 grid cells, a part of it 2 x 2 x 2. At the corners of other parts inside the solid,
    `grid.values` is set to -1.

    blocks : (b, 3) int32, positions of the blocks in units of blocks
    near : (b, 64) bool, written: the marks
    """
    solid, grid, half = borrow(solid), borrow(grid), 0.5 * PART_EDGE * grid.cell
    t = next_tile(work)
    while t >= 0:
        for part in range(near.shape[1]):
            i, j, k = _corner_of(blocks, t, part)
            x, y = grid.low[0] + i * grid.cell + half, grid.low[1] + j * grid.cell + half
            f = field(solid, x, y, grid.low[2] + k * grid.cell + half)
            near[t, part] = abs(f) < 2.0 * sqrt(3.0) * half
            if f < 0.0 and not near[t, part]:
                grid.values[i : i + PART_EDGE + 1, j : j + PART_EDGE + 1, k : k + PART_EDGE + 1] = FAR_INSIDE
        t = next_tile(work)


@inline
def _corner_of(blocks: Array, t: int, part: int) -> Cell:
    """Return the low corner of a part of a block, in cells of the grid.

    A block has 8 x 8 x 8 cells, its 64 parts 2 x 2 x 2 each.

    blocks : (b, 3) positions of the blocks in units of blocks; t : number of the block; part : number of the part
    """
    parts = BLOCK_EDGE // PART_EDGE
    i, j, k = part // (parts * parts), part // parts % parts, part % parts
    return (
        blocks[t, 0] * BLOCK_EDGE + i * PART_EDGE,
        blocks[t, 1] * BLOCK_EDGE + j * PART_EDGE,
        blocks[t, 2] * BLOCK_EDGE + k * PART_EDGE,
    )


@kernel
def _fill(work: Array, solid: Solid, grid: Grid, blocks: Array, near: Array) -> None:
    """Write the field of a solid to `grid.values` at the corners of all cells that the surface may pass through.

    Shared corners may be written twice, with the same number.

    blocks : (b, 3) positions of blocks of 8 x 8 x 8 cells; near : (b, 64) which of their parts to evaluate
    """
    solid, grid = borrow(solid), borrow(grid)
    t = next_tile(work)
    while t >= 0:
        for part in range(near.shape[1]):
            if near[t, part]:
                a, b, c = _corner_of(blocks, t, part)
                for i in range(a, a + PART_EDGE + 1):
                    for j in range(b, b + PART_EDGE + 1):
                        for k in range(c, c + PART_EDGE + 1):
                            if abs(grid.values[i, j, k]) == FAR_OUTSIDE:
                                x, y = grid.low[0] + i * grid.cell, grid.low[1] + j * grid.cell
                                grid.values[i, j, k] = field(solid, x, y, grid.low[2] + k * grid.cell)
        t = next_tile(work)


@inline
def _crossings(values: Array, i: int, j: int, k: int) -> tuple[int, float, float, float]:
    """Return how many edges of a grid cell the surface crosses, and the sums of x, y and z of the crossings.

    The coordinates are relative to the low corner of the cell, in cells.

    values : the field at the corners of the grid; i, j, k : the cell
    """
    count, x, y, z = 0, 0.0, 0.0, 0.0
    for axis in range(3):
        for a in range(2):
            for b in range(2):
                if axis == 0:
                    p, q, r, u, v, w = 0, a, b, 1, 0, 0
                elif axis == 1:
                    p, q, r, u, v, w = a, 0, b, 0, 1, 0
                else:
                    p, q, r, u, v, w = a, b, 0, 0, 0, 1
                f, g = values[i + p, j + q, k + r], values[i + p + u, j + q + v, k + r + w]
                if (f < 0.0) != (g < 0.0):
                    t = f / (f - g)
                    count += 1
                    x, y, z = x + p + t * u, y + q + t * v, z + r + t * w
    return count, x, y, z


@kernel
def _vertices(
    work: Array, solid: Solid, grid: Grid, blocks: Array, first: Array, vertices: Array, numbers: Array
) -> None:
    """Make one vertex for each cell that the surface crosses: the mean of the crossings, moved onto the surface.

    If the array `vertices` is empty, the vertices of each block are only counted.

    blocks : (b, 3) positions of blocks of 8 x 8 x 8 cells
    first : (b,) number of the first vertex of each block; if `vertices` is empty, the counts are added to it
    vertices : (v, 3), written
    numbers : one per grid cell, receives the number of the cell's vertex
    """
    solid, grid = borrow(solid), borrow(grid)
    t = next_tile(work)
    while t >= 0:
        number = first[t]
        for i in range(blocks[t, 0] * BLOCK_EDGE, (blocks[t, 0] + 1) * BLOCK_EDGE):
            for j in range(blocks[t, 1] * BLOCK_EDGE, (blocks[t, 1] + 1) * BLOCK_EDGE):
                for k in range(blocks[t, 2] * BLOCK_EDGE, (blocks[t, 2] + 1) * BLOCK_EDGE):
                    count, x, y, z = _crossings(grid.values, i, j, k)
                    if count == 0:
                        continue
                    if vertices.size > 0:
                        x, y, z = i + x / count, j + y / count, k + z / count
                        x, y, z = grid.low[0] + x * grid.cell, grid.low[1] + y * grid.cell, grid.low[2] + z * grid.cell
                        x, y, z, _ = settle(solid, x, y, z, 1, NEARLY)
                        vertices[number, 0], vertices[number, 1], vertices[number, 2] = x, y, z
                        numbers[i, j, k] = number
                    number += 1
        if vertices.size == 0:
            first[t] = number
        t = next_tile(work)


@inline
def _quad(numbers: Array, a: Cell, b: Cell, c: Cell, d: Cell, flip: bool, faces: Array, count: int) -> int:
    """Make two triangles between the vertices of the four cells around an edge; return the new number of faces.

    Nothing is made if a cell has no vertex, and nothing is written beyond the last row of `faces`.

    numbers : number of each cell's vertex, -1 if it has none; a, b, c, d : the cells, in order around the edge
    flip : whether to reverse the order; count : number of faces so far
    """
    p, q = numbers[a[0], a[1], a[2]], numbers[b[0], b[1], b[2]]
    r, s = numbers[c[0], c[1], c[2]], numbers[d[0], d[1], d[2]]
    if min(min(p, q), min(r, s)) < 0:
        return count
    if flip:
        q, s = s, q
    if count + 2 <= faces.shape[0]:
        faces[count, 0], faces[count, 1], faces[count, 2] = p, q, r
        faces[count + 1, 0], faces[count + 1, 1], faces[count + 1, 2] = p, r, s
    return count + 2


@kernel
def _faces(grid: Grid, blocks: Array, numbers: Array, faces: Array) -> int:
    """Make triangles around every edge of the grid that the surface crosses; return their number.

    It may be larger than the number of rows of `faces`, which then holds only the first of them.

    blocks : (b, 3) positions of blocks of 8 x 8 x 8 cells; numbers : number of each cell's vertex, -1 if it has none
    faces : (f, 3) int32, written
    """
    count = 0
    v = grid.values
    for t in range(blocks.shape[0]):
        for i in range(max(blocks[t, 0] * BLOCK_EDGE, 1), (blocks[t, 0] + 1) * BLOCK_EDGE):
            for j in range(max(blocks[t, 1] * BLOCK_EDGE, 1), (blocks[t, 1] + 1) * BLOCK_EDGE):
                for k in range(max(blocks[t, 2] * BLOCK_EDGE, 1), (blocks[t, 2] + 1) * BLOCK_EDGE):
                    inside = v[i, j, k] < 0.0
                    cell = (i, j, k)
                    if inside != (v[i + 1, j, k] < 0.0):
                        around = ((i, j - 1, k), (i, j - 1, k - 1), (i, j, k - 1))
                        count = _quad(numbers, cell, around[0], around[1], around[2], not inside, faces, count)
                    if inside != (v[i, j + 1, k] < 0.0):
                        around = ((i, j, k - 1), (i - 1, j, k - 1), (i - 1, j, k))
                        count = _quad(numbers, cell, around[0], around[1], around[2], not inside, faces, count)
                    if inside != (v[i, j, k + 1] < 0.0):
                        around = ((i - 1, j, k), (i - 1, j - 1, k), (i, j - 1, k))
                        count = _quad(numbers, cell, around[0], around[1], around[2], not inside, faces, count)
    return count


def mesh_solid(solid: Solid, low: Doubles, high: Doubles, cell: float) -> tuple[Doubles, NDArray[np.int32]]:
    """Return a closed triangle mesh of the solid's surface.

    Parameters
    ----------
    low, high : (3,) float64
        A box that contains the surface, with a margin of a cell.
    cell : float
        Edge of the grid's cells; thinner parts of the solid are lost.

    Returns
    -------
    vertices : (v, 3) float64
        On the surface to about cell^3 or 1e-6, whichever is more.
    faces : (f, 3) int32
        Counterclockwise seen from outside.
    """
    shape = tuple(ceil(float(extent) / (cell * BLOCK_EDGE)) for extent in high - low)
    near = np.empty(shape, np.bool_)
    corners = tuple(BLOCK_EDGE * s + 1 for s in shape)
    grid = Grid(low, cell, np.ones(corners, np.float32))
    run(_near, shape[0], solid, grid, near)
    blocks = np.argwhere(near).astype(np.int32)
    parts = np.empty((len(blocks), (BLOCK_EDGE // PART_EDGE) ** 3), np.bool_)
    run(_find_parts, len(blocks), solid, grid, blocks, parts)
    run(_fill, len(blocks), solid, grid, blocks, parts)
    numbers = np.full(corners, -1, np.int32)
    counts = np.zeros(len(blocks), np.int64)
    run(_vertices, len(blocks), solid, grid, blocks, counts, np.empty((0, 3)), numbers)
    vertices = np.empty((int(counts.sum()), 3))
    run(_vertices, len(blocks), solid, grid, blocks, np.cumsum(counts) - counts, vertices, numbers)
    faces = np.empty((int(2.2 * len(vertices)) + 16, 3), np.int32)
    count = _faces(grid, blocks, numbers, faces)
    if count > len(faces):
        faces = np.empty((count, 3), np.int32)
        _faces(grid, blocks, numbers, faces)
    return vertices, faces[:count].copy()
