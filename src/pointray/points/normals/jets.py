"""Directions of normals: a quadric is fitted to each point's neighbours, as many as the noise requires.

A quadric over the tangent plane (a jet of order 2; Cazals and Pouget 2003) follows the curvature that tilts a plane, so
that more neighbours cost no accuracy on smooth surfaces. The number of neighbours is chosen for each point from two
errors (after Mitra and Nguyen 2003): noise, which shrinks with the number, and the surface's detail, which shows as
residuals beyond the noise. The noise is estimated once, as a share of the spacing, from the lowest residuals of small
fits, where there is no detail.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...jit import Array, borrow, f64, inline, kernel, next_tile, routine, run
from ...kernels.vec import Vec3, tangents
from ...neighbors import neighbor_chunks, neighbors
from ...progress import Progress, part_of, tell
from .planes import least_axis, plane
from .quadrics import TERMS, height_variance, residual, slope_variance, solve

Floats = NDArray[np.float32]
# One thread's memory: weights, weights by distance alone, terms and height of each point; coefficients and factor of
# the quadric; variances and axes of the plane.
Memory: TypeAlias = tuple[Array, Array, Array, Array, Array, Array, Array]

SIZES = (10, 16, 32, 64)  # neighbourhoods to choose from; the point itself is one of them
CLEAN = 0.01  # noise in spacings below which 16 are enough
DETAIL = 0.15  # weight of squared residuals beyond the noise: 1 takes noise for detail
WIDTH = 1.0  # weights fall to 1/e at the rim
SURVEY = 0.15  # share of the time after which the noise is known
NOISE_SAMPLE, NOISE_SIZES = 5000, (12, 32, 64)
LINED = 0.1  # share of fits that may be to points on a line; beyond it, more points are used
QUANTILE, AT_QUANTILE = 0.25, 0.75  # a quarter of the residuals of pure noise are below 0.75 of the mean
SLIM = 0.2  # ratio of the plane's variances below which points are on a line or two, and more points are used
LINE = 0.05  # ratio below which a plane is fitted if there are no more points
SLIM_VARIANCE = 1e30  # stands for the slope's variance where no quadric was fitted
RIDGE = 1e-4  # so that points on a line still have an answer
JET_LEAST = 8  # points; fewer are fitted by a plane
CHUNK = 1024
FACING = 0.03  # cosine to the eye from which a normal's own sign is clear
GRAZING = 0.2  # cosine to the eye up to which the plane through the neighbours grazes it


@inline
def _slimness(a: Array) -> float:
    """The second largest number on the diagonal over the largest."""
    low, high = min(a[0, 0], a[1, 1]), max(a[0, 0], a[1, 1])
    return max(low, min(high, a[2, 2])) / max(high, a[2, 2], 1e-300)


@routine
def jet(d: Array, k: int, slim: float, memory: Memory) -> tuple[Vec3, float, float]:
    """Normal, residual (in d's unit) and the slope's variance for unit residuals, of the quadric through k points.

    The first fit has weights by distance; in the second, points far off the first fit count less.
    """
    w, near, terms, x, m, a, v = memory
    farthest = math.sqrt(d[k - 1, 0] ** 2 + d[k - 1, 1] ** 2 + d[k - 1, 2] ** 2)
    for j in range(k):
        near[j] = math.exp(-WIDTH * (d[j, 0] ** 2 + d[j, 1] ** 2 + d[j, 2] ** 2) / (farthest * farthest))
        w[j] = near[j]
    n = plane(d, w, k, a, v)
    if k < JET_LEAST or _slimness(a) < slim:
        return n, 0.0, SLIM_VARIANCE
    one, two = tangents(n)
    for j in range(k):
        p = (d[j, 0] * one[0] + d[j, 1] * one[1] + d[j, 2] * one[2]) / farthest
        q = (d[j, 0] * two[0] + d[j, 1] * two[1] + d[j, 2] * two[2]) / farthest
        terms[j, 0], terms[j, 1], terms[j, 2] = 1.0, p, q
        terms[j, 3], terms[j, 4], terms[j, 5] = p * p, p * q, q * q
        terms[j, TERMS] = (d[j, 0] * n[0] + d[j, 1] * n[1] + d[j, 2] * n[2]) / farthest
    total = solve(terms, w, k, RIDGE, m, x)
    square = 0.0
    for j in range(k):
        square += w[j] * residual(terms, x, j) ** 2
    square = 4.0 * square / total + 1e-12
    for j in range(k):
        w[j] = near[j] / (1.0 + residual(terms, x, j) ** 2 / square) ** 2
    total = solve(terms, w, k, RIDGE, m, x)
    square = squares = 0.0
    for j in range(k):
        square += w[j] * residual(terms, x, j) ** 2
        squares += w[j] * w[j]
    effective = total * total / squares
    square *= effective / (total * max(effective - TERMS, 1.0))
    g0 = n[0] - x[1] * one[0] - x[2] * two[0]
    g1 = n[1] - x[1] * one[1] - x[2] * two[1]
    g2 = n[2] - x[1] * one[2] - x[2] * two[2]
    length = math.sqrt(g0 * g0 + g1 * g1 + g2 * g2)
    variance = slope_variance(m) * squares / total / (farthest * farthest)
    return (g0 / length, g1 / length, g2 / length), farthest * math.sqrt(square), variance


@routine
def height(d: Array, k: int, memory: Memory) -> tuple[float, float]:
    """The height of the quadric that `jet` has just fitted over the origin of d, along the plane's normal, in d's unit.

    The second number is its variance for unit noise.
    """
    w, _, _, x, m, _, _ = memory
    farthest = math.sqrt(d[k - 1, 0] ** 2 + d[k - 1, 1] ** 2 + d[k - 1, 2] ** 2)
    total = squares = 0.0
    for j in range(k):
        total += w[j]
        squares += w[j] * w[j]
    return farthest * x[0], height_variance(m) * squares / total


@inline
def jet_memory(most: int) -> Memory:
    """Memory for fits to at most so many points."""
    return (
        np.empty(most),
        np.empty(most),
        np.empty((most, TERMS + 1)),
        np.empty(TERMS),
        np.zeros((TERMS, TERMS)),
        np.empty((3, 3)),
        np.empty((3, 3)),
    )


@kernel
def _fit(
    work: Array, positions: Array, rows: Array, near: Array, sizes: Array, noise: float, out: Array, residuals: Array
) -> int:
    """Write to out[i] the normal at positions[rows[i]] from the size with the least error, and the normal of a plane.

    Residuals are those of the smallest size. The plane is fitted to 16 points, or more if they are on a line.
    """
    positions, near, out, most = borrow(positions), borrow(near), borrow(out), near.shape[1]
    d = np.empty((most, 3))
    memory = jet_memory(most)
    tile = next_tile(work)
    while tile >= 0:
        for i in range(tile * CHUNK, min((tile + 1) * CHUNK, len(out))):
            for j in range(most):
                for c in range(3):
                    d[j, c] = f64(positions[near[i, j], c]) - f64(positions[rows[i], c])
            spacing = math.sqrt((d[most - 1, 0] ** 2 + d[most - 1, 1] ** 2 + d[most - 1, 2] ** 2) / most)
            least, settled = np.inf, False
            for k in sizes:
                n, residual, variance = jet(d, k, SLIM if k < sizes[-1] else LINE, memory)
                if not settled:
                    out[i, 3], out[i, 4], out[i, 5] = least_axis(memory[5], memory[6])
                    settled = k >= SIZES[1] and variance < SLIM_VARIANCE
                if k == sizes[0]:
                    residuals[i] = residual / spacing if variance < SLIM_VARIANCE else np.nan
                if k < sizes[-1] and variance == SLIM_VARIANCE:
                    continue
                excess = (residual / spacing) ** 2 - noise * noise
                error = variance * (noise * spacing) ** 2 + DETAIL * max(excess, 0.0)
                if error < least:
                    least = error
                    out[i, 0], out[i, 1], out[i, 2] = n
        tile = next_tile(work)
    return 0


def _fit_rows(
    positions: Floats, rows: NDArray[np.int64], near: NDArray[np.int32], sizes: list[int], noise: float
) -> tuple[Floats, Floats]:
    out, residuals = np.empty((len(rows), 6), np.float32), np.empty(len(rows), np.float32)
    run(_fit, -(-len(rows) // CHUNK), positions, rows, near, np.array(sizes), noise, out, residuals)
    return out, residuals


def fit_residuals(positions: Floats, rows: NDArray[np.int64], near: NDArray[np.int32], k: int) -> NDArray[np.float64]:
    """Root mean squares of the residuals of fits to k of the neighbours, (m,) in the unit; NaN for points on a line."""
    spacing = np.linalg.norm(positions[near[:, -1]].astype(np.float64) - positions[rows], axis=1)
    _, residuals = _fit_rows(positions, rows, near, [k], 0.0)
    return np.asarray(residuals * spacing / math.sqrt(near.shape[1]), np.float64)


def survey(positions: Floats) -> tuple[float, int]:
    """The noise, and the largest size to choose from: where scan lines lie far apart, few points form a line.

    The noise is how far points lie off their surface, in spacings (distance to the k-th neighbour over the root of k).
    """
    if len(positions) <= NOISE_SIZES[0]:
        return 0.0, SIZES[1]
    rows = np.random.default_rng(0).permutation(len(positions))[:NOISE_SAMPLE]
    _, near = neighbors(positions, NOISE_SIZES[-1], positions[rows])
    noise, size = 0.0, 0
    for size in NOISE_SIZES:
        _, residuals = _fit_rows(positions, rows, near, [min(size, len(positions))], 0.0)
        sound = residuals[np.isfinite(residuals)]
        noise = float(np.quantile(sound, QUANTILE)) / AT_QUANTILE if len(sound) else 0.0
        if len(sound) > (1 - LINED) * len(residuals):
            break
    return noise, SIZES[1] if size == NOISE_SIZES[0] and noise <= CLEAN else max(size, SIZES[2])


class Fits(NamedTuple):
    """What is fitted to the neighbours of points that are all different and lie along a Morton curve.

    Attributes
    ----------
    positions : (n, 3) float32
    normals : (n, 3) float32
        Of unit length.
    near : (n, k) int32
        The nearest neighbours, which signs may pass to, the point itself first.
    residuals : (n,) float32
        Residuals of the smallest fits, in spacings; NaN for fits to points on a line.
    noise : (n,) float32 or None
        What was smoothed away, if the points were moved.
    """

    positions: Floats
    normals: Floats
    near: NDArray[np.int32]
    residuals: Floats
    noise: Floats | None = None


class Planes(Protocol):
    """What else is fitted to the neighbours, see `layers`."""

    def wanted(self, noise: float) -> int:
        """How many neighbours are wanted, at this noise in spacings; 0: none."""

    def lay(self, part: slice, found: NDArray[np.int32]) -> None:
        """Take the neighbours of some points."""


def faces(normals: Floats, planes: Floats, to_eye: Floats) -> NDArray[np.bool_]:
    """Which normals face the eye, or, where this is unclear, the side of their plane that does.

    With planes alone 3.0% of the normals of a layered wall faced away from its scanner, now 0.3%. Without planes 0.16%
    of the normals of noisy pipes (0.5 spacings) were flipped, now 0.02%.
    """
    view, plane_view = np.einsum("ij,ij->i", normals, to_eye), np.einsum("ij,ij->i", planes, to_eye)
    distance = np.sqrt(np.einsum("ij,ij->i", to_eye, to_eye))
    clear = (np.abs(view) > FACING * distance) | (np.abs(plane_view) > GRAZING * distance)
    with_plane = plane_view * np.einsum("ij,ij->i", planes, normals)
    return ~(np.where(clear, view, with_plane) < 0)


def fit_normals(
    positions: Floats,
    kept: int,
    eye: Floats | None = None,
    progress: Progress | None = None,
    planes: Planes | None = None,
    neighbors: int | None = None,
) -> Fits:
    """Unit normals of quadrics through the nearest neighbours.

    Parameters
    ----------
    positions : (n, 3) float32
        All different, along a Morton curve.
    kept : int
        Number of neighbours to return, the point itself first.
    eye : (3,) or (n, 3) float32, optional
        Each normal is turned towards it. Where both the normal and the plane through its neighbours graze it, the plane
        is turned, and the normal with the plane, which tilts less. None, or NaN for a point: normals of either sign.
    progress : callable, optional
    planes : Planes, optional
        Takes the neighbours too, as many as it wants.
    neighbors : int, optional
        How many a quadric is fitted to. None: the best of `SIZES` for each point.
    """
    n = len(positions)
    noise, most = survey(positions) if neighbors is None else (0.0, 0)
    sizes = [k for k in SIZES if k <= most] if neighbors is None else [neighbors]
    sizes = sorted({min(k, n) for k in sizes})
    normals, near = np.empty_like(positions), np.empty((n, min(kept, n)), np.int32)
    residuals = np.empty(n, np.float32)
    wanted = 0 if planes is None else planes.wanted(noise)
    tell(progress, SURVEY)
    for part, found in neighbor_chunks(positions, max(sizes[-1], kept, wanted), part_of(progress, SURVEY, 1.0)):
        if planes is not None and wanted:
            planes.lay(part, found)
        rows = np.arange(part.start, part.start + len(found))
        table = np.ascontiguousarray(found[:, : sizes[-1]])
        fits, residuals[part] = _fit_rows(positions, rows, table, sizes, noise)
        normals[part] = fits[:, :3]
        if eye is not None:
            to_eye = (eye if eye.ndim == 1 else eye[part]) - positions[part]
            normals[part][~faces(normals[part], fits[:, 3:], to_eye)] *= -1
        near[part] = found[:, : near.shape[1]]
    return Fits(positions, normals, near, residuals)
