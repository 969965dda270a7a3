"""Radii of scattered points drawn as spheres or discs, and the directions in which their neighbourhoods are open."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ....base.arguments import check_choice, check_positive
from ....base.arrays import Flags, Floats, Rows
from ....base.choices import AS_SPHERES, AS_SURFACE, AUTO, SCATTER
from ....cloud.kd_ordering import KdOrdering, compute_kd_ordering
from ....cloud.neighbors import NeighborTree
from ....cloud.points import Points
from ....cloud.statistics import CloudStatistics
from ....engine.kernels.tree import DISCS, SPHERES
from ...tree.build import Splats
from ..gaps import largest_reach
from ..local_planes import columns_of, fit_planes

NEIGHBORS = 8  # whose mean distance is the local spacing
AROUND = 24  # neighbours that determine the direction of a neighbourhood
SIZE = 0.35  # radius in local spacings
CLOSEST = 0.75  # upper limit in distances to the nearest other position: spheres overlap by up to a half
LEAST = 0.5  # lower limit, as a share of the chosen radius, for close positions: double points stay visible
WIDEST = 1.5  # upper limit in median radii of the neighbours: isolated points are not drawn much larger than others
LARGEST = 0.98  # quantile of the radii that limits all: a few remote points do not become balloons
FLAT = 17  # points to which the normal of a disc is fitted if the points have no normals
PIECE = 1 << 18  # rows whose neighbours are held at once


NOTHING_TO_DRAW = 'scatter: all points are scattered, so "none" leaves nothing to draw; use spheres, discs or surface'


class Drawing(NamedTuple):
    """How scattered points are drawn.

    scatter : "spheres", "discs", "surface" (as surface, undetected) or "none" (not drawn)
    size : factor for their radii
    """

    scatter: str = AS_SURFACE
    size: float = 1.0

    @property
    def is_apart(self) -> bool:
        """Whether scattered points are detected, and drawn separately or not at all."""
        return self.scatter != AS_SURFACE

    @property
    def facts(self) -> dict[str, Any]:
        """Settings for a model's files: both fields by name; empty for "surface", as in files of earlier releases."""
        if self == ALL_SURFACE:
            return {}
        return {"scatter": self.scatter, "scatter_size": self.size}

    @property
    def kind(self) -> int:
        """Shape of scattered points in a tree: SPHERES or DISCS."""
        return DISCS if self.scatter == "discs" else SPHERES


ALL_SURFACE = Drawing(AS_SURFACE, 1.0)


def check_drawing(scatter: str, scatter_size: float, sized: bool = False) -> Drawing:
    """Check the parameters `scatter` and `scatter_size` of `Model` and return them as a `Drawing`.

    sized : whether the points have radii; then "auto" means "surface", otherwise "spheres"
    """
    if check_choice(scatter, "scatter", (AUTO, *SCATTER)) == AUTO:
        scatter = AS_SURFACE if sized else AS_SPHERES
    return Drawing(scatter, check_positive(scatter_size, "scatter_size"))


def check_mask(mask: ArrayLike | None, count: int) -> Flags | None:
    """Return a mask of scattered points as an array; raise ValueError unless it has `count` bools. None stays None."""
    if mask is None:
        return None
    try:
        checked = np.asarray(mask)
    except ValueError as error:  # rows of different lengths
        raise ValueError(f"_scattered must be {count} bools: {error}") from None
    if checked.dtype != np.bool_ or checked.shape != (count,):
        raise ValueError(f"_scattered must be {count} bools, not {checked.dtype} of shape {checked.shape}")
    return checked


def make_scattered(
    points: Points, mask: Flags, rows: NDArray[np.int32], drawing: Drawing, given: Floats | None = None
) -> Splats:
    """Return the scattered points of a cloud as splats with radii and directions, to be drawn as spheres or discs.

    Parameters
    ----------
    points : Points
        All points of the cloud, finite, including those of the surface, which count as neighbours.
    mask : (n,) bool
        Mask of the scattered points, at least one.
    rows : (n,) int32
        The caller's row of each point.
    drawing : Drawing
        How they are drawn.
    given : (n,) float32, optional
        Radii of all points. Default: chosen.

    Raises
    ------
    ValueError
        If all positions are equal and no radii are given.
    """
    some, along = np.flatnonzero(mask), compute_kd_ordering(points)
    statistics = CloudStatistics.of(len(along.positions))
    radii, directions = shapes_of(points, along, drawing, given, statistics, mask)
    colors = None if points.colors is None else points.colors[some]
    return Splats(points.positions[some], directions[some], radii[some], rows[some], colors)


def shapes_of(
    points: Points,
    along: KdOrdering,
    drawing: Drawing,
    given: Floats | None,
    statistics: CloudStatistics,
    mask: Flags | None = None,
) -> tuple[Floats, Floats]:
    """Return the radii (n,) and directions (n, 3) of points drawn as spheres or discs.

    The direction of a sphere is the mean, over its point and the 8 nearest ones, of unit vectors away from the centroid
    of the points around each. Shading uses it as a smooth normal.
    The direction of a disc is the normal of its point; without normals, that of the plane through the neighbours, with
    the sign that makes it point outwards too.

    Parameters
    ----------
    points : Points
        Finite.
    along : KdOrdering
        Their kd order.
    drawing : Drawing
        Spheres or discs, and a factor for their radii.
    given : (n,) float32, optional
        Radii. Default: 0.35 times the mean distance to the 8 nearest other positions, limited by the neighbours' radii,
        by the 98th percentile of all (rounded up to 8 bits), and to less than 2% of an image that the cloud fills.
    statistics : CloudStatistics
        Provides that percentile, or computes it from the points.
    mask : (n,) bool, optional
        Points to compute; results for others are invalid. Default: all.
    """
    places = along.positions
    if len(places) > 1:
        wanted, sampled = np.ones(len(places), np.bool_), statistics.rows_for_quantile(len(places))
        if mask is not None:
            wanted[:] = False
            wanted[along.ids[mask]] = True
            wanted[sampled] = True
        chosen, outwards = _at_places(places, np.flatnonzero(wanted), sampled, statistics)
        if drawing.kind == DISCS and points.normals is None:
            outwards = _across(places, outwards)
        radii, directions = chosen[along.ids] if given is None else given, outwards[along.ids]
    elif given is None:
        raise ValueError(
            f"scatter: no radius can be chosen for {drawing.scatter}: all points have the same position; give radii or "
            "an attribute radius in the file"
        )
    else:
        radii, directions = given, np.tile(np.array([0, 0, 1], np.float32), (len(points), 1))
    if drawing.kind == DISCS and points.normals is not None:
        directions = unit_vectors(np.nan_to_num(points.normals))
    return np.asarray(radii * np.float32(drawing.size), np.float32), directions


def _at_places(places: Floats, some: Rows, sampled: Rows, statistics: CloudStatistics) -> tuple[Floats, Floats]:
    """Return radii (n,) and directions (n, 3) of spheres at some of n distinct positions in kd order, 0 at others.

    some : rows of these positions; sampled : rows whose 98th percentile of radii limits all radii
    statistics : of the whole cloud; provides that percentile, or computes it
    """
    tree, count = NeighborTree(places, in_order=True), min(AROUND + 1, len(places))
    radii, outwards = np.zeros(len(places), np.float32), np.zeros_like(places)
    near = np.zeros((len(places), min(NEIGHBORS, len(places) - 1)), np.int32)
    inner = some
    if len(some) < len(places):  # include their neighbours
        beside = np.zeros(len(places), np.bool_)
        beside[tree.rows_at(near.shape[1] + 1, places[some])] = True
        inner = np.flatnonzero(beside)
    for start in range(0, len(inner), PIECE):
        part = inner[start : start + PIECE]
        found = tree.query(count, places[part])
        distances = found.distances[:, 1 : NEIGHBORS + 1]
        spacing = distances.mean(axis=1)
        radii[part] = SIZE * np.minimum(spacing, np.maximum(CLOSEST / SIZE * distances[:, 0], LEAST * spacing))
        near[part] = found.indices[:, 1 : NEIGHBORS + 1]
        outwards[part] = unit_vectors(places[part] - places[found.indices].mean(axis=1))
    limited, directions, around = np.zeros_like(radii), np.zeros_like(outwards), near[some]
    limited[some] = np.minimum(radii[some], WIDEST * np.median(radii[around], axis=1))
    most = min(
        statistics.quantile_of_rows("largest sphere", limited, sampled, LARGEST), largest_reach(places, statistics)
    )
    np.minimum(limited, np.float32(most), out=limited)
    directions[some] = unit_vectors(outwards[some] + outwards[around].sum(axis=1))
    return limited, directions


def _across(places: Floats, outwards: Floats) -> Floats:
    """Return normals of the planes through the neighbours of positions, for discs, on the side of `outwards`, (n, 3).

    places : (n, 3) in kd order; outwards : (n, 3) unit directions away from the centroids of their neighbours
    """
    if len(places) <= FLAT:
        return outwards
    planes = fit_planes(columns_of(places), NeighborTree(places, in_order=True).rows(FLAT), (0, FLAT))
    normals = unit_vectors(np.column_stack(planes[:3]))
    return np.where((normals * outwards).sum(axis=1, keepdims=True) < 0, -normals, normals)


def unit_vectors(vectors: Floats) -> Floats:
    """Normalize vectors (n, 3); zero vectors become (0, 0, 1)."""
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    known = size > 0
    out = np.divide(vectors, size, out=np.zeros_like(vectors), where=known)
    out[~known[:, 0], 2] = 1.0
    return np.asarray(out, np.float32)
