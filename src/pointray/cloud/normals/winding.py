"""Winding number of a cloud's surface around a position (Barill et al. 2018): 0 outside and 1 inside.

Each point is a dipole. Distant groups of points are approximated by one dipole: the nodes of a binary tree over the kd
order. Aligned ranges of it (tiles) have subtrees of their own. The roots of all tiles, and the points of the tiles near
the queries, are enough to compute the same numbers as from the whole cloud, to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Floats, Rows
from ...engine.jit import Array, borrow, f32, f64, i64, inline, kernel, next_tile, run

Arrays: TypeAlias = tuple[Array, ...]

AREA = 8  # neighbour whose distance gives a point's area
LEAF, LEAVES = 16, 256  # points of a leaf, leaves of a tile
TILE = LEAF * LEAVES
NODES = 2 * LEAVES  # nodes of a tile
FAR = 1.5  # nodes farther than this many radii and a step are one dipole: 2.0 is no better and takes twice as long
SOFT = 0.5  # radius within which a dipole is blurred, in spacings
CHUNK = 256
STACK = 64
NUMBERS = 8  # floats of a node: centre, dipole, radius, area


class Frame(NamedTuple):
    """Coordinates in which winding numbers are computed, so that squares neither overflow nor vanish.

    A winding number is 0 outside a closed surface and 1 inside.

    origin : (3,) float32
    size : largest extent of the cloud, which becomes 1
    """

    origin: Floats
    size: float

    def of(self, positions: Floats) -> Floats:
        """Return positions, (n, 3), relative to the frame's origin and size."""
        placed: Floats = (positions - self.origin) / f32(max(self.size, 1e-30))
        return placed


class Splats(NamedTuple):
    """Points for winding numbers, in whole tiles: ranges of 4,096 points in kd order, fewer in a cloud's last one.

    A winding number is 0 outside a closed surface and 1 inside.

    positions : (n, 3) float32, scaled to an extent of 1
    normals : (n, 3) float32, unit
    spacing : (n,) float32, square roots of the points' areas
    """

    positions: Floats
    normals: Floats
    spacing: Floats


@kernel
def _spacings(work: Array, positions: Array, near: Array, core: int, out: Array) -> None:
    """Write the square roots of the areas that the points from row `core` on stand for, by distances of neighbours.

    work : gives each thread its next tile, 256 points
    positions : (n, 3)
    near : (m, k) rows of the neighbours, each point first
    out : (m,)
    """
    positions, near, out = borrow(positions), borrow(near), borrow(out)
    k = min(AREA, near.shape[1] - 1)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            square = 0.0
            for c in range(3):
                square += (f64(positions[near[i, k], c]) - f64(positions[core + i, c])) ** 2
            out[i] = math.sqrt(math.pi * square / (k + 0.5))
        tile = next_tile(work)


def spacings(positions: Floats, near: NDArray[np.int32], core: int = 0) -> Floats:
    """Return the square roots of the areas, (m,), that the points from row `core` on stand for, by their neighbours.

    near : (m, k) rows of the neighbours, each point first
    """
    out = np.empty(len(near), np.float32)
    run(_spacings, -(-len(out) // CHUNK), positions, near, core, out)
    return out


@inline
def _distance(one: Array, i: int, other: Array, j: int) -> float:
    x, y, z = one[i, 0] - other[j, 0], one[i, 1] - other[j, 1], one[i, 2] - other[j, 2]
    return math.sqrt(x * x + y * y + z * z)


@inline
def _combine(nodes: Array, t: int, one: int, two: int) -> None:
    """Compute node t of a tree of dipoles from its children, nodes `one` and `two`.

    A dipole approximates what distant points contribute to a winding number (0 outside a surface, 1 inside).

    nodes : (m, 8) centre, dipole, radius and area of each node; node t is zero
    """
    for child in (one, two):
        nodes[t, 7] += nodes[child, 7]
        for c in range(3):
            nodes[t, c] += nodes[child, 7] * nodes[child, c]
            nodes[t, 3 + c] += nodes[child, 3 + c]
    for c in range(3):
        nodes[t, c] /= max(nodes[t, 7], 1e-300)
    for child in (one, two):
        if nodes[child, 7] > 0.0:
            nodes[t, 6] = max(nodes[t, 6], nodes[child, 6] + _distance(nodes, child, nodes, t))


@kernel
def _grow(work: Array, positions: Array, normals: Array, spacing: Array, nodes: Array) -> None:
    """Build a tree of dipoles for each tile (4,096 consecutive points).

    The dipole of a node approximates what the points below the node contribute to the winding numbers of distant
    places. The root is node 1, children of node i are 2i and 2i + 1, leaves have 16 points.

    work : gives each thread its next tile
    positions, normals, spacing : (n, 3), (n, 3), and (n,) square roots of the points' areas
    nodes : (tiles * 512, 8) receives centre, dipole, radius and area of each node
    """
    positions, normals, spacing, nodes = borrow(positions), borrow(normals), borrow(spacing), borrow(nodes)
    n, tile = len(positions), next_tile(work)
    while tile >= 0:
        for b in range(LEAVES):
            t, start = tile * NODES + LEAVES + b, tile * TILE + b * LEAF
            stop = min(start + LEAF, n)
            for i in range(start, stop):
                a = spacing[i] * spacing[i]
                nodes[t, 7] += a
                for c in range(3):
                    nodes[t, c] += a * positions[i, c]
                    nodes[t, 3 + c] += a * normals[i, c]
            for c in range(3):
                nodes[t, c] /= max(nodes[t, 7], 1e-300)
            for i in range(start, stop):
                nodes[t, 6] = max(nodes[t, 6], _distance(positions, i, nodes, t))
        for t in range(LEAVES - 1, 0, -1):
            at = tile * NODES
            _combine(nodes, at + t, at + 2 * t, at + 2 * t + 1)
        tile = next_tile(work)


@kernel
def _join_roots(top: Array) -> None:
    """Build the tree of dipoles over all tiles (4,096 consecutive points each) of a cloud, from their roots.

    top : (2^h, 8) nodes, children of node i are 2i and 2i + 1; the last half holds the roots of the tiles
    """
    for t in range(len(top) // 2 - 1, 0, -1):
        _combine(top, t, 2 * t, 2 * t + 1)


def trees_of(splats: Splats) -> Floats:
    """Return the trees of dipoles, each of 512 nodes, for all tiles of 4,096 consecutive points: (tiles * 512, 8).

    The columns are centre, dipole, radius and area. The dipole of a node approximates what the points below it
    contribute to the winding numbers of distant places.
    """
    tiles = -(-len(splats.positions) // TILE)
    nodes = np.zeros((tiles * NODES, NUMBERS), np.float32)
    run(_grow, tiles, *splats, nodes)
    return nodes


def roots_of(splats: Splats) -> Floats:
    """Return the dipoles that stand for all tiles of 4,096 consecutive points, (tiles, 8).

    The columns are centre, dipole, radius and area.
    """
    return trees_of(splats)[1::NODES]


def top_of(roots: Floats) -> Floats:
    """Build the tree of dipoles over all tiles (4,096 consecutive points each) of a cloud, (2^h, 8) nodes.

    roots : (tiles, 8) dipoles of the tiles, see `roots_of`
    """
    leaves = 1 << (len(roots) - 1).bit_length()
    top = np.zeros((2 * leaves, NUMBERS), np.float32)
    top[leaves : leaves + len(roots)] = roots
    _join_roots(top)
    return top


@inline
def _dipole(x: float, y: float, z: float, u: float, v: float, w: float, soft: float) -> float:
    """Return the blurred solid angle of the dipole (u, v, w) at (x, y, z), seen from the origin.

    soft : square of the radius within which it is blurred
    """
    square = x * x + y * y + z * z + soft
    return (x * u + y * v + z * w) / (square * math.sqrt(square))


@inline
def _below(t: int, tops: int, slots: Array, needed: Array) -> int:
    """Return the index of the first child of a node: of the tree of dipoles over all tiles, or of a loaded tile's tree.

    A tile is a range of 4,096 points. For a leaf return -1 minus the index of its first point among the loaded ones; 0
    if there is no child, or its tile is not loaded.

    t : the node; tops : number of nodes of the tree over all tiles, after which those of loaded tiles follow
    slots : (tiles,) index of each tile among the loaded ones, or -1
    needed : (tiles,) receives 1 if the tile is not loaded
    """
    if t >= tops:
        tile, node = (t - tops) // NODES, (t - tops) % NODES
        return t + node if node < LEAVES else -1 - (tile * TILE + (node - LEAVES) * LEAF)
    if 2 * t < tops:
        return 2 * t
    tile = t - tops // 2
    if tile >= len(slots):  # beyond the last tile
        return 0
    slot = i64(slots[tile])
    if slot < 0:
        needed[tile] = 1
        return 0
    return tops + slot * NODES + 2


@kernel
def _wind(work: Array, rows: Array, splats: Arrays, trees: Arrays, step: float, out: Array, needed: Array) -> None:
    """Write the winding numbers a step in front of some points and behind them, both in one traversal.

    They are 0 outside the surface and 1 inside, if the spacings are scaled accordingly.

    Only some tiles, ranges of 4,096 points, are loaded.

    work : gives each thread its next tile, 256 rows
    rows : (m,) indices into the loaded splats
    splats : positions, normals and spacings (square roots of areas) of the points of loaded tiles
    trees : nodes of the tree of dipoles over all tiles, then of those of loaded tiles; (1,) int64 number of the former;
        (tiles,) int32 index of each tile among the loaded ones, or -1
    step : distance in front and behind, in spacings of the point
    out : (m, 2) receives the numbers in front and behind
    needed : (tiles,) int8, set to 1 for tiles that the numbers lack because they are not loaded
    """
    (positions, normals, spacing), (nodes, top, slots) = borrow(splats), borrow(trees)
    rows, out, needed = borrow(rows), borrow(out), borrow(needed)
    tops, n = i64(top[0]), len(positions)
    stack = np.empty(STACK, np.int64)
    share = f32(1.0 / (4.0 * math.pi))
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(rows))):
            r = rows[i]
            h = f32(step) * spacing[r]
            soft = (f32(SOFT) * spacing[r]) ** 2
            p, q, s = positions[r, 0], positions[r, 1], positions[r, 2]
            a, b, c = h * normals[r, 0], h * normals[r, 1], h * normals[r, 2]
            front = behind = f32(0.0)
            stack[0], depth = 1, 1
            while depth > 0:
                depth -= 1
                t = stack[depth]
                x, y, z = nodes[t, 0] - p, nodes[t, 1] - q, nodes[t, 2] - s
                extent = nodes[t, 6] + h
                if x * x + y * y + z * z > f32(FAR * FAR) * extent * extent:
                    u, v, w = nodes[t, 3], nodes[t, 4], nodes[t, 5]
                    front += _dipole(x - a, y - b, z - c, u, v, w, soft)
                    behind += _dipole(x + a, y + b, z + c, u, v, w, soft)
                    continue
                child = _below(t, tops, slots, needed)
                if child > 0:
                    stack[depth], stack[depth + 1] = child, child + 1
                    depth += 2
                elif child < 0:
                    for j in range(-child - 1, min(-child - 1 + LEAF, n)):
                        x, y, z = positions[j, 0] - p, positions[j, 1] - q, positions[j, 2] - s
                        g = spacing[j] * spacing[j]
                        u, v, w = g * normals[j, 0], g * normals[j, 1], g * normals[j, 2]
                        front += _dipole(x - a, y - b, z - c, u, v, w, soft)
                        behind += _dipole(x + a, y + b, z + c, u, v, w, soft)
            out[i, 0], out[i, 1] = share * front, share * behind
        tile = next_tile(work)


class Winding:
    """Winding numbers of a cloud's surface, 0 outside and 1 inside; only tiles of points near the queries are loaded.

    Parameters
    ----------
    top : (m, 8) float32
        Tree of dipoles, which approximate distant points, over all tiles (4,096 points each), see `top_of`.
    tiles : int
        Number of tiles of the cloud.
    read : callable
        Returns the points (`Splats`) of some tiles, given in ascending order.
    """

    def __init__(self, top: Floats, tiles: int, read: Callable[[Rows], Splats]) -> None:
        self._top, self._tiles, self._read = top, tiles, read
        self._loaded = np.zeros(0, np.int64)

    @classmethod
    def of(cls, splats: Splats) -> Winding:
        """Prepare winding numbers (0 outside, 1 inside) of a whole cloud in memory: points with normals and areas."""
        trees, tiles = trees_of(splats), -(-len(splats.positions) // TILE)
        winding = cls(top_of(trees[1::NODES]), tiles, lambda _: splats)
        winding._set_loaded(np.arange(tiles), splats, trees)
        return winding

    def around(self, rows: Rows, step: float) -> Floats:
        """Return the winding numbers `step` point spacings in front of some points and behind them, (m, 2).

        They are 0 outside the surface and 1 inside, if the spacings are scaled accordingly.

        Tiles that are not loaded are read where they are needed.

        rows : (m,) rows of the cloud
        """
        out, needed = np.empty((len(rows), 2), np.float32), np.zeros(self._tiles, np.int8)
        self._load(np.unique(rows // TILE))
        while len(rows):
            local = self._slots[rows // TILE].astype(np.int64) * TILE + rows % TILE
            trees = self._nodes, np.array([len(self._top)]), self._slots
            run(_wind, -(-len(rows) // CHUNK), local, tuple(self._splats), trees, float(step), out, needed)
            if not needed.any():
                break
            self._load(np.flatnonzero(needed))
            needed[:] = 0
        return out

    def _load(self, tiles: Rows) -> None:
        """Load the points of some tiles (numbers of ranges of 4,096 points), unless they are loaded."""
        loaded = np.union1d(self._loaded, tiles)
        if len(loaded) == len(self._loaded):
            return
        splats = self._read(loaded)
        self._set_loaded(loaded, splats, trees_of(splats))

    def _set_loaded(self, loaded: Rows, splats: Splats, trees: Floats) -> None:
        self._loaded, self._splats, self._slots = loaded, splats, np.full(self._tiles, -1, np.int32)
        self._slots[loaded] = np.arange(len(loaded))
        self._nodes = np.concatenate([self._top, trees])
