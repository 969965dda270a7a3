"""Surface points of a tile: storage, and the `ShadingPoint` that materials take."""

from __future__ import annotations

from ..engine.jit import f64, i64, inline
from ..engine.kernels import scratch as sc, vec
from ..engine.kernels.records import INSTANCE, SHAPE_ROW, ShadingPoint, World
from ..engine.kernels.scratch import Scratch, load3, store3
from ..engine.kernels.tree import BLOCK, NX, NY, NZ, SCATTER, SCATTERED, SPHERES, tree_at
from ..engine.kernels.vec import Vec3
from ..surface.trace.hits import material_at
from ..surface.trace.space import matrix_at, of_size_one
from .bsdf import base_color

SOFTNESS = 0.6  # weight of the mean direction in the normal of a sphere, chosen by eye on tree crowns
LEAST_COSINE = 0.05  # smallest cosine between that normal and the direction to the eye


@inline
def begin_radiance(scratch: Scratch) -> None:
    """Reset the radiance of the tile's camera rays to 0 and their throughput to 1 (rows RADIANCE and THROUGHPUT)."""
    for i in range(sc.TILE):
        store3(scratch.shading_points, sc.RADIANCE + i, vec.BLACK)
        store3(scratch.shading_points, sc.THROUGHPUT + i, vec.WHITE)


@inline
def add_radiance(scratch: Scratch, i: int, light: Vec3) -> None:
    """Add light that arrives along ray i, times the ray's throughput, to the radiance of its pixel sample."""
    points = scratch.shading_points
    weighted = vec.multiply(load3(points, sc.THROUGHPUT + i), light)
    store3(points, sc.RADIANCE + i, vec.add(load3(points, sc.RADIANCE + i), weighted))


@inline
def margin_of(world: World, scratch: Scratch, i: int) -> float:
    """Return the distance from the surface at which new rays start at hit i: the noise removed there by denoising.

    Denoising leaves bumps of a quarter of the noise, which shadow each other under a grazing sun. At 2 degrees, on a
    wall with noise of 0.3 spacings, 23% is in shadow without an offset, 0.3% with half of it, none with all of it.
    """
    instance, leaf = scratch.numbers[sc.INSTANCE_OF + i], scratch.numbers[sc.LEAF_OF + i]
    if instance < 0 or leaf < 0 or leaf >= SCATTERED:
        return 0.0
    offset = instance * INSTANCE
    tree = tree_at(world.table, i64(world.instances[offset + SHAPE_ROW]))
    if tree.noise.size == 0:
        return 0.0
    noise = tree.noise[tree.refs[16 * i64(tree.spans[2 * leaf])]]
    return noise / vec.length(vec.transform(matrix_at(world, offset), load3(scratch.world, sc.NORMAL + i)))


@inline
def _soften(world: World, scratch: Scratch, i: int) -> None:
    """Blend the normal at the hit of ray i on a scattered point, drawn as a sphere, with the direction of its splat.

    That is the mean, over the point and its neighbours, of directions away from the centroid of nearby points.

    This gives tree crowns smooth shading instead of speckle. The normal stays on the side of the eye.
    """
    points, offset = scratch.shading_points, scratch.numbers[sc.INSTANCE_OF + i] * INSTANCE
    tree = tree_at(world.table, i64(world.instances[offset + SHAPE_ROW]))
    if tree.head[SCATTER] != SPHERES or points[sc.SHADING_SIDE + i] < 0.0:
        return
    slot = scratch.numbers[sc.LEAF_OF + i] - SCATTERED
    at = slot // 4 * BLOCK + slot % 4
    mean = f64(tree.blocks[at + NX]), f64(tree.blocks[at + NY]), f64(tree.blocks[at + NZ])
    mean = vec.transform_transposed(of_size_one(matrix_at(world, offset)), mean)
    wo, normal = load3(points, sc.SHADING_WO + i), load3(points, sc.SHADING_NORMAL + i)
    soft = vec.add(vec.scale(normal, 1.0 - SOFTNESS), vec.scale(vec.unit(mean), SOFTNESS))
    cosine = vec.dot(soft, wo)
    if cosine < LEAST_COSINE:
        soft = vec.add(soft, vec.scale(wo, LEAST_COSINE - cosine))
    store3(points, sc.SHADING_NORMAL + i, vec.unit(soft))


@inline
def store_shading_points(world: World, scratch: Scratch) -> None:
    """Store the surface points of the tile's hits (rows SHADING_*), with normals turned to the eye.

    The main loop has no branches, so that it is vectorized; rays without a hit only need SHADING_INSTANCE.
    """
    points, wide = scratch.shading_points, scratch.world
    for i in range(sc.TILE):
        points[sc.SHADING_INSTANCE + i] = scratch.numbers[sc.INSTANCE_OF + i]
    for i in range(sc.TILE):
        d, normal = load3(wide, sc.DIRECTION + i), load3(wide, sc.NORMAL + i)
        wo = vec.scale(vec.unit(d), -1.0)
        # Side of the eye: shadow rays start there, and the normal is flipped to it.
        side = 1.0 if vec.dot(normal, wo) >= 0.0 else -1.0
        store3(points, sc.SHADING_POINT + i, vec.add(load3(wide, sc.ORIGIN + i), vec.scale(d, wide[sc.NEAREST + i])))
        store3(points, sc.SHADING_NORMAL + i, vec.scale(normal, side))
        store3(points, sc.SHADING_WO + i, wo)
        store3(points, sc.SHADING_COLOR + i, load3(wide, sc.COLOR + i))
        points[sc.SHADING_SIDE + i] = side
    for i in range(sc.TILE):
        points[sc.SHADING_MARGIN + i] = margin_of(world, scratch, i)
        if scratch.numbers[sc.LEAF_OF + i] >= SCATTERED and scratch.numbers[sc.INSTANCE_OF + i] >= 0:
            _soften(world, scratch, i)


@inline
def start_of(scratch: Scratch, i: int, side: float) -> Vec3:
    """Return the origin of rays that leave surface point i of the tile on one side, a small distance off the surface.

    side : +1 for the side to which normals point, or -1
    """
    points = scratch.shading_points
    away = side * points[sc.SHADING_SIDE + i] * points[sc.SHADING_MARGIN + i]
    return vec.add(load3(points, sc.SHADING_POINT + i), vec.scale(load3(points, sc.SHADING_NORMAL + i), away))


@inline
def is_shaded(scratch: Scratch, i: int) -> bool:
    """Return whether ray i of the tile has hit a surface to shade."""
    return scratch.shading_points[sc.SHADING_INSTANCE + i] >= 0.0


@inline
def shading_point(world: World, scratch: Scratch, i: int) -> tuple[int, ShadingPoint]:
    """Return the material, geometry and colour of surface point i of the tile, from which BSDFs are evaluated.

    The material is the offset of its record in `world.materials`.
    """
    points = scratch.shading_points
    material = material_at(world, int(points[sc.SHADING_INSTANCE + i]))
    color = base_color(world, material, load3(points, sc.SHADING_COLOR + i))
    return material, ShadingPoint(
        load3(points, sc.SHADING_NORMAL + i), load3(points, sc.SHADING_WO + i), color, points[sc.SHADING_SIDE + i]
    )
