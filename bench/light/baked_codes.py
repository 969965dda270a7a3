"""Candidate encodings of the light that arrives at a splat, and their reflections: moments, a Gaussian, records."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import least_squares

from bench.light.baked_maps import COSINE, MIRRORED, Floats, Lobe, W, spiral
from bench.light.baked_records import LUMINANCE, pack_values, reflected, values_of
from pointray.engine.kernels.records import PHONG, PRINCIPLED

Y00 = 0.5 / np.sqrt(np.pi)
Kernel = Callable[[Lobe, Floats], Floats]


def harmonics(w: Floats) -> Floats:
    """Real spherical harmonics of bands 0 to 2, (9, n)."""
    x, y, z = w.T
    band1 = [np.sqrt(3) * a for a in (x, y, z)]
    band2 = [np.sqrt(15) * a for a in (x * y, y * z, z * x, (x * x - y * y) / 2)]
    return Y00 * np.array([np.ones(len(w)), *band1, *band2, np.sqrt(5) / 2 * (3 * z * z - 1)])


def irradiances(maps: Floats) -> Floats:
    """Irradiance of each map (points, 3), as RGB9E5."""
    energy = np.einsum("pnc,n->pc", maps, COSINE)
    step = 2.0 ** (np.floor(np.log2(energy.max(axis=1, keepdims=True))) - 8)
    return np.asarray(np.round(energy / step) * step, np.float64)


def quantised(values: Floats, most: Floats | float, bits: int, power: float = 1.0) -> Floats:
    """Signed values quantized to a number of bits, evenly in values^power."""
    steps, whole = 2 ** (bits - 1) - 1, np.clip(values / most, -1, 1)
    level = np.round(np.abs(whole) ** power * steps) / steps
    return np.sign(whole) * level ** (1 / power) * most


class Code(Protocol):
    """An encoding of light in addition to the irradiance (RGB9E5). size : total bits"""

    size: int

    def __call__(self, maps: Floats, frames: Floats, lobes: list[Lobe]) -> list[Floats]:
        """Reflected radiance for each lobe, (points, 3, 32).

        Parameters
        ----------
        maps : (points, n, 3)
            Radiance that arrives.
        frames : (points, 3, 3)
        lobes : list of Lobe
        """


@dataclass(frozen=True, eq=False)
class Linear(Code):
    """Moments of the radiance divided by the first, which follows from the irradiance.

    What is kept is how a ratio differs from that of even light, in steps that grow with it. The range is half of the
    possible one, and all of it for RGB; luminance in these scenes never left it.

    Attributes
    ----------
    moments : (k, n)
    kernel : Kernel
        From a lobe and k moments to the reflected radiance of each, (k, 32).
    irradiance : (k,)
        Irradiance of the radiance that each moment stands for.
    bits : int
        A ratio, of luminance.
    rgb : bool
        The ratios are of each channel.
    world : bool
        The moments are harmonics, kept in world axes.
    """

    moments: Floats
    kernel: Kernel
    irradiance: Floats
    bits: int = 8
    rgb: bool = False
    world: bool = False

    @property
    def size(self) -> int:
        """Bits in all."""
        return (len(self.moments) - 1) * self.bits * (3 if self.rgb else 1)

    def ratios(self, maps: Floats, frames: Floats) -> Floats:
        """Ratios (points, 3, k)."""
        k, most = len(self.moments), np.abs(self.moments / self.moments[0]).max(axis=1)
        turn = np.broadcast_to(np.eye(k), (len(maps), k, k))
        if self.world:
            own = np.linalg.pinv(harmonics(W).T)
            turn = np.array([own @ harmonics(W @ frame).T for frame in frames])[:, :k, :k]
            most = np.repeat(np.sqrt((1, 3, 5)), (1, 3, 5))[:k]
        moments = np.einsum("pnc,kn->pck", maps, self.moments)
        each, grey = moments / moments[..., :1], LUMINANCE @ moments
        ratio = each if self.rgb else np.repeat((grey / grey[:, :1])[:, None], 3, axis=1)
        even = self.moments.sum(axis=1) / self.moments[0].sum()
        kept = quantised((ratio - even) @ turn, most if self.rgb else most / 2, self.bits, power=0.7)
        return kept @ np.swapaxes(turn, 1, 2) + even

    def __call__(self, maps: Floats, frames: Floats, lobes: list[Lobe]) -> list[Floats]:
        """Reflected radiance."""
        ratios = self.ratios(maps, frames)
        scale = irradiances(maps) / np.maximum(ratios @ self.irradiance, 0.05 * self.irradiance[0])
        return [scale[..., None] * (ratios @ self.kernel(lobe, self.moments)) for lobe in lobes]


class Gaussian(Code):
    """A spherical Gaussian over even light, with a share of the irradiance of each channel: 8 bits a number.

    Its axis is octahedral; its sharpness, 1/2 to 128, logarithmic. Evaluation is exact.
    """

    size = 48

    def __call__(self, maps: Floats, frames: Floats, lobes: list[Lobe]) -> list[Floats]:
        """Reflected radiance."""
        pictures = []
        for goal, frame in zip(maps / np.einsum("pnc,n->pc", maps, COSINE)[:, None], frames, strict=True):
            bump = gaussians(packed_axes(fit(goal - 1 / np.pi) @ frame) @ frame.T)
            pictures.append(1 / np.pi + bump @ quantised(shares(bump, goal - 1 / np.pi), 1.0, 8))
        scaled = irradiances(maps)[:, None] * np.array(pictures)
        return [np.einsum("pnc,nr->pcr", scaled, lobe.table, optimize=True) for lobe in lobes]


def gaussians(axes: Floats) -> Floats:
    """Spherical Gaussians of irradiance 1 less such even light, (n, k); axes (k, 3) are as long as they are sharp."""
    bumps = np.exp(W @ axes.T - np.linalg.norm(axes, axis=1))
    return bumps / (COSINE @ bumps) - 1 / np.pi


def shares(bumps: Floats, rest: Floats) -> Floats:
    """The share of each bump (n, k) with which they come closest to the rest, times the cosine, (k, channels)."""
    weighted = bumps.T * (COSINE * W[:, 2])
    return np.clip(np.linalg.lstsq(weighted @ bumps, weighted @ rest, rcond=None)[0], -1, 1)


ROOT = np.sqrt(COSINE * W[:, 2])[:, None]
GRID = np.concatenate([sharpness * spiral(300, -0.2) for sharpness in (1, 2, 4, 8, 16, 32, 64)])
BUMPS = ROOT * gaussians(GRID)


def fit(rest: Floats) -> Floats:
    """The axis (1, 3), as long as the Gaussian is sharp: the best of a grid at first, then by least squares."""

    def left(axis: Floats) -> Floats:
        bump = gaussians(axis[None])
        return (ROOT * (rest - bump @ shares(bump, rest))).ravel()

    gain = ((BUMPS.T @ (ROOT * rest)) ** 2).sum(axis=1) / (BUMPS**2).sum(axis=0)
    found = least_squares(left, GRID[np.argmax(gain)], bounds=(-130, 130), max_nfev=30)
    return np.asarray(found.x, np.float64)[None]


def packed_axes(axes: Floats) -> Floats:
    """Axes (k, 3) with octahedral directions and logarithmic lengths of 8 bits."""
    length = np.linalg.norm(axes, axis=1, keepdims=True)
    flat = axes / np.abs(axes).sum(axis=1, keepdims=True)
    flat = quantised(np.where(flat[:, 2:] < 0, folded(flat[:, :2]), flat[:, :2]), 1.0, 8)
    height = 1 - np.abs(flat).sum(axis=1, keepdims=True)
    whole = np.hstack([np.where(height < 0, folded(flat), flat), height])
    octaves = quantised(np.log2(np.maximum(length, 0.5) / 8), 4.0, 8)
    return whole / np.linalg.norm(whole, axis=1, keepdims=True) * 8 * 2**octaves


def folded(flat: Floats) -> Floats:
    """The lower half of an octahedron unfolded around its upper half, and back."""
    return (1 - np.abs(flat[:, ::-1])) * np.where(flat < 0, -1, 1)


class Records(Code):
    """What pointray keeps, by its own kernels; it is always packed."""

    size = 64

    def __call__(self, maps: Floats, frames: Floats, lobes: list[Lobe]) -> list[Floats]:
        """Reflected radiance."""
        values = [values_of(light, W @ frame, COSINE, frame[2]) for light, frame in zip(maps, frames, strict=True)]
        records, r = pack_values(np.array(values)), np.einsum("rk,pkx->prx", MIRRORED, frames)
        results = []
        for lobe in lobes:
            kind = PRINCIPLED if lobe.name.startswith("ggx") else PHONG
            result = reflected(records, (float(kind), float(lobe.exponent)), frames[:, 2], r).swapaxes(1, 2)
            results.append(result * lobe.table.sum(axis=0) if kind == PRINCIPLED else result)
        return results
