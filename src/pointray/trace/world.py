"""A ray through the scene: each instance in its own space, the nearest hit of all.

Rays are float64 in the world. In an instance's space they get unit length, start where they enter the model's bounds
(so that a far camera costs no precision) and go on as float32.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inline
from ..records import (
    BOUNDS,
    COUNT_OWNER,
    INSTANCE,
    KIND,
    MODEL,
    MODEL_ROW,
    PLANE_CHECKER,
    PLANE_COLOR,
    PLANE_NORMAL,
    PLANE_POINT,
    PLANE_U,
    PLANE_V,
    TO_MODEL,
    Hit,
    WorldHit,
    tree_at,
)
from ..vec import add, dot, length, scale, sub, transform, transform_transposed, triple, unit
from .leaf import gather_near
from .surface import ONE, ZERO, blend
from .traverse import closest, make_ray

WHITE = (1.0, 1.0, 1.0)
ON_PLANE = 1e-7  # share of the coordinates within which a ray starts on a plane


@inline
def no_hit():  # type: ignore[no-untyped-def]
    """What a ray that misses finds."""
    zero = (0.0, 0.0, 0.0)
    return WorldHit(np.inf, zero, zero, -1, np.int64(-1), np.int64(-1), zero)


@inline
def no_model_hit():  # type: ignore[no-untyped-def]
    """What a ray that misses a model finds in it."""
    zero = np.float32(0.0)
    return Hit(np.float32(np.inf), zero, zero, zero, -1)


@inline
def _clip(head, o, d, t_min, t_max):  # type: ignore[no-untyped-def]
    """The part of a ray inside of a model's bounds, padded against rounding; empty where low > high."""
    low, high = t_min, t_max
    for c in range(3):
        a, b = np.float64(head[BOUNDS + c]), np.float64(head[BOUNDS + 3 + c])
        pad = 1e-6 * (abs(a) + abs(b))
        inverse = 1.0 / (d[c] if abs(d[c]) > 1e-300 else 1e-300)
        near, far = (a - pad - o[c]) * inverse, (b + pad - o[c]) * inverse
        low, high = max(low, min(near, far)), min(high, max(near, far))
    return low, high


@inline
def _model_hit(world, at, ray, side, scratch):  # type: ignore[no-untyped-def]
    """(t, hit, tree, start) of a ray (o, d, t_min, t_max) with one model, t in lengths of d; the hit in model space."""
    tree = tree_at(world.table, np.int64(world.instances[at + MODEL_ROW]))
    o = transform(world.instances, at + TO_MODEL, ray[0])
    o = (
        o[0] + world.instances[at + TO_MODEL + 3],
        o[1] + world.instances[at + TO_MODEL + 7],
        o[2] + world.instances[at + TO_MODEL + 11],
    )
    d = transform(world.instances, at + TO_MODEL, ray[1])
    speed = length(d)
    d = scale(d, 1.0 / speed)
    low, high = _clip(tree.head, o, d, ray[2] * speed, ray[3] * speed)
    if not low <= high:
        return np.inf, no_model_hit(), tree, o
    start = add(o, scale(d, low))
    hit = closest(tree, make_ray(start, d, high - low, side), scratch)
    return (low + np.float64(hit.t)) / speed, hit, tree, add(start, scale(d, np.float64(hit.t)))


@inline
def _plane_hit(world, at, ray, side):  # type: ignore[no-untyped-def]
    """t of a ray with a plane; a ray that starts on the plane is on `side` of it."""
    o, d, t_min, t_max = ray
    normal, point = triple(world.instances, at + PLANE_NORMAL), triple(world.instances, at + PLANE_POINT)
    start = add(o, scale(d, t_min))
    height, rise = dot(normal, sub(start, point)), dot(normal, d)
    if abs(height) <= ON_PLANE * (length(start) + length(point)):
        return t_min if rise * side < 0.0 else np.inf
    t = t_min - height / rise
    return t if t >= t_min and t <= t_max else np.inf


@inline
def plane_color(world, at, x):  # type: ignore[no-untyped-def]
    """A plane's colour at a point: plain, or a checker with every other square at half."""
    color = triple(world.instances, at + PLANE_COLOR)
    edge = world.instances[at + PLANE_CHECKER]
    if edge > 0.0:
        v = sub(x, triple(world.instances, at + PLANE_POINT))
        a = math.floor(dot(v, triple(world.instances, at + PLANE_U)) / edge)
        b = math.floor(dot(v, triple(world.instances, at + PLANE_V)) / edge)
        if int(a + b) % 2 != 0:
            return scale(color, 0.5)
    return color


@inline
def is_ray(o, d, t_min, t_max):  # type: ignore[no-untyped-def]
    """Whether a ray can hit anything: finite, a direction that is not zero, an interval that is not empty."""
    square = dot(d, d)
    return square > 0.0 and square < np.inf and dot(o, o) < np.inf and t_min <= t_max


@inline
def closest_in(world, ray, side, scratch):  # type: ignore[no-untyped-def]
    """The nearest hit of a ray (o, d, t_min, t_max) with everything in the scene; a degenerate ray misses.

    On a model its colour and slot are left to `described`.
    """
    best = no_hit()
    o, d, t_min, t_max = ray
    if not is_ray(o, d, t_min, t_max):
        return best
    for i in range(world.instances.size // INSTANCE):
        at = i * INSTANCE
        if world.instances[at + KIND] == MODEL:
            t, hit, tree, local = _model_hit(world, at, (o, d, t_min, t_max), side, scratch)
            if hit.leaf >= 0 and t <= t_max:
                normal = transform_transposed(
                    world.instances, at + TO_MODEL, (np.float64(hit.nx), np.float64(hit.ny), np.float64(hit.nz))
                )
                best = WorldHit(t, unit(normal), WHITE, i, -1, hit.leaf, local)
                scratch.counts[COUNT_OWNER] = i
                t_max = t
        else:
            t = _plane_hit(world, at, (o, d, t_min, t_max), side)
            if t < np.inf:
                normal = triple(world.instances, at + PLANE_NORMAL)
                best = WorldHit(t, normal, plane_color(world, at, add(o, scale(d, t))), i, -1, -1, (0.0, 0.0, 0.0))
                t_max = t
    return best


@inline
def described(world, hit, scratch):  # type: ignore[no-untyped-def]
    """The hit with its colour and the slot of most weight."""
    if hit.leaf < 0:
        return hit
    tree = tree_at(world.table, np.int64(world.instances[hit.instance * INSTANCE + MODEL_ROW]))
    x = (np.float32(hit.local[0]), np.float32(hit.local[1]), np.float32(hit.local[2]))
    if scratch.counts[COUNT_OWNER] != hit.instance:  # the near blocks of another ray or model are listed
        gather_near(tree, hit.leaf, scratch, x, (ONE, ZERO, ZERO), ZERO)
    red, green, blue, slot = blend(tree, scratch, world.tone, x[0], x[1], x[2])
    color = (np.float64(red), np.float64(green), np.float64(blue))
    return WorldHit(hit.t, hit.normal, color, hit.instance, slot, hit.leaf, hit.local)


@inline
def occluded_in(world, ray, side, scratch):  # type: ignore[no-untyped-def]
    """Whether anything in the scene is between t_min and t_max of a ray (o, d, t_min, t_max)."""
    o, d, t_min, t_max = ray
    if not is_ray(o, d, t_min, t_max):
        return False
    for i in range(world.instances.size // INSTANCE):
        at = i * INSTANCE
        if world.instances[at + KIND] == MODEL:
            if _model_hit(world, at, ray, side, scratch)[1].leaf >= 0:
                return True
        elif _plane_hit(world, at, ray, side) < np.inf:
            return True
    return False
