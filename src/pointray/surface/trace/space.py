"""Transform of rays from the world into a model's space: unit direction, origin at the entry into the model's bounds.

So distance costs no precision when rays become float32. The entry does not depend on t_min and t_max, nor do the
samples along the rays (`intersect/march.py`): a shorter ray hits what the whole one does, or nothing. A ray whose
t_min is below 0 enters a whole number of the longest steps before its origin, so that the lattice is the same.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from ...engine.jit import Array, f64, inline
from ...engine.kernels.records import TO_MODEL, World
from ...engine.kernels.tree import BOUNDS
from ...engine.kernels.vec import Vec3, add, length, load3_flat, scale, sub, transform

WorldRay: TypeAlias = tuple[Vec3, Vec3, float, float]  # origin, direction, t_min, t_max
Bounds: TypeAlias = tuple[Vec3, Vec3]  # lo x y z, hi x y z
ToModel: TypeAlias = tuple[Any, Any, Any]  # three rows of four; `vec.transform` reads three of each


@inline
def model_bounds(head: Array) -> Bounds:
    """Return the low and the high corner of a model's bounds in float64, padded against rounding. head : `Tree.head`"""
    lows, highs = load3_flat(head, BOUNDS), load3_flat(head, BOUNDS + 3)
    lows = f64(lows[0]), f64(lows[1]), f64(lows[2])
    highs = f64(highs[0]), f64(highs[1]), f64(highs[2])
    x, y, z = abs(lows[0]) + abs(highs[0]), abs(lows[1]) + abs(highs[1]), abs(lows[2]) + abs(highs[2])
    pad = 1e-6 * x, 1e-6 * y, 1e-6 * z
    return sub(lows, pad), add(highs, pad)


@inline
def _clip(span: tuple[float, float], edges: tuple[float, float], o: float, d: float) -> tuple[float, float]:
    """Clip an interval of t along a ray to the space between two planes across an axis; it is empty if low > high.

    span : (low, high), the interval, as in the result
    edges : the planes' coordinates on the axis
    o, d : components of the ray's origin and direction along the axis
    """
    inverse = 1.0 / (d if abs(d) > 1e-300 else 1e-300)
    a, b = (edges[0] - o) * inverse, (edges[1] - o) * inverse
    near, far = (a if a < b else b), (b if a < b else a)
    return (near if near > span[0] else span[0]), (far if far < span[1] else span[1])


@inline
def matrix_at(world: World, offset: int) -> ToModel:
    """Return an instance's transform from the world to its model: three rows of four.

    offset : of the instance's record in `World.instances`
    """
    m, k = world.instances, offset + TO_MODEL
    return (
        (m[k], m[k + 1], m[k + 2], m[k + 3]),
        (m[k + 4], m[k + 5], m[k + 6], m[k + 7]),
        (m[k + 8], m[k + 9], m[k + 10], m[k + 11]),
    )


@inline
def of_size_one(matrix: ToModel) -> ToModel:
    """Scale the linear part of a transform to components of at most 1, so that transformed vectors do not overflow."""
    most = 0.0
    for r in range(3):
        for c in range(3):
            most = max(most, abs(matrix[r][c]))
    size = 1.0 / most
    a, b, c = matrix[0], matrix[1], matrix[2]
    return (
        (a[0] * size, a[1] * size, a[2] * size, a[3]),
        (b[0] * size, b[1] * size, b[2] * size, b[3]),
        (c[0] * size, c[1] * size, c[2] * size, c[3]),
    )


@inline
def into_model(
    matrix: ToModel, bounds: Bounds, ray: WorldRay, step: tuple[float, float]
) -> tuple[Vec3, Vec3, float, float, float, float]:
    """Transform a world ray (o, d, t_min, t_max) into model space, starting where it enters the bounds.

    No branches: the rays of a tile are processed as vectors.

    matrix : from the world to the model; bounds : low and high corner of the model
    step : the model's longest sample step (0: unknown), and 1 / step

    Returns (start, direction, low, high, speed, begin), where
        `start` is the position where the ray enters the bounds, and `direction` is unit
        `low` and `high` are distances along `direction` from the ray's origin, of `start` and of the ray's end in the
        bounds; low > high if it misses them
        `speed` is the length of the original direction in model space
        `begin` is the distance from `start` to where the ray begins, 0 if that is before `start`
    """
    d = transform(matrix, ray[1])
    speed = length(d)
    d = scale(d, 1.0 / speed)
    o = transform(matrix, ray[0])
    o = o[0] + matrix[0][3], o[1] + matrix[1][3], o[2] + matrix[2][3]
    first = ray[2] * speed
    span = (0.0 if first >= 0.0 else -np.inf, ray[3] * speed)
    span = _clip(span, (bounds[0][0], bounds[1][0]), o[0], d[0])
    span = _clip(span, (bounds[0][1], bounds[1][1]), o[1], d[1])
    span = _clip(span, (bounds[0][2], bounds[1][2]), o[2], d[2])
    low = span[0]
    back = np.floor(low * step[1]) * step[0]
    low = back if (low < 0.0) & (step[0] > 0.0) else low
    begin = first - low if first > low else 0.0
    high = span[1] if first <= span[1] else -np.inf
    end = high if (speed > 0.0) & (speed < np.inf) else -np.inf  # else the direction has underflowed or overflowed
    return add(o, scale(d, low)), d, low, end, speed, begin
