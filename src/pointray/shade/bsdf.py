"""Evaluation and sampling of BSDFs, for all integrators.

BSDFs are reciprocal, colours are linear RGB, pdfs are per solid angle. Rays carry basic radiance (Nicodemus 1963), that
is radiance divided by the square of the index of refraction. Refraction does not change it, so no weight has a factor
(n1 / n2)^2. In air, where cameras and lights are, it equals radiance. With the factor a path would lose n^2 on entering
a closed body and regain it on leaving: the same image, unless a light is inside.
"""

from __future__ import annotations

from ..engine.jit import inline
from ..engine.kernels import records as rec
from ..engine.kernels.records import ShadingPoint, World
from ..engine.kernels.vec import BLACK, Vec3, dot, load3_flat, scale
from .materials.diffuse import eval_diffuse, sample_diffuse
from .materials.phong import eval_phong, lobes_of_phong, sample_phong
from .materials.principled import eval_principled, exponent_of_facets, lobes_of_principled, sample_principled
from .materials.specular import sample_specular

LEAST_PDF = 1e-200  # smaller ones may overflow as divisors


@inline
def base_color(world: World, material: int, color: Vec3) -> Vec3:
    """Return the colour of a material, or the given colour of the surface if the material takes that; linear RGB.

    material : offset of its record in `world.materials`
    """
    if world.materials[material + rec.OWN_COLOR] != 0.0:
        return color
    return load3_flat(world.materials, material + rec.BASE_COLOR)


@inline
def emitted(world: World, material: int) -> Vec3:
    """Return the radiance that a surface with this material emits, on both sides; black for all but Emissive.

    material : offset of its record in `world.materials`
    """
    if world.materials[material + rec.MATERIAL_KIND] == rec.EMISSIVE:
        return load3_flat(world.materials, material + rec.EMITTED)
    return BLACK


@inline
def is_specular(world: World, material: int) -> bool:
    """Return whether a material is a mirror or glass: its BSDF consists of delta distributions only.

    material : offset of its record in `world.materials`
    """
    kind = world.materials[material + rec.MATERIAL_KIND]
    return kind in (rec.MIRROR, rec.DIELECTRIC)


@inline
def ambient(world: World, material: int, point: ShadingPoint) -> Vec3:
    """Return the albedo by which uniform sky light is reflected: of the diffuse lobe for Phong, else the colour.

    It is black for mirrors and glass. material : offset of its record in `world.materials`
    """
    if is_specular(world, material):
        return BLACK
    share = (
        1.0 - world.materials[material + rec.SPECULAR]
        if world.materials[material + rec.MATERIAL_KIND] == rec.PHONG
        else 1.0
    )
    return scale(point.color, share)


@inline
def lobes_of(world: World, material: int, point: ShadingPoint) -> tuple[Vec3, Vec3]:
    """Return the albedos (diffuse lobe, glossy lobe) of a material at a point, RGB; black for mirrors and glass.

    An albedo is the fraction of uniform light that the lobe reflects. The glossy lobe is about the mirrored direction.

    material : offset of its record in `world.materials`
    """
    if is_specular(world, material):
        return BLACK, BLACK
    kind = world.materials[material + rec.MATERIAL_KIND]
    if kind == rec.PHONG:
        return lobes_of_phong(world, material, point)
    if kind == rec.PRINCIPLED:
        return lobes_of_principled(world, material, point)
    return point.color, BLACK


@inline
def lobe_exponent(world: World, material: int) -> float:
    """Return the exponent of a material's glossy lobe, cos^exponent about the mirrored direction; -1.0 if it has none.

    material : offset of its record in `world.materials`
    """
    kind = world.materials[material + rec.MATERIAL_KIND]
    if kind == rec.PHONG:
        return world.materials[material + rec.EXPONENT] if world.materials[material + rec.SPECULAR] > 0.0 else -1.0
    return exponent_of_facets(world.materials[material + rec.ALPHA]) if kind == rec.PRINCIPLED else -1.0


@inline
def eval_bsdf(world: World, material: int, point: ShadingPoint, wi: Vec3) -> tuple[Vec3, float]:
    """Return (BSDF times cosine as RGB, pdf per solid angle of `sample_bsdf`) for light from direction wi.

    Both are 0 if wi or the direction to the viewer is below the surface, and for mirrors and glass.

    material : offset of its record in `world.materials`; wi : unit direction to the light
    """
    cosine = dot(point.normal, wi)
    if cosine <= 0.0 or dot(point.normal, point.wo) <= 0.0 or is_specular(world, material):
        return BLACK, 0.0
    kind = world.materials[material + rec.MATERIAL_KIND]
    if kind == rec.PHONG:
        return eval_phong(world, material, point, wi, cosine)
    if kind == rec.PRINCIPLED:
        return eval_principled(world, material, point, wi, cosine)
    return eval_diffuse(point, cosine)


@inline
def _direction(world: World, material: int, point: ShadingPoint, which: float, u: float, v: float) -> Vec3:
    """Sample a direction with the pdf that `eval_bsdf` returns; it may lie below the surface.

    material : offset of its record in `world.materials`
    which : random number in [0, 1) that chooses the lobe; u, v : random numbers in [0, 1) that choose the direction
    """
    kind = world.materials[material + rec.MATERIAL_KIND]
    if kind == rec.PHONG:
        return sample_phong(world, material, point, which, u, v)
    if kind == rec.PRINCIPLED:
        return sample_principled(world, material, point, which, u, v)
    return sample_diffuse(point.normal, u, v)


@inline
def sample_bsdf(
    world: World, material: int, point: ShadingPoint, which: float, u: float, v: float
) -> tuple[Vec3, Vec3, float, float]:
    """Sample the BSDF: return (unit direction, weight, pdf, side).

    material : offset of its record in `world.materials`
    which : random number in [0, 1) that chooses the lobe; u, v : random numbers in [0, 1) that choose the direction

    Returns
    -------
    tuple
        Unit direction; weight, which is BSDF times cosine over the pdf, RGB, black if nothing is scattered; pdf per
        solid angle, 0.0 for mirrors and glass; side of the surface, +1.0 or -1.0, on which the new ray leaves.
    """
    if dot(point.normal, point.wo) <= 0.0:
        return point.normal, BLACK, 0.0, point.side
    if is_specular(world, material):
        return sample_specular(world, material, point, which)
    direction = _direction(world, material, point, which, u, v)
    rgb, pdf = eval_bsdf(world, material, point, direction)
    if pdf < LEAST_PDF:
        return direction, BLACK, 0.0, point.side
    return direction, scale(rgb, 1.0 / pdf), pdf, point.side
