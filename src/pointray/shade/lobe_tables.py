"""Tables for estimates of what a lobe reflects, given the irradiance and a few moments of the arriving light.

The unknown radiance is modelled as a random field over directions: an arbitrary level, plus deviations with the
correlation exp(-angle). The estimate is the mean reflected light of all fields with the known moments, whose error is
NOISE of the irradiance (kriging; Rasmussen and Williams 2006, equation 2.41). It is linear in the differences from the
moments of uniform light (`baked_code.py`). With the irradiance E, the normal n and the unit direction r of the lobe:

    E even + d.(a n + b r) + n.D (p n + q r) + s r.D r + c.(a' n + b' r)

The vector d and the symmetric matrix D are bands 1 and 2 of luminance; the vector c is band 1 of a channel minus that
of luminance. By symmetry the coefficients even, a, b, p, q, s, a', b' depend only on n.r and on the width of the lobe.
Each entry of the table holds them in this order; `lobes.py` interpolates between entries.

Integrals are sums over half of the hemisphere, as the integrands are symmetric about the plane of n and r. Both tables
take 12 ms.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..base.arrays import Doubles, Floats
from ..engine.jit import Table
from .harmonics import BAND_0, BAND_1, BAND_2, BAND_2_CROSS

NUMBERS = 8
COLUMNS = 16  # uniform steps of n.r from 0 to 1
ROWS, HALFWAY, LAST = 16, 4.0, 2.0 / 3.0  # uniform steps of exponent / (exponent + HALFWAY) from 0 to LAST
RINGS, TURNS = 24, 24  # elevations and azimuths of the quadrature
NOISE = 0.02
LEVEL = 100.0  # variance of the level, relative to that of the deviations
GRAZING = 1e-4  # 1 - n.r of the last column, where n and r still span a plane

PHONG_LOBES, FACETS = 0, 1  # kinds of lobes


def exponents() -> Doubles:
    """Return the exponents of glossy lobes for which coefficients are tabulated, (ROWS,), increasing from 0."""
    u = np.linspace(0.0, LAST, ROWS)
    return np.asarray(HALFWAY * u / (1.0 - u))


def phong_lobes(w: Doubles, cosine: Doubles, exponent: float) -> Doubles:
    """Evaluate Phong's lobe times the cosine to the normal, (n, k), for n light directions and k mirrored directions.

    w : (n, 3), unit light directions, z along the normal; cosine : (k,), of the mirrored directions to the normal
    exponent : of the lobe
    """
    along = w[:, :1] * np.sqrt(1.0 - cosine**2) + w[:, 2:] * cosine
    lobe = np.where(along > 0.0, np.abs(along) ** exponent, 0.0)
    return np.asarray((exponent + 2.0) / (2.0 * math.pi) * lobe * w[:, 2:])


def facet_lobes(w: Doubles, cosine: Doubles, exponent: float) -> Doubles:
    """Evaluate GGX without Fresnel times the cosine to the normal, (n, k), for n light and k eye directions.

    w : (n, 3), unit light directions, z along the normal; cosine : (k,), of the eye direction (and of its mirror image,
        about which the lobe lies) to the normal
    exponent : gives the roughness, as the inverse of `exponent_of_facets`
    """
    square, i = 1.0 / (2.0 * exponent + 1.0), w[:, 2:]
    half = np.stack([w[:, :1] - np.sqrt(1.0 - cosine**2), w[:, 1:2] + 0.0 * cosine, i + cosine])
    spread = 1.0 + (square - 1.0) * half[2] ** 2 / (half**2).sum(axis=0)
    roots = cosine * np.sqrt(square + (1.0 - square) * i * i) + i * np.sqrt(square + (1.0 - square) * cosine**2)
    return np.asarray(0.5 * square / (math.pi * spread**2 * roots) * i)


def _sums() -> tuple[Doubles, Doubles]:
    """Return directions and weights for integrals over half of the hemisphere: (n, 3) with y > 0, z up, and (n,).

    They are ordered by elevation, and denser at the horizon.
    """
    u, weights = np.polynomial.legendre.leggauss(RINGS)
    u = 0.5 * u + 0.5
    z, turn = u * u, (np.arange(TURNS) + 0.5) * math.pi / TURNS
    level = np.sqrt(1.0 - z * z)[:, None]
    w = np.stack(np.broadcast_arrays(level * np.cos(turn), level * np.sin(turn), z[:, None]), axis=-1).reshape(-1, 3)
    return w, np.repeat(weights * u * 2.0 * math.pi / TURNS, TURNS)


def _moments(w: Doubles) -> tuple[Doubles, Doubles, Doubles]:
    """Return the real spherical harmonics up to band 2 that are even in y, at directions w, (n, 3).

    They are grouped by azimuthal order 0, 1 and 2: arrays (3, n), (2, n) and (1, n).
    """
    x, y, z = w.T
    steady = np.array([np.full_like(z, BAND_0), BAND_1 * z, BAND_2 * (3.0 * z * z - 1.0)])
    return steady, np.array([BAND_1 * x, 2.0 * BAND_2_CROSS * x * z]), np.array([BAND_2_CROSS * (x * x - y * y)])


class _Estimate:
    """Linear estimator of what a glossy lobe reflects, from a few spherical harmonics of the arriving light."""

    def __init__(self) -> None:
        w, self.weights = _sums()
        self.w = w
        ring = w[::TURNS] * (0, 0, 1)
        ring[:, 0] = np.sqrt(1.0 - ring[:, 2] ** 2)
        apart = np.exp(-np.arccos(np.clip(ring @ w.T, -1.0, 1.0)))  # correlation with the directions of azimuth 0
        turn = np.arctan2(w[:, 1], w[:, 0])
        self._with_lobes, self._with_each = [], []
        noise = 0.0
        for order, functions in enumerate(_moments(w)):
            weighted = functions * w[:, 2] * self.weights
            around = np.cos(order * turn)
            of_field = np.repeat(weighted @ apart.T, TURNS, axis=1) * around
            if order == 0:
                noise = NOISE**2 * float(of_field[0] @ weighted[0])
                of_field = of_field + LEVEL * weighted.sum(axis=1, keepdims=True)
            uncertain = np.full(len(functions), noise)
            uncertain[0] = 0.0 if order == 0 else noise
            self._with_lobes.append(of_field)
            self._with_each.append(of_field @ weighted.T + np.diag(uncertain))

    def __call__(self, lobes: Doubles, colors: bool) -> list[Doubles]:
        """Return the coefficients of harmonics of arriving light whose sum estimates what each of k lobes reflects.

        lobes : (n, k), lobes at the quadrature directions, times their weights
        colors : use bands 0 and 1 only, all that is known of red and blue; else also band 2

        Returns
        -------
        list of (m, k) float64
            For each azimuthal order the coefficients of its m harmonics.
        """
        used = (2, 1) if colors else (3, 2, 1)
        return [
            np.asarray(np.linalg.solve(each[:m, :m], with_lobes[:m] @ lobes))
            for m, each, with_lobes in zip(used, self._with_each, self._with_lobes, strict=False)
        ]


def make_table() -> Floats:
    """Compute the coefficients from which a glossy lobe's reflection of baked light is estimated.

    Entries of NUMBERS coefficients are ordered by kind of lobe (Phong, facets), exponent, and cosine of normal and
    mirrored direction. Facet lobes are normalized to albedo 1.

    Returns
    -------
    (kinds * ROWS * COLUMNS * NUMBERS,) float32
    """
    cosine = np.minimum(np.linspace(0.0, 1.0, COLUMNS), 1.0 - GRAZING)
    estimate = _Estimate()
    of_phong = [phong_lobes(estimate.w, cosine, e) for e in exponents()]
    of_facets = [facet_lobes(estimate.w, cosine, e) for e in exponents()]
    lobes = np.stack([of_phong, of_facets]).transpose(2, 0, 1, 3) * estimate.weights[:, None, None, None]
    even = lobes.sum(axis=0)
    lobes[:, FACETS] /= even[FACETS]
    even[FACETS] = 1.0
    flat, sine = lobes.reshape(len(lobes), -1), np.sqrt(1.0 - cosine**2)
    shape = even.shape
    steady, once, twice = (part.reshape(-1, *shape) for part in estimate(flat, colors=False))
    level, tilt = (part.reshape(-1, *shape) for part in estimate(flat, colors=True))
    # t = (r - (n.r) n) / sine is the unit vector perpendicular to n.
    b, b_color = once[0] / sine, tilt[0] / sine
    nn, nt, tt = steady[2] / (2.0 * BAND_2) + 0.5 * twice[0] / BAND_2_CROSS, once[1] / sine, twice[0] / sine**2
    nt, tt = nt / BAND_2_CROSS, tt / BAND_2_CROSS
    numbers = [even / math.pi, steady[1] - cosine * b, b]
    numbers += [nn - cosine * nt + cosine**2 * tt, nt - 2.0 * cosine * tt, tt]
    numbers += [level[1] - cosine * b_color, b_color]
    return np.stack(numbers, axis=-1).astype(np.float32).reshape(-1)


def facet_shares() -> Floats:
    """Compute the albedo of GGX facets without Fresnel loss, (ROWS * COLUMNS,) float32.

    Rows are uniform steps of the roughness alpha from 0 to 1, columns uniform steps of the cosine of eye and normal.
    The albedo is the mean masking over visible facets, sampled as in `materials/principled.py`.
    """
    alpha = np.maximum(np.linspace(0.0, 1.0, ROWS), 1e-3)[:, None, None, None]
    o = np.maximum(np.linspace(0.0, 1.0, COLUMNS), 1e-3)[:, None, None]
    turn = ((np.arange(TURNS) + 0.5) * math.pi / TURNS)[:, None]
    v = (np.arange(RINGS) + 0.5) / RINGS
    across = np.sqrt(1.0 - o * o)
    size = np.sqrt((alpha * across) ** 2 + o * o)
    height = (1.0 - v) * (1.0 + o / size) - o / size
    level = np.sqrt(1.0 - height**2)
    x, y, z = alpha * (level * np.cos(turn) + alpha * across / size), alpha * level * np.sin(turn), height + o / size
    i = 2.0 * (x * across + z * o) * z / (x * x + y * y + z * z) - o
    of_eye, of_light = (np.sqrt(alpha**2 + (1.0 - alpha**2) * c * c) for c in (o, i))
    seen = np.where(i > 0.0, i * (o + of_eye) / (o * of_light + np.abs(i) * of_eye), 0.0)
    return np.asarray(seen.mean(axis=(2, 3)), np.float32).reshape(-1)


LOBES: Any = Table(make_table)
FACET_SHARES: Any = Table(facet_shares)
