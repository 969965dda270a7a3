"""Sample of a scene's points in world coordinates, from which the automatic view is chosen."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from ..base.arrays import Doubles
from ..cloud.points import RANGES, Points, spread_rows
from ..engine.kernels.records import TO_MODEL
from ..engine.kernels.tree import Tree
from ..model.model import Model
from ..scene.scene import Scene
from .clusters import find_main, places
from .fitted import fitted_normals

MOST = 200_000  # points; 0.05% of them are still 100
COARSE = 20_000  # smallest number of points in a level of detail that represents a model in parts


class Ignored(NamedTuple):
    """Counts of points that the camera does not frame.

    Attributes
    ----------
    distant : int
        Points far from all others.
    zeros : int
        Points at (0, 0, 0), far from all others: rows of the file without a return (no echo of the laser).
    total : int
        All points of the sample.
    """

    distant: int = 0
    zeros: int = 0
    total: int = 0

    def __add__(self, other: object) -> Ignored:
        assert isinstance(other, Ignored)
        return Ignored(*(one + another for one, another in zip(self, other, strict=True)))

    def __str__(self) -> str:
        kinds = ((self.distant, "far from all others"), (self.zeros, "at 0, 0, 0 far from all others"))
        found = [f"{_percent(count / self.total)} of the points lie {where}" for count, where in kinds if count]
        return f"Not framed: {', '.join(found)}." if found else ""


class Sample(NamedTuple):
    """Points drawn evenly from a scene, from which its view is chosen.

    Attributes
    ----------
    positions : (n, 3) float64
        World, relative to the origin.
    normals : (n, 3) float64
        World, unit; zero where unknown.
    origin : (3,) float64
        World position.
    far : bool
        Whether some coordinates are as large as map coordinates, so that the points have an origin.
    splats : bool
        Whether all points were Gaussian splats.
    format : str or None
        File format, see `Georeference.format`; None if the scene rotates the points.
    stations : (k, 3) float64
        Scanner positions relative to the origin.
    ignored : Ignored
        Counts of the points that were left out because they are far away.
    """

    positions: Doubles
    normals: Doubles
    origin: Doubles
    far: bool
    splats: bool = False
    format: str | None = None
    stations: Doubles = np.zeros((0, 3))
    ignored: Ignored = Ignored()

    def relative_to(self, point: Doubles) -> Sample:
        """Return the sample with another origin. point : (3,), the new origin relative to the old one"""
        stations = self.stations - point
        return self._replace(positions=self.positions - point, origin=self.origin + point, stations=stations)

    def without_islands(self) -> Sample:
        """Return the points to frame: distinct positions without small groups of points, near or far from the rest."""
        rows = places(self.positions)
        framed, distant = find_main(self.positions[rows])
        if len(rows) == len(self.positions) and framed.all():
            return self
        zeros = np.count_nonzero((self.positions[rows[distant]] + self.origin == 0).all(axis=1))
        ignored = Ignored(
            int(np.count_nonzero(distant)) - int(zeros), int(zeros) and _count_zeros(self), len(self.positions)
        )
        rows = rows[framed]
        return self._replace(positions=self.positions[rows], normals=self.normals[rows], ignored=ignored)


def _count_zeros(sample: Sample) -> int:
    return int(np.count_nonzero((sample.positions + sample.origin == 0).all(axis=1)))


def _percent(share: float) -> str:
    return f"{100 * share:.2g}%" if share >= 1e-4 else "less than 0.01%"


def sample_of(subject: Scene | Model | Points, most: int = MOST, islands: bool = True) -> Sample:
    """Draw at most `most` points evenly from a subject's rows; raise ValueError if it has none.

    Planes are ignored. Each instance of a model contributes its points.

    islands : whether to keep duplicates and small groups of a model's points, see `Sample.without_islands`
    """
    placed = _placed(subject)
    total = sum(len(one.points) for one in placed)
    if total == 0:
        raise ValueError("no points to view")
    origin = placed[0].world_origin
    far = any(one.points.origin.any() or one.points.georeference.projection for one in placed)
    splats = all(_were_splats(one.points) for one in placed)
    drawn = (_part(one, min(most / total, 1.0), origin) for one in placed)
    stations = np.concatenate([one.stations for one in placed]) - origin
    about = origin, far, splats, _format(placed), stations
    parts = [Sample(positions, normals, *about) for positions, normals in drawn if len(positions) > 0]
    if not parts:
        raise ValueError("no point has finite coordinates")
    if not islands:
        parts = [part.without_islands() for part in parts]
    positions, normals = (np.concatenate(arrays) for arrays in zip(*(part[:2] for part in parts), strict=True))
    return Sample(positions, normals, *about, sum((part.ignored for part in parts), Ignored()))


class _PlacedPoints(NamedTuple):
    """Points with the transform of their instance, and the tree of its model, from which missing normals are read.

    matrix : (4, 4), from the coordinates of the points' file (origin + positions) to the world
    """

    points: Points
    matrix: Doubles
    tree: Tree | None = None

    @property
    def world_origin(self) -> Doubles:
        """World position of the points' origin, (3,)."""
        return np.asarray((self.matrix @ [*self.points.origin, 1.0])[:3])

    @property
    def stations(self) -> Doubles:
        """World positions of the scanners that the points' file names, (k, 3)."""
        local = np.reshape(self.points.georeference.stations, (-1, 3))
        return np.asarray(local @ self.matrix[:3, :3].T + self.matrix[:3, 3])

    @property
    def format(self) -> str | None:
        """File format of the points, evidence for the up axis; None if the transform rotates them."""
        linear = self.matrix[:3, :3]
        is_turned = not np.allclose(linear, abs(linear[0, 0]) * np.eye(3))
        return None if is_turned else self.points.georeference.format


def _format(placed: list[_PlacedPoints]) -> str | None:
    """Return the file format that all points share, or None if they differ."""
    formats = {one.format for one in placed}
    return formats.pop() if len(formats) == 1 else None


def _were_splats(points: Points) -> bool:
    """Return whether points come from a file of Gaussian splats, by their attributes.

    These have an "opacity" and a "scale" or, in PLY files, a "scale_0".
    """
    return "opacity" in points.attributes and not points.attributes.keys().isdisjoint(("scale", "scale_0"))


def _placed(subject: Scene | Model | Points) -> list[_PlacedPoints]:
    """Return the points of each instance of a model in a subject, with their transforms to the world."""
    if isinstance(subject, Points):
        return [_PlacedPoints(subject, np.eye(4))]
    if isinstance(subject, Model):
        return [_PlacedPoints(points, np.eye(4), _tree_of(subject)) for points in _representative_points(subject)]
    with subject._lock:
        shapes, records = list(subject._instances.shapes), subject._instances.records.copy()
    placed = [(shape, row) for shape, row in zip(shapes, records, strict=True) if isinstance(shape, Model)]
    return [
        _PlacedPoints(points, _matrix(row[TO_MODEL:], points), _tree_of(shape))
        for shape, row in placed
        for points in _representative_points(shape)
    ]


def _tree_of(model: Model) -> Tree | None:
    """Return the tree of a model, from whose splats normals are read; None if the points have normals.

    None also for models in parts.
    """
    return None if model.parts or model.points.normals is not None else model.tree


def _representative_points(model: Model) -> list[Points]:
    """Return the points of a model; for a model in parts on disk, points that represent it in all parts.

    The parts are represented by one level of detail with the same density everywhere: the coarsest with at least
    COARSE (20,000) points. Parts without this level contribute the same share of their points.
    """
    counts = [part.source.file.points for part in model.parts if part.source is not None]
    if not counts:
        return [model.points]
    level = _coarsest(model)
    has_level = [part.has_surface and len(part.levels) >= level > 0 for part in model.parts]
    coarse = [
        part.levels[level - 1].points for part, is_leveled in zip(model.parts, has_level, strict=True) if is_leveled
    ]
    share = sum(map(len, coarse)) / max(sum(itertools.compress(counts, has_level)), 1) or MOST / len(model.points)
    rest = [
        start + spread_rows(count, max(int(share * count), RANGES))
        for start, count, is_leveled in zip(np.cumsum([0, *counts]), counts, has_level, strict=False)
        if not is_leveled
    ]
    return [*coarse, *([model.points.select(np.concatenate(rest))] if rest else [])]


def _coarsest(model: Model) -> int:
    """Return the number of the coarsest level of detail with at least COARSE (20,000) points in all parts together.

    Levels are numbered from 1, the finest. 1 if no level has as many; 0 if there are no levels.
    """
    sizes: dict[int, int] = {}
    for level in itertools.chain.from_iterable(part.levels for part in model.parts):
        if level.source is not None:
            number = level.source.key.level
            sizes[number] = sizes.get(number, 0) + level.source.file.points
    return max((number for number, size in sizes.items() if size >= COARSE), default=min(len(sizes), 1))


def _matrix(to_model: Doubles, points: Points) -> Doubles:
    """Return an instance's transform from the coordinates of its points' file to the world, (4, 4).

    to_model : (12,), rows of (3, 4), from the world to positions relative to the points' origin
    """
    out = np.eye(4)
    out[:3] = to_model.reshape(3, 4)
    out[:3, 3] += points.origin
    return np.asarray(np.linalg.inv(out))


def _part(placed: _PlacedPoints, share: float, origin: Doubles) -> tuple[Doubles, Doubles]:
    """Draw a random share of placed points; return their positions relative to an origin, and their normals, (n, 3).

    share : 0 to 1; origin : (3,), world. Normals are unit, in world axes; zero if unknown.
    """
    points, matrix, tree = placed
    rows = np.flatnonzero(points.finite)
    if share < 1.0:
        rows = rows[np.random.default_rng(0).random(len(rows)) < share]
    linear = matrix[:3, :3]
    positions = points.positions[rows].astype(np.float64) @ linear.T
    positions += linear @ points.origin + matrix[:3, 3] - origin
    if points.normals is not None:
        local = points.normals[rows]
    elif tree is not None:
        local = fitted_normals(tree, rows, len(points))
    else:
        return positions, np.zeros_like(positions)
    normals = np.nan_to_num(local.astype(np.float64)) @ np.linalg.inv(linear)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return positions, np.asarray(normals / np.where(lengths > 0, lengths, 1.0))
