"""Diffuse reflection, and Phong's highlight besides it: the light that they scatter, and how directions are sampled.

cosine : between normal and light, positive. Pdfs are per solid angle. The formulas are in `materials.py`.
"""

from __future__ import annotations

import math

from ...jit import inline
from ...kernels.records import EXPONENT, SPECULAR, ShadingPoint, World
from ...kernels.vec import Vec3, add, around, dot, mirrored, scale


@inline
def eval_diffuse(point: ShadingPoint, cosine: float) -> tuple[Vec3, float]:
    """(BRDF times cosine, pdf)."""
    pdf = cosine / math.pi
    return scale(point.color, pdf), pdf


@inline
def sample_diffuse(normal: Vec3, u: float, v: float) -> Vec3:
    """A direction with pdf cosine / pi: uniform on the disc below the hemisphere (Malley's method)."""
    return around(normal, math.sqrt(1.0 - u), v)


@inline
def _share_of_highlight(color: Vec3, specular: float) -> float:
    """The probability with which the highlight is sampled: by what each lobe reflects at most. specular > 0."""
    return specular / (specular + (1.0 - specular) * (color[0] + color[1] + color[2]) / 3.0)


@inline
def eval_phong(world: World, material: int, point: ShadingPoint, wi: Vec3, cosine: float) -> tuple[Vec3, float]:
    """(BRDF times cosine, pdf)."""
    specular = world.materials[material + SPECULAR]
    diffuse, pdf = eval_diffuse(point, cosine)
    if specular == 0.0:  # the power is what takes long here
        return diffuse, pdf
    exponent, share = world.materials[material + EXPONENT], _share_of_highlight(point.color, specular)
    along = dot(mirrored(wi, point.normal), point.wo)
    lobe = along**exponent / (2.0 * math.pi) if along > 0.0 else 0.0
    gloss = specular * (exponent + 2.0) * lobe * cosine
    both = add(scale(diffuse, 1.0 - specular), (gloss, gloss, gloss))
    return both, share * (exponent + 1.0) * lobe + (1.0 - share) * pdf


@inline
def sample_phong(world: World, material: int, point: ShadingPoint, which: float, u: float, v: float) -> Vec3:
    """A direction by the cosine, or by a power of the cosine about the mirrored one, which may lie below the surface.

    After Lafortune and Willems (1994).
    """
    specular = world.materials[material + SPECULAR]
    if specular == 0.0 or which >= _share_of_highlight(point.color, specular):
        return sample_diffuse(point.normal, u, v)
    cosine = (1.0 - u) ** (1.0 / (world.materials[material + EXPONENT] + 1.0))
    return around(mirrored(point.wo, point.normal), cosine, v)
