"""Local estimates of the noise: the standard deviation of points from their surface.

Quadrics are fitted to k and to 2 k neighbours of some points. Residuals of noise are equal in both; those of a crease
grow like the radius, so that their squares double, and those of smooth detail grow faster. 2 r(k)^2 - r(2k)^2 thus
keeps the noise, while at detail it is below zero for many points; a low quantile over a range of the kd order separates
them. Points with known normals show more: two points of a sphere of any radius have no height above the mean of their
tangent planes, and detail, unlike noise, bends the normals.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles, Floats, Rows
from ..neighbors import NeighborTree
from ..normals.jets import fit_residuals

FEW, MANY, MOST = 16, 32, 64  # neighbours of the fits; the larger ones are used where there is much noise
MUCH, MORE = 0.12, 5.0  # squared spacings from which they are used, and how much larger their result may be
# A low quantile of 2 r(k)^2 - r(2k)^2, and its ratio to the noise's square on tori with 0.1 to 0.3 spacings of noise,
# and with 0.5 to 1. With the median, detail of the statue of 10,000 points passes for noise of 0.12 spacings.
QUANTILE, SHOWN, MUCH_SHOWN = 0.25, 0.36, 0.28
HEIGHTS = 0.73  # median of the squared heights, relative to their mean
LEFT = 0.4  # share of the noise's square that fits leave, at least: 0.64 of up to 0.3 spacings, 0.31 of 1
LITTLE = 0.06  # negligible noise, in spacings
SHARE, FEWEST = 32, 20_000  # one of this many points is examined, but at least so many in total
RANGE = 128  # examined points of a range
# Where this quantile of the nearest ranges exceeds LOUD spacings, it is a lower limit: at 1 spacing a quarter of the
# dragon's ranges and some of a torus's passed for detail. Their error was 0.497 and 0.233, and is 0.283 and 0.173.
LOUD, NEAREST, LOUDER = 0.5, 9, 0.75
AROUND = 16  # neighbours that define the spacing
BESIDE = 8  # neighbours whose tangent planes are used
DETAIL = 0.6  # height below which it is detail, in distance times difference of normals
ALIKE = 0.7  # cosine above which normals may belong to the same smooth piece


class NoiseRanges(NamedTuple):
    """Noise and point spacing of a cloud, measured in ranges of consecutive points in kd order.

    places : (m,) int64, row in kd order of the middle of each range
    middles : (m, 3) float32, positions of these rows
    noise : (m,) float64, standard deviation of the distance from the surface, in the points' unit
    spacing : (m,) float64, square root of the area per point
    """

    places: Rows
    middles: Floats
    noise: Doubles
    spacing: Doubles

    def interpolate(self, rows: Rows) -> tuple[Floats, Floats]:
        """Return noise and spacing, (n,) float32 each, at rows of the kd order, interpolated between ranges.

        rows : (n,) numbers in the kd order of the whole cloud
        """
        noise, spacing = (np.interp(rows, self.places, values) for values in (self.noise, self.spacing))
        return noise.astype(np.float32), spacing.astype(np.float32)


def points_per_range(count: int) -> int:
    """Return how many consecutive points share one estimate of noise, in a cloud of `count` points: a power of two."""
    every = max(min(SHARE, count // FEWEST), 1)
    return RANGE << (every.bit_length() - 1)


def measure_ranges(ordered: Floats, normals: Floats | None = None, size: int | None = None) -> NoiseRanges:
    """Measure noise and point spacing of each range of consecutive points, independently of the other ranges.

    ordered : (n, 3) distinct positions in kd order
    normals : (n, 3) unit normals, which then also show the noise; None: it is measured by fitted quadrics
    size : points of a range, see `points_per_range`; None: as for a whole cloud. The last range may be longer.
    """
    n = len(ordered)
    if n < MOST:
        return NoiseRanges(np.zeros(1, np.int64), ordered[:1], np.zeros(1), np.ones(1))
    size = points_per_range(n) if size is None else size
    rows = np.arange(0, n, size // RANGE)
    ends = np.append(np.arange(0, max(len(rows) // RANGE, 1) * RANGE, RANGE), len(rows))
    ranges = [slice(*pair) for pair in zip(ends[:-1], ends[1:], strict=True)]
    away, near = NeighborTree(ordered, in_order=True).query(MOST if normals is None else AROUND, ordered[rows])
    spacing = _quantiles(away[:, AROUND - 1].astype(np.float64), ranges) * math.sqrt(math.pi / AROUND)
    if normals is not None:
        square = _quantiles(_heights(ordered, normals, rows, near[:, 1 : 1 + BESIDE]), ranges) / HEIGHTS
        loud = square > (LITTLE * spacing) ** 2
        if loud.any():  # wrong normals look like noise, but fits to clean points do not
            fitted = _quantiles(fit_residuals(ordered, rows, near, FEW) ** 2, ranges) / LEFT
            square = np.where(loud, np.minimum(square, fitted), square)
    else:
        square = _residuals(ordered, rows, near, ranges, spacing)
    middles = rows[(ends[:-1] + ends[1:]) // 2]
    return NoiseRanges(middles, ordered[middles], np.sqrt(square), spacing)


def raise_to_typical(ranges: NoiseRanges) -> NoiseRanges:
    """Raise the noise of each range, where the 9 nearest ranges are very noisy, to the 75th percentile of theirs.

    Much noise in a range can pass for detail of the surface, which gives too small a value.

    ranges : all ranges of a cloud
    """
    typical = _around(ranges.middles, ranges.noise / ranges.spacing)
    return ranges._replace(noise=np.maximum(ranges.noise, typical * ranges.spacing))


def _residuals(ordered: Floats, rows: Rows, near: NDArray[np.int32], ranges: list[slice], spacing: Doubles) -> Doubles:
    """Estimate the squared noise of each range, (r,), from residuals of quadrics through 16, 32 and 64 neighbours.

    ordered : (n, 3) positions in kd order
    rows, near : (m,) examined rows, and (m, k) their neighbours
    ranges : slice of `rows` that forms each range
    spacing : (r,) point spacing of each range
    """
    least, middle, most = (fit_residuals(ordered, rows, near, k) ** 2 for k in (FEW, MANY, MOST))
    little = _quantiles(2 * least - middle, ranges, QUANTILE) / SHOWN
    much = _quantiles(2 * middle - most, ranges, QUANTILE) / MUCH_SHOWN
    return np.where(little > MUCH * spacing**2, np.maximum(little, np.minimum(much, MORE * little)), little)


def _around(middles: Floats, noise: Doubles) -> Doubles:
    """Return the 75th percentile of the noise of the 9 nearest ranges to each one, (r,), in spacings; 0 if up to 0.5.

    middles : (r, 3) positions of the ranges; noise : (r,) noise of each, in spacings
    """
    near = NeighborTree(middles).query(NEAREST)[1]
    typical = np.quantile(noise[near], LOUDER, axis=1)
    return np.where(typical > LOUD, typical, 0.0)


def _quantiles(values: Doubles, ranges: list[slice], q: float = 0.5) -> Doubles:
    """Return the quantile `q` of the values in each range, not below zero; zero where at most a quarter are finite."""
    parts = [values[span] for span in ranges]
    known = [part[np.isfinite(part)] for part in parts]
    return np.array(
        [
            max(np.quantile(some, q), 0.0) if 4 * len(some) > len(part) else 0.0
            for some, part in zip(known, parts, strict=True)
        ]
    )


def _heights(ordered: Floats, normals: Floats, rows: Rows, near: NDArray[np.int32]) -> Doubles:
    """Estimate the squared noise at some rows, (m,), from neighbours with similar normals; NaN without any.

    Half the mean squared height of neighbours above the mean of the two tangent planes, less what curvature explains.

    ordered, normals : (n, 3) positions and unit normals of all points
    rows, near : (m,) examined rows, and (m, k) their neighbours
    """
    own, others = normals[rows][:, None].astype(np.float64), normals[near].astype(np.float64)
    cosine = np.einsum("ijc,ijc->ij", own, others)
    away = ordered[near].astype(np.float64) - ordered[rows][:, None]
    height = np.einsum("ijc,ijc->ij", away, own + others) / 2
    bend = (away**2).sum(axis=2) * 2 * (1 - cosine)  # squared distance times difference of normals
    alike = cosine >= ALIKE
    counts = alike.sum(axis=1)
    square = ((height**2 - DETAIL**2 * bend) * alike).sum(axis=1)
    return np.where(counts > 0, square / (2 * np.maximum(counts, 1)), np.nan)
