"""Diffuse reflection: `Diffuse`, and `Emissive`, which also emits light.

cosine : of the angle between normal and light, positive. Pdfs are per solid angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.arguments import rgb
from ...engine.jit import inline
from ...engine.kernels.records import DIFFUSE, EMISSIVE, EMITTED, ShadingPoint
from ...engine.kernels.vec import Vec3, around, scale
from .base import Color, Material, record_of


@dataclass(frozen=True)
class Diffuse(Material):
    """Lambertian reflection with the BRDF color / pi.

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
    >>> scene.add(pr.Model(pr.procedural("sphere", 1000)), material=pr.Diffuse((0.8, 0.3, 0.2)))
    0
    """

    color: Color = None

    def record(self) -> NDArray[np.float64]:
        """Return the material's record for kernels, (10,) float64: kind and colour, see `records.MATERIAL_SIZE`."""
        return record_of(DIFFUSE, self.color)


@dataclass(frozen=True)
class Emissive(Material):
    """Lambertian reflection, and emission of the same radiance in all directions on both sides.

    Parameters
    ----------
    radiance : float or (3,) float
        W/(m2 sr), linear RGB.
    color : float or (3,) float, or Attribute, optional
        Albedo of the reflection, with the BRDF color / pi, linear RGB, 0 to 1. None: the colours of the points or the
        plane.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If a value is not finite or out of its range.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> lamp = scene.add(pr.Model(pr.procedural("sphere", 1000)), material=pr.Emissive(2.0))
    >>> image = pr.render(scene, pr.Camera.frame(scene.bounds, size=(3, 3)), pr.Settings("path"))
    >>> float(image[1, 1, 0])
    2.0
    """

    radiance: ArrayLike
    color: Color = 0.0

    def record(self) -> NDArray[np.float64]:
        """Return the material's record for kernels, (10,) float64, with its radiance, see `records.MATERIAL_SIZE`."""
        out = record_of(EMISSIVE, self.color)
        out[EMITTED : EMITTED + 3] = rgb(self.radiance, "radiance")
        return out


@inline
def eval_diffuse(point: ShadingPoint, cosine: float) -> tuple[Vec3, float]:
    """Evaluate Lambertian reflection: return (BRDF times cosine as RGB, pdf per solid angle of `sample_diffuse`).

    cosine : of the angle between normal and light, positive
    """
    pdf = cosine / math.pi
    return scale(point.color, pdf), pdf


@inline
def sample_diffuse(normal: Vec3, u: float, v: float) -> Vec3:
    """Sample a unit direction with pdf cosine / pi by projecting the disc to the hemisphere (Malley's method).

    u, v : random numbers in [0, 1)
    """
    return around(normal, math.sqrt(1.0 - u), v)
