"""Smooth surfaces with delta distributions: `Mirror` and `Dielectric`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...base.arguments import check_range
from ...engine.jit import inline
from ...engine.kernels.records import DIELECTRIC, IOR, MATERIAL_KIND, MIRROR, ShadingPoint, World
from ...engine.kernels.vec import WHITE, Vec3, dot, mirrored, scale, sub
from .base import Color, Material, record_of


@dataclass(frozen=True)
class Mirror(Material):
    """Perfect mirror with the reflectance `color` at all angles.

    Parameters
    ----------
    color : float or (3,) float, or Attribute, optional
        Linear RGB, 0 to 1. None: the colours of the points or the plane.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is not finite or out of its range.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> scene.add(pr.Plane(point=(0, 0, -1), normal=(0, 0, 1)), material=pr.Mirror(0.9))
    0
    """

    color: Color = 1.0

    def record(self) -> NDArray[np.float64]:
        """Return the material's record for kernels, (10,) float64: kind and colour, see `records.MATERIAL_SIZE`."""
        return record_of(MIRROR, self.color)


@dataclass(frozen=True)
class Dielectric(Material):
    """Smooth, clear dielectric such as glass or water. Normals point outside; the surface must be closed.

    Light follows Snell's law and Fresnel's equations for unpolarised light. With the cosines c and c' to the normal on
    this and the other side, and the ratio n of the indices, the reflectance is
    ((c - n c') / (c + n c'))^2 / 2 + ((n c - c') / (n c + c'))^2 / 2, and 1 with total reflection. Refracted light is
    not coloured. `shade/bsdf.py` explains why it has no factor n^2.

    Parameters
    ----------
    ior : float
        Index of refraction of the inside divided by that of the outside, 0.01 to 100: 1.33 for water in air, 0.75 for
        air in water.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is not finite or out of its range.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> scene.add(pr.Model(pr.procedural("sphere", 1000)), material=pr.Dielectric(ior=1.33))
    0
    """

    ior: float = 1.5

    def record(self) -> NDArray[np.float64]:
        """Return the material's record for kernels, (10,) float64: kind and index, see `records.MATERIAL_SIZE`."""
        out = record_of(DIELECTRIC, 1.0)
        out[IOR] = check_range(self.ior, "ior", 0.01, 100)
        return out


@inline
def fresnel(cosine: float, beyond: float, ratio: float) -> float:
    """Return the reflectance of a smooth dielectric for unpolarised light.

    cosine, beyond : cosines to the normal on this side and on the other, not both 0
    ratio : index of refraction of the other side divided by that of this one
    """
    across = (cosine - ratio * beyond) / (cosine + ratio * beyond)
    within = (ratio * cosine - beyond) / (ratio * cosine + beyond)
    return 0.5 * (across * across + within * within)


@inline
def glass(world: World, material: int, point: ShadingPoint) -> tuple[Vec3, Vec3, float]:
    """Return (reflected direction, refracted direction, reflectance) of a Dielectric; directions are unit vectors.

    With total reflection, or at cosine 0, the reflectance is 1 and the refracted direction is the reflected one.

    material : offset of its record in `world.materials`
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
    """Sample a Mirror or a Dielectric: return (unit direction, weight as RGB, 0.0 for the pdf, side).

    The side, +1.0 or -1.0, is that of the surface on which the new ray leaves.

    material : offset of its record in `world.materials`
    which : random number in [0, 1) that chooses between reflection and refraction
    """
    if world.materials[material + MATERIAL_KIND] == MIRROR:
        return mirrored(point.wo, point.normal), point.color, 0.0, point.side
    reflected, refracted, share = glass(world, material, point)
    if which < share:
        return reflected, WHITE, 0.0, point.side
    return refracted, WHITE, 0.0, -point.side
