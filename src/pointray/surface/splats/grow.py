"""Candidate splats: grown from a point over its neighbours, nearest first, while the cloud stays near their plane.

A splat stops at the first point that would make the range of heights over its plane exceed twice the error bound, or
whose normal turns away (at a fold, or on the other sheet of a thin plate). It grows from neighbour to neighbour and so
does not jump over gaps (Wu and Kobbelt 2004, section 3).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats, Rows
from ...engine.jit import Array, borrow, f32, i32, inline, kernel, next_tile, run
from ...engine.kernels.vec import Vec3
from .priority_queue import pop, push

AWAY = 0.0  # least cosine of a member's normal with the splat's: 0.5 needs 1.8 times as many splats
SMALL = 0.25  # in error bounds: a splat may always be this wide, as it cannot exceed the bound
MOST = 1 << 16  # maximum number of points in a splat
CHUNK = 256
FIRST_ROUND, GROWTH = 200, 1.1  # rounds of a pool: the first takes 1/200 of the seeds, each next 1.1 times as many


class Cloud(NamedTuple):
    """Points that splats grow over and have to cover: distinct positions in kd order.

    positions, normals : (n, 3) float32; normals are unit vectors
    near : (n, k) int32, rows of the neighbours of each point, nearest first, without the point
    area : (n,) float32, area that each point represents
    radii : (n,) float32, about the distance to the 8th neighbour: a radius with which splats at all points cover the
        surface
    border : (n,) bool, whether the point lies on an open border
    """

    positions: Floats
    normals: Floats
    near: NDArray[np.int32]
    area: Floats
    radii: Floats
    border: Flags


class Splats(NamedTuple):
    """Splats that represent a cloud, and the points that each covers.

    seeds : (m,) int32, row of the centre point of each splat
    starts : (m + 1,) int64, start of each splat's points in `members`, and the end
    members : int32, rows of the covered points, splat by splat, nearest first
    widths : (m,) float32, upper limit of the distance of a splat's points from its centre, which they need not reach;
        the support radius is at least 1.8 times this limit
    """

    seeds: NDArray[np.int32]
    starts: Rows
    members: NDArray[np.int32]
    widths: Floats

    def pick(self, rows: NDArray[Any]) -> Splats:
        """Return the splats of the given rows, (k,) ints, with their points."""
        starts = np.concatenate([[0], np.cumsum(np.diff(self.starts)[rows])])
        members = np.empty(starts[-1], np.int32)
        _gather(self.starts, self.members, np.ascontiguousarray(rows, np.int64), starts, members)
        return Splats(self.seeds[rows], starts, members, self.widths[rows])

    @property
    def owners(self) -> Rows:
        """Index of the splat that covers each point in `members`."""
        return np.repeat(np.arange(len(self.seeds)), np.diff(self.starts))


def join(parts: list[Splats]) -> Splats:
    """Concatenate several sets of splats."""
    counts = np.concatenate([np.diff(part.starts) for part in parts])
    starts = np.concatenate([[0], np.cumsum(counts)])
    seeds, _, members, widths = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Splats(seeds, starts, members, widths)


@kernel
def _gather(starts: Array, members: Array, rows: Array, begins: Array, out: Array) -> None:
    """Copy the covered points of the splats `rows`, splat by splat, to `out`.

    starts, members : start of each splat's covered points in `members`, and the rows of these points
    begins : start of each copy in `out`, and the end
    """
    for i in range(len(rows)):
        first = starts[rows[i]]
        for k in range(begins[i + 1] - begins[i]):
            out[begins[i] + k] = members[first + k]


@inline
def at(rows: Array, i: int) -> Vec3:
    """Return row i of an (n, 3) array as a vector."""
    return rows[i, 0], rows[i, 1], rows[i, 2]


@inline
def _grow_one(
    cloud: Cloud,
    seed: int,
    bounds: tuple[float, float],
    stamp: tuple[Array, int],
    queue: tuple[Array, Array],
    out: Array,
) -> tuple[int, float]:
    """Grow one splat around the point `seed`, from neighbour to neighbour, while its points stay near its plane.

    bounds : largest radius of the splat, and half the largest range of heights of its points over the plane
    stamp : for each point the last splat that visited it, and the number of this splat
    queue : memory for a heap
    out : output, rows of the covered points

    Returns the number of covered points, and the squared distance from the seed of the last point reached.
    """
    keys, rows = queue
    met, mark = stamp
    (px, py, pz), (nx, ny, nz) = at(cloud.positions, seed), at(cloud.normals, seed)
    widest, spread = bounds[0] * bounds[0], 2.0 * bounds[1]
    small, low, high = (SMALL * bounds[1]) ** 2, 0.0, 0.0
    size = push(keys, rows, 0, f32(0.0), seed)
    met[seed] = mark
    count, last = 0, f32(0.0)
    while size > 0 and count < len(out):
        square, j = keys[0], rows[0]
        size = pop(keys, rows, size)
        x, y, z = at(cloud.positions, j)
        a, b, c = at(cloud.normals, j)
        height = (x - px) * nx + (y - py) * ny + (z - pz) * nz
        low, high = min(low, height), max(high, height)
        if square > small and (high - low > spread or a * nx + b * ny + c * nz < AWAY):
            break
        last = square
        if cloud.border[seed] or not cloud.border[j]:  # only border seeds cover border points
            out[count] = j
            count += 1
        for k in range(cloud.near.shape[1]):
            m = cloud.near[j, k]
            if met[m] != mark:
                met[m] = mark
                x, y, z = at(cloud.positions, m)
                square = (x - px) * (x - px) + (y - py) * (y - py) + (z - pz) * (z - pz)
                if square <= widest and size < len(keys):
                    size = push(keys, rows, size, square, m)
    return count, last


@inline
def _with_capacity(array: Array, used: int, more: int) -> Array:
    """Return `array`, of which `used` numbers are in use, or a larger copy if `more` numbers would not fit.

    The copy has at least twice the size.
    """
    if used + more <= len(array):
        return array
    larger = np.empty(2 * len(array) + more, array.dtype)
    larger[:used] = array[:used]
    return larger


@kernel
def _grow(work: Array, cloud: Cloud, seeds: Array, bound: Array, error: float) -> tuple[Array, Array, Array, Array]:
    """Grow splats from seeds, each from neighbour to neighbour while its points stay near its plane.

    seeds : (m,) rows of centre points; bound : (n,) largest radius of a splat at each point
    error : half the largest range of heights of a splat's points over its plane

    Returns four arrays, in the order in which this thread grew the splats:
        index in `seeds` of each splat
        number of points that each covers
        radius of each
        rows of all covered points, splat by splat
    """
    lent, seeds, bound = borrow(cloud), borrow(seeds), borrow(bound)
    met = np.full(len(lent.positions), -1, np.int32)
    queue = np.empty(4 * MOST, np.float32), np.empty(4 * MOST, np.int32)
    one = np.empty(MOST, np.int32)
    which, counts = np.empty(len(seeds), np.int64), np.empty(len(seeds), np.int64)
    radii, members = np.empty(len(seeds), np.float32), np.empty(1 << 16, np.int32)
    done = used = 0
    tile = next_tile(work)
    while tile >= 0:
        for s in range(tile * CHUNK, min((tile + 1) * CHUNK, len(seeds))):
            count, last = _grow_one(lent, seeds[s], (bound[seeds[s]], error), (met, i32(s)), queue, one)
            members = _with_capacity(members, used, count)
            members[used : used + count] = one[:count]
            which[done], counts[done], radii[done] = s, count, math.sqrt(last)
            used += count
            done += 1
        tile = next_tile(work)
    return which[:done].copy(), counts[:done].copy(), radii[:done].copy(), members[:used].copy()


def grow(cloud: Cloud, seeds: NDArray[np.int32], bound: Floats, error: float) -> tuple[Splats, Floats]:
    """Grow a splat around each seed; return the splats and the radius that each reached, (m,).

    seeds : (m,) rows of centre points; bound : (n,) largest radius at each point
    error : half the largest range of heights of a splat's points over its plane
    """
    results = run(_grow, -(-len(seeds) // CHUNK), cloud, seeds, bound, float(error))
    which, counts, radii, members = (np.concatenate(column) for column in zip(*results, strict=True))
    order = np.argsort(which)  # independent of the threads
    starts = np.concatenate([[0], np.cumsum(counts)])
    return Splats(seeds[which], starts, members, bound[seeds[which]]).pick(order), radii[order]


def grow_pool(
    cloud: Cloud, bound: Floats, error: float, times: int, wanted: Flags | None = None
) -> tuple[Splats, Floats]:
    """Grow splats to choose from, until each wanted point lies in at least `times` of them or is the centre of one.

    bound : (n,) largest radius of a splat at each point
    error : half the largest range of heights of a splat's points over its plane
    wanted : (n,) bool, points to cover, default: all

    Returns the splats and their radii (m,). The cost is about n * times, regardless of the size of splats. A splat for
    each point would cost n times their size.
    """
    n = len(cloud.positions)
    rows = np.arange(n, dtype=np.int32) if wanted is None else np.flatnonzero(wanted).astype(np.int32)
    order = np.random.default_rng(len(rows)).permutation(rows)
    cover = np.zeros(n, np.int64)
    parts, first, step = [], 0, max(len(order) // FIRST_ROUND, 4 * CHUNK)
    while first < len(order):
        seeds = order[first : first + step]
        seeds = np.sort(seeds[cover[seeds] < times])
        first, step = first + step, int(GROWTH * step)
        if len(seeds):
            parts.append(grow(cloud, seeds, bound, error))
            cover += np.bincount(parts[-1][0].members, minlength=n)
    return join([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


@kernel
def _grade(work: Array, sizes: Array, cloud: Cloud, slope: float) -> None:
    """Lower sizes, in place, until those of neighbours differ by at most `slope` times their distance.

    sizes : (n,) radii of splats centred at the points of the cloud; the smallest are processed first
    """
    n = len(sizes)
    keys, rows = np.empty(2 * n + 64, np.float32), np.empty(2 * n + 64, np.int32)
    count = 0
    for i in range(n):
        count = push(keys, rows, count, sizes[i], i32(i))
    while count > 0:
        key, i = keys[0], rows[0]
        count = pop(keys, rows, count)
        if key > sizes[i]:
            continue
        px, py, pz = at(cloud.positions, i)
        for k in range(cloud.near.shape[1]):
            j = cloud.near[i, k]
            x, y, z = at(cloud.positions, j)
            distance = math.sqrt((x - px) * (x - px) + (y - py) * (y - py) + (z - pz) * (z - pz))
            size = f32(key + slope * distance)
            if size < sizes[j]:
                sizes[j] = size
                keys, rows = _with_capacity(keys, count, 1), _with_capacity(rows, count, 1)
                count = push(keys, rows, count, size, j)


def grade(sizes: Floats, cloud: Cloud, slope: float) -> Floats:
    """Return sizes (n,) of splats, lowered until those at neighbours differ by at most `slope` times their distance."""
    graded = sizes.copy()
    run(_grade, 1, graded, cloud, slope)
    return graded
