"""A surface of a material for tests: its BSDF and samples of it, and integrals over directions."""

from __future__ import annotations

import numpy as np

import pointray as pr
from pointray.engine.jit import kernel
from pointray.engine.kernels.records import ShadingPoint
from pointray.shade.bsdf import base_color, emitted, eval_bsdf, is_specular, sample_bsdf
from pointray.shade.materials.specular import glass
from pointray.surface.trace.hits import material_at


@kernel
def _eval_bsdf(world, instance, wo, color, wi, rgb, pdf):
    """The BSDF at a point with normal z. wo : (4,), the direction to the eye and its side; wi, rgb : (n, 3)"""
    material = material_at(world, instance)
    own = base_color(world, material, (color[0], color[1], color[2]))
    point = ShadingPoint((0.0, 0.0, 1.0), (wo[0], wo[1], wo[2]), own, wo[3])
    for i in range(len(wi)):
        rgb[i], pdf[i] = eval_bsdf(world, material, point, (wi[i, 0], wi[i, 1], wi[i, 2]))


@kernel
def _sample(world, instance, wo, color, numbers, direction, weight, pdf, side):
    """Samples of the BSDF at a point with normal z. numbers : rows lobe, u, v"""
    material = material_at(world, instance)
    own = base_color(world, material, (color[0], color[1], color[2]))
    point = ShadingPoint((0.0, 0.0, 1.0), (wo[0], wo[1], wo[2]), own, wo[3])
    for i in range(len(numbers)):
        lobe, u, v = numbers[i, 0], numbers[i, 1], numbers[i, 2]
        direction[i], weight[i], pdf[i], side[i] = sample_bsdf(world, material, point, lobe, u, v)


@kernel
def _glass(world, instance, wo, reflected, refracted, share):
    material = material_at(world, instance)
    for i in range(len(wo)):
        point = ShadingPoint((0.0, 0.0, 1.0), (wo[i, 0], wo[i, 1], wo[i, 2]), (1.0, 1.0, 1.0), wo[i, 3])
        reflected[i], refracted[i], share[i] = glass(world, material, point)


@kernel
def _own_light(world, instance, out):
    material = material_at(world, instance)
    out[0], out[1], out[2] = emitted(world, material)
    return is_specular(world, material)


class Surface:
    """A material at a point with normal z, seen from some angle in the xz plane."""

    def __init__(self, material, color=(1.0, 1.0, 1.0)):
        scene = pr.Scene()
        scene.add(pr.Plane((0, 0, 0), (0, 0, 1)))  # so that the material is not the first of the world
        self.instance = scene.add(pr.Plane((0, 0, 0), (0, 0, 1)), material=material)
        self.world = scene.snapshot().world
        self.color = np.array(color, float)

    def eval_bsdf(self, wo, wi):
        """(rgb (n, 3), pdf (n,)) of directions wi (n, 3)."""
        rgb, pdf = np.empty((len(wi), 3)), np.empty(len(wi))
        _eval_bsdf(self.world, self.instance, wo, self.color, wi, rgb, pdf)
        return rgb, pdf

    def sample(self, wo, numbers):
        """(direction (n, 3), weight (n, 3), pdf (n,), side (n,)) for numbers (n, 3)."""
        n = len(numbers)
        out = np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty(n)
        _sample(self.world, self.instance, wo, self.color, numbers, *out)
        return out

    def glass(self, wos):
        """(reflected (n, 3), refracted (n, 3), share (n,)) for wos (n, 4)."""
        out = np.empty((len(wos), 3)), np.empty((len(wos), 3)), np.empty(len(wos))
        _glass(self.world, self.instance, wos, *out)
        return out

    def own_light(self):
        """(radiance (3,), whether specular)."""
        out = np.empty(3)
        specular = _own_light(self.world, self.instance, out)
        return out, specular


def wo_at(degrees, side=1.0):
    """The direction to the eye at an angle from the normal, and the eye's side."""
    angle = np.radians(degrees)
    return np.array([np.sin(angle), 0.0, np.cos(angle), side])


# Polar coordinates around the mirrored direction of the eye: rings that widen from it, and sectors.
RINGS = np.append(0, np.pi * 0.5 ** np.arange(16, -1, -1.0))
SECTORS, TURNS, NODES = 8, 720, 8


def quadrature(wo):
    """Directions (n, 3) and their solid angles (n,), ordered by ring, then by sector."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    width = np.diff(RINGS)[:, None]
    polar, dpolar = (RINGS[:-1, None] + width * (x + 1) / 2).ravel(), (width * w / 2).ravel()
    turn = (np.arange(TURNS) + 0.5) * 2 * np.pi / TURNS
    axis, side, back = frame(wo)
    ring = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * back
    directions = np.cos(polar)[:, None, None] * axis + np.sin(polar)[:, None, None] * ring
    return directions.reshape(-1, 3), np.repeat(np.sin(polar) * dpolar * 2 * np.pi / TURNS, TURNS)


def frame(wo):
    """The mirrored direction of the eye, and two directions across it."""
    x, _, z = wo[:3]
    return np.array([-x, 0.0, z]), np.array([z, 0.0, x]), np.array([0.0, 1.0, 0.0])


def upper(v):
    """Unit vectors on the normal's side."""
    v = v / np.linalg.norm(v, axis=1, keepdims=True)
    return np.column_stack([v[:, :2], np.abs(v[:, 2])])


def integrals(surface, wo):
    """(albedo (3,), integral of the pdf) over all directions."""
    directions, solid = quadrature(wo)
    rgb, pdf = surface.eval_bsdf(wo, directions)
    return solid @ rgb, solid @ pdf


def bins_of(wo, directions):
    """Ring and sector of directions, as one number."""
    axis, side, back = frame(wo)
    across = np.stack([directions @ side, directions @ back])
    polar = np.arctan2(np.hypot(*across), directions @ axis)
    turn = np.arctan2(across[1], across[0]) % (2 * np.pi)
    ring = np.clip(np.searchsorted(RINGS, polar) - 1, 0, len(RINGS) - 2)
    return ring * SECTORS + np.minimum((turn * SECTORS / (2 * np.pi)).astype(int), SECTORS - 1)
