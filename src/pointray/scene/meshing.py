"""Triangle meshes of the surface of a model: marching cubes on a grid, whose vertices lie on the surface.

Rays along the lines of the grid, in all three directions, cross the surface inwards or outwards. The crossings before
and after a node of the grid on its three lines vote whether it is inside: four of six must. This closes small holes,
and no error of a single ray is visible. The mesh of these nodes is closed. Each of its vertices lies on an edge of the
grid, and a ray along this edge moves it exactly onto the surface.
"""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_callback, check_whole
from ..base.arrays import Doubles, Flags, Floats, Rows
from ..base.extras import require
from ..base.progress import Progress, StageProgress, in_stage, part_of, report_progress
from ..image.tone import linear_to_srgb
from ..model.model import Model
from .casting import intersect_snapshot
from .crossings import Crossings, find_crossings
from .rays import check_rays
from .scene import Scene
from .world import Snapshot

MARGIN = 2  # cells between the surface and the faces of the grid
LEAST, GREATEST, DEFAULT = 2, 4096, 400  # cells along the longest side; the last is the most that None chooses
NODE_BYTES, SLAB_BYTES = 48, 1 << 28  # memory of a node of the grid, and of the slab that is processed at a time
SPECK = 3  # cells: smaller pieces are left out, as they have no shape
MAJORITY = 4  # of six votes
NEAREST = 0.01  # cells: least distance of a vertex from the ends of its edge, so that no triangle vanishes
# Shares of the vertices without a surface beyond which a warning says that it has holes, and beyond which it is open.
# For half a sphere with a lid it is a third, for a gentle hill half.
OPEN, TOO_OPEN = 0.02, 0.4
NOT_CLOSED = (
    "the surface encloses no volume, or only parts thinner than a cell: a mesh needs a closed surface, and this one is "
    "open, like that of a terrain"
)
INWARD = (
    "the surface encloses no volume, because its normals point inward: flip them with points.with_normals("
    "-points.normals)"
)


class _Grid(NamedTuple):
    """A grid of nodes. low : (3,) position of the first one; cell : their distance; size : (3,) number of nodes"""

    low: Doubles
    cell: float
    size: tuple[int, int, int]


class _Spans(NamedTuple):
    """Pieces of lines parallel to an axis.

    line : (m, 2) grid coordinates of each line, along the other two axes in ascending order
    begin, end : (m,) where the piece begins and ends, in cells; infinite where no crossing of the surface ends it
    votes : (m,) 1 or 2, how many of its two ends indicate that it is inside
    """

    line: Rows
    begin: Doubles
    end: Doubles
    votes: NDArray[np.int8]


class _Vertices(NamedTuple):
    """Vertices of a mesh: position (v, 3), linear colour (v, 3), and whether a ray has hit the surface there, (v,)."""

    position: Doubles
    color: Floats
    is_hit: Flags


def mesh_model(model: Model, resolution: int | None, progress: StageProgress | None) -> Any:
    """Return the surface of a model as a `trimesh.Trimesh`; see `Model.to_mesh`, which documents the parameters."""
    check_callback(progress)
    cells = None if resolution is None else check_whole(resolution, "resolution", LEAST, GREATEST, or_none=True)
    trimesh = require("trimesh", "mesh", "Model.to_mesh")
    measure = require("skimage.measure", "mesh", "Model.to_mesh")
    model.check_whole()
    if not model.has_surface:
        raise ValueError(NOT_CLOSED)
    scene = Scene()
    scene.add(model)
    grid = _grid_of(model, cells)
    mesher = _Mesher(model, scene.snapshot(), grid, in_stage(progress, "meshing"))
    vertices, faces = mesher.run(measure)
    vertices, faces = _without_specks(vertices, faces, SPECK * grid.cell)
    missed = 1 - float(vertices.is_hit.mean())
    if missed > TOO_OPEN or mesher.is_inward:
        raise ValueError(INWARD if mesher.is_inward else NOT_CLOSED)
    if missed > OPEN:
        warnings.warn(
            f"{missed:.0%} of the mesh's vertices close holes of the surface, where there are no points", stacklevel=3
        )
    colors = None if model.points.colors is None else _srgb_of(vertices)
    return trimesh.Trimesh(vertices.position, faces, vertex_colors=colors, process=False)


def _grid_of(model: Model, cells: int | None) -> _Grid:
    """Return the grid around the surface of a model.

    cells : along the longest side; None: cells as wide as the median radius, but at most `DEFAULT`
    """
    low, high = model.surface_bounds + model.points.origin
    longest = float((high - low).max())
    if cells is None:
        cells = int(np.clip(np.ceil(longest / model.spacing), LEAST, DEFAULT))
    cell = longest / cells
    counts = np.ceil((high - low) / cell).astype(int) + 2 * MARGIN + 1
    low = (low + high) / 2 - (counts - 1) * cell / 2
    return _Grid(low, cell, (int(counts[0]), int(counts[1]), int(counts[2])))


class _Mesher:
    """Mesh of the surface of one model, made slab by slab along z."""

    def __init__(self, model: Model, scene: Snapshot, grid: _Grid, progress: Progress | None) -> None:
        self._model, self._scene, self._grid, self._progress = model, scene, grid, progress
        self._scattered = model.scattered
        self._lines, self._first_entering, self._last_leaving = 0, 0, 0  # lines that cross the surface; of these

    @property
    def is_inward(self) -> bool:
        """Whether most lines of the grid leave the surface at their first crossing, and enter it at their last one."""
        return 2 * max(self._first_entering, self._last_leaving) < self._lines

    def run(self, measure: Any) -> tuple[_Vertices, Rows]:
        """Return vertices and triangles, (m, 3). measure : the module `skimage.measure`"""
        nx, ny, nz = self._grid.size
        layers = int(np.clip(SLAB_BYTES // (NODE_BYTES * nx * ny), 8, nz))
        columns = self._spans(2, (0, nx), (0, ny), part_of(self._progress, 0.0, 0.3))
        found, triangles, count = [], [], 0
        top_keys = top_numbers = np.zeros(0, np.int64)
        for first in range(0, nz - 1, layers):
            last = min(first + layers, nz - 1)
            field = self._field(columns, first, last)
            report_progress(self._progress, 0.3 + 0.7 * last / (nz - 1))
            if not (field < 0).any():
                top_keys = top_numbers = np.zeros(0, np.int64)
                continue
            places, faces, *_ = measure.marching_cubes(field, 0.0, gradient_direction="descent")
            places = places.astype(np.float64)
            keys = self._keys(places, first)
            row = np.searchsorted(top_keys, keys)
            row[row == len(top_keys)] = 0
            known = (top_keys[row] == keys) if len(top_keys) else np.zeros(len(keys), np.bool_)
            numbers = np.empty(len(keys), np.int64)
            numbers[known] = top_numbers[row[known]]
            numbers[~known] = count + np.arange(int((~known).sum()))
            count += int((~known).sum())
            found.append(self._settled(field, places[~known], first))
            triangles.append(numbers[faces])
            upper = np.flatnonzero(places[:, 2] == last - first)
            upper = upper[np.argsort(keys[upper])]
            top_keys, top_numbers = keys[upper], numbers[upper]
        if not found:
            raise ValueError(INWARD if self.is_inward else NOT_CLOSED)
        return _Vertices(*(np.concatenate(column) for column in zip(*found, strict=True))), np.concatenate(triangles)

    def _spans(
        self, axis: int, one: tuple[int, int], other: tuple[int, int], progress: Progress | None = None
    ) -> _Spans:
        """Return the pieces of grid lines that are inside the surface according to at least one of their ends.

        axis : direction of the lines; one, other : ranges of their grid coordinates along the other two axes
        """
        a, b = (k for k in range(3) if k != axis)
        shape = one[1] - one[0], other[1] - other[0]
        origins, direction = np.empty((*shape, 3)), np.zeros(3)
        origins[..., axis] = self._grid.low[axis]
        origins[..., a] = self._grid.low[a] + self._grid.cell * np.arange(*one)[:, None]
        origins[..., b] = self._grid.low[b] + self._grid.cell * np.arange(*other)
        direction[axis] = self._grid.cell
        every = find_crossings(self._scene, *check_rays(origins, direction, 0, self._grid.size[axis] - 1), progress)
        every = self._without_scattered(every)
        # One piece after each crossing, and one before the first crossing of each line.
        first = np.flatnonzero(np.diff(every.ray, prepend=-1))
        follows = np.append(every.ray[1:] == every.ray[:-1], False)
        self._lines += len(first)
        self._first_entering += int(every.entering[first].sum())
        self._last_leaving += int((~every.entering[np.flatnonzero(np.diff(every.ray, append=-1))]).sum())
        after = np.append(every.t[1:], np.inf)
        leaving = np.append(~every.entering[1:], False)
        votes = np.concatenate([every.entering.astype(np.int8) + (leaving & follows), ~every.entering[first]])
        begin = np.concatenate([every.t, np.full(len(first), -np.inf)])
        end = np.concatenate([np.where(follows, after, np.inf), every.t[first]])
        ray = np.concatenate([every.ray, every.ray[first]])
        line = np.stack(np.divmod(ray, shape[1]), axis=1) + [one[0], other[0]]
        some = votes > 0
        return _Spans(line[some], begin[some], end[some], votes[some].astype(np.int8))

    def _without_scattered(self, every: Crossings) -> Crossings:
        return every.select(~self._scattered[every.point]) if self._scattered.any() else every

    def _field(self, columns: _Spans, first: int, last: int) -> Floats:
        """Return values at the nodes of the layers `first` to `last`, whose zero is near the surface.

        They are negative inside, and the distance to the surface along a line of the grid, from NEAREST to 1 cell.
        """
        nx, ny, _ = self._grid.size
        shape = nx, ny, last - first + 1
        layers = first, last + 1
        votes, distance = np.zeros(shape, np.int8), np.ones(shape, np.float32)
        _mark(votes, distance, columns._replace(begin=columns.begin - first, end=columns.end - first))
        for axis, one in ((0, (0, ny)), (1, (0, nx))):
            spans = self._spans(axis, one, layers)
            spans = spans._replace(line=spans.line - np.array([0, first]))
            _mark(np.moveaxis(votes, axis, 2), np.moveaxis(distance, axis, 2), spans)
        return np.asarray(np.where(votes >= MAJORITY, -distance, distance))

    def _keys(self, places: Doubles, first: int) -> Rows:
        """Return a number for each vertex, (v,), which is the same in the slab below and above for a shared vertex."""
        half = np.rint(2 * (np.floor(places) + 0.5 * (np.abs(places - np.rint(places)) > NEAREST / 4)))
        half = np.where(np.abs(places - np.rint(places)) > NEAREST / 4, half, 2 * np.rint(places)).astype(np.int64)
        half[:, 2] += 2 * first
        nx, ny, _ = self._grid.size
        return np.asarray((half[:, 2] * 2 * ny + half[:, 1]) * 2 * nx + half[:, 0])

    def _settled(self, field: Floats, places: Doubles, first: int) -> _Vertices:
        """Move vertices, (v, 3) in nodes of a slab, along their edges of the grid onto the surface."""
        grid = self._grid
        position = grid.low + grid.cell * (places + [0, 0, first])
        color, is_hit = np.ones((len(places), 3), np.float32), np.zeros(len(places), np.bool_)
        off = np.abs(places - np.rint(places)) > NEAREST / 4
        rows = np.flatnonzero(off.sum(axis=1) == 1)  # others lie inside of a cell
        along = off[rows].argmax(axis=1)
        below = np.rint(places[rows]).astype(np.int64)
        below[np.arange(len(rows)), along] = np.floor(places[rows, along])
        above = below.copy()
        above[np.arange(len(rows)), along] += 1
        outside = (field[tuple(below.T)] > 0)[:, None]
        start, end = np.where(outside, below, above), np.where(outside, above, below)
        origins, directions = grid.low + grid.cell * (start + [0, 0, first]), grid.cell * (end - start).astype(float)
        hits = intersect_snapshot(self._scene, *check_rays(origins, directions, 0, 1))
        good = (hits.instance >= 0) & ~self._scattered[hits.point]
        t = np.clip(hits.t[good], NEAREST, 1 - NEAREST).astype(np.float64)
        position[rows[good]] = origins[good] + t[:, None] * directions[good]
        color[rows[good]], is_hit[rows[good]] = hits.color[good], True
        return _Vertices(position, color, is_hit)


def _without_specks(vertices: _Vertices, faces: Rows, least: float) -> tuple[_Vertices, Rows]:
    """Return a mesh without its connected pieces that are smaller than `least` along all axes, except the largest."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n = len(vertices.position)
    links = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = coo_matrix((np.ones(len(links), np.bool_), (links[:, 0], links[:, 1])), shape=(n, n))
    count, piece = connected_components(graph, directed=False)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, piece, vertices.position)
    np.maximum.at(high, piece, vertices.position)
    sizes = (high - low).max(axis=1)
    kept = (sizes >= min(least, float(sizes.max())))[piece]
    number = np.cumsum(kept) - 1
    return _Vertices(*(column[kept] for column in vertices)), number[faces[kept[faces[:, 0]]]]


def _mark(votes: NDArray[np.int8], distance: Floats, spans: _Spans) -> None:
    """Add the votes of the lines of one direction at each node, and reduce the distances next to crossings.

    votes, distance : (a, b, n), changed; the last axis is that of the lines
    """
    n = votes.shape[2]
    low = np.clip(np.ceil(spans.begin), 0, n).astype(np.int64)
    high = np.clip(np.floor(spans.end) + 1, 0, n).astype(np.int64)
    change = np.zeros((*votes.shape[:2], n + 1), np.int8)
    a, b = spans.line.T
    np.add.at(change, (a, b, low), np.where(low < high, spans.votes, 0).astype(np.int8))
    np.add.at(change, (a, b, high), np.where(low < high, -spans.votes, 0).astype(np.int8))
    votes += np.cumsum(change[..., :-1], axis=2, dtype=np.int8)
    for end in (spans.begin, spans.end):
        for node in (np.floor(end), np.floor(end) + 1):
            here = (node >= 0) & (node < n)  # false for infinite ones
            a, b = spans.line[here].T
            away = np.clip(np.abs(end[here] - node[here]), NEAREST, 1).astype(np.float32)
            np.minimum.at(distance, (a, b, node[here].astype(np.int64)), away)


def _srgb_of(vertices: _Vertices) -> NDArray[np.uint8]:
    """Return colours of vertices, (v, 3) uint8; those without a hit have the colour of the nearest vertex with one."""
    from scipy.spatial import cKDTree

    color, known = vertices.color.copy(), vertices.is_hit
    if known.any() and not known.all():
        near = cKDTree(vertices.position[known]).query(vertices.position[~known], workers=-1)[1]
        color[~known] = color[known][near]
    return np.asarray(np.rint(255 * linear_to_srgb(color)), np.uint8)
