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
    """Return the largest radius of a splat at each point within an error bound, (n,); neighbours differ little.

    times : splats that are grown over each point to measure; wanted : (n,) bool, points to measure, default: all
    """
    low, high = cloud.positions.min(axis=0), cloud.positions.max(axis=0)
    widest = np.full(len(cloud.positions), WIDEST * np.linalg.norm(np.float64(high) - low), np.float32)
    pool, reached = grow_pool(cloud, widest, error, times, wanted)
    sizes = widest
    sizes[pool.seeds] = reached
    return grade_sizes(cloud, sizes)


def grade_sizes(cloud: Cloud, sizes: Floats) -> Floats:
    """Lower radii of splats (n,) so that they change gradually, but not below a share of the cloud's spacing.

    A large support that reaches into fine detail would spoil it.
    """
    least = np.float32(LEAST) * cloud.radii
    return np.asarray(np.maximum(grade(np.maximum(sizes, least), cloud, SLOPE), least))


def select(cloud: Cloud, sizes: Floats, error: float, progress: StageProgress) -> Splats:
    """Select splats that cover every point: greedily by newly covered area, then relaxed to fewer.

    sizes : (n,) largest radius of a splat at each point; error : largest error of a splat
    """
    pool, rows = select_greedily(cloud, sizes, error)
    return pool.pick(relax(pool, cloud, rows, progress=progress))


def select_greedily(cloud: Cloud, sizes: Floats, error: float) -> tuple[Splats, NDArray[np.int32]]:
    """Return candidate splats, and the rows of those that a greedy selection by newly covered area chooses, (m,) int32.

    sizes : (n,) largest radius of a splat at each point; error : largest error of a splat
    """
    pool, _ = grow_pool(cloud, sizes, error, CANDIDATES)
    return pool, choose(pool, cloud, np.zeros(len(sizes), np.int32))


def fit(cloud: Cloud, splats: Splats, error: float) -> Subset:
    """Shift and tilt the splats until their blended surface is centred among the points that each covers.

    error : error bound, which limits the influence of outliers
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

    surface : positions, normals and support radii of splats; error : half of the limit
    """
    distances, _ = deviations(cloud.positions, cloud.normals, surface)
    return np.clip(distances, -2 * error, 2 * error)


def _tilted(first: Floats, normals: Floats, slope: NDArray[np.floating[Any]]) -> Floats:
    """Tilt unit normals (m, 3) by the tangential part of `slope` (m, 3), unless they would be too far from `first`.

    first : (m, 3) normals of the points from which the splats grew
    """
    slope = slope - np.einsum("ij,ij->i", slope, normals)[:, None] * normals
    new = normals - slope
    new /= np.linalg.norm(new, axis=1, keepdims=True)
    return np.where(np.einsum("ij,ij->i", new, first)[:, None] > STEEPEST, new, normals).astype(np.float32)


def _shifted(seeds: Floats, positions: NDArray[np.floating[Any]], widths: Floats) -> Floats:
    """Return positions (m, 3) moved to at most half a splat's width from its seed. seeds : (m, 3); widths : (m,)"""
    offsets = positions - seeds
    length = np.linalg.norm(offsets, axis=1)
    return np.asarray(seeds + offsets * np.minimum(1, 0.5 * widths / np.maximum(length, 1e-30))[:, None], np.float32)


def errors(subset: Subset, tolerance: float) -> Floats:
    """Return the distance of each point of the cloud from the surface, (n,), in tolerances; 4 for uncovered points."""
    return np.where(subset.bare, np.float32(BARE), np.abs(subset.distances) / np.float32(tolerance))


def worst(subset: Subset, tolerance: float) -> Floats:
    """Return the largest error among the points that each splat covers, (m,), in tolerances."""
    return np.asarray(np.maximum.reduceat(errors(subset, tolerance)[subset.splats.members], subset.splats.starts[:-1]))


def shrink_splats(cloud: Cloud, subset: Subset, sizes: Floats, error: float, ratio: Floats) -> tuple[Splats, Floats]:
    """Shrink splats of a subset whose error is too large, and cover their points again with smaller ones.

    sizes : (n,) largest radius of a splat at each point; error : largest error of a new splat
    ratio : (m,) error of each splat over the tolerance; over 1 it is shrunk

    Returns the splats that remain together with the new ones, and the reduced sizes.
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
