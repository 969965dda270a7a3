"""Blue noise on a mesh: dart throwing almost to saturation, in bricks of space that all cores fill in turn.

Bricks of one colour (of eight, like a chessboard in 3D) do not touch, so that neither their order nor the number of
threads changes the result. Random sequential addition saturates at n d^2 / A = 0.6966, d = 0.835 sqrt(A / n) (Feder
1980); a finite number of darts reaches d = 0.79. The last points fill the remaining gaps, as d slowly shrinks.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Floats
from ..engine.jit import Array, borrow, f32, f64, inline, kernel, next_tile, run, u64
from ..engine.kernels.vec import Vec3
from .creases import areas as triangle_areas

FIRST_DISTANCE = 0.79  # in units of sqrt(A / n)
FIRST_ROUNDS, LATER_ROUNDS = 16, 6  # darts per d^2 of the surface
SHRINK = 0.95
ROOM = 1.3  # slots of a brick per expected point

LocalGrid: TypeAlias = tuple[float, float, float, float]  # low corner, 1 / distance


class Bricks(NamedTuple):
    """Triangles of a mesh sorted into bricks (cells of a grid), the units in which points are spread over the mesh.

    corners : (t, 3, 3) triangles, sorted by the brick that contains their centre
    first : (bricks + 1,) first triangle of each brick
    cells : (bricks, 3) grid position; number : (nx, ny, nz) brick at each grid position, or -1
    slot : (bricks + 1,) first of the rows of `points` reserved for each brick
    filled : (bricks,) points in it so far; points : (slots, 3) float32
    low : (3,) lower corner of the grid; edge : of a brick
    margin : how far a triangle may extend out of its brick
    """

    corners: Doubles  # (t, 3, 3) triangles, sorted
    first: NDArray[np.int64]  # (bricks + 1,) first triangle of each brick
    cells: NDArray[np.int64]  # (bricks, 3) grid coordinates
    number: NDArray[np.int32]  # (nx, ny, nz) brick at a grid position, or -1
    slot: NDArray[np.int64]  # (bricks + 1,) first slot of each brick
    filled: NDArray[np.int64]  # (bricks,) points so far
    points: Floats  # (slots, 3)
    low: Doubles  # (3,)
    edge: float
    margin: float  # how far a triangle may extend out of its brick


@inline
def mix(a: int, b: int) -> int:
    """Hash two 64-bit numbers to one (the finalizer of splitmix64), for random numbers that depend on a seed only."""
    z = u64(a) + u64(0x9E3779B97F4A7C15) * (u64(b) + u64(1))
    z = (z ^ (z >> u64(30))) * u64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> u64(27))) * u64(0x94D049BB133111EB)
    return z ^ (z >> u64(31))


@inline
def _unit(word: int, part: int) -> float:
    """Convert one half of a 64-bit hash to a number in [0, 1). part : 0 for the lower half, 1 for the upper"""
    return float((word >> u64(32 * part)) & u64(0xFFFFFFFF)) * (1.0 / 4294967296.0)


@inline
def _is_close(x: float, y: float, z: float, p: int, following: Array, local: Array, square: float) -> bool:
    """Return whether any point in a cell of a grid is closer to a position than a distance.

    p : first point of the cell, -1 if it has none; following : next point of the same cell, -1 at the end
    local : (held, 3) positions of the points in the grid; square : of the distance
    """
    while p >= 0:
        u, v, w = local[p, 0] - x, local[p, 1] - y, local[p, 2] - z
        if u * u + v * v + w * w < square:
            return True
        p = following[p]
    return False


@inline
def _fits(
    x: float,
    y: float,
    z: float,
    grid: LocalGrid,
    dims: int,
    heads: Array,
    following: Array,
    local: Array,
    square: float,
) -> bool:
    """Return whether no point of a grid is closer to a position than the edge of its cells, so that a point fits there.

    grid : (x, y, z of the low corner, 1 / edge); dims : cells along an axis
    heads : first point of each cell, -1 if it has none; following : next point of the same cell, -1 at the end
    local : (held, 3) positions of the points; square : of the least distance, the edge
    """
    i, j = int((x - grid[0]) * grid[3]), int((y - grid[1]) * grid[3])
    k = int((z - grid[2]) * grid[3])
    if _is_close(x, y, z, heads[(i * dims + j) * dims + k], following, local, square):  # most darts fail here
        return False
    for a in range(-1, 2):
        for b in range(-1, 2):
            base = ((i + a) * dims + j + b) * dims + k
            for c in range(base - 1, base + 2):
                if _is_close(x, y, z, heads[c], following, local, square):
                    return False
    return True


@inline
def _neighbor(bricks: Bricks, brick: int, number: int) -> int:
    """Return the brick (cell of a grid) at one of the 27 positions at and around a brick, -1 if there is none.

    number : of the position, 0 to 26
    """
    i = bricks.cells[brick, 0] + number // 9 - 1
    j = bricks.cells[brick, 1] + number // 3 % 3 - 1
    k = bricks.cells[brick, 2] + number % 3 - 1
    nx, ny, nz = bricks.number.shape
    if min(i, min(j, k)) < 0 or i >= nx or j >= ny or k >= nz:
        return -1
    return int(bricks.number[i, j, k])


@inline
def _capacity(bricks: Bricks, brick: int) -> int:
    """Return for how many points a brick (cell of a coarse grid) and its 26 neighbours have rows reserved, together."""
    total = 0
    for number in range(27):
        other = _neighbor(bricks, brick, number)
        if other >= 0:
            total += bricks.slot[other + 1] - bricks.slot[other]
    return total


@inline
def _gather(
    bricks: Bricks, brick: int, grid: LocalGrid, dims: int, heads: Array, following: Array, local: Array
) -> int:
    """Put the points in and around a brick, a cell of a coarse grid, into cells of a fine grid; return their number.

    Points outside the fine grid are left out.

    bricks, brick : all cells of the coarse grid with their points, and the number of one
    grid : (x, y, z of the low corner, 1 / edge of a cell) of the fine grid; dims : its cells along an axis
    heads : first point of each cell, -1 if it has none, updated
    following : next point in the same cell, -1 at the end, written; local : (held, 3) positions, written
    """
    held = 0
    for number in range(27):
        other = _neighbor(bricks, brick, number)
        if other < 0:
            continue
        for p in range(bricks.slot[other], bricks.slot[other] + bricks.filled[other]):
            x, y, z = f64(bricks.points[p, 0]), f64(bricks.points[p, 1]), f64(bricks.points[p, 2])
            u, v, w = (x - grid[0]) * grid[3], (y - grid[1]) * grid[3], (z - grid[2]) * grid[3]
            if min(u, min(v, w)) >= 0.0 and max(u, max(v, w)) < dims:
                held = _insert(x, y, z, (int(u) * dims + int(v)) * dims + int(w), heads, following, local, held)
    return held


@inline
def _insert(x: float, y: float, z: float, cell: int, heads: Array, following: Array, local: Array, held: int) -> int:
    local[held, 0], local[held, 1], local[held, 2] = x, y, z
    following[held] = heads[cell]
    heads[cell] = held
    return held + 1


@inline
def _dart(corners: Array, t: int, word: int) -> Vec3:
    """Return a uniform random point of triangle t, rounded to float32 as it is stored. word : 64 random bits"""
    a, b = sqrt(_unit(word, 0)), _unit(word, 1)
    p, q, r = 1.0 - a, a * (1.0 - b), a * b
    x = p * corners[t, 0, 0] + q * corners[t, 1, 0] + r * corners[t, 2, 0]
    y = p * corners[t, 0, 1] + q * corners[t, 1, 1] + r * corners[t, 2, 1]
    z = p * corners[t, 0, 2] + q * corners[t, 1, 2] + r * corners[t, 2, 2]
    return f64(f32(x)), f64(f32(y)), f64(f32(z))


@kernel
def _throw(work: Array, bricks: Bricks, turn: Array, areas: Array, distance: float, rounds: int, key: int) -> None:
    """Throw darts (random points of the triangles) at some bricks; add those at least `distance` from all other points.

    They are added to `bricks.points`, and counted in `bricks.filled`.

    turn : numbers of the bricks (cells of a grid), which do not touch, so that they can be filled at the same time
    areas : (t,) areas of the triangles
    rounds : number of rounds; in each a triangle gets area / distance^2 darts
    key : seed
    """
    bricks, areas = borrow(bricks), borrow(areas)
    margin = bricks.margin + 1.01 * distance
    dims = int((bricks.edge + 2.0 * margin) / distance) + 3
    heads = np.empty(dims * dims * dims, np.int32)
    square = distance * distance
    number = next_tile(work)
    while number >= 0:
        brick = turn[number]
        grid = (
            bricks.low[0] + bricks.cells[brick, 0] * bricks.edge - margin,
            bricks.low[1] + bricks.cells[brick, 1] * bricks.edge - margin,
            bricks.low[2] + bricks.cells[brick, 2] * bricks.edge - margin,
            1.0 / distance,
        )
        heads[:] = -1
        size = _capacity(bricks, brick)
        local, following = np.empty((size, 3)), np.empty(size, np.int32)
        held = _gather(bricks, brick, grid, dims, heads, following, local)
        free = bricks.slot[brick] + bricks.filled[brick]
        for turn_of in range(rounds):
            for t in range(bricks.first[brick], bricks.first[brick + 1]):
                seed = mix(mix(key, turn_of), t)
                darts = int(areas[t] / square + _unit(seed, 0))
                for dart in range(darts):
                    x, y, z = _dart(bricks.corners, t, mix(seed, dart))
                    if free < bricks.slot[brick + 1] and _fits(x, y, z, grid, dims, heads, following, local, square):
                        u, v, w = (x - grid[0]) * grid[3], (y - grid[1]) * grid[3], (z - grid[2]) * grid[3]
                        cell = (int(u) * dims + int(v)) * dims + int(w)
                        held = _insert(x, y, z, cell, heads, following, local, held)
                        bricks.points[free] = (x, y, z)
                        free += 1
        bricks.filled[brick] = free - bricks.slot[brick]
        number = next_tile(work)


def _lay_bricks(corners: Doubles, areas: Doubles, n: int) -> tuple[Bricks, Doubles]:
    """Sort the triangles into bricks (cells of a grid) of about a thousand points; return them and the areas, sorted.

    corners : (t, 3, 3) triangles; areas : (t,) of these; n : number of points to spread
    """
    spacing = float(np.sqrt(areas.sum() / n))
    centers = corners.mean(axis=1)
    margin = float(np.abs(corners - centers[:, None]).max())
    edge = max(28 * spacing, 3 * margin)
    low = centers.min(axis=0)
    cells = ((centers - low) / edge).astype(np.int64)
    dims = cells.max(axis=0) + 1
    key = np.ravel_multi_index(tuple(cells.T), tuple(dims))
    order = np.argsort(key, kind="stable")
    keys, first = np.unique(key[order], return_index=True)
    number = np.full(dims.prod(), -1, np.int32)
    number[keys] = np.arange(len(keys), dtype=np.int32)
    expected = np.add.reduceat(areas[order], first) / spacing**2
    slot = np.concatenate([[0], np.cumsum((ROOM * expected + 6 * np.sqrt(expected) + 16).astype(np.int64))])
    return Bricks(
        corners[order],
        np.append(first, len(order)),
        np.column_stack(np.unravel_index(keys, tuple(dims))),
        number.reshape(tuple(dims)),
        slot,
        np.zeros(len(keys), np.int64),
        np.empty((int(slot[-1]), 3), np.float32),
        low,
        edge,
        margin,
    ), areas[order]


def _hash(numbers: NDArray[np.int64], key: int) -> NDArray[np.uint64]:
    """Hash numbers to 64 bits, for a random but reproducible order of points. key : seed"""
    z = numbers.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(key)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    return np.asarray(z ^ (z >> np.uint64(27)))


def scatter(corners: Doubles, n: int, seed: int) -> Floats:
    """Spread exactly n points evenly over triangles: blue noise, by throwing darts.

    Parameters
    ----------
    corners : (t, 3, 3) float64
        The triangles.
    n : int
        At least 1.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    (n, 3) float32
        Positions on the triangles.
    """
    bricks, areas = _lay_bricks(corners, triangle_areas(corners), n)
    colors = (bricks.cells & 1) @ np.array([4, 2, 1])
    distance = FIRST_DISTANCE * float(np.sqrt(areas.sum() / n))
    rounds, attempt = FIRST_ROUNDS, 0
    before = bricks.filled.copy()
    while bricks.filled.sum() < n:
        before = bricks.filled.copy()
        for color in range(8):
            turn = np.flatnonzero(colors == color)
            key = u64((seed * 1_000_003 + attempt) % 2**63)
            run(_throw, len(turn), bricks, turn, areas, distance, rounds, key)
        distance, rounds, attempt = distance * SHRINK, LATER_ROUNDS, attempt + 1
    # too many points: only points of the last pass are removed
    added = bricks.filled - before
    start = np.cumsum(added) - added
    late = np.repeat(bricks.slot[:-1] + before - start, added) + np.arange(int(added.sum()))
    excess = int(bricks.filled.sum()) - n
    keep = np.arange(int(bricks.slot[-1])) < np.repeat(bricks.slot[:-1] + bricks.filled, np.diff(bricks.slot))
    keep[late[np.argsort(_hash(late, seed), kind="stable")[:excess]]] = False
    return np.asarray(bricks.points[keep])
