"""Normal directions: a quadric is fitted to each point's neighbours, as many as the noise requires.

A quadric over the tangent plane (a jet of order 2; Cazals and Pouget 2003) follows the curvature that would tilt a
plane, so more neighbours cost no accuracy on smooth surfaces. The number of neighbours is chosen for each point from
two errors (after Mitra and Nguyen 2003): noise, which shrinks with the number, and surface detail, which shows as
residuals beyond the noise. The noise is estimated once, in spacings, from the lowest residuals of small fits, where
there is no detail.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Doubles, Flags, Floats, Rows
from ...base.progress import Progress, part_of, report_progress
from ...engine.jit import Array, borrow, f32, kernel, next_tile, routine, run
from ...engine.simd import INF, ONE, broadcast16, load16, select, store, vmax
from ..neighbors import NeighborTree, neighbor_chunks
from ..statistics import CloudStatistics
from .fit_batch import LANES, FitBatch16, load_point, new_fit_batch, zeros
from .jet import AXIS, LINE, NORMAL, RESIDUAL, SLIM, SLIM_VARIANCE, SLOPE, jet, take_triple

SIZES = (10, 16, 32, 64)  # neighbourhood sizes to choose from, including the point itself
CLEAN = 0.01  # noise in spacings below which 16 neighbours are enough
DETAIL = 0.15  # weight of squared residuals beyond the noise: with 1, noise passes for detail
SURVEY = 0.15  # progress after the noise is measured
NOISE_SAMPLE, NOISE_SIZES = 5000, (12, 32, 64)
LINED = 0.1  # share of fits to points on a line beyond which more points are used
QUANTILE, AT_QUANTILE = 0.25, 0.75  # a quarter of the residuals of pure noise are below 0.75 of the mean
CHUNK = 1024
NOT_KNOWN = f32(np.nan)
PLANE, LEFT, CHOSEN = 3, 6, 7  # rows of lanes that `_choose` writes: normal, plane's normal, residual; their number
FACING = 0.03  # cosine to the eye above which a normal's own sign is clear
GRAZING = 0.2  # cosine to the eye below which the plane through the neighbours grazes the view


@routine
def _choose(sizes: Array, noise: float, spacing: float, memory: FitBatch16, found: Array) -> None:
    """Fit quadrics to several numbers of neighbours of sixteen points; keep the one with the least estimated error.

    sizes : numbers of neighbours, ascending
    noise : standard deviation of the points from the surface, in spacings
    spacing : point spacing, relative to the distance of the farthest neighbour
    memory : neighbours of the sixteen points
    found : (7 * 16,) receives the best quadric's normal; the normal of a plane through 16 neighbours, or more if these
        lie on a line; the residual of the smallest fit, in spacings, NaN if its points lie on a line
    """
    least, settled = broadcast16(INF), zeros() > ONE
    for s in range(len(sizes)):
        last = s == len(sizes) - 1
        jet(sizes[s], LINE if last else SLIM, memory)
        slope = load16(memory.results, LANES * SLOPE)
        residual = load16(memory.results, LANES * RESIDUAL) * (1.0 / spacing)
        sound = slope < SLIM_VARIANCE
        take_triple(settled, found, PLANE, memory.results, AXIS, found, PLANE)
        settled = settled | (sound & (zeros() + sizes[s] >= f32(SIZES[1])))
        if s == 0:
            store(found, LANES * LEFT, select(sound, residual, broadcast16(NOT_KNOWN)))
        excess = vmax(residual * residual - noise * noise, zeros())
        error = slope * (noise * noise * spacing * spacing) + DETAIL * excess
        better = error < least
        if not last:
            better = better & sound
        least = select(better, error, least)
        take_triple(better, memory.results, NORMAL, found, 0, found, 0)


@kernel
def _fit(
    work: Array, positions: Array, rows: Array, near: Array, sizes: Array, noise: float, out: Array, residuals: Array
) -> None:
    """Fit quadrics of several sizes to the neighbours of each row; write the normal of the best one.

    work : gives each thread its next tile, 1024 rows
    positions, rows : (n, 3) points, and (m,) the rows to fit
    near : (m, k) nearest neighbours of these rows, themselves first
    sizes : numbers of neighbours to try, ascending
    noise : standard deviation of the points from the surface, in spacings
    out : (m, 6) receives the quadric's normal, and the normal of a plane through 16 neighbours, or more if these lie on
        a line
    residuals : (m,) receives the residuals of the smallest fits, in spacings; NaN for points on a line
    """
    positions, rows, near, out = borrow(positions), borrow(rows), borrow(near), borrow(out)
    memory = new_fit_batch(sizes[-1])
    found, spacing = np.zeros(LANES * CHOSEN, np.float32), 1.0 / math.sqrt(near.shape[1])
    tile = next_tile(work)
    while tile >= 0:
        stop = min((tile + 1) * CHUNK, len(out))
        for first in range(tile * CHUNK, stop, LANES):
            for lane in range(LANES):
                i = min(first + lane, stop - 1)
                load_point(positions, rows[i], near, i, near.shape[1] - 1, lane, memory)
            _choose(sizes, noise, spacing, memory, found)
            for lane in range(min(LANES, stop - first)):
                for c in range(LEFT):
                    out[first + lane, c] = found[LANES * c + lane]
                residuals[first + lane] = found[LANES * LEFT + lane]
        tile = next_tile(work)


def _fit_rows(
    positions: Floats, rows: Rows, near: NDArray[np.int32], sizes: list[int], noise: float
) -> tuple[Floats, Floats]:
    out, residuals = np.empty((len(rows), 6), np.float32), np.empty(len(rows), np.float32)
    run(_fit, -(-len(rows) // CHUNK), positions, rows, near, np.array(sizes), noise, out, residuals)
    return out, residuals


def fit_residuals(positions: Floats, rows: Rows, near: NDArray[np.int32], k: int) -> Doubles:
    """Return RMS residuals of quadrics fitted to k neighbours, (m,), in the points' unit; NaN for points on a line.

    positions, rows : (n, 3) points, and (m,) the rows to fit
    near : (m, q) their nearest neighbours, themselves first, at least k
    """
    spacing = np.linalg.norm(positions[near[:, -1]].astype(np.float64) - positions[rows], axis=1)
    _, residuals = _fit_rows(positions, rows, near, [k], 0.0)
    return np.asarray(residuals * spacing / math.sqrt(near.shape[1]), np.float64)


def measure_noise(positions: Floats, statistics: CloudStatistics | None = None) -> tuple[float, int]:
    """Estimate the noise of a cloud; return it, and the largest number of neighbours that its normals are fitted to.

    The noise is the standard deviation of the points from the surface, in spacings (the distance of the k-th neighbour
    over the root of k). Where scan lines are far apart, the nearest neighbours lie on a line, and more are needed.

    positions : (n, 3) in kd order
    statistics : of the cloud that the points are a part of. None: they are the whole cloud
    """
    statistics = statistics or CloudStatistics.of(len(positions))
    if len(positions) > NOISE_SIZES[0]:
        statistics.compute_together(
            ("noise of fits", "points of fits"),
            lambda: _measure_noise(positions, statistics.some(len(positions), NOISE_SAMPLE)),
        )
    return statistics.known.get("noise of fits", 0.0), int(statistics.known.get("points of fits", SIZES[1]))


def _measure_noise(positions: Floats, rows: Rows) -> tuple[float, int]:
    """Estimate the noise, in spacings, by quadrics at some rows; return it, and how many neighbours fits need at most.

    positions : (n, 3) in kd order
    """
    near = NeighborTree(positions, in_order=True).query(NOISE_SIZES[-1], positions[rows]).indices
    noise, size = 0.0, 0
    for size in NOISE_SIZES:
        _, residuals = _fit_rows(positions, rows, near, [min(size, len(positions))], 0.0)
        sound = residuals[np.isfinite(residuals)]
        noise = float(np.quantile(sound, QUANTILE)) / AT_QUANTILE if len(sound) else 0.0
        if len(sound) > (1 - LINED) * len(residuals):
            break
    return noise, SIZES[1] if size == NOISE_SIZES[0] and noise <= CLEAN else max(size, SIZES[2])


class Fits(NamedTuple):
    """Normals fitted to the neighbours of distinct points in kd order, with what later steps need.

    Attributes
    ----------
    positions : (n, 3) float32
        As given, or moved onto the surface where they were noisy.
    normals : (n, 3) float32
        Unit length.
    near : (n, k) int32
        The nearest neighbours, by which signs are made consistent; the point itself first.
    residuals : (n,) float32
        Residuals of the fits to the fewest neighbours, in spacings; NaN where these lie on a line.
    noise : (n,) float32 or None
        Standard deviation of the noise that was removed, if the points were moved.
    """

    positions: Floats
    normals: Floats
    near: NDArray[np.int32]
    residuals: Floats
    noise: Floats | None = None


class Planes(Protocol):
    """Receiver of each point's neighbours, which are searched once for all fits; `Layers` fits planes to them."""

    def needed(self, noise: float) -> int:
        """Return how many neighbours of each point the receiver needs; 0: none.

        noise : standard deviation of the points from the surface, in spacings
        """

    def add_neighbors(self, part: slice, found: NDArray[np.int32]) -> None:
        """Receive the neighbours of some points: `found`, (m, k) rows, of the m points in the range `part`."""


def faces(normals: Floats, planes: Floats, to_eye: Floats) -> Flags:
    """Return which normals, (m,) bool, face the scanner; where they graze the view, planes through neighbours decide.

    With planes alone 3.0% of the normals of a layered wall faced away from its scanner, now 0.3%. Without planes 0.16%
    of the normals of noisy pipes (0.5 spacings) were flipped, now 0.02%.

    normals, planes : (m, 3) unit normals of quadrics, and of planes through the same neighbours
    to_eye : (m, 3) vectors to the scanner
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
    statistics: CloudStatistics | None = None,
) -> Fits:
    """Fit quadrics to the nearest neighbours of points, for unit normals.

    Parameters
    ----------
    positions : (n, 3) float32
        All distinct, in kd order.
    kept : int
        Number of neighbours to return, including the point itself, which comes first.
    eye : (3,) or (n, 3) float32, optional
        Position of the scanner, which normals face. Where both the normal and the plane through the neighbours graze
        the view, the plane, which tilts less, is turned, and the normal follows. None, or NaN for a point: arbitrary
        sign.
    progress : callable, optional
    planes : Planes, optional
        Also receives the neighbours, as many as it needs.
    neighbors : int, optional
        Number of neighbours a quadric is fitted to. None: the best of 10, 16, 32 and 64 for each point.
    statistics : CloudStatistics, optional
        Of the cloud that the points are a part of, for its noise. None: they are the whole cloud.
    """
    n = len(positions)
    noise, most = measure_noise(positions, statistics) if neighbors is None else (0.0, 0)
    sizes = [k for k in SIZES if k <= most] if neighbors is None else [neighbors]
    sizes = sorted({min(k, n) for k in sizes})
    normals, near = np.empty_like(positions), np.empty((n, min(kept, n)), np.int32)
    residuals = np.empty(n, np.float32)
    needed = 0 if planes is None else planes.needed(noise)
    report_progress(progress, SURVEY)
    for part, found in neighbor_chunks(positions, max(sizes[-1], kept, needed), part_of(progress, SURVEY, 1.0)):
        if planes is not None and needed:
            planes.add_neighbors(part, found)
        rows = np.arange(part.start, part.start + len(found))
        table = np.ascontiguousarray(found[:, : sizes[-1]])
        fits, residuals[part] = _fit_rows(positions, rows, table, sizes, noise)
        normals[part] = fits[:, :3]
        if eye is not None:
            to_eye = (eye if eye.ndim == 1 else eye[part]) - positions[part]
            normals[part][~faces(normals[part], fits[:, 3:], to_eye)] *= -1
        near[part] = found[:, : near.shape[1]]
    return Fits(positions, normals, near, residuals)
