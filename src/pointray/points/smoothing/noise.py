"""Noise: how far points lie off their surface, place by place.

Quadrics are fitted to k and to 2 k neighbours of some points. Residuals of noise are as large in both; those of a
crease grow like the radius, so that their squares double, and those of smooth detail grow faster. So 2 r(k)^2 - r(2k)^2
is what is left for noise. The median over a stretch of the Morton curve leaves out edges and single points. Points that
have normals of their own tell more: two points of a sphere, whatever its radius, have no height over the mean of their
tangent planes. The lesser of both counts, as detail that is finer than the points looks like noise to the first.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...neighbors import NeighborTree
from ..normals.jets import fit_residuals

Floats = NDArray[np.float32]

PAIRS = (16, 32), (32, 64)  # neighbours of the two fits; of much noise the larger fits tell more
SEEN = 0.64  # the share of the noise's square that the robust fits leave: 0.62 to 0.67 on tori with 0.1 to 0.3 spacings
HEIGHTS = 0.73  # the same of heights: most points lie closer to the surface than the root of their mean square
SHARE, FEWEST = 32, 20_000  # every so manieth point is examined, but at least so many
STRETCH = 64  # examined points whose median counts
AROUND = 16  # neighbours that tell the spacing
BESIDE = 8  # neighbours whose tangent planes are asked
ALIKE = 0.7  # cosine from which their normals may belong to the same smooth piece


def noise_along(path: Floats, normals: Floats | None = None) -> tuple[Floats, Floats]:
    """How far points lie off their surface, and how far from each other, in their unit.

    Parameters
    ----------
    path : (n, 3) float32
        Positions, all different, along a Morton curve.
    normals : (n, 3) float32, optional
        Unit normals that were measured or known, of either sign.

    Returns
    -------
    noise : (n,) float32
        Standard deviation of the distance.
    spacing : (n,) float32
        The root of the area per point.
    """
    n = len(path)
    if n < PAIRS[0][1]:
        return np.zeros(n, np.float32), np.ones(n, np.float32)
    rows = np.arange(0, n, max(min(SHARE, n // FEWEST), 1))
    stretches = np.arange(0, len(rows), STRETCH)
    away, near = NeighborTree(path).query(PAIRS[-1][1], path[rows])
    square = np.zeros(len(stretches))
    for few, many in PAIRS:
        if many <= near.shape[1]:
            small, large = (fit_residuals(path, rows, near, k) for k in (few, many))
            square = np.maximum(square, _medians(2 * small**2 - large**2) / SEEN)
    if normals is not None:
        square = np.minimum(square, _medians(_heights(path, normals, rows, near[:, 1 : 1 + BESIDE])) / HEIGHTS)
    middles = rows[np.minimum(stretches + STRETCH // 2, len(rows) - 1)]
    spacing = _medians(away[:, AROUND - 1].astype(np.float64)) * math.sqrt(math.pi / AROUND)
    noise, spacing = (np.interp(np.arange(n), middles, values) for values in (np.sqrt(square), spacing))
    return noise.astype(np.float32), spacing.astype(np.float32)


def _medians(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The median of each stretch, not below zero; zero where too little is known."""
    padded = np.full(-(-len(values) // STRETCH) * STRETCH, np.nan)
    padded[: len(values)] = values
    table = padded.reshape(-1, STRETCH)
    known = np.isfinite(table).sum(axis=1) >= min(STRETCH, len(values)) // 4
    table[~known] = 0.0
    return np.maximum(np.nanmedian(table, axis=1), 0.0)


def _heights(path: Floats, normals: Floats, rows: NDArray[np.int64], near: NDArray[np.int32]) -> NDArray[np.float64]:
    """Half the mean square of the heights of neighbours over the mean of two tangent planes, NaN without any."""
    own, others = normals[rows][:, None].astype(np.float64), normals[near].astype(np.float64)
    cosine = np.einsum("ijc,ijc->ij", own, others)
    away = path[near].astype(np.float64) - path[rows][:, None]
    height = np.einsum("ijc,ijc->ij", away, own + np.sign(cosine)[..., None] * others) / 2
    alike = np.abs(cosine) >= ALIKE
    counts = alike.sum(axis=1)
    return np.where(counts > 0, (height**2 * alike).sum(axis=1) / (2 * np.maximum(counts, 1)), np.nan)
