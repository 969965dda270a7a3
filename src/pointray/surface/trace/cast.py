"""Intersection of batches of rays on all cores, with two entry points: closest hit and occlusion."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ...base.arrays import Flags
from ...engine.jit import Array, borrow, f32, i64, inline, keep_alive, kernel, next_tile, run
from ...engine.kernels import scratch as sc
from ...engine.kernels.records import INSTANCE, SHAPE_ROW, World
from ...engine.kernels.scratch import Scratch, load3, new_scratch, store3
from ...engine.kernels.tree import SCATTERED, tree_at
from ...engine.kernels.vec import Vec3, add, along_curve, dot, load3_flat, scale
from ...engine.simd import lane
from ..intersect.gather import list_blocks, segment
from ..intersect.surface import weights_of_block
from .hits import describe_tile, tile_hit
from .world import NO_RAY, is_blocked, occlude_tile, set_ray, trace_tile

SHORT, LONG = 1e-60, 1e60  # limits of a direction's squared length, see `_exponent`
MOST = float(np.finfo(np.float32).max)
BATCH, SQUARE = 1024, 32  # rays that a thread takes at a time; in an image they form a square of this edge


class Pace(NamedTuple):
    """Number of threads and progress callback for tracing a batch of rays.

    threads : number of threads; None for all cores
    progress : called with the share done, about ten times a second; an exception in it ends the work
    """

    threads: int | None = None
    progress: Callable[[float], Any] | None = None


PLAIN = Pace()

HitArrays: TypeAlias = tuple[Array, Array, Array, Array, Array, Array, Array, Array]


@inline
def ray_at(shape: tuple[int, int], batch: int, k: int) -> int:
    """Return the index of ray k of a batch of 1,024 rays, or -1 if there is none. k : 0 to 1023

    shape : height and width of an image, in which each batch is a square that follows a Morton curve, so that
        consecutive rays are close together; or 1 and the number of rays, which keep their order
    """
    height, width = shape
    if height == 1:
        i = batch * BATCH + k
        return i if i < width else -1
    across = (width + SQUARE - 1) // SQUARE
    x, y = along_curve(k)
    x, y = x + batch % across * SQUARE, y + batch // across * SQUARE
    return y * width + x if x < width and y < height else -1


def batches(shape: tuple[int, int]) -> int:
    """Return the number of batches of up to 1,024 rays into which an image, or a row of rays, is divided.

    shape : height and width of an image; or 1 and the number of rays
    """
    height, width = shape
    return -(-width // BATCH) if height == 1 else -(-height // SQUARE) * -(-width // SQUARE)


@inline
def _is_ordinary(square: float) -> bool:
    """Return whether a direction of this squared length is traced unchanged, being neither too short nor too long."""
    return (SHORT < square) & (square < LONG)


@inline
def _exponent(d: Vec3) -> int:
    """Return the exponent of the power of two that divides a direction d before tracing, to make its square finite.

    It is 0 for lengths from 1e-30 to 1e30, and for directions that are zero or not finite: they miss.
    """
    square = dot(d, d)
    most = max(abs(d[0]), max(abs(d[1]), abs(d[2])))
    known = (most > 0.0) & (square == square) & (most < np.inf)
    return math.frexp(most)[1] if known and not _is_ordinary(square) else 0


@inline
def _times_power(a: Vec3, exponent: int) -> Vec3:
    """Multiply a vector by 2 ** exponent in two halves, because the power itself may exceed float64."""
    half = exponent // 2
    a = scale(a, math.ldexp(1.0, half))
    return scale(a, math.ldexp(1.0, exponent - half))


@inline
def _set_rays(
    rays: tuple[Array, Array, Array], shape: tuple[int, int], start: tuple[int, int], scratch: Scratch
) -> bool:
    """Copy the next tile of rays to `scratch`; return whether any direction was scaled to make its square finite.

    rays : origins (n * 3,), directions (n * 3,), limits (n * 2,), the last t_min and t_max
    shape : height and width of the image that the rays form; or 1 and n
    start : number of the batch, and offset of the tile in it
    """
    origins, directions, limits = rays
    for k in range(sc.TILE):
        i = ray_at(shape, start[0], start[1] + k)
        if i >= 0:
            o, d = load3_flat(origins, 3 * i), load3_flat(directions, 3 * i)
            set_ray(scratch, k, (o, d, limits[2 * i], limits[2 * i + 1]))
        else:
            set_ray(scratch, k, NO_RAY)
    wide, odd = scratch.world, False
    for k in range(sc.TILE):
        d = load3(wide, sc.DIRECTION + k)
        odd |= not _is_ordinary(dot(d, d))
    if odd:
        for k in range(sc.TILE):
            d = load3(wide, sc.DIRECTION + k)
            exponent = _exponent(d)
            store3(wide, sc.DIRECTION + k, _times_power(d, -exponent))
            limits_k = _times_power((wide[sc.T_MIN + k], wide[sc.NEAREST + k], 0.0), exponent)
            wide[sc.T_MIN + k], wide[sc.NEAREST + k] = limits_k[0], limits_k[1]
    return odd


@kernel
def _closest(
    work: Array, world: World, origins: Array, directions: Array, limits: Array, shape: tuple[int, int], out: HitArrays
) -> None:
    """Find the closest hits of n rays with everything in the scene, and write them to `out`.

    origins, directions : (n * 3,); limits : (n * 2,), t_min and t_max of each ray
    shape : height and width of the image that the rays form; or 1 and n
    out : flat arrays of t, position, normal, color, point (the caller's row), instance, leaf, local (position in model)
    """
    t, position, normal, color, point, instance, leaf, local = out
    origins, directions, limits = borrow(origins), borrow(directions), borrow(limits)
    memory = new_scratch(world.longest)
    scratch, world = borrow(memory), borrow(world)
    batch = next_tile(work)
    while batch >= 0:
        for first in range(0, BATCH, sc.TILE):
            odd = _set_rays((origins, directions, limits), shape, (batch, first), scratch)
            trace_tile(world, scratch)
            describe_tile(world, False, scratch)
            for k in range(sc.TILE):
                i = ray_at(shape, batch, first + k)
                if i < 0:
                    continue
                hit = tile_hit(scratch, k)
                t[i], instance[i], leaf[i] = np.inf, hit.instance, hit.leaf
                x = (np.nan, np.nan, np.nan)
                if hit.instance >= 0:
                    d, along = load3_flat(directions, 3 * i), hit.t
                    if odd:
                        exponent = _exponent(d)
                        d, along = _times_power(d, -exponent), _times_power((along, 0.0, 0.0), -exponent)[0]
                    t[i] = min(max(along, -MOST), MOST)
                    x = add(load3_flat(origins, 3 * i), scale(d, hit.t))
                for c in range(3):
                    position[3 * i + c], normal[3 * i + c], color[3 * i + c] = x[c], hit.normal[c], hit.color[c]
                    local[3 * i + c] = hit.local[c]
                point[i] = -1
                if hit.slot >= 0:
                    tree = tree_at(world.table, i64(world.instances[hit.instance * INSTANCE + SHAPE_ROW]))
                    point[i] = tree.order[hit.slot]
        batch = next_tile(work)
    keep_alive(memory)


@kernel
def _occluded(
    work: Array, world: World, origins: Array, directions: Array, limits: Array, shape: tuple[int, int], out: Array
) -> None:
    """Test whether each of n rays hits anything; write 1 or 0 to `out`, (n,) uint8.

    origins, directions : (n * 3,); limits : (n * 2,), t_min and t_max of each ray
    shape : height and width of the image that the rays form; or 1 and n
    """
    origins, directions, limits = borrow(origins), borrow(directions), borrow(limits)
    memory = new_scratch(world.longest)
    scratch, world = borrow(memory), borrow(world)
    batch = next_tile(work)
    while batch >= 0:
        for first in range(0, BATCH, sc.TILE):
            _set_rays((origins, directions, limits), shape, (batch, first), scratch)
            occlude_tile(world, scratch)
            for k in range(sc.TILE):
                i = ray_at(shape, batch, first + k)
                if i >= 0:
                    out[i] = is_blocked(scratch, k)
        batch = next_tile(work)
    keep_alive(memory)


@kernel
def _blend_attribute(
    work: Array, world: World, found: tuple[Array, int, Array, Array, Array], values: Array, width: int, out: Array
) -> None:
    """Blend one attribute at hits on one model, with the weights of f, and write it to `out`, (hits * width,).

    If all weights are zero, the value is that of the point that was hit.

    found : (rows, model, leaf, local, point), where
        `rows` are the rows of the hits on this model among all hits
        `model` is the model's index
        `leaf`, `local` (position in the model) and `point` (row) are those of all hits
    values : (n * width,) float64, `width` values for each of the model's n points, in the caller's order
    """
    hits, model, leaf, local, point = found
    memory = new_scratch(world.longest)
    scratch, world = borrow(memory), borrow(world)
    tree = tree_at(world.table, model)
    zero, one = f32(0.0), f32(1.0)
    block = next_tile(work)
    while block >= 0:
        for h in range(block * BATCH, min((block + 1) * BATCH, hits.size)):
            i = hits[h]
            x = (f32(local[3 * i]), f32(local[3 * i + 1]), f32(local[3 * i + 2]))
            scratch.counts[sc.COUNT_NEAR] = 0
            if leaf[i] < SCATTERED:  # a scattered point has its own value
                list_blocks(tree, leaf[i], segment(x, (one, zero, zero), zero, zero), scratch)
            total = 0.0
            for c in range(width):
                out[h * width + c] = 0.0
            for k in range(scratch.counts[sc.COUNT_NEAR]):
                weights = weights_of_block(tree, scratch.near[k], x[0], x[1], x[2])
                for j in range(4):
                    w = lane(weights, j)
                    if w > 0.0:
                        total += w
                        row = tree.order[i64(scratch.near[k]) * 4 + j]
                        for c in range(width):
                            out[h * width + c] += w * values[i64(row) * width + c]
            for c in range(width):
                known = total > 0.0
                out[h * width + c] = out[h * width + c] / total if known else values[point[i] * width + c]
        block = next_tile(work)
    keep_alive(memory)


def _picture(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return height and width of the image that rays form; 1 and their number if they form none.

    shape : leading shape of the rays, an image if it has two axes, both longer than 1
    """
    return (shape[0], shape[1]) if len(shape) == 2 and min(shape) > 1 else (1, int(np.prod(shape)))


def closest_hits(
    world: World, shape: tuple[int, ...], origins: Array, directions: Array, limits: Array, pace: Pace = PLAIN
) -> dict[str, Array]:
    """Find the closest hits of n rays with everything in the scene, as a dict of arrays, one row per ray.

    Parameters
    ----------
    shape : tuple of int
        The leading shape of the rays: two axes are taken as those of an image, whose squares are traced together.
    origins, directions : (n, 3) float64, C-contiguous
    limits : (n, 2) float64, t_min and t_max
    pace : Pace
        Threads and progress callback.

    Returns
    -------
    dict
        "t" (inf for a miss), "position", "normal", "color", "point" (the caller's row, -1 for none), "instance" (-1 for
        a miss), "leaf" and "local" (position in model space). The last two serve to blend attributes later.
    """
    n, picture = len(origins), _picture(shape)
    out: dict[str, Array] = {
        "t": np.empty(n, np.float32),
        "position": np.empty((n, 3)),
        "normal": np.empty((n, 3), np.float32),
        "color": np.empty((n, 3), np.float32),
        "point": np.empty(n, np.int64),
        "instance": np.empty(n, np.int32),
        "leaf": np.empty(n, np.int64),
        "local": np.empty((n, 3)),
    }
    flat = tuple(array.reshape(-1) for array in out.values())
    rays = origins.reshape(-1), directions.reshape(-1), limits.reshape(-1)
    run(_closest, batches(picture), world, *rays, picture, flat, **pace._asdict())
    return out


def occlusions(
    world: World, shape: tuple[int, ...], origins: Array, directions: Array, limits: Array, pace: Pace = PLAIN
) -> Flags:
    """Return whether each of n rays hits anything, (n,) bool.

    shape : leading shape of the rays, an image if it has two axes
    origins, directions : (n, 3) float64, C-contiguous
    limits : (n, 2) float64, t_min and t_max of each ray
    pace : threads and progress callback
    """
    out, picture = np.zeros(len(origins), np.uint8), _picture(shape)
    rays = origins.reshape(-1), directions.reshape(-1), limits.reshape(-1)
    run(_occluded, batches(picture), world, *rays, picture, out, **pace._asdict())
    return out.view(np.bool_)


def blend_attribute(
    world: World, hits: dict[str, Array], rows: Array, model: int, values: Array, pace: Pace = PLAIN
) -> Array:
    """Blend one attribute at hits on one model, with the weights of f; return float64, one row per hit.

    hits : all hits, from `closest_hits`; rows : rows of the hits on the model among them
    model : index of the model; values : (n,) or (n, k), of all its points in the caller's order
    pace : threads and progress callback
    """
    out = np.empty((len(rows), *values.shape[1:]))
    found = (rows, model, hits["leaf"], hits["local"].reshape(-1), hits["point"])
    width = values.size // len(values)
    args = (world, found, np.ascontiguousarray(values, np.float64).reshape(-1), width, out.reshape(-1))
    run(_blend_attribute, -(-len(rows) // BATCH), *args, **pace._asdict())
    return out
