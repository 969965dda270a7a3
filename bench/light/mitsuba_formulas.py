"""Materials that Mitsuba 3 lacks, implemented for it with the formulas of `pointray.shade.materials`.

They compare everything except the formula: normals, lights, sampling, bounces. This module can only be imported with a
variant of Mitsuba that works on arrays.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

import pointray as pr
from pointray.engine.kernels.records import COAT

F0 = 0.04


class Glossy(mi.BSDF):  # type: ignore[misc]
    """A diffuse base under a glossy lobe. Half of the directions are sampled by the cosine, half by microfacets."""

    def __init__(self, properties: Any, alpha: float) -> None:
        super().__init__(properties)
        self._color = mi.Color3f(properties["color"])
        self._facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)
        self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
        self.m_flags = self.m_components[0]

    def formula(self, color: Any, wi: Any, wo: Any) -> Any:
        """BRDF times cosine."""
        raise NotImplementedError

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any) -> Any:
        facet, _ = self._facets.sample(si.wi, sample2)
        even = mi.warp.square_to_cosine_hemisphere(sample2)
        out = dr.zeros(mi.BSDFSample3f)
        out.wo = dr.select(sample1 < 0.5, even, mi.reflect(si.wi, facet))
        out.pdf = self.pdf(ctx, si, out.wo, active)
        out.eta, out.sampled_type, out.sampled_component = 1.0, mi.UInt32(+mi.BSDFFlags.GlossyReflection), 0
        good = active & (out.pdf > 0.0)
        return out, dr.select(good, self.eval(ctx, si, out.wo, active) / out.pdf, 0.0)

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
        seen = active & (si.wi.z > 0.0) & (wo.z > 0.0)
        return dr.select(seen, self.formula(self._color, si.wi, wo), 0.0)

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
        half = dr.normalize(si.wi + wo)
        mirrored = self._facets.pdf(si.wi, half) / (4.0 * dr.dot(wo, half))
        seen = active & (si.wi.z > 0.0) & (wo.z > 0.0)
        return dr.select(seen, 0.5 * mirrored + 0.5 * wo.z * dr.inv_pi, 0.0)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)


class Phong(Glossy):
    """`pr.Phong`."""

    def __init__(self, properties: Any) -> None:
        self.specular, self.exponent = properties["specular"], properties["exponent"]
        super().__init__(properties, (2.0 / (self.exponent + 2.0)) ** 0.5)

    def formula(self, color: Any, wi: Any, wo: Any) -> Any:
        along = dr.maximum(dr.dot(mi.reflect(wi), wo), 0.0)
        lobe = (self.exponent + 2.0) * 0.5 * dr.inv_pi * along**self.exponent
        return ((1.0 - self.specular) * color * dr.inv_pi + self.specular * lobe) * wo.z


class Plastic(Glossy):
    """`pr.Principled` without metal."""

    def __init__(self, properties: Any) -> None:
        self._alpha = properties["roughness"] ** 2
        self._coat = pr.Principled(1.0, properties["roughness"]).record()[COAT : COAT + 3]
        super().__init__(properties, self._alpha)

    def _transmittance(self, cosine: Any) -> Any:
        least, rise, power = (float(c) for c in self._coat)
        return 1.0 - least - rise * (1.0 - cosine) ** power

    def _beyond(self, w: Any) -> Any:
        """Smith's Lambda."""
        square = (1.0 - w.z * w.z) / (w.z * w.z)
        return 0.5 * (dr.sqrt(1.0 + self._alpha**2 * square) - 1.0)

    def formula(self, color: Any, wi: Any, wo: Any) -> Any:
        least, rise, power = (float(c) for c in self._coat)
        half = dr.normalize(wi + wo)
        spread = (half.z * half.z) * (self._alpha**2 - 1.0) + 1.0
        facets = self._alpha**2 * dr.inv_pi / (spread * spread)
        fresnel = F0 + (1.0 - F0) * (1.0 - dr.dot(wi, half)) ** 5
        gloss = fresnel * facets / (1.0 + self._beyond(wi) + self._beyond(wo)) / (4.0 * wi.z)
        mean = 1.0 - least - 2.0 * rise / ((power + 1.0) * (power + 2.0))
        return gloss + color * dr.inv_pi * self._transmittance(wi.z) * self._transmittance(wo.z) / mean * wo.z


mi.register_bsdf("pointray_phong", Phong)
mi.register_bsdf("pointray_plastic", Plastic)
