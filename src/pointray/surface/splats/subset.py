"""Splats for a cloud under an error bound: selected, fitted to the points, and refined where the error is too large.

The error is that of the blended surface, not of the flat splats. So supports are OVERLAP times as wide as the covering
discs. Sizes of neighbours differ by at most SLOPE times their distance, because a large support that reaches into fine
detail spoils it. Centres are moved to the middle of the heights over the blended surface, not over the disc.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats
from ...base.progress import StageProgress
from .cover import choose, relax
from .deviation import deviations
from .grow import Cloud, Splats, grade, grow_pool, join

OVERLAP = 1.8  # support radius in disc radii: 1.6 leaves ten times as many bare points, 2.0 a third more error
SLOPE = 0.25  # 0.2 needs 10% more splats for the same error, 0.3 has a longer tail of errors, 0.6 leaves holes in 10%
SIZE_SAMPLES, CANDIDATES = 4, 16  # splats over each point: to measure how large splats can be; to choose from
LEAST = 0.3  # least size, as a share of the radius with which the whole cloud covers itself
WIDEST = 1 / 16  # largest size, as a share of the cloud's diagonal
TILTS = 3  # rounds of fitting
STEEPEST = 0.9  # least cosine of a fitted normal with the point's own
CLOSE = 0.02  # distances up to this many tolerances are not refined; 0.3 missed half of the large errors, at creases
BARE = 4.0  # error of an uncovered point, in tolerances
SHRINK = 0.5, 0.9  # limits of the factor by which splats shrink where the error is too large


class Subset(NamedTuple):
    """Splats chosen to represent a cloud of n points, fitted to it, and the distances of the cloud from their surface.

    splats : the m splats, with the points that each covers
    positions, normals : (m, 3) float32, fitted; radii : (m,) float32, support radii
    distances : (n,) float32, signed distance of each point of the cloud from the surface
    bare : (n,) bool, points that the surface does not cover
    """

    splats: Splats
    positions: Floats
    normals: Floats
    radii: Floats
    distances: Floats
    bare: Flags


def measure(cloud: Cloud, error: float, times: int = SIZE_SAMPLES, wanted: Flags | None = None) -> Floats:
    """Return the largest radius of a splat within an error bound at each point, (n,); neighbours differ little.

    error : bound, half the largest range of heights of a splat's points over its plane
    times : number of splats to grow over each point for the measurement
    wanted : (n,) bool, points at which radii are measured, default: all
    """
    low, high = cloud.positions.min(axis=0), cloud.positions.max(axis=0)
    widest = np.full(len(cloud.positions), WIDEST * np.linalg.norm(np.float64(high) - low), np.float32)
    pool, reached = grow_pool(cloud, widest, error, times, wanted)
    sizes = widest
    sizes[pool.seeds] = reached
    return grade_sizes(cloud, sizes)


def grade_sizes(cloud: Cloud, sizes: Floats) -> Floats:
    """Lower radii of splats (n,) so that they change gradually, but stay above a share of the local spacing.

    A large support that reaches into fine detail would spoil the detail. Returns the new radii.
    """
    least = np.float32(LEAST) * cloud.radii
    return np.asarray(np.maximum(grade(np.maximum(sizes, least), cloud, SLOPE), least))


def select(cloud: Cloud, sizes: Floats, error: float, progress: StageProgress) -> Splats:
    """Select splats that cover every point: greedily by newly covered area, then relaxed to fewer.

    sizes : (n,) largest radius of a splat at each point
    error : half the largest range of heights of a splat's points over its plane
    """
    pool, rows = select_greedily(cloud, sizes, error)
    return pool.pick(relax(pool, cloud, rows, progress=progress))


def select_greedily(cloud: Cloud, sizes: Floats, error: float) -> tuple[Splats, NDArray[np.int32]]:
    """Return candidate splats, and the rows of those that a greedy selection by newly covered area chooses, (m,) int32.

    sizes : (n,) largest radius of a splat at each point
    error : half the largest range of heights of a splat's points over its plane
    """
    pool, _ = grow_pool(cloud, sizes, error, CANDIDATES)
    return pool, choose(pool, cloud, np.zeros(len(sizes), np.int32))


def fit(cloud: Cloud, splats: Splats, error: float) -> Subset:
    """Shift and tilt the splats until their blended surface is centred among the points that each covers.

    error : distances of points from the surface are clipped to twice this, so that outliers do not guide the fit

    Also measure the distances of the points from the result.
    """
    at, own, members = splats.starts[:-1], splats.owners, splats.members
    seeds, first = cloud.positions[splats.seeds], cloud.normals[splats.seeds]
    radii = np.maximum(np.float32(OVERLAP) * splats.widths, cloud.radii[splats.seeds])
    positions, normals = seeds.copy(), first.copy()
    offsets = cloud.positions[members] - seeds[own]
    squares = np.einsum("ij,ij->i", offsets, offsets)
    weights = np.maximum(1 - squares / (1.44 * splats.widths[own] ** 2), np.float32(1e-3))
    total = np.add.reduceat(weights, at)
    inertia = np.maximum(np.add.reduceat(weights * squares, at), np.float32(1e-30))
    for _ in range(TILTS):
        heights = _heights(cloud, (positions, normals, radii), error)[members]
        mean = np.add.reduceat(weights * heights, at) / total
        moment = np.stack([np.add.reduceat(weights * (heights - mean[own]) * column, at) for column in offsets.T], 1)
        # Half of the full step (twice the moment), which overshoots, as neighbours tilt too.
        normals = _tilted(first, normals, moment / inertia[:, None])
        positions = _shifted(seeds, positions + mean[:, None] * normals, splats.widths)
    heights = _heights(cloud, (positions, normals, radii), error)[members]
    middle = 0.5 * (np.maximum.reduceat(heights, at) + np.minimum.reduceat(heights, at))
    positions = _shifted(seeds, positions + middle[:, None] * normals, splats.widths)
    found = deviations(cloud.positions, cloud.normals, (positions, normals, radii), CLOSE * error)
    return Subset(splats, positions, normals, radii, *found)


def _heights(cloud: Cloud, surface: tuple[Floats, Floats, Floats], error: float) -> Floats:
    """Return the signed distances of the cloud from a surface, (n,), clipped so that outliers do not guide a fit.

    surface : positions, normals and support radii of splats
    error : distances are clipped to twice this
    """
    distances, _ = deviations(cloud.positions, cloud.normals, surface)
    return np.clip(distances, -2 * error, 2 * error)


def _tilted(first: Floats, normals: Floats, slope: NDArray[np.floating[Any]]) -> Floats:
    """Tilt unit normals (m, 3) by the tangential part of `slope`, unless they would be over 26 degrees from `first`.

    first : (m, 3) normals of the points from which the splats grew
    slope : (m, 3) gradient, along the splat, of the heights of the points over the surface
    """
    slope = slope - np.einsum("ij,ij->i", slope, normals)[:, None] * normals
    new = normals - slope
    new /= np.linalg.norm(new, axis=1, keepdims=True)
    return np.where(np.einsum("ij,ij->i", new, first)[:, None] > STEEPEST, new, normals).astype(np.float32)


def _shifted(seeds: Floats, positions: NDArray[np.floating[Any]], widths: Floats) -> Floats:
    """Return the positions of splats, (m, 3), moved towards their seeds where they are over half a width from these.

    seeds : (m, 3) points from which the splats grew; widths : (m,) widths of the splats
    """
    offsets = positions - seeds
    length = np.linalg.norm(offsets, axis=1)
    return np.asarray(seeds + offsets * np.minimum(1, 0.5 * widths / np.maximum(length, 1e-30))[:, None], np.float32)


def errors(subset: Subset, tolerance: float) -> Floats:
    """Return the distance of each point of the cloud from the surface over the tolerance, (n,); 4 for uncovered points.

    tolerance : largest acceptable distance
    """
    return np.where(subset.bare, np.float32(BARE), np.abs(subset.distances) / np.float32(tolerance))


def worst(subset: Subset, tolerance: float) -> Floats:
    """Return the largest distance from the surface, over the tolerance, of the points that each splat covers, (m,).

    tolerance : largest acceptable distance
    """
    return np.asarray(np.maximum.reduceat(errors(subset, tolerance)[subset.splats.members], subset.splats.starts[:-1]))


def shrink_splats(cloud: Cloud, subset: Subset, sizes: Floats, error: float, ratio: Floats) -> tuple[Splats, Floats]:
    """Shrink splats of a subset whose error is too large, and cover their points again with smaller ones.

    sizes : (n,) largest radius of a splat at each point
    error : half the largest range of heights of a new splat's points over its plane
    ratio : (m,) largest distance from the surface of the points that each splat of the subset covers, divided by the
        tolerance; over 1 the splat is shrunk

    Returns the splats that remain together with the new ones, and the reduced sizes (n,).
    """
    splats = subset.splats
    shrunk = splats.widths * np.clip(SHRINK[1] * np.maximum(ratio, 1) ** -0.5, *SHRINK)
    least = np.where(ratio > 1, shrunk, np.float32(np.inf)).astype(np.float32)
    sizes = sizes.copy()
    np.minimum.at(sizes, splats.members, least[splats.owners])
    sizes = grade_sizes(cloud, sizes)
    kept = splats.pick(np.flatnonzero(sizes[splats.seeds] >= np.float32(SHRINK[1]) * splats.widths))
    times = np.bincount(kept.members, minlength=len(sizes)).astype(np.int32)
    if times.all():
        return kept, sizes
    pool, _ = grow_pool(cloud, sizes, error, CANDIDATES, times == 0)
    return join([kept, pool.pick(choose(pool, cloud, times))]), sizes
