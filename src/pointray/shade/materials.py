"""Materials: how a surface scatters light. Colours are linear RGB or an `Attribute`; None takes the points' own.

Opaque materials shade both sides. None of them reflects more light than it receives, and all are reciprocal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arguments import check_range, reflectance, rgb
from ..kernels.records import (
    ALPHA,
    BASE_COLOR,
    COAT,
    DIELECTRIC,
    DIFFUSE,
    EMISSIVE,
    EMITTED,
    EXPONENT,
    IOR,
    MATERIAL_KIND,
    MATERIAL_SIZE,
    METALLIC,
    MIRROR,
    OWN_COLOR,
    PHONG,
    PRINCIPLED,
    SPECULAR,
)
from .attributes import Attribute

Color = ArrayLike | Attribute | None

MOST_EXPONENT = 1e8  # half a hundredth of a degree wide: a narrower highlight is lost in rounding
LEAST_ALPHA = 1e-3  # a lobe a twentieth of a degree wide; for a narrower one there is Mirror


def record_of(kind: int, color: Color, name: str = "color") -> NDArray[np.float64]:
    """The record of a kind of material with a colour of 0 to 1."""
    out = np.zeros(MATERIAL_SIZE)
    out[MATERIAL_KIND], out[OWN_COLOR] = kind, color is None or isinstance(color, Attribute)
    out[BASE_COLOR : BASE_COLOR + 3] = reflectance(1.0 if out[OWN_COLOR] else color, name)
    return out


class Material:
    """What all materials share: they are checked when they are made."""

    def __post_init__(self) -> None:
        self.record()

    def record(self) -> NDArray[np.float64]:
        """The material as kernels read it, (10,) float64; ValueError if a value is out of range."""
        raise NotImplementedError

    @property
    def attribute(self) -> Attribute | None:
        """The attribute that colours the material, if there is one."""
        color = getattr(self, "base_color" if isinstance(self, Principled) else "color", None)
        return color if isinstance(color, Attribute) else None


@dataclass(frozen=True)
class Diffuse(Material):
    """Reflects evenly (Lambert): BRDF color / pi.

    Parameters
    ----------
    color : float or (3,) float, 0 to 1, or Attribute, optional
    """

    color: Color = None

    def record(self) -> NDArray[np.float64]:
        """The material as kernels read it, (10,) float64."""
        return record_of(DIFFUSE, self.color)


@dataclass(frozen=True)
class Phong(Material):
    """Diffuse with a highlight, energy-conserving.

    BRDF (1 - specular) color / pi + specular (exponent + 2) / (2 pi) cos^exponent, with the angle between the eye and
    the mirrored direction to the light (Lafortune and Willems 1994). The highlight reflects `specular` of the light at
    normal incidence and less at other angles; a narrow one reflects `specular` times the cosine.

    Parameters
    ----------
    color : float or (3,) float, 0 to 1, or Attribute, optional
    specular : float
        Share of the light that the highlight reflects, 0 to 1.
    exponent : float
        How narrow the highlight is, from 0; beyond 1e8 nothing changes.
    """

    color: Color = None
    specular: float = 0.2
    exponent: float = 20

    def record(self) -> NDArray[np.float64]:
        """The material as kernels read it, (10,) float64."""
        out = record_of(PHONG, self.color)
        out[SPECULAR] = check_range(self.specular, "specular", 0, 1)
        out[EXPONENT] = min(check_range(self.exponent, "exponent", 0), MOST_EXPONENT)
        return out


@dataclass(frozen=True)
class Mirror(Material):
    """Reflects `color` of the light into the mirrored direction, at any angle.

    Parameters
    ----------
    color : float or (3,) float, 0 to 1, or Attribute, optional
    """

    color: Color = 1.0

    def record(self) -> NDArray[np.float64]:
        """The material as kernels read it, (10,) float64."""
        return record_of(MIRROR, self.color)


@dataclass(frozen=True)
class Dielectric(Material):
    """A clear body with a smooth surface: glass, water. Outside is where normals point; the surface must be closed.

    Snell's law, and Fresnel's equations for unpolarised light: with the cosines c and c' to the normal on this side and
    beyond it, and the indices' ratio n, ((c - n c') / (c + n c'))^2 / 2 + ((n c - c') / (n c + c'))^2 / 2 is reflected,
    all of it where c' does not exist. Refracted light is not coloured. `shade/bsdf.py` explains why it has no
    factor n^2.

    Parameters
    ----------
    ior : float
        Index of refraction of the inside over that of the outside, 0.01 to 100: 1.33 for water in air, 0.75 for air in
        water.
    """

    ior: float = 1.5

    def record(self) -> NDArray[np.float64]:
        """The material as kernels read it, (10,) float64."""
        out = record_of(DIELECTRIC, 1.0)
        out[IOR] = check_range(self.ior, "ior", 0.01, 100)
        return out


def _coat(alpha: float) -> tuple[float, float, float]:
    """(a, b, p): dielectric facets reflect a + b (1 - c)^p of the light that meets them with cosine c to the normal.

    They are fitted to integrals of F D G2 / (4 c), nowhere below them, so that facets and base together reflect at most
    all light; the fit is above them by at most 0.015 where c > 0.2, and by at most 0.05 where c > 0.1.
    """
    rough = alpha**0.5
    least = 0.0404 - 0.0261 * rough**3.62
    rise = 0.0556 + 0.904 / (1.0 + (rough / 0.305) ** 3.53)
    return least, rise, 2.89 + 2.11 / (1.0 + (rough / 0.292) ** 3.53)


@dataclass(frozen=True)
class Principled(Material):
    """A rough glossy surface over a diffuse base, or metal: base colour, roughness and metallic as in glTF 2.0.

    BRDF F D G2 / (4 c c') + (1 - metallic) base_color / pi t(c) t(c') / t', with cosines c and c' of eye and light to
    the normal. D : GGX (Walter et al. 2007) with alpha = roughness^2, at least 0.001; G2 : Smith's, correlated by
    height (Heitz 2014); F : Schlick's, from (1 - metallic) 0.04 + metallic base_color at normal incidence to 1;
    t : share of the light from one direction that dielectric facets let through, t' its mean (Kelemen and
    Szirmay-Kalos 2001).

    Light that meets several facets is lost (single scattering): white metal reflects 99.9% at roughness 0.1, 92% at
    0.5, 31% at 1 and normal incidence. A white dielectric reflects at least 98% up to 78 degrees, 95% up to 84.

    Parameters
    ----------
    base_color : float or (3,) float, 0 to 1, or Attribute, optional
        The colour of the diffuse base, and of the metal's reflection at normal incidence.
    roughness : float
        0 (nearly a mirror: a lobe of a tenth of a degree) to 1.
    metallic : float
        0 (dielectric) to 1 (metal); between them the BRDFs are blended.
    """

    base_color: Color = None
    roughness: float = 0.5
    metallic: float = 0.0

    def record(self) -> NDArray[np.float64]:
        """The material as kernels read it, (10,) float64."""
        out = record_of(PRINCIPLED, self.base_color, "base_color")
        alpha = max(check_range(self.roughness, "roughness", 0, 1) ** 2, LEAST_ALPHA)
        out[ALPHA], out[METALLIC] = alpha, check_range(self.metallic, "metallic", 0, 1)
        out[COAT : COAT + 3] = _coat(alpha)
        return out


@dataclass(frozen=True)
class Emissive(Material):
    """Emits the same radiance into all directions from both sides, and reflects diffusely.

    Parameters
    ----------
    radiance : float or (3,) float
        W/(sr m2), RGB.
    color : float or (3,) float, 0 to 1, or Attribute, optional
        The colour of the reflection: BRDF color / pi.
    """

    radiance: ArrayLike
    color: Color = 0.0

    def record(self) -> NDArray[np.float64]:
        """The material as kernels read it, (10,) float64."""
        out = record_of(EMISSIVE, self.color)
        out[EMITTED : EMITTED + 3] = rgb(self.radiance, "radiance")
        return out
