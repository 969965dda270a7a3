"""Noise: how far points lie off their surface, place by place.

Quadrics are fitted to k and to 2 k neighbours of some points. Residuals of noise are as large in both; those of a
crease grow like the radius, so that their squares double, and those of smooth detail grow faster. So 2 r(k)^2 - r(2k)^2
is what is left for noise: at detail it is below zero for many points. A low quantile over a stretch of the kd order
tells them apart. Points that have normals of their own tell more: two points of a sphere, whatever its radius, have no
height over the mean of their tangent planes; and what is not noise bends the normals.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..neighbors import NeighborTree
from ..normals.jets import fit_residuals

Floats = NDArray[np.float32]

FEW, MANY, MOST = 16, 32, 64  # neighbours of the fits; of much noise the larger ones tell more
MUCH, MORE = 0.12, 5.0  # squares of spacings from which they do, and how much more at most
# A low quantile of 2 r(k)^2 - r(2k)^2, and what it is of the noise's square on tori with 0.1 to 0.3 spacings of noise,
# and with 0.5 to 1. By the median, detail of the statue of 10,000 points is noise of 0.12 spacings.
QUANTILE, SHOWN, MUCH_SHOWN = 0.25, 0.36, 0.28
HEIGHTS = 0.73  # the median of heights' squares is so much of their mean
LEFT = 0.4  # what fits leave of the noise's square at least: 0.64 of up to 0.3 spacings, 0.31 of 1
LITTLE = 0.06  # spacings: noise that does not matter
SHARE, FEWEST = 32, 20_000  # every so manieth point is examined, but at least so many
STRETCH = 128  # examined points that are taken together
# Where a quantile of the nearest stretches, in spacings, says so much, none of them has less: at 1 spacing a quarter of
# the dragon's and some of a torus's passed for detail. Their depth was 0.497 and 0.233, so it is 0.283 and 0.173.
LOUD, NEAREST, LOUDER = 0.5, 9, 0.75
AROUND = 16  # neighbours that tell the spacing
BESIDE = 8  # neighbours whose tangent planes are asked
DETAIL = 0.6  # height, in distance times difference of normals, below which it is detail, which bends normals
ALIKE = 0.7  # cosine from which their normals may belong to the same smooth piece


class Stretches(NamedTuple):
    """What stretches of the kd order show of the noise, each as a whole.

    places : (m,) int64, the rows of their middles
    middles : (m, 3) float32, where these are
    noise : (m,) float64, standard deviation of the distance from the surface, in the points' unit
    spacing : (m,) float64, the root of the area per point
    """

    places: NDArray[np.int64]
    middles: Floats
    noise: NDArray[np.float64]
    spacing: NDArray[np.float64]

    def along(self, rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """The noise and the spacing at rows of the kd order, (n,)."""
        noise, spacing = (np.interp(rows, self.places, values) for values in (self.noise, self.spacing))
        return noise.astype(np.float32), spacing.astype(np.float32)


def noise_along(path: Floats, normals: Floats | None = None) -> tuple[Floats, Floats]:
    """How far points lie off their surface, and how far from each other, in their unit.

    Parameters
    ----------
    path : (n, 3) float32
        Positions, all different, in kd order.
    normals : (n, 3) float32, optional
        Unit normals that were measured or known.

    Returns
    -------
    noise : (n,) float32
        Standard deviation of the distance.
    spacing : (n,) float32
        The root of the area per point.
    """
    return settled(examined(path, normals)).along(np.arange(len(path)))


def points_per_stretch(count: int) -> int:
    """How many points of so many are taken together, a power of two."""
    every = max(min(SHARE, count // FEWEST), 1)
    return STRETCH << (every.bit_length() - 1)


def examined(path: Floats, normals: Floats | None = None, size: int | None = None) -> Stretches:
    """What each stretch shows by itself, for `settled`.

    size : points of a stretch; None: as many as a whole cloud should have. The last one may be longer.
    """
    n = len(path)
    if n < MOST:
        return Stretches(np.zeros(1, np.int64), path[:1], np.zeros(1), np.ones(1))
    size = points_per_stretch(n) if size is None else size
    rows = np.arange(0, n, size // STRETCH)
    ends = np.append(np.arange(0, max(len(rows) // STRETCH, 1) * STRETCH, STRETCH), len(rows))
    stretches = [slice(*pair) for pair in zip(ends[:-1], ends[1:], strict=True)]
    away, near = NeighborTree(path, in_order=True).query(MOST if normals is None else AROUND, path[rows])
    spacing = _quantiles(away[:, AROUND - 1].astype(np.float64), stretches) * math.sqrt(math.pi / AROUND)
    if normals is not None:
        square = _quantiles(_heights(path, normals, rows, near[:, 1 : 1 + BESIDE]), stretches) / HEIGHTS
        loud = square > (LITTLE * spacing) ** 2
        if loud.any():  # wrong normals look like noise, but fits to clean points do not
            fitted = _quantiles(fit_residuals(path, rows, near, FEW) ** 2, stretches) / LEFT
            square = np.where(loud, np.minimum(square, fitted), square)
    else:
        square = _residuals(path, rows, near, stretches, spacing)
    middles = rows[(ends[:-1] + ends[1:]) // 2]
    return Stretches(middles, path[middles], np.sqrt(square), spacing)


def settled(stretches: Stretches) -> Stretches:
    """The stretches of a whole cloud, none of them quieter than is usual where it is loud."""
    usual = _around(stretches.middles, stretches.noise / stretches.spacing)
    return stretches._replace(noise=np.maximum(stretches.noise, usual * stretches.spacing))


def _residuals(
    path: Floats,
    rows: NDArray[np.int64],
    near: NDArray[np.int32],
    stretches: list[slice],
    spacing: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The square of the noise in each stretch, by residuals of fits."""
    least, middle, most = (fit_residuals(path, rows, near, k) ** 2 for k in (FEW, MANY, MOST))
    little = _quantiles(2 * least - middle, stretches, QUANTILE) / SHOWN
    much = _quantiles(2 * middle - most, stretches, QUANTILE) / MUCH_SHOWN
    return np.where(little > MUCH * spacing**2, np.maximum(little, np.minimum(much, MORE * little)), little)


def _around(middles: Floats, noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """The noise that is usual around each stretch, in spacings; 0 where that is not much."""
    near = NeighborTree(middles).query(NEAREST)[1]
    usual = np.quantile(noise[near], LOUDER, axis=1)
    return np.where(usual > LOUD, usual, 0.0)


def _quantiles(values: NDArray[np.float64], stretches: list[slice], q: float = 0.5) -> NDArray[np.float64]:
    """A quantile of each stretch, not below zero; zero where too little is known."""
    parts = [values[stretch] for stretch in stretches]
    known = [part[np.isfinite(part)] for part in parts]
    return np.array(
        [
            max(np.quantile(some, q), 0.0) if 4 * len(some) > len(part) else 0.0
            for some, part in zip(known, parts, strict=True)
        ]
    )


def _heights(path: Floats, normals: Floats, rows: NDArray[np.int64], near: NDArray[np.int32]) -> NDArray[np.float64]:
    """Half the mean square of the heights of neighbours over the mean of two tangent planes, NaN without any."""
    own, others = normals[rows][:, None].astype(np.float64), normals[near].astype(np.float64)
    cosine = np.einsum("ijc,ijc->ij", own, others)
    away = path[near].astype(np.float64) - path[rows][:, None]
    height = np.einsum("ijc,ijc->ij", away, own + others) / 2
    bend = (away**2).sum(axis=2) * 2 * (1 - cosine)  # squares of distance times difference of normals
    alike = cosine >= ALIKE
    counts = alike.sum(axis=1)
    square = ((height**2 - DETAIL**2 * bend) * alike).sum(axis=1)
    return np.where(counts > 0, square / (2 * np.maximum(counts, 1)), np.nan)
