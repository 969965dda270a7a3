"""What lobes reflect of light of which only the irradiance and a few moments are known: tables of kernels.

The unknown radiance is taken for a random field over directions: a level that may be anything, and deviations that are
correlated as exp(-angle). The estimate is what a lobe reflects on average of all fields that have the known moments,
these being uncertain by NOISE of the irradiance (kriging; Rasmussen and Williams 2006, equation 2.41). It is linear in
the differences from the moments of even light (`baked_code.py`). With the irradiance E, the normal n and the unit
direction r of the lobe it is

    E even + d.(a n + b r) + n.D (p n + q r) + s r.D r + c.(a' n + b' r)

where the vector d and the symmetric matrix D are bands 1 and 2 of luminance, and the vector c is band 1 of what one
channel has more than luminance. By symmetry the numbers even, a, b, p, q, s, a', b' depend only on n.r and on the width
of the lobe. They stand in this order in a row of the table, which is read between its rows and columns (`lobes.py`).

The integrals are sums over half of the hemisphere: the other side of the plane of n and r is its mirror image. Both
tables take 12 ms.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..engine.jit import Table
from .harmonics import BAND_0, BAND_1, BAND_2, BAND_2_CROSS

NUMBERS = 8
COLUMNS = 16  # even steps of n.r from 0 to 1
ROWS, HALFWAY, LAST = 16, 4.0, 2.0 / 3.0  # even steps of exponent / (exponent + HALFWAY) from 0 to LAST
RINGS, TURNS = 24, 24  # of the sums: heights and azimuths
NOISE = 0.02
LEVEL = 100.0  # the variance of the level, in variances of the deviations
GRAZING = 1e-4  # 1 - n.r of the last column: there n and r still tell a plane

Floats = NDArray[np.float64]
PHONG_LOBES, FACETS = 0, 1  # kinds of lobes


def exponents() -> Floats:
    """The exponents of the rows."""
    u = np.linspace(0.0, LAST, ROWS)
    return np.asarray(HALFWAY * u / (1.0 - u))


def phong_lobes(w: Floats, cosine: Floats, exponent: float) -> Floats:
    """Phong's lobe times the cosine. w : (n, 3), z along the normal; cosine : (k,), n.r"""
    along = w[:, :1] * np.sqrt(1.0 - cosine**2) + w[:, 2:] * cosine
    lobe = np.where(along > 0.0, np.abs(along) ** exponent, 0.0)
    return np.asarray((exponent + 2.0) / (2.0 * math.pi) * lobe * w[:, 2:])


def facet_lobes(w: Floats, cosine: Floats, exponent: float) -> Floats:
    """GGX without Fresnel's share, times the cosine (`materials/principled.py`), whose width has this exponent there.

    The eye is at the mirrored r.
    """
    square, i = 1.0 / (2.0 * exponent + 1.0), w[:, 2:]
    half = np.stack([w[:, :1] - np.sqrt(1.0 - cosine**2), w[:, 1:2] + 0.0 * cosine, i + cosine])
    spread = 1.0 + (square - 1.0) * half[2] ** 2 / (half**2).sum(axis=0)
    roots = cosine * np.sqrt(square + (1.0 - square) * i * i) + i * np.sqrt(square + (1.0 - square) * cosine**2)
    return np.asarray(0.5 * square / (math.pi * spread**2 * roots) * i)


def _sums() -> tuple[Floats, Floats]:
    """Directions (n, 3) of a hemisphere with y > 0, heights one by one, denser at the horizon; and their weights."""
    u, weights = np.polynomial.legendre.leggauss(RINGS)
    u = 0.5 * u + 0.5
    z, turn = u * u, (np.arange(TURNS) + 0.5) * math.pi / TURNS
    level = np.sqrt(1.0 - z * z)[:, None]
    w = np.stack(np.broadcast_arrays(level * np.cos(turn), level * np.sin(turn), z[:, None]), axis=-1).reshape(-1, 3)
    return w, np.repeat(weights * u * 2.0 * math.pi / TURNS, TURNS)


def _moments(w: Floats) -> tuple[Floats, Floats, Floats]:
    """Harmonics that are even in y, by the azimuth: those that do not depend on it, then of cos and of cos of twice."""
    x, y, z = w.T
    steady = np.array([np.full_like(z, BAND_0), BAND_1 * z, BAND_2 * (3.0 * z * z - 1.0)])
    return steady, np.array([BAND_1 * x, 2.0 * BAND_2_CROSS * x * z]), np.array([BAND_2_CROSS * (x * x - y * y)])


class _Estimate:
    """From lobes to the factors of moments. `colors`: of those of bands 0 and 1 only."""

    def __init__(self) -> None:
        w, self.weights = _sums()
        self.w = w
        ring = w[::TURNS] * (0, 0, 1)
        ring[:, 0] = np.sqrt(1.0 - ring[:, 2] ** 2)
        apart = np.exp(-np.arccos(np.clip(ring @ w.T, -1.0, 1.0)))  # from the directions of azimuth 0
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

    def __call__(self, lobes: Floats, colors: bool) -> list[Floats]:
        """The factors of the moments by their azimuth, (moments, k). lobes : (n, k), times weights"""
        used = (2, 1) if colors else (3, 2, 1)
        return [
            np.asarray(np.linalg.solve(each[:m, :m], with_lobes[:m] @ lobes))
            for m, each, with_lobes in zip(used, self._with_each, self._with_lobes, strict=False)
        ]


def make_table() -> NDArray[np.float32]:
    """The table, (kinds * ROWS * COLUMNS * NUMBERS,) float32. Lobes of facets are scaled to reflect all even light."""
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
    # Across n lies the unit vector t = (r - (n.r) n) / sine.
    b, b_color = once[0] / sine, tilt[0] / sine
    nn, nt, tt = steady[2] / (2.0 * BAND_2) + 0.5 * twice[0] / BAND_2_CROSS, once[1] / sine, twice[0] / sine**2
    nt, tt = nt / BAND_2_CROSS, tt / BAND_2_CROSS
    numbers = [even / math.pi, steady[1] - cosine * b, b]
    numbers += [nn - cosine * nt + cosine**2 * tt, nt - 2.0 * cosine * tt, tt]
    numbers += [level[1] - cosine * b_color, b_color]
    return np.stack(numbers, axis=-1).astype(np.float32).reshape(-1)


def facet_shares() -> NDArray[np.float32]:
    """The share of even light that facets reflect which reflect all they meet, (ROWS * COLUMNS,) float32.

    Rows are even steps of alpha from 0 to 1, columns as in the other table. The mean over visible facets, chosen as
    `materials/principled.py` does, is that of their masking.
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
