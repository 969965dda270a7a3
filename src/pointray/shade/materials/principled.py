"""Microfacet material (GGX): a rough dielectric over a diffuse base, or rough metal.

Facets: Walter et al. (2007). Masking and shadowing: Smith, height-correlated (Heitz 2014). Visible normals are sampled
(Heitz 2018) with the spherical caps of Dupuy and Benyoub (2023). cosine : of the angle between normal and light,
positive. Pdfs are per solid angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...base.arguments import check_range
from ...engine.jit import inline
from ...engine.kernels.records import ALPHA, COAT, METALLIC, PRINCIPLED, ShadingPoint, World
from ...engine.kernels.vec import Vec3, add, around, dot, load3_flat, mirrored, scale, unit
from ..lobe_tables import COLUMNS, FACET_SHARES, ROWS
from .base import Color, Material, record_of
from .diffuse import sample_diffuse

F0 = 0.04  # reflectance of a dielectric of index 1.5 at normal incidence
LEAST_ALPHA = 1e-3  # a lobe 0.05 degrees wide; use Mirror instead of narrower ones


def _coat(alpha: float) -> tuple[float, float, float]:
    """Return (a, b, p) so that the albedo of dielectric facets is a + b (1 - c)^p for light at cosine c to the normal.

    This is a fit to integrals of F D G2 / (4 c) that is nowhere below them, so that facets and base conserve energy. It
    exceeds them by at most 0.015 for c > 0.2, and by at most 0.05 for c > 0.1.

    alpha : roughness of GGX
    """
    rough = alpha**0.5
    least = 0.0404 - 0.0261 * rough**3.62
    rise = 0.0556 + 0.904 / (1.0 + (rough / 0.305) ** 3.53)
    return least, rise, 2.89 + 2.11 / (1.0 + (rough / 0.292) ** 3.53)


@dataclass(frozen=True)
class Principled(Material):
    """Microfacet model with base colour, roughness and metallic as in glTF 2.0: dielectric over diffuse, or metal.

    The BRDF is F D G2 / (4 c c') + (1 - metallic) base_color / pi t(c) t(c') / t', with cosines c and c' of eye and
    light to the normal. D : GGX (Walter et al. 2007) with alpha = roughness^2, at least 0.001; G2 : Smith,
    height-correlated (Heitz 2014); F : Schlick, from (1 - metallic) 0.04 + metallic base_color at normal incidence to
    1; t : directional transmittance of dielectric facets, t' its mean (Kelemen and Szirmay-Kalos 2001).

    Scattering between facets is neglected (single scattering): at normal incidence white metal reflects 99.9% at
    roughness 0.1, 92% at 0.5 and 31% at 1. A white dielectric reflects at least 98% up to 78 degrees, 95% up to 84.

    Parameters
    ----------
    base_color : float or (3,) float, or Attribute, optional
        Colour of the diffuse base, and of metal at normal incidence, linear RGB, 0 to 1. None: the colours of the
        points or the plane.
    roughness : float
        0 (nearly a mirror, with a lobe of 0.1 degrees) to 1.
    metallic : float
        0 (dielectric) to 1 (metal); the BRDFs are blended in between.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is not finite or out of its range.

    References
    ----------
    Walter, Marschner, Li, Torrance: Microfacet models for refraction through rough surfaces (2007).
    Heitz: Understanding the masking-shadowing function in microfacet-based BRDFs (2014).
    Kelemen, Szirmay-Kalos: A microfacet based coupled specular-matte BRDF model with importance sampling (2001).

    Examples
    --------
    >>> gold = pr.Principled(base_color=(1.0, 0.77, 0.34), roughness=0.3, metallic=1.0)
    >>> scene = pr.Scene()
    >>> scene.add(pr.Model(pr.procedural("sphere", 1000)), material=gold)
    0
    """

    base_color: Color = None
    roughness: float = 0.5
    metallic: float = 0.0

    def record(self) -> NDArray[np.float64]:
        """Return the material's record for kernels, (10,) float64, with its roughness, see `records.MATERIAL_SIZE`."""
        out = record_of(PRINCIPLED, self.base_color, "base_color")
        alpha = max(check_range(self.roughness, "roughness", 0, 1) ** 2, LEAST_ALPHA)
        out[ALPHA], out[METALLIC] = alpha, check_range(self.metallic, "metallic", 0, 1)
        out[COAT : COAT + 3] = _coat(alpha)
        return out


@inline
def _mean(color: Vec3) -> float:
    return (color[0] + color[1] + color[2]) / 3.0


@inline
def _schlick(at_normal: Vec3, cosine: float) -> Vec3:
    """Return the Fresnel reflectance of a facet, RGB (Schlick 1994).

    at_normal : reflectance at normal incidence; cosine : of the angle between light and the facet's normal
    """
    x = max(1.0 - cosine, 0.0)
    rise = x * x * (x * x) * x
    return add(scale(at_normal, 1.0 - rise), (rise, rise, rise))


@inline
def _transmittance(coat: Vec3, cosine: float) -> float:
    """Return the fraction of light that dielectric facets transmit to the diffuse base below them.

    coat : (a, b, p) of the fit from `_coat`; cosine : of the light's direction to the normal
    """
    return 1.0 - coat[0] - coat[1] * max(1.0 - cosine, 0.0) ** coat[2]


@inline
def _mean_transmittance(coat: Vec3) -> float:
    """Return the fraction of uniform light that dielectric facets transmit to the diffuse base below them.

    coat : (a, b, p) of the fit from `_coat`
    """
    return 1.0 - coat[0] - 2.0 * coat[1] / ((coat[2] + 1.0) * (coat[2] + 2.0))


@inline
def _smith(alpha: float, cosine: float) -> float:
    """Return the root in Smith's masking of GGX facets, G1 = 2 cosine / (cosine + root).

    alpha : roughness; cosine : of the light or eye direction to the normal
    """
    return math.sqrt(alpha * alpha + (1.0 - alpha * alpha) * cosine * cosine)


@inline
def _facets(alpha: float, cosine: float, cos_o: float, half: float) -> tuple[float, float]:
    """Evaluate GGX facets without Fresnel: return (D G2 / (4 cosine cos_o) times cosine, pdf by visible normals).

    alpha : roughness; cosine, cos_o, half : cosines of light, eye and half vector to the surface normal
    """
    spread = 1.0 + (alpha * alpha - 1.0) * half * half
    facets = alpha * alpha / (math.pi * spread * spread)
    both = 0.5 * cosine / (cosine * _smith(alpha, cos_o) + cos_o * _smith(alpha, cosine))
    return facets * both, 0.5 * facets / (cos_o + _smith(alpha, cos_o))


@inline
def _share_of_facets(world: World, material: int, point: ShadingPoint, cos_o: float) -> float:
    """Return the probability of sampling the facets rather than the diffuse base, roughly by their albedos.

    material : offset of its record in `world.materials`; cos_o : cosine of the eye direction to the normal
    """
    metallic, through = (
        world.materials[material + METALLIC],
        _transmittance(load3_flat(world.materials, material + COAT), cos_o),
    )
    gray = _mean(point.color)
    reflected = (1.0 - metallic) * (1.0 - through) + metallic * gray + 1e-6  # black metal reflects at grazing angles
    return reflected / (reflected + (1.0 - metallic) * gray * through)


@inline
def eval_principled(world: World, material: int, point: ShadingPoint, wi: Vec3, cosine: float) -> tuple[Vec3, float]:
    """Evaluate the Principled material: return (BRDF times cosine as RGB, pdf per solid angle of `sample_principled`).

    material : offset of its record in `world.materials`; wi : unit direction to the light
    cosine : of the angle between normal and light, positive
    """
    metallic, coat = world.materials[material + METALLIC], load3_flat(world.materials, material + COAT)
    cos_o = dot(point.normal, point.wo)
    normal = unit(add(point.wo, wi))
    lobe, visible = _facets(world.materials[material + ALPHA], cosine, cos_o, dot(point.normal, normal))
    plain = F0 * (1.0 - metallic)
    at_normal = add((plain, plain, plain), scale(point.color, metallic))
    gloss = scale(_schlick(at_normal, dot(point.wo, normal)), lobe)
    through = _transmittance(coat, cos_o) * _transmittance(coat, cosine) / _mean_transmittance(coat)
    pdf = cosine / math.pi
    share = _share_of_facets(world, material, point, cos_o)
    both = add(gloss, scale(point.color, (1.0 - metallic) * through * pdf))
    return both, share * visible + (1.0 - share) * pdf


@inline
def sample_principled(world: World, material: int, point: ShadingPoint, which: float, u: float, v: float) -> Vec3:
    """Sample a unit direction of the diffuse base, or a reflection at a visible facet.

    The latter may lie below the surface.

    material : offset of its record in `world.materials`; which, u, v : random numbers in [0, 1), for lobe and direction
    """
    normal, cos_o = point.normal, dot(point.normal, point.wo)
    if which >= _share_of_facets(world, material, point, cos_o):
        return sample_diffuse(normal, u, v)
    alpha = world.materials[material + ALPHA]
    # Stretched along the normal, the facets form a hemisphere. Reflections of the stretched eye direction at its
    # visible part are uniform on a spherical cap (Dupuy and Benyoub 2023).
    eye = unit(add(scale(point.wo, alpha), scale(normal, (1.0 - alpha) * cos_o)))
    height = dot(normal, eye)
    facet = add(around(normal, (1.0 - u) * (1.0 + height) - height, v), eye)
    facet = unit(add(scale(facet, alpha), scale(normal, (1.0 - alpha) * dot(normal, facet))))
    return mirrored(point.wo, facet)


@inline
def _share_reflected(alpha: float, cosine: float) -> float:
    """Return the albedo of GGX facets without Fresnel loss, from a table; the rest is scattered between facets.

    alpha : roughness, 0 to 1; cosine : of the eye direction to the normal
    """
    x, y = cosine * (COLUMNS - 1), alpha * (ROWS - 1)
    column, row = min(int(x), COLUMNS - 2), min(int(y), ROWS - 2)
    at, right, below = row * COLUMNS + column, x - column, y - row
    upper = FACET_SHARES[at] * (1.0 - right) + FACET_SHARES[at + 1] * right
    return (
        upper * (1.0 - below)
        + (FACET_SHARES[at + COLUMNS] * (1.0 - right) + FACET_SHARES[at + COLUMNS + 1] * right) * below
    )


@inline
def lobes_of_principled(world: World, material: int, point: ShadingPoint) -> tuple[Vec3, Vec3]:
    """Return the albedos (diffuse base, facets) of a Principled material at a point, RGB.

    material : offset of its record in `world.materials`
    """
    metallic, cos_o = world.materials[material + METALLIC], max(dot(point.normal, point.wo), 0.0)
    through = _transmittance(load3_flat(world.materials, material + COAT), cos_o)
    plain, share = (1.0 - metallic) * (1.0 - through), _share_reflected(world.materials[material + ALPHA], cos_o)
    gloss = add((plain, plain, plain), scale(_schlick(point.color, cos_o), metallic * share))
    return scale(point.color, (1.0 - metallic) * through), gloss


@inline
def exponent_of_facets(alpha: float) -> float:
    """Return the exponent of a lobe cos^exponent about the mirrored direction, as wide as GGX at normal incidence.

    It is a quarter of the exponent 2 / alpha^2 - 2 of the facets' normals (Walter et al. 2007).
    """
    return 0.25 * max(2.0 / (alpha * alpha) - 2.0, 0.0)
