"""Splats for a cloud under an error bound: selected, fitted to the points, and mended where the surface is too far.

What counts is not the flat splats but the blended surface that is traced. So supports are OVERLAP times as wide as the
covering discs. Neighbouring sizes differ by at most SLOPE times the distance, as a large support that reaches into fine
detail spoils it. Centres are shifted to the middle of the heights over that surface, not over the disc.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .cover import choose, relax
from .deviation import deviations
from .grow import Cloud, Floats, Splats, grade, grow_pool, join

Progress = Callable[[str, float], None]

OVERLAP = 1.8  # support radius in disc radii: 1.6 leaves ten times as many bare points, 2.0 a third more error
SLOPE = 0.25  # 0.2 needs a tenth more splats for the same error, 0.3 leaves a longer tail, 0.6 holes in a tenth
SCOUTS, CANDIDATES = 4, 16  # splats over each point: to learn how large splats can be, and to choose from
LEAST = 0.3  # least size, as a share of the radius with which the whole cloud covers itself
WIDEST = 1 / 16  # of the cloud's diagonal
TILTS = 3  # rounds of fitting
STEEPEST = 0.9  # cosine between a fitted normal and the point's own
CLOSE = 0.02  # in tolerances: distances up to this are not refined; 0.3 missed half of the large ones, at creases
BARE = 4.0  # an uncovered point counts as this many tolerances away
SHRINK = 0.5, 0.9  # least and greatest factor when splats are made smaller where the error is too large


class Subset(NamedTuple):
    """Chosen splats in the form that a model takes, and how far the cloud is from their surface."""

    splats: Splats
    positions: Floats  # (m, 3), fitted
    normals: Floats  # (m, 3)
    radii: Floats  # (m,), supports
    distances: Floats  # (n,), signed
    bare: NDArray[np.bool_]  # (n,)


def measure(cloud: Cloud, error: float, times: int = SCOUTS, wanted: NDArray[np.bool_] | None = None) -> Floats:
    """How large splats may be at each point (n,): the size to which they grow within the error bound, graded."""
    low, high = cloud.positions.min(axis=0), cloud.positions.max(axis=0)
    widest = np.full(len(cloud.positions), WIDEST * np.linalg.norm(np.float64(high) - low), np.float32)
    pool, reached = grow_pool(cloud, widest, error, times, wanted)
    sizes = widest
    sizes[pool.seeds] = reached
    return grade_sizes(cloud, sizes)


def grade_sizes(cloud: Cloud, sizes: Floats) -> Floats:
    """The sizes, lowered as far as neighbours require, but not below what the cloud's spacing needs."""
    least = np.float32(LEAST) * cloud.radii
    return np.asarray(np.maximum(grade(np.maximum(sizes, least), cloud, SLOPE), least))


def select(cloud: Cloud, sizes: Floats, error: float, progress: Progress) -> Splats:
    """Splats that cover every point: chosen greedily, then relaxed."""
    pool, rows = select_greedily(cloud, sizes, error)
    return pool.pick(relax(pool, cloud, rows, progress=progress))


def select_greedily(cloud: Cloud, sizes: Floats, error: float) -> tuple[Splats, NDArray[np.int32]]:
    """A pool of splats, and the rows of the chosen ones."""
    pool, _ = grow_pool(cloud, sizes, error, CANDIDATES)
    return pool, choose(pool, cloud, np.zeros(len(sizes), np.int32))


def fit(cloud: Cloud, splats: Splats, error: float) -> Subset:
    """Shift and tilt the splats until their blended surface lies amid the points that each covers."""
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
        # This is half of the full step, twice the moment, which overshoots, as neighbours tilt too.
        normals = _tilted(first, normals, moment / inertia[:, None])
        positions = _shifted(seeds, positions + mean[:, None] * normals, splats.widths)
    heights = _heights(cloud, (positions, normals, radii), error)[members]
    middle = 0.5 * (np.maximum.reduceat(heights, at) + np.minimum.reduceat(heights, at))
    positions = _shifted(seeds, positions + middle[:, None] * normals, splats.widths)
    found = deviations(cloud.positions, cloud.normals, (positions, normals, radii), CLOSE * error)
    return Subset(splats, positions, normals, radii, *found)


def _heights(cloud: Cloud, surface: tuple[Floats, Floats, Floats], error: float) -> Floats:
    """Distances of the points from a surface, clipped: large ones do not guide the fit."""
    distances, _ = deviations(cloud.positions, cloud.normals, surface)
    return np.clip(distances, -2 * error, 2 * error)


def _tilted(first: Floats, normals: Floats, slope: NDArray[np.floating[Any]]) -> Floats:
    """Unit normals tilted by the part of the slope in their planes; a normal stays if it would tilt too far."""
    slope = slope - np.einsum("ij,ij->i", slope, normals)[:, None] * normals
    new = normals - slope
    new /= np.linalg.norm(new, axis=1, keepdims=True)
    return np.where(np.einsum("ij,ij->i", new, first)[:, None] > STEEPEST, new, normals).astype(np.float32)


def _shifted(seeds: Floats, positions: NDArray[np.floating[Any]], widths: Floats) -> Floats:
    """The positions, moved to within half a width of the seeds."""
    offsets = positions - seeds
    length = np.linalg.norm(offsets, axis=1)
    return np.asarray(seeds + offsets * np.minimum(1, 0.5 * widths / np.maximum(length, 1e-30))[:, None], np.float32)


def errors(subset: Subset, tolerance: float) -> Floats:
    """How far each point is from the surface, in tolerances."""
    return np.where(subset.bare, np.float32(BARE), np.abs(subset.distances) / np.float32(tolerance))


def worst(subset: Subset, tolerance: float) -> Floats:
    """The greatest error among the points of each splat."""
    return np.asarray(np.maximum.reduceat(errors(subset, tolerance)[subset.splats.members], subset.splats.starts[:-1]))


def mend(cloud: Cloud, subset: Subset, sizes: Floats, error: float, ratio: Floats) -> tuple[Splats, Floats]:
    """Smaller splats and sizes where the ratio (m,) of error to tolerance is over 1; the other splats stay."""
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
