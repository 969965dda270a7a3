"""Principled: a rough specular surface of small facets (GGX) over a diffuse base, or of metal.

Facets follow Walter et al. (2007), masking and shadowing follow Smith, correlated by height (Heitz 2014). Visible
normals are sampled (Heitz 2018) with the spherical caps of Dupuy and Benyoub (2023). cosine : between normal and light,
positive. Pdfs are per solid angle. The formulas are in `materials.py`.
"""

from __future__ import annotations

import math

from ...jit import inline
from ...kernels.records import ALPHA, COAT, METALLIC, ShadingPoint, World
from ...kernels.vec import Vec3, add, around, dot, load3_flat, mirrored, scale, unit
from .phong import sample_diffuse

F0 = 0.04  # reflectance of a dielectric of index 1.5 at normal incidence


@inline
def _mean(color: Vec3) -> float:
    return (color[0] + color[1] + color[2]) / 3.0


@inline
def _schlick(at_normal: Vec3, cosine: float) -> Vec3:
    """Fresnel reflectance, RGB (Schlick 1994)."""
    x = max(1.0 - cosine, 0.0)
    rise = x * x * (x * x) * x
    return add(scale(at_normal, 1.0 - rise), (rise, rise, rise))


@inline
def _let_in(coat: Vec3, cosine: float) -> float:
    """Share of the light from one direction that the facets of a dielectric let through to the base."""
    return 1.0 - coat[0] - coat[1] * max(1.0 - cosine, 0.0) ** coat[2]


@inline
def _let_in_on_average(coat: Vec3) -> float:
    """The mean of `_let_in` over the hemisphere, weighted by the cosine."""
    return 1.0 - coat[0] - 2.0 * coat[1] / ((coat[2] + 1.0) * (coat[2] + 2.0))


@inline
def _smith(alpha: float, cosine: float) -> float:
    """The root in Smith's masking: G1 = 2 cosine / (cosine + root)."""
    return math.sqrt(alpha * alpha + (1.0 - alpha * alpha) * cosine * cosine)


@inline
def _facets(alpha: float, cosine: float, cos_o: float, half: float) -> tuple[float, float]:
    """(D G2 / (4 cosine cos_o) times cosine, pdf of visible normals); cosines with the normal.

    D : density of the facets' normals; G2 : share of them that both eye and light see
    """
    spread = 1.0 + (alpha * alpha - 1.0) * half * half
    facets = alpha * alpha / (math.pi * spread * spread)
    both = 0.5 * cosine / (cosine * _smith(alpha, cos_o) + cos_o * _smith(alpha, cosine))
    return facets * both, 0.5 * facets / (cos_o + _smith(alpha, cos_o))


@inline
def _share_of_facets(world: World, material: int, point: ShadingPoint, cos_o: float) -> float:
    """The probability with which facets are sampled, not the base: roughly by what they reflect."""
    metallic, through = (
        world.materials[material + METALLIC],
        _let_in(load3_flat(world.materials, material + COAT), cos_o),
    )
    gray = _mean(point.color)
    reflected = (1.0 - metallic) * (1.0 - through) + metallic * gray + 1e-6  # black metal reflects at grazing angles
    return reflected / (reflected + (1.0 - metallic) * gray * through)


@inline
def eval_principled(world: World, material: int, point: ShadingPoint, wi: Vec3, cosine: float) -> tuple[Vec3, float]:
    """(BRDF times cosine, pdf)."""
    metallic, coat = world.materials[material + METALLIC], load3_flat(world.materials, material + COAT)
    cos_o = dot(point.normal, point.wo)
    normal = unit(add(point.wo, wi))
    lobe, visible = _facets(world.materials[material + ALPHA], cosine, cos_o, dot(point.normal, normal))
    plain = F0 * (1.0 - metallic)
    at_normal = add((plain, plain, plain), scale(point.color, metallic))
    gloss = scale(_schlick(at_normal, dot(point.wo, normal)), lobe)
    through = _let_in(coat, cos_o) * _let_in(coat, cosine) / _let_in_on_average(coat)
    pdf = cosine / math.pi
    share = _share_of_facets(world, material, point, cos_o)
    both = add(gloss, scale(point.color, (1.0 - metallic) * through * pdf))
    return both, share * visible + (1.0 - share) * pdf


@inline
def sample_principled(world: World, material: int, point: ShadingPoint, which: float, u: float, v: float) -> Vec3:
    """A cosine-distributed direction, or one mirrored at a visible facet, which may lie below the surface."""
    normal, cos_o = point.normal, dot(point.normal, point.wo)
    if which >= _share_of_facets(world, material, point, cos_o):
        return sample_diffuse(normal, u, v)
    alpha = world.materials[material + ALPHA]
    # Stretched along the normal, the facets form a hemisphere. The eye sees a cap of it about the stretched direction,
    # and the points of that cap mirror this direction uniformly.
    eye = unit(add(scale(point.wo, alpha), scale(normal, (1.0 - alpha) * cos_o)))
    height = dot(normal, eye)
    facet = add(around(normal, (1.0 - u) * (1.0 + height) - height, v), eye)
    facet = unit(add(scale(facet, alpha), scale(normal, (1.0 - alpha) * dot(normal, facet))))
    return mirrored(point.wo, facet)
