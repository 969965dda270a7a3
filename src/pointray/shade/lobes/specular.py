"""Smooth surfaces, which send light into one or two directions only: mirrors, and bodies that let light through."""

from __future__ import annotations

import math

from ...jit import inline
from ...kernels.records import IOR, MATERIAL_KIND, MIRROR, ShadingPoint, World
from ...kernels.vec import WHITE, Vec3, dot, mirrored, scale, sub


@inline
def fresnel(cosine: float, beyond: float, ratio: float) -> float:
    """The share of unpolarised light that a smooth dielectric reflects.

    cosine, beyond : cosines of the angles to the normal on this side and on the other, not both 0
    ratio : index of refraction of the other side over that of this one
    """
    across = (cosine - ratio * beyond) / (cosine + ratio * beyond)
    within = (ratio * cosine - beyond) / (ratio * cosine + beyond)
    return 0.5 * (across * across + within * within)


@inline
def glass(world: World, material: int, point: ShadingPoint) -> tuple[Vec3, Vec3, float]:
    """(reflected direction, refracted direction, share reflected) of a Dielectric; the rest is refracted.

    With total reflection, or a ray that only grazes, the share is 1 and the refracted direction is the reflected one.
    """
    ior = world.materials[material + IOR]
    ratio = ior if point.side > 0.0 else 1.0 / ior
    cosine = min(max(dot(point.normal, point.wo), 0.0), 1.0)
    reflected = mirrored(point.wo, point.normal)
    square = (1.0 - cosine * cosine) / (ratio * ratio)  # squared sine on the other side: Snell's law
    if square >= 1.0 or cosine == 0.0:
        return reflected, reflected, 1.0
    beyond = math.sqrt(1.0 - square)
    refracted = sub(scale(point.normal, cosine / ratio - beyond), scale(point.wo, 1.0 / ratio))
    return reflected, refracted, fresnel(cosine, beyond, ratio)


@inline
def sample_specular(world: World, material: int, point: ShadingPoint, which: float) -> tuple[Vec3, Vec3, float, float]:
    """(direction, weight, pdf 0, side on which it leaves) of a Mirror or a Dielectric, see `bsdf.sample_bsdf`."""
    if world.materials[material + MATERIAL_KIND] == MIRROR:
        return mirrored(point.wo, point.normal), point.color, 0.0, point.side
    reflected, refracted, share = glass(world, material, point)
    if which < share:
        return reflected, WHITE, 0.0, point.side
    return refracted, WHITE, 0.0, -point.side
