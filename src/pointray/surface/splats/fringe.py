"""Frayed borders: points that protrude from the outline of a noisy scan, and wide discs along it.

At the outline of an object a scanner measures mixed and grazing returns. Their discs protrude from the surface, singly
or as wide scallops. Only noisy points of clouds with open borders are examined; closed or clean clouds stay unchanged.

- A point protrudes if few of its neighbours lie on a rough sheet with it, while those neighbours share one. Its disc is
  reduced to a small part of those around it.
- A point is on the rim if its neighbours on the sheet leave half of all directions open and its disc is wider than
  those around it, because nothing closes its cell there. Its disc is reduced to their width.

Both are borders from then on, beyond which hits do not count. A crease is no rim: the other side closes its cell.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats
from ...cloud.neighbors import NeighborTree
from ...cloud.statistics import CloudStatistics
from ...engine.jit import Array, borrow, f32, f64, i64, inline, keep_alive, kernel, next_tile, run
from ...engine.kernels.vec import Vec3, dot, load3_flat, sub, tangents
from .borders import insert, widest
from .cells import NEIGHBORS
from .closed import NEAREST
from .gaps import bend
from .medians import medians_around
from .radii import Chosen
from .voronoi import CHUNK, Neighborhood

# Share of border points above which a cloud is open: range scans have 0.0008 to 0.008, closed meshes 4e-5.
OPEN = 5e-4
SHEET, ROUGH = 0.5, 0.3  # rough sheet: least cosine of normals; maximum distance from an arc over the points' distance
HALF = math.pi  # gap in the directions of neighbours at a rim
WIDE = 1.2  # a disc on the rim is wider than this times those around it
FEW, MOST = 6, 10  # neighbours on the sheet, of 20: a protruding point has at most FEW, its neighbours' median is MOST
NONE = 4  # of 8 neighbours; only points with at most this many are examined for protruding
SMALL = 0.4  # disc of a protruding point, in those around it

Rows = NDArray[Any]


@inline
def _on_sheet(positions: Array, normals: Array, i: int, near: Array, axes: tuple[Vec3, Vec3], found: Array) -> int:
    """Write the tangent directions of the neighbours that lie on a rough sheet with point i; return their number.

    Two points are on a rough sheet if their normals are similar and both are near an arc perpendicular to the normals.

    positions, normals : flat; near : row i, then the rows of its neighbours
    axes : two tangents of point i
    found : output, rows turn, x, y, sorted by turn, a number that increases with the angle
    """
    u, v = axes
    count = 0
    for k in range(1, len(near)):
        j = i64(near[k])
        cosine, off = bend(positions, normals, i, j)
        if cosine >= SHEET and off <= ROUGH:
            d = sub(load3_flat(positions, 3 * j), load3_flat(positions, 3 * i))
            count = insert(found, count, dot(d, u), dot(d, v))
    return count


@kernel
def _survey(
    work: Array, cloud: tuple[Array, Array], neighborhood: tuple[Array, Array], counts: Array, out: Array
) -> None:
    """Count the neighbours on a rough sheet with each row; find rims, where these leave half of all directions open.

    Two points are on a rough sheet if their normals are similar and both are near an arc perpendicular to the normals.

    cloud : flat positions and normals
    neighborhood : rows (m,), and each row with its neighbours (m, k)
    counts : (m,) output, number of these neighbours
    out : (m, 3) output, direction of a gap over 180 degrees wide between them, or zero; empty if not needed
    """
    (positions, normals), (rows, near), counts, out = borrow(cloud), borrow(neighborhood), borrow(counts), borrow(out)
    memory = np.empty((near.shape[1], 3))
    found = borrow(memory)
    tile = next_tile(work)
    while tile >= 0:
        for at in range(tile * CHUNK, min((tile + 1) * CHUNK, len(counts))):
            i = i64(rows[at])
            n = load3_flat(normals, 3 * i)
            axes = tangents((f64(n[0]), f64(n[1]), f64(n[2])))
            count = _on_sheet(positions, normals, i, near[at], axes, found)
            counts[at] = f32(count)
            if len(out) > 0:
                gap, middle = widest(found, count)
                for c in range(3):
                    outward = math.cos(middle) * axes[0][c] + math.sin(middle) * axes[1][c] if gap > HALF else 0.0
                    out[at, c] = outward
        tile = next_tile(work)
    keep_alive(memory)


def trim_fringe(
    positions: Floats, normals: Floats, tree: NeighborTree, found: Chosen, noisy: Flags, statistics: CloudStatistics
) -> None:
    """Shrink discs that protrude from the outline of a noisy cloud and mark their points as borders, in place.

    Parameters
    ----------
    positions : (n, 3) float32
        All distinct.
    normals : (n, 3) float32
        Unit normals.
    tree : NeighborTree
        Neighbour search over the positions, made from them in the same order.
    found : Chosen
        Radii and borders, which are changed.
    noisy : (n,) bool
        Mask of noisy points.
    statistics : CloudStatistics
        Of the whole cloud.
    """
    share = statistics.share("open borders", np.any(found.borders, axis=1).astype(np.bool_))
    if share < OPEN or found.near.shape[1] <= NEAREST or len(positions) < 16:
        return
    cloud = np.ascontiguousarray(positions).reshape(-1), np.ascontiguousarray(normals).reshape(-1)
    no_points = Neighborhood(np.empty(0, np.int64), np.empty((0, NEAREST + 1), np.int32))
    around = medians_around(found.radii, normals, found.near, no_points, own=False)
    rows = np.flatnonzero(noisy).astype(np.int32)
    few = _counts(cloud, rows, found.near[rows])[0] <= NONE
    wide = np.flatnonzero(~few & (found.radii[rows] > np.float32(WIDE) * around[rows]))
    # A gap among 20 neighbours is also a gap among the first 8.
    few[wide] = _counts(cloud, rows[wide], found.near[rows[wide]], True)[1].any(axis=1)
    rows = rows[few]
    near = tree.rows_at(NEIGHBORS + 1, positions[rows])
    counts, out = _counts(cloud, rows, near, True)
    some = np.flatnonzero(counts <= FEW)
    beside, which = np.unique(near[some, 1 : NEAREST + 1], return_inverse=True)
    there, _ = _counts(cloud, beside, tree.rows_at(NEIGHBORS + 1, positions[beside]))
    stands = some[np.median(there[which.reshape(len(some), NEAREST)], axis=1) >= MOST]
    rim = np.flatnonzero(out.any(axis=1) & (found.radii[rows] > np.float32(WIDE) * around[rows]))
    found.radii[rows[rim]] = around[rows[rim]]
    found.radii[rows[stands]] = np.float32(SMALL) * around[rows[stands]]
    ends = np.union1d(rim, stands)
    ends = ends[out[ends].any(axis=1) & ~found.borders[rows[ends]].any(axis=1)]
    found.borders[rows[ends]] = out[ends]


def _counts(
    cloud: tuple[Floats, Floats], rows: Rows, near: NDArray[np.int32], directions: bool = False
) -> tuple[Floats, Floats]:
    """Return the number of neighbours on a rough sheet with each row, (m,), and the outward direction at rims.

    Two points are on a rough sheet if their normals are similar and both are near an arc perpendicular to the normals.

    cloud : flat positions and normals
    rows : (m,) the points; near : (m, k) rows of each point and its neighbours
    directions : whether to compute the second result, (m, 3): the middle of the gap where these neighbours leave over
        half of all directions open, else zero. Without it the second result is empty
    """
    counts = np.empty(len(rows), np.float32)
    out = np.zeros((len(rows) if directions else 0, 3), np.float32)
    neighborhood = np.ascontiguousarray(rows, np.int32), np.ascontiguousarray(near)
    if len(rows):
        run(_survey, -(-len(rows) // CHUNK), cloud, neighborhood, counts, out)
    return counts, out
