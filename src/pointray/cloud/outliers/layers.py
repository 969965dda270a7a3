"""Second layers: sparse passes of a surface that do not fit, which models move onto it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import Progress, part_of, tell
from ..kd_ordering import Path, along_path
from ..neighbors import neighbors
from ..neighbors.components import connected_components
from ..points import Points
from ..statistics import CloudStatistics
from .floors import LAYER, LEAST, Floors, Ground
from .passes import merge_passes
from .search import Search

Floats = NDArray[np.float32]
Rows = NDArray[np.int64]

SPARSE_MERGED = 0.6  # share of the time
OPPOSITE = -0.3  # mean cosine of a point's given normal and those around it, below which it is another sheet

# A layer is a group of many points that are about as far off on the same side. Clean clouds have groups of at most 10.
FEWEST = 50
LINKS, APART = 8, 6.0  # the nearest points of the layer that it links, at most so many spacings away
LEVEL, ALIKE = 1.0, 0.5  # differences in height, in spacings, and cosines of the ways to the floor


class Part(NamedTuple):
    """Of which cloud points are a part.

    total : how many positions that has
    numbers : (m,) int64, for each position of the part, in order, its place in the kd order of all
    usual : numbers that hold for all
    blocks : those of its positions that show layers, see `Search`; None: they are searched for
    ignored : the numbers of stations that are not believed; None: the points show it, see `eyes_of`
    """

    total: int
    numbers: Rows
    usual: CloudStatistics
    blocks: Rows | None = None
    ignored: tuple[int, ...] | None = None


def merge_for_model(
    points: Points, progress: Progress | None = None, along: Path | None = None, part: Part | None = None
) -> Points:
    """The points with those of second layers and passes moved onto one surface; `points` itself, where there are none.

    Unlike `merge_layers` it looks closely only where a few stretches of the kd order show layers, and moves only
    groups of `FEWEST` points or more: a surface without layers stays as it is, to the bit. `along`, if it is known, is
    the path through the points; `part` tells of which cloud they are a part, None: they are the whole.
    """
    along = along or along_path(points)
    path, ids, _ = along
    tell(progress, 0.1)
    if len(path) < LEAST:
        return points
    part = part or Part(len(path), np.arange(len(path)), CloudStatistics.of(len(path)))
    if part.blocks is None or len(part.blocks):
        shift = _shifts(points, along, part, part_of(progress, 0.1, SPARSE_MERGED))
        if shift is not None:
            positions = points.positions.copy()
            positions[points.finite] += shift[ids]
            points = points.changed(positions=positions)
            along = along.moved(points)
    tell(progress, SPARSE_MERGED)
    rest = part_of(progress, SPARSE_MERGED, 1.0)
    return merge_passes(points, None, rest, along, part.usual, part.ignored)


def _shifts(points: Points, along: Path, part: Part, progress: Progress | None) -> Floats | None:
    """By how much positions of second layers are moved, (n, 3); None: there are none."""
    ground = Ground(along.positions)
    search = Search(ground, part.total, part.numbers)
    if part.blocks is None:
        search.everywhere(progress)
    else:
        search.open(part.blocks)
    floors = ground.floors()
    off = np.flatnonzero(floors.off)
    off = off[np.linalg.norm(floors.offset[off], axis=1) <= LAYER * floors.spacing[off]]
    off = off[~faces_back(points, along.rows, floors, off)]
    off = off[_in_company(along.positions, floors, off)]
    if not len(off):
        return None
    shift = np.zeros_like(along.positions)
    shift[off] = floors.offset[off]
    return shift


def _in_company(path: Floats, floors: Floors, rows: Rows) -> NDArray[np.bool_]:
    """Which of some rows that are off their floor are in a large group at about the same height."""
    m = len(rows)
    if m < FEWEST:
        return np.zeros(m, np.bool_)
    away, near = neighbors(path[rows], LINKS + 1)
    offset, spacing = floors.offset[rows], floors.spacing[rows]
    height = np.linalg.norm(offset, axis=1)
    ways = offset / np.maximum(height, 1e-30)[:, None]
    is_linked = (away < APART * spacing[:, None]) & (np.abs(height[near] - height[:, None]) < LEVEL * spacing[:, None])
    is_linked &= np.einsum("ij,ikj->ik", ways, ways[near]) > ALIKE
    part = connected_components(near, is_linked)
    return np.asarray(np.bincount(part)[part] >= FEWEST)


def faces_back(points: Points, rows: NDArray[np.integer[Any]], floors: Floors, some: Rows) -> NDArray[np.bool_]:
    """Which of some positions have a given normal against those around: they are the back of a thin body.

    rows : the row of `points` of each position
    """
    if points.normals is None or len(some) == 0:
        return np.zeros(len(some), np.bool_)
    with np.errstate(invalid="ignore", over="ignore"):
        normals = points.normals / np.linalg.norm(points.normals, axis=1, keepdims=True)
        own, around = normals[rows[some]], normals[rows[floors.near[some, 1:]]]
        cosines = np.einsum("ij,ikj->ik", own, around)
        counts = np.isfinite(cosines).sum(axis=1)
        return np.asarray(np.nansum(cosines, axis=1) < OPPOSITE * np.maximum(counts, 1))
