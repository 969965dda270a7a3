"""Phong's highlight over diffuse reflection: `Phong`.

cosine : of the angle between normal and light, positive. Pdfs are per solid angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...base.arguments import check_range
from ...engine.jit import inline
from ...engine.kernels.records import EXPONENT, PHONG, SPECULAR, ShadingPoint, World
from ...engine.kernels.vec import Vec3, add, around, dot, mirrored, scale
from .base import Color, Material, record_of
from .diffuse import eval_diffuse, sample_diffuse

MOST_EXPONENT = 1e8  # a lobe 0.005 degrees wide; narrower ones are lost in rounding


@dataclass(frozen=True)
class Phong(Material):
    """Modified Phong model: diffuse with an energy-conserving highlight (Lafortune and Willems 1994).

    The BRDF is (1 - specular) color / pi + specular (exponent + 2) / (2 pi) cos^exponent, with the cosine of the angle
    between the eye and the mirrored direction to the light. The albedo of the highlight is `specular` at normal
    incidence and less at other angles; that of a narrow highlight is `specular` times the cosine.

    Parameters
    ----------
    color : float or (3,) float, or Attribute, optional
        Linear RGB, 0 to 1. None: the colours of the points or the plane.
    specular : float
        Albedo of the highlight at normal incidence, 0 to 1.
    exponent : float
        Exponent of the highlight, at least 0; larger is narrower. Limited to 1e8.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is not finite or out of its range.

    References
    ----------
    Lafortune, Willems: Using the modified Phong reflectance model for physically based rendering (1994).

    Examples
    --------
    >>> scene = pr.Scene()
    >>> scene.add(pr.Model(pr.procedural("sphere", 1000)), material=pr.Phong(specular=0.05, exponent=40))
    0
    """

    color: Color = None
    specular: float = 0.2
    exponent: float = 20

    def record(self) -> NDArray[np.float64]:
        """Return the material's record for kernels, (10,) float64, with its highlight, see `records.MATERIAL_SIZE`."""
        out = record_of(PHONG, self.color)
        out[SPECULAR] = check_range(self.specular, "specular", 0, 1)
        out[EXPONENT] = min(check_range(self.exponent, "exponent", 0), MOST_EXPONENT)
        return out


@inline
def _share_of_highlight(color: Vec3, specular: float) -> float:
    """Return the probability of sampling Phong's highlight rather than its diffuse lobe, by the largest albedo of each.

    color : of the diffuse lobe; specular : albedo of the highlight, above 0
    """
    return specular / (specular + (1.0 - specular) * (color[0] + color[1] + color[2]) / 3.0)


@inline
def eval_phong(world: World, material: int, point: ShadingPoint, wi: Vec3, cosine: float) -> tuple[Vec3, float]:
    """Evaluate the Phong material: return (BRDF times cosine as RGB, pdf per solid angle of `sample_phong`).

    material : offset of its record in `world.materials`; wi : unit direction to the light
    cosine : of the angle between normal and light, positive
    """
    specular = world.materials[material + SPECULAR]
    diffuse, pdf = eval_diffuse(point, cosine)
    if specular == 0.0:  # skips the costly power
        return diffuse, pdf
    exponent, share = world.materials[material + EXPONENT], _share_of_highlight(point.color, specular)
    along = dot(mirrored(wi, point.normal), point.wo)
    lobe = along**exponent / (2.0 * math.pi) if along > 0.0 else 0.0
    gloss = specular * (exponent + 2.0) * lobe * cosine
    both = add(scale(diffuse, 1.0 - specular), (gloss, gloss, gloss))
    return both, share * (exponent + 1.0) * lobe + (1.0 - share) * pdf


@inline
def sample_phong(world: World, material: int, point: ShadingPoint, which: float, u: float, v: float) -> Vec3:
    """Sample a unit direction of the diffuse lobe or the highlight (Lafortune and Willems 1994).

    Directions of the highlight may lie below the surface.

    material : offset of its record in `world.materials`; which, u, v : random numbers in [0, 1), for lobe and direction
    """
    specular = world.materials[material + SPECULAR]
    if specular == 0.0 or which >= _share_of_highlight(point.color, specular):
        return sample_diffuse(point.normal, u, v)
    cosine = (1.0 - u) ** (1.0 / (world.materials[material + EXPONENT] + 1.0))
    return around(mirrored(point.wo, point.normal), cosine, v)


@inline
def lobes_of_phong(world: World, material: int, point: ShadingPoint) -> tuple[Vec3, Vec3]:
    """Return the albedos (diffuse lobe, highlight) of a Phong material, RGB.

    material : offset of its record in `world.materials`
    """
    specular = world.materials[material + SPECULAR]
    return scale(point.color, 1.0 - specular), (specular, specular, specular)
