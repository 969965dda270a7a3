"""Light at points of a surface by path tracing: the reference for a bake where no camera is involved.

Each path begins with a ray perpendicular to the surface; it returns the outgoing radiance of the surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from pointray.engine.jit import Array, borrow, keep_alive, kernel, next_tile, run
from pointray.engine.kernels.records import World
from pointray.engine.kernels.sampling import hash32
from pointray.engine.kernels.scratch import KEY, RADIANCE, TILE, load3, new_scratch
from pointray.engine.kernels.vec import load3_flat
from pointray.shade.path import begin_paths, trace_paths
from pointray.shade.shading_points import begin_radiance
from pointray.surface.trace.world import set_ray

DEEP = 1000  # scatterings
OFF = 0.1  # share of a ray's length by which its hit may miss the point


class Places(NamedTuple):
    """Rays onto the surface, flat float64, and the rows of the points they are for."""

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.rows)


@kernel
def _gather(
    work: Array, world: World, origins: Array, directions: Array, job: tuple[int, int, int], sums: Array
) -> int:
    """Add the radiance along rays, (n * 3,) float64. job : samples, scatterings, seed"""
    memory = new_scratch(world.longest)
    scratch, world = borrow(memory), borrow(world)
    tile, n = next_tile(work), sums.size // 3
    while tile >= 0:
        for i in range(TILE):
            scratch.shading_points[KEY + i] = hash32((job[2] * 0x9E3779B9 + tile * TILE + i) & 0xFFFFFFFF)
        for sample in range(job[0]):
            for i in range(TILE):
                at = 3 * min(tile * TILE + i, n - 1)
                set_ray(scratch, i, (load3_flat(origins, at), load3_flat(directions, at), 0.0, np.inf))
            begin_radiance(scratch)
            begin_paths(scratch)
            trace_paths(world, sample, job[1], False, scratch)
            for i in range(min(TILE, n - tile * TILE)):
                light = load3(scratch.shading_points, RADIANCE + i)
                for c in range(3):
                    sums[3 * (tile * TILE + i) + c] += light[c]
        tile = next_tile(work)
    keep_alive(memory)
    return 0


def places_on(
    scene: pr.Scene, id: int, positions: NDArray[np.floating], normals: NDArray[np.floating], rows: NDArray[np.int64]
) -> Places:
    """Rays onto a surface: some rows of positions and unit normals, (n, 3), in the world.

    Places off the surface, or under another one, are left out. The instance has no transform.
    """
    model = scene.shapes[id]
    assert isinstance(model, pr.Model)
    length, normals = float(np.median(model.radii)), np.asarray(normals, float)[rows]
    origins = positions[rows] + 0.5 * length * normals
    hits = scene.intersect(origins, -normals)
    good = (hits.instance == id) & (np.abs(hits.t - 0.5 * length) < OFF * length)
    return Places(origins[good].reshape(-1), -normals[good].reshape(-1), rows[good])


def places_of_points(scene: pr.Scene, id: int, count: int) -> Places:
    """Rays onto random points of an instance."""
    points = scene.shapes[id].points
    rows = np.random.default_rng(0).permutation(len(points))[:count]
    return places_on(scene, id, points.world, points.normals, rows)


def places_of_patches(scene: pr.Scene, baked: pr.Baked, count: int) -> Places:
    """Rays onto patches of the front of instance 0: 64 neighbours at a time, as in a gather of all patches."""
    side = baked._exchange.sides[0, 1]
    tiles = np.random.default_rng(0).permutation(side.size // TILE)[: count // TILE]
    rows = side.first + (tiles[:, None] * TILE + np.arange(TILE)).reshape(-1)
    return places_on(scene, 0, baked._exchange.transport.positions, baked._exchange.transport.normals, rows)


def gather(scene: pr.Scene, places: Places, samples: int, seed: int = 0, depth: int = DEEP) -> NDArray[np.float64]:
    """Radiance that the surface sends out at places, (n, 3)."""
    sums = np.zeros(3 * len(places))
    world, job = scene.snapshot().world, (samples, depth, seed)
    run(_gather, -(-len(places) // TILE), world, places.origins, places.directions, job, sums)
    return sums.reshape(-1, 3) / samples


def rms_error(light: NDArray[np.floating], first: NDArray[np.floating], second: NDArray[np.floating]) -> float:
    """Root mean square error of values, (n,), as a share of their mean, without the noise of the references.

    first, second : two independent references, whose noise falls out of the product of the differences
    """
    square = np.mean((light - first) * (light - second))
    return float(np.sqrt(max(square, 0.0)) / np.mean(first + second) * 2.0)
