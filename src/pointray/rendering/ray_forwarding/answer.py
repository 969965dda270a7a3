"""Intersection of forwarded rays with the models of a holder, with the data that shading needs."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ...engine.jit import Array, borrow, i64, keep_alive, kernel, next_tile, run
from ...engine.kernels import scratch as sc
from ...engine.kernels.records import World
from ...engine.kernels.scratch import load3, new_scratch
from ...engine.kernels.vec import load3_flat, scale
from ...shade.shading_points import store_shading_points
from ...surface.trace.cast import PLAIN, Pace
from ...surface.trace.hits import describe_tile
from ...surface.trace.world import NO_RAY, is_blocked, occlude_tile, set_ray, set_ray_from, trace_tile

BATCH = 16  # tiles that a thread takes at a time
BEGINS, SLOT = 128, 63  # masks of a ray's slot: first ray of a tile; index of the ray in its tile

Rays: TypeAlias = tuple[Array, Array, Array, Array]  # origins, directions, ends, sides: float64, flat


@kernel
def _answer(
    work: Array, world: World, rays: Rays, tiles: tuple[Array, Array], any_hit: bool, out: tuple[Array, Array]
) -> None:
    """Intersect a world with rays that another process has sent, tile by tile, and store the hits in `out`.

    work : counter from which threads take batches of tiles
    rays : (origins, directions, largest t, sides), the first two (n * 3,), the others (n,)
    tiles : (slots, begins), (n,) uint8 index of each ray in its tile, with a mark at the first ray of a tile, and
        (m + 1,) int64 row of the first ray of each of m tiles, then n
    any_hit : whether to test for occlusion only
    out : (instances, facts), (n,) int32 row of the instance hit (0 with `any_hit`) or -1 for a miss, and
        (n * 8,) float64 t, normal, color and offset of secondary rays from the surface (empty with `any_hit`)
    """
    origins, directions, ends, sides = borrow(rays[0]), borrow(rays[1]), borrow(rays[2]), borrow(rays[3])
    slots, begins, instances, facts = borrow(tiles[0]), borrow(tiles[1]), borrow(out[0]), borrow(out[1])
    memory = new_scratch(world.longest)
    scratch, world = borrow(memory), borrow(world)
    batch = next_tile(work)
    while batch >= 0:
        for tile in range(batch * BATCH, min((batch + 1) * BATCH, begins.size - 1)):
            for k in range(sc.TILE):
                set_ray(scratch, k, NO_RAY)
            for i in range(begins[tile], begins[tile + 1]):
                ray = load3_flat(origins, 3 * i), load3_flat(directions, 3 * i), 0.0, ends[i]
                set_ray_from(scratch, i64(slots[i] & SLOT), ray, sides[i])
            if any_hit:
                occlude_tile(world, scratch)
            else:
                trace_tile(world, scratch)
                describe_tile(world, True, scratch)
                store_shading_points(world, scratch)
            for i in range(begins[tile], begins[tile + 1]):
                k = i64(slots[i] & SLOT)
                if any_hit:
                    instances[i] = 0 if is_blocked(scratch, k) else -1
                    continue
                instances[i] = scratch.numbers[sc.INSTANCE_OF + k]
                if instances[i] >= 0:
                    # For spheres the blended normal, which is on the eye's side as the exact one is.
                    side = scratch.shading_points[sc.SHADING_SIDE + k]
                    normal = scale(load3(scratch.shading_points, sc.SHADING_NORMAL + k), side)
                    color = load3(scratch.world, sc.COLOR + k)
                    facts[8 * i] = scratch.world[sc.NEAREST + k]
                    facts[8 * i + 7] = scratch.shading_points[sc.SHADING_MARGIN + k]
                    for c in range(3):
                        facts[8 * i + 1 + c], facts[8 * i + 4 + c] = normal[c], color[c]
        batch = next_tile(work)
    keep_alive(memory)


def answer(world: World, rays: Array, slots: Array, any_hit: bool, pace: Pace = PLAIN) -> tuple[Array, Array]:
    """Intersect a world with rays that another process has sent, and return the hits with the data for shading.

    Parameters
    ----------
    rays : (n, 8) float64
        Origin, unit direction, largest t, side (+1 if a ray that starts on a surface is outside of it, -1 if inside).
    slots : (n,) uint8
        Index of each ray in its tile, 0 to 63, plus `BEGINS` at the first ray of a tile. Rays keep the tiles of the
        image, whose rays are coherent.
    any_hit : bool
        Whether to test for occlusion only.
    pace : Pace
        Number of threads, progress callback.

    Returns
    -------
    instances : (n,) int32
        Row of the instance hit, or 0 with `any_hit`; -1 for a miss.
    facts : (n, 8) float64
        t, normal, colour, and the offset of secondary rays from the surface; undefined for a miss. Empty with
        `any_hit`.
    """
    n = len(rays)
    instances, facts = np.full(n, -1, np.int32), np.empty((0 if any_hit else n, 8))
    columns = tuple(np.ascontiguousarray(rays[:, part]).reshape(-1) for part in (slice(3), slice(3, 6), 6, 7))
    begins = np.unique([0, *np.flatnonzero(slots & BEGINS), n])
    # Arrays from a message are read-only, which would be another type for the kernel.
    args = columns, (np.array(slots), begins.astype(np.int64)), any_hit, (instances, facts.reshape(-1))
    run(_answer, -(-(len(begins) - 1) // BATCH), world, *args, **pace._asdict())
    return instances, facts
