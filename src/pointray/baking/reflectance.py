"""Albedo of materials in uniform light. Light that travels between patches treats all surfaces as Lambertian."""

from __future__ import annotations

from ..engine.jit import Array, borrow, inline, kernel, next_tile
from ..engine.kernels.records import MATERIAL_SIZE, ShadingPoint, World
from ..engine.kernels.sampling import WHICH, sample_pair
from ..engine.kernels.vec import Vec3, add
from ..shade.bsdf import is_specular, sample_bsdf
from ..shade.materials.diffuse import sample_diffuse

ALBEDO_SAMPLES = 4096


@inline
def _reflected(world: World, material: int, color: Vec3) -> Vec3:
    """Return the fraction of light that a material reflects if it arrives uniformly, RGB: a Monte Carlo estimate.

    Mirrors and glass reflect nothing here. material : offset of its record in `world.materials`; color : of the surface
    """
    total, normal = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    if is_specular(world, material):
        return total
    for k in range(ALBEDO_SAMPLES):
        u, v = sample_pair(1, k, 0)
        wo = sample_diffuse(normal, u, v)
        u, v = sample_pair(2, k, 0)
        point = ShadingPoint(normal, wo, color, 1.0)
        total = add(total, sample_bsdf(world, material, point, sample_pair(3, k, WHICH)[0], u, v)[1])
    return total[0] / ALBEDO_SAMPLES, total[1] / ALBEDO_SAMPLES, total[2] / ALBEDO_SAMPLES


@kernel
def find_reflectances(work: Array, world: World, out: Array) -> None:
    """Compute the albedo in uniform light of all materials, which is linear in the surface's colour.

    out : (materials * 2,) float64, written: albedo of a black surface, and how much that of a white one exceeds it
    """
    world = borrow(world)
    material = next_tile(work)
    while material >= 0:
        black = _reflected(world, material * MATERIAL_SIZE, (0.0, 0.0, 0.0))[0]
        white = _reflected(world, material * MATERIAL_SIZE, (1.0, 1.0, 1.0))[0]
        out[2 * material], out[2 * material + 1] = black, white - black
        material = next_tile(work)
