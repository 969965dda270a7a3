"""A ray through the scene: each instance in its own space, the nearest hit of all.

Rays are float64 in the world. In an instance's space they get unit length, start where they enter the model's bounds
(so that a far camera costs no precision) and go on as float32.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inline, routine
from ..records import (
    BOUNDS,
    INSTANCE,
    KIND,
    MODEL,
    MODEL_ROW,
    TO_MODEL,
    lend_world,
    tree_at,
)
from ..scratch import (
    DIRECTION,
    DX,
    END,
    FOUND,
    HEADING,
    HIGH,
    INSTANCE_OF,
    IX,
    LANES,
    LEAF_OF,
    LENGTH,
    LOCAL,
    LOW,
    NEAREST,
    NORMAL,
    NX,
    ORIGIN,
    OX,
    SIDE,
    SIDE_OF,
    SPEED,
    START,
    T_MIN,
    TILE,
    lend_scratch,
    put,
    row,
)
from ..simd import load16, lowest, select, spread16, store
from ..vec import add, dot, length, scale, sub, transform, transform_transposed, triple
from .plane import tile_on_plane
from .surface import ONE, ZERO
from .tile import ALL, bits_of_row, closest_of_tile, coherent, tile_ray
from .traverse import closest, make_ray

NOWHERE = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, -1.0)  # a ray that meets nothing: for places in a tile that are free


@inline
def model_bounds(head):  # type: ignore[no-untyped-def]
    """A model's bounds (lo x y z, hi x y z) in float64, padded against rounding."""
    lows, highs = triple(head, BOUNDS), triple(head, BOUNDS + 3)
    lows = np.float64(lows[0]), np.float64(lows[1]), np.float64(lows[2])
    highs = np.float64(highs[0]), np.float64(highs[1]), np.float64(highs[2])
    x, y, z = abs(lows[0]) + abs(highs[0]), abs(lows[1]) + abs(highs[1]), abs(lows[2]) + abs(highs[2])
    pad = 1e-6 * x, 1e-6 * y, 1e-6 * z
    return sub(lows, pad), add(highs, pad)


@inline
def _clip(span, edges, o, d):  # type: ignore[no-untyped-def]
    """The part of a span of a ray between two planes across an axis, where o and d are its components."""
    inverse = 1.0 / (d if abs(d) > 1e-300 else 1e-300)
    a, b = (edges[0] - o) * inverse, (edges[1] - o) * inverse
    near, far = (a if a < b else b), (b if a < b else a)
    return (near if near > span[0] else span[0]), (far if far < span[1] else span[1])


@inline
def matrix_at(world, at):  # type: ignore[no-untyped-def]
    """An instance's transform from the world to its model: three rows of four."""
    m, k = world.instances, at + TO_MODEL
    return (
        (m[k], m[k + 1], m[k + 2], m[k + 3]),
        (m[k + 4], m[k + 5], m[k + 6], m[k + 7]),
        (m[k + 8], m[k + 9], m[k + 10], m[k + 11]),
    )


@inline
def into_model(matrix, bounds, ray):  # type: ignore[no-untyped-def]
    """A world ray (o, d, t_min, t_max) in model space, from where it enters the bounds on.

    Returns (start, unit direction, low, high, speed): low and high along the unit direction, low > high for a ray
    that misses the bounds; speed is how much longer the direction was. No branches: the rays of a tile go through it
    as vectors.
    """
    d = transform(matrix, ray[1])
    speed = length(d)
    d = scale(d, 1.0 / speed)
    o = transform(matrix, ray[0])
    o = o[0] + matrix[0][3], o[1] + matrix[1][3], o[2] + matrix[2][3]
    span = (ray[2] * speed, ray[3] * speed)
    span = _clip(span, (bounds[0][0], bounds[1][0]), o[0], d[0])
    span = _clip(span, (bounds[0][1], bounds[1][1]), o[1], d[1])
    span = _clip(span, (bounds[0][2], bounds[1][2]), o[2], d[2])
    end = span[1] if (speed > 0.0) & (speed < np.inf) else -np.inf  # else the matrix has squeezed the direction away
    return add(o, scale(d, span[0])), d, span[0], end, speed


@inline
def is_ray(o, d, t_min, t_max):  # type: ignore[no-untyped-def]
    """Whether a ray can hit anything: finite, a direction that is not zero, an interval that is not empty."""
    square = dot(d, d)
    return (square > 0.0) & (square < np.inf) & (dot(o, o) < np.inf) & (t_min <= t_max)


@inline
def _tile_into_model(world, at, head, scratch):  # type: ignore[no-untyped-def]
    """Put the tile's rays into the space of one model; returns those (bits) that meet its bounds.

    No branches but for tiles at the rim of the bounds: the rays go through it as vectors.
    """
    matrix, bounds = matrix_at(world, at), model_bounds(head)
    wide, rows = scratch.world, scratch.model
    for i in range(TILE):
        ray = (row(wide, ORIGIN + i), row(wide, DIRECTION + i), wide[T_MIN + i], wide[NEAREST + i])
        start, d, low, high, speed = into_model(matrix, bounds, ray)
        put(wide, START + i, start)
        put(wide, HEADING + i, d)
        wide[LOW + i], wide[HIGH + i], wide[SPEED + i] = low, high, speed
        rows[LENGTH + i] = np.float32(high - low) if low <= high else -ONE
    meeting = bits_of_row(rows, LENGTH)
    if meeting == 0:
        return meeting
    for i in range(TILE):
        ray = make_ray(row(wide, START + i), row(wide, HEADING + i), 0.0, 1.0)
        put(rows, OX + i, (ray.ox, ray.oy, ray.oz))
        put(rows, DX + i, (ray.dx, ray.dy, ray.dz))
        put(rows, IX + i, (ray.ix, ray.iy, ray.iz))
        rows[END + i], rows[SIDE + i] = rows[LENGTH + i], np.float32(wide[SIDE_OF + i])
        scratch.numbers[FOUND + i] = -1
    if meeting != ALL:
        # Rays that miss the bounds stand where another one does, so that they do not widen the tile.
        first = lowest(meeting)
        for at in range(0, TILE, LANES):
            meet = load16(rows, LENGTH + at) >= ZERO
            for k in range(0, 9 * TILE, TILE):
                store(rows, k + at, select(meet, load16(rows, k + at), spread16(rows[k + first])))
    return meeting


@inline
def _tile_through_model(world, at, scratch):  # type: ignore[no-untyped-def]
    """Nearest hits of the tile's rays with one model, where they are nearer than what was found before."""
    model = np.int64(world.instances[at + MODEL_ROW])
    tree = tree_at(world.table, model)
    if _tile_into_model(world, at, tree.head, scratch) == 0:
        return
    rows, numbers = scratch.model, scratch.numbers
    alone = np.int64(0)
    if coherent(tree.head, rows, 0, TILE):
        alone = closest_of_tile(world.table, model, (0, TILE), scratch)
    else:
        for v in range(0, TILE, LANES):
            if coherent(tree.head, rows, v, v + LANES):
                alone |= closest_of_tile(world.table, model, (v, v + LANES), scratch)
            else:
                alone |= np.int64(0xFFFF) << v
    while alone != 0:
        i = lowest(alone)
        alone &= alone - 1
        if rows[LENGTH + i] >= ZERO:
            hit = closest(world.table, model, tile_ray(rows, i), scratch)
            numbers[FOUND + i] = hit.leaf
            rows[LENGTH + i] = hit.t
            put(rows, NX + i, (hit.nx, hit.ny, hit.nz))
    _keep_nearest(world, at, scratch)


@inline
def _either(first, a, b):  # type: ignore[no-untyped-def]
    """a or b, component by component: no branch."""
    return a[0] if first else b[0], a[1] if first else b[1], a[2] if first else b[2]


@inline
def _keep_nearest(world, at, scratch):  # type: ignore[no-untyped-def]
    """Of the hits in a model keep those that are nearer than what was hit before. No branches: the rays as vectors."""
    matrix, instance = matrix_at(world, at), at // INSTANCE
    wide, rows, numbers = scratch.world, scratch.model, scratch.numbers
    found = False
    for i in range(TILE):
        found |= numbers[FOUND + i] >= 0
    if not found:
        return
    for i in range(TILE):
        t = (wide[LOW + i] + np.float64(rows[LENGTH + i])) / wide[SPEED + i]
        better = (numbers[FOUND + i] >= 0) & (t <= wide[NEAREST + i])
        wide[NEAREST + i] = t if better else wide[NEAREST + i]
        numbers[FOUND + i] = numbers[FOUND + i] if better else -1
    for i in range(TILE):
        n = row(rows, NX + i)
        n = transform_transposed(matrix, (np.float64(n[0]), np.float64(n[1]), np.float64(n[2])))
        n = scale(n, 1.0 / math.sqrt(dot(n, n)))
        x = add(row(wide, START + i), scale(row(wide, HEADING + i), np.float64(rows[LENGTH + i])))
        better = numbers[FOUND + i] >= 0
        old_n, old_x = row(wide, NORMAL + i), row(wide, LOCAL + i)
        put(wide, NORMAL + i, _either(better, n, old_n))
        put(wide, LOCAL + i, _either(better, x, old_x))
    for i in range(TILE):
        if numbers[FOUND + i] >= 0:
            numbers[INSTANCE_OF + i], numbers[LEAF_OF + i] = instance, numbers[FOUND + i]


@inline
def aim(scratch, i, ray):  # type: ignore[no-untyped-def]
    """Ray i of the tile becomes (o, d, t_min, t_max), outside of what it may start on."""
    aim_from(scratch, i, ray, 1.0)


@inline
def aim_from(scratch, i, ray, side):  # type: ignore[no-untyped-def]
    """Ray i of the tile becomes (o, d, t_min, t_max), on one side of the surface that it may start on: +1, -1."""
    wide = scratch.world
    wide[SIDE_OF + i] = side
    put(wide, ORIGIN + i, ray[0])
    put(wide, DIRECTION + i, ray[1])
    wide[T_MIN + i], wide[NEAREST + i] = ray[2], ray[3]


@inline
def _settle(scratch):  # type: ignore[no-untyped-def]
    """Nothing is hit yet; a degenerate ray becomes one that misses everything. No branches: rays as vectors."""
    wide = scratch.world
    for i in range(TILE):
        o, d, t_min, t_max = row(wide, ORIGIN + i), row(wide, DIRECTION + i), wide[T_MIN + i], wide[NEAREST + i]
        good = is_ray(o, d, t_min, t_max)
        put(wide, ORIGIN + i, _either(good, o, (0.0, 0.0, 0.0)))
        put(wide, DIRECTION + i, _either(good, d, (1.0, 0.0, 0.0)))
        wide[T_MIN + i], wide[NEAREST + i] = (t_min if good else 0.0), (t_max if good else -1.0)
    for i in range(TILE):
        scratch.numbers[INSTANCE_OF + i] = -1


@routine
def trace_tile(world, scratch):  # type: ignore[no-untyped-def]
    """The nearest hits of the tile's rays with everything in the scene, for `hits.tile_hit`."""
    # Lent once more: a routine sees that nothing owns this memory only if it is said in it.
    scratch, world = lend_scratch(scratch), lend_world(world)
    _settle(scratch)
    for k in range(world.instances.size // INSTANCE):
        at = k * INSTANCE
        if world.instances[at + KIND] == MODEL:
            _tile_through_model(world, at, scratch)
        else:
            tile_on_plane(world, at, scratch)
