"""Second layers: sparse, misaligned passes of a surface, which models move onto it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.arrays import Flags, Floats, Rows
from ...base.progress import Progress, part_of, report_progress
from ..kd_ordering import KdOrdering, compute_kd_ordering
from ..neighbors import neighbors
from ..neighbors.components import connected_components
from ..points import Points
from ..statistics import CloudStatistics
from .floors import LAYER, LEAST, Floors, FloorSearch
from .passes import merge_passes
from .search import LayerSearch

SPARSE_MERGED = 0.6  # progress after sparse layers are merged
OPPOSITE = -0.3  # mean cosine of a point's given normal and those around it, below which it belongs to another sheet

# A layer is a large group of points at about the same height on the same side. Clean clouds have groups of at most 10.
FEWEST = 50
LINKS, APART = 8, 6.0  # nearest points of the layer that are linked, and their greatest distance in spacings
LEVEL, ALIKE = 1.0, 0.5  # greatest difference in height, in spacings; least cosine of the directions to the floor


class Part(NamedTuple):
    """Description of the cloud that some points are a part of, so that parts are treated as in the whole.

    total : number of its distinct positions
    numbers : (m,) int64, place in its kd order of each position of the part, in order
    statistics : statistics of the whole cloud
    blocks : numbers of the ranges of its kd order that contain second layers (duplicates of a surface, from
        misaligned scans); None: they are searched
    ignored : indices of scanner positions to ignore; None: found from the points
    """

    total: int
    numbers: Rows
    statistics: CloudStatistics
    blocks: Rows | None = None
    ignored: tuple[int, ...] | None = None


def merge_for_model(
    points: Points, progress: Progress | None = None, ordering: KdOrdering | None = None, part: Part | None = None
) -> Points:
    """Move second layers (duplicates of a surface, from misaligned scans) onto the surface.

    Return `points` itself if nothing moves.

    Unlike `merge_layers` this examines the cloud closely only where a few ranges of the kd order show layers, and moves
    only groups of at least 50 points: a surface without layers is unchanged, to the bit.

    ordering : kd ordering of the points, if known
    part : the cloud that the points are a part of; None: they are the whole cloud
    """
    ordering = ordering or compute_kd_ordering(points)
    ordered, ids, _ = ordering
    report_progress(progress, 0.1)
    if len(ordered) < LEAST:
        return points
    part = part or Part(len(ordered), np.arange(len(ordered)), CloudStatistics.of(len(ordered)))
    if part.blocks is None or len(part.blocks):
        shift = _shifts(points, ordering, part, part_of(progress, 0.1, SPARSE_MERGED))
        if shift is not None:
            positions = points.positions.copy()
            positions[points.finite] += shift[ids]
            points = points.changed(positions=positions)
            ordering = ordering.moved(points)
    report_progress(progress, SPARSE_MERGED)
    rest = part_of(progress, SPARSE_MERGED, 1.0)
    return merge_passes(points, None, rest, ordering, part.statistics, part.ignored)


def _shifts(points: Points, ordering: KdOrdering, part: Part, progress: Progress | None) -> Floats | None:
    """Return how positions in second layers move onto the surface, (n, 3), 0 for others; None if there are no layers.

    A second layer is a sparse duplicate of a surface, from a misaligned scan.

    part : the cloud that the points are a part of
    """
    floor_search = FloorSearch(ordering.positions)
    search = LayerSearch(floor_search, part.total, part.numbers)
    if part.blocks is None:
        search.examine_all(progress)
    else:
        search.open(part.blocks)
    floors = floor_search.floors()
    off = np.flatnonzero(floors.off)
    off = off[np.linalg.norm(floors.offset[off], axis=1) <= LAYER * floors.spacing[off]]
    off = off[~faces_back(points, ordering.rows, floors, off)]
    off = off[_in_company(ordering.positions, floors, off)]
    if not len(off):
        return None
    shift = np.zeros_like(ordering.positions)
    shift[off] = floors.offset[off]
    return shift


def _in_company(ordered: Floats, floors: Floors, rows: Rows) -> Flags:
    """Return which rows, all off the surface near them, are in a large group at about the same height, (m,) bool.

    ordered : (n, 3) positions in kd order
    floors : the surface near each position
    rows : (m,)
    """
    m = len(rows)
    if m < FEWEST:
        return np.zeros(m, np.bool_)
    away, near = neighbors(ordered[rows], LINKS + 1)
    offset, spacing = floors.offset[rows], floors.spacing[rows]
    height = np.linalg.norm(offset, axis=1)
    ways = offset / np.maximum(height, 1e-30)[:, None]
    is_linked = (away < APART * spacing[:, None]) & (np.abs(height[near] - height[:, None]) < LEVEL * spacing[:, None])
    is_linked &= np.einsum("ij,ikj->ik", ways, ways[near]) > ALIKE
    part = connected_components(near, is_linked)
    return np.asarray(np.bincount(part)[part] >= FEWEST)


def faces_back(points: Points, rows: NDArray[np.integer[Any]], floors: Floors, some: Rows) -> Flags:
    """Return which positions have a given normal opposite to those around, (m,) bool: they are the back of a thin body.

    rows : (n,) the row of `points` of each position
    floors : the surface near each position, with its neighbours
    some : (m,) the positions to test
    """
    if points.normals is None or len(some) == 0:
        return np.zeros(len(some), np.bool_)
    with np.errstate(invalid="ignore", over="ignore"):
        normals = points.normals / np.linalg.norm(points.normals, axis=1, keepdims=True)
        own, around = normals[rows[some]], normals[rows[floors.near[some, 1:]]]
        cosines = np.einsum("ij,ikj->ik", own, around)
        counts = np.isfinite(cosines).sum(axis=1)
        return np.asarray(np.nansum(cosines, axis=1) < OPPOSITE * np.maximum(counts, 1))
