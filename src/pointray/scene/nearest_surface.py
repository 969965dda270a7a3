"""Closest points on the surfaces of a scene: on what rays hit, not on the points or splats themselves.

The splats near a position, from a k-d tree, give a first estimate. Rays along the normal project it onto the surface,
and steps tangential to the surface reduce the distance until they vanish.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..base.arrays import Doubles, Flags, Indices, Rows
from ..engine.kernels.records import INSTANCE, KIND, MODEL, SHAPE_ROW, TO_MODEL
from ..engine.kernels.tree import SCATTER, SPHERES
from ..surface.trace.cast import Pace
from .casting import intersect_snapshot
from .crossings import find_crossings, world_scales
from .world import Snapshot

BATCH = 1 << 17  # positions at a time, which limits the memory
CANDIDATES = 8  # splats near a position, from which the first estimate is chosen
DISC = 0.5  # radius of the disc that stands for a splat, in support radii: about half the spacing
FARTHEST = 1e100  # greatest coordinate: squares of distances are finite
STEPS = 24
TOLERANCE = 1e-3  # radii: shorter steps end the search
LEAST_FACTOR, GREATEST_FACTOR = 0.05, 20.0  # of a step to the tangential offset
TURNS = np.radians([0.0, 70.0, -70.0, 0.0, 40.0, -40.0])  # of steps that left the surface, at an open border


class ClosestPoints(NamedTuple):
    """Closest points on the surfaces of a scene, for n positions.

    Attributes
    ----------
    distance : (n,) float64
        Signed distance, positive on the side of the points' normals.
    position : (n, 3) float64
        Closest point.
    normal : (n, 3) float64
        Unit normal there.
    point : (n,) int64
        Row of the splat of greatest weight there.
    instance : (n,) int32
        Number that `Scene.add` returned.
    """

    distance: Doubles
    position: Doubles
    normal: Doubles
    point: Rows
    instance: Indices


class _Splats(NamedTuple):
    """Splats of all instances in world space: position, unit normal, radius, row, instance, whether it is a sphere."""

    positions: Doubles
    normals: Doubles
    radii: Doubles
    points: Rows
    instances: Indices
    is_sphere: Flags


class NearestSurface:
    """Search for the closest points on the models of a scene. Planes and clip planes are ignored.

    Parameters
    ----------
    scene : Snapshot
        At least one model; ValueError for a model in parts.
    """

    def __init__(self, scene: Snapshot) -> None:
        from scipy.spatial import cKDTree  # its import takes 0.1 s

        self._scene = scene
        self._splats = _splats_of(scene)
        self._tree = cKDTree(self._splats.positions, balanced_tree=False, compact_nodes=False)

    def find(self, positions: Doubles, threads: int | None = None) -> ClosestPoints:
        """Return the closest points for positions in world space, (n, 3).

        Positions that are not finite, or beyond 1e100, have NaN and -1.

        threads : number of threads; None for all cores
        """
        out = _empty(len(positions))
        columns: tuple[Any, ...] = out
        known = np.flatnonzero((np.abs(positions) < FARTHEST).all(axis=1))  # false for NaN
        for start in range(0, len(known), BATCH):
            rows = known[start : start + BATCH]
            some: Any = self._find(positions[rows], threads)
            for column, values in zip(columns, some, strict=True):
                column[rows] = values
        return out

    def _find(self, x: Doubles, threads: int | None) -> ClosestPoints:
        splat, foot = self._estimate(x, threads or -1)
        s = self._splats
        found = _empty(len(x))._replace(
            position=foot, normal=s.normals[splat].copy(), point=s.points[splat], instance=s.instances[splat]
        )
        spheres = s.is_sphere[splat]
        found.normal[spheres] = _unit((x - s.positions[splat])[spheres])
        search = _Descent((self._scene, Pace(threads)), x, s.radii[splat], found)
        search.run(np.flatnonzero(~spheres))
        away = x - found.position
        side = np.where(np.einsum("ij,ij->i", away, found.normal) < 0, -1.0, 1.0)
        return found._replace(distance=side * np.linalg.norm(away, axis=1))

    def _estimate(self, x: Doubles, workers: int) -> tuple[Rows, Doubles]:
        """Return the splat whose disc or sphere is nearest to each position, and the closest point on it."""
        s = self._splats
        k = min(CANDIDATES, len(s.radii))
        near = self._tree.query(x, k, workers=workers)[1].reshape(len(x), k)
        offset = x[:, None] - s.positions[near]
        normals, radii = s.normals[near], s.radii[near]
        height = np.einsum("ijk,ijk->ij", offset, normals)
        flat = offset - height[..., None] * normals
        along = np.linalg.norm(flat, axis=2)
        feet = s.positions[near] + flat * np.minimum(DISC * radii / np.maximum(along, 1e-300), 1.0)[..., None]
        spheres = s.is_sphere[near]
        feet[spheres] = (s.positions[near] + _unit(offset) * radii[..., None])[spheres]
        best = np.linalg.norm(x[:, None] - feet, axis=2).argmin(axis=1)
        rows = np.arange(len(x))
        return near[rows, best], feet[rows, best]


class _Descent:
    """Points that move over the surface towards the closest ones, all at once.

    traced : the scene whose surface it is, and the number of threads
    x : (n, 3), the positions; radii : (n,), of the splats near the first estimate
    found : the first estimates, changed in place
    """

    def __init__(self, traced: tuple[Snapshot, Pace], x: Doubles, radii: Doubles, found: ClosestPoints) -> None:
        (self._scene, self._pace), self._x, self._radii, self._found = traced, x, radii, found
        self._factors, self._lost = np.ones(len(x)), np.zeros(len(x), np.int64)

    def run(self, rows: Rows) -> None:
        """Improve the estimates in some rows; those that no ray along the normal hits stay on their splat's disc."""
        x, found = self._x, self._found
        rows = rows[self._project(rows, found.position[rows], found.normal[rows], np.full(len(rows), np.inf))[0]]
        for _ in range(STEPS):
            offset = self._tangential(rows)
            step = offset * self._factors[rows, None]
            length = np.linalg.norm(step, axis=1)
            moving = length > TOLERANCE * self._radii[rows]
            rows, offset, step, length = rows[moving], offset[moving], step[moving], length[moving]
            if not len(rows):
                return
            step *= np.minimum(1.0, self._radii[rows] / length)[:, None]
            normal, before = found.normal[rows].copy(), found.position[rows].copy()
            step = _turned(step, normal, TURNS[self._lost[rows] % len(TURNS)])
            square = ((x[rows] - before) ** 2).sum(axis=1)
            better, hit = self._project(rows, before + step, normal, square)
            self._lost[rows[~hit]] += 1
            self._factors[rows[~better]] *= 0.5
            moved = rows[better]
            self._lost[moved] = 0
            self._learn(moved, found.position[moved] - before[better], offset[better])

    def _tangential(self, rows: Rows) -> Doubles:
        """Return the offsets of the positions from the estimates, without their part along the normals."""
        away, normal = self._x[rows] - self._found.position[rows], self._found.normal[rows]
        return np.asarray(away - np.einsum("ij,ij->i", away, normal)[:, None] * normal)

    def _learn(self, rows: Rows, step: Doubles, offset: Doubles) -> None:
        """Choose the factor of the next steps from the change of the tangential offset (Barzilai and Borwein).

        On a sphere the next step leads to the closest point, however far away the position is.

        step, offset : (m, 3), the steps made, and the offsets before them
        """
        change = np.einsum("ij,ij->i", step, offset - self._tangential(rows))
        square = (step**2).sum(axis=1)
        factor = np.where(change > 0, square / np.maximum(change, 1e-300), 2 * self._factors[rows])
        self._factors[rows] = np.clip(factor, LEAST_FACTOR * self._factors[rows], GREATEST_FACTOR)

    def _project(self, rows: Rows, base: Doubles, axis: Doubles, square: Doubles) -> tuple[Flags, Flags]:
        """Move the estimates in some rows to the surface at a line, where that reduces the distance.

        base, axis : (m, 3), a point of each line, near the surface, and its unit direction, that of the normal
        square : (m,), squared distances that must be reduced

        Returns which estimates have moved, and which lines cross a surface that faces the same way.
        """
        reach = self._radii[rows]
        origins, directions = base + reach[:, None] * axis, -reach[:, None] * axis
        rays = origins, directions, np.tile([0.0, 2.0], (len(rows), 1))
        hits = intersect_snapshot(self._scene, (len(rows),), rays, pace=self._pace)
        position, normal = hits.position, hits.normal.astype(np.float64)
        point, instance = hits.point, hits.instance
        good = (instance >= 0) & (point >= 0) & (np.einsum("ij,ij->i", normal, axis) > 0)
        behind = np.flatnonzero((instance >= 0) & ~good)
        if len(behind):  # another sheet is in front
            some = origins[behind], directions[behind], rays[2][behind]
            every = find_crossings(self._scene, (len(behind),), some, threads=self._pace.threads)
            every = every.select(every.entering & (every.point >= 0))
            every = every.select(np.lexsort((np.abs(every.t - 1), every.ray)))
            ray, first = np.unique(every.ray, return_index=True)
            here = behind[ray]
            position[here], normal[here] = every.position[first], every.normal[first]
            point[here], instance[here], good[here] = every.point[first], every.instance[first], True
        better = good & (((self._x[rows] - position) ** 2).sum(axis=1) < square)
        moved = rows[better]
        self._found.position[moved], self._found.normal[moved] = position[better], normal[better]
        self._found.point[moved], self._found.instance[moved] = point[better], instance[better]
        return better, good


def _splats_of(scene: Snapshot) -> _Splats:
    """Return the splats of all instances of models, in world space."""
    records, scales = scene.world.instances.reshape(-1, INSTANCE), world_scales(scene)
    columns = []
    for row in np.flatnonzero(records[:, KIND] == MODEL):
        model = scene.models[int(records[row, SHAPE_ROW])]
        points, rows = model.splats
        to_model = records[row, TO_MODEL : TO_MODEL + 12].reshape(3, 4)
        linear = np.linalg.inv(to_model[:, :3])
        assert points.normals is not None
        columns.append(
            _Splats(
                (points.positions - to_model[:, 3]) @ linear.T,
                _unit(np.asarray(points.normals @ to_model[:, :3], np.float64)),
                model.radii[rows] * scales[row],
                rows,
                np.full(len(rows), scene.numbers[row], np.int32),
                model.scattered[rows] & (model.tree.head[SCATTER] == SPHERES),
            )
        )
    if not columns:
        raise ValueError("the scene has no models: closest points need at least one")
    return _Splats(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _empty(n: int) -> ClosestPoints:
    missing = np.full(n, -1, np.int64)
    return ClosestPoints(
        np.full(n, np.nan), np.full((n, 3), np.nan), np.full((n, 3), np.nan), missing, missing.astype(np.int32)
    )


def _unit(vectors: Doubles) -> Doubles:
    """Return vectors (..., 3) at unit length; +z for those of length zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.where(lengths > 0, vectors / np.maximum(lengths, 1e-300), [0.0, 0.0, 1.0]))


def _turned(vectors: Doubles, axes: Doubles, angles: Doubles) -> Doubles:
    """Return vectors rotated about unit axes perpendicular to them, (m, 3). angles : (m,), radians"""
    return np.asarray(vectors * np.cos(angles)[:, None] + np.cross(axes, vectors) * np.sin(angles)[:, None])
