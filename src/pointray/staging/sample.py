"""Some of a scene's points in world coordinates, from which its first view is chosen."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..data import STRETCHES, Points, spread_rows
from ..kernels.records import TO_MODEL
from ..model import Model
from ..scene.scene import Scene

Floats = NDArray[np.float64]

MOST = 200_000  # points; 0.05% of them are still a hundred
COARSE = 20_000  # points of a level of detail that stands for a model in parts
STRAY = 0.0005  # share of the points at either end of an axis that counts as strays
CELLS = 32  # along the longest side of the others: points in neighbouring cells are connected
ISLAND = 0.0025  # share of the points: a smaller connected group is apart from the scan
APART = 0.02  # share of the points: where more lie in such islands the scan consists of islands


class Sample(NamedTuple):
    """Points of a scene.

    Attributes
    ----------
    positions : (n, 3) float64
        World, about the origin.
    normals : (n, 3) float64
        World, unit; zero where there are none.
    origin : (3,) float64
    far : bool
        Whether some coordinates are as large as those of maps, so that the points have an origin of their own.
    splats : bool
        Whether all of them were Gaussian splats.
    """

    positions: Floats
    normals: Floats
    origin: Floats
    far: bool
    splats: bool = False

    def seen_from(self, point: Floats) -> Sample:
        """The same points relative to another point: (3,), relative to the origin of this sample."""
        return self._replace(positions=self.positions - point, origin=self.origin + point)

    def without_islands(self) -> Sample:
        """The connected points: without small groups far from all others, as wrongly matched cameras produce them."""
        low, high = np.quantile(self.positions, [STRAY, 1.0 - STRAY], axis=0)
        size = float((high - low).max()) / CELLS
        if not size > 0:
            return self
        cell = np.floor((self.positions - low) / size) + 1.0  # one more cell on either side: the scan's own ends
        within = np.flatnonzero(((cell >= 0) & (cell < CELLS + 3)).all(axis=1))
        cells = tuple(cell[within].astype(int).T)
        taken = np.zeros((CELLS + 3,) * 3, bool)
        taken[cells] = True
        island = ndimage.label(taken, np.ones((3, 3, 3)))[0][cells]
        large = np.bincount(island)[island] >= ISLAND * len(self.positions)
        if large.all() or large.mean() < 1.0 - APART:
            return self
        return self._replace(positions=self.positions[within[large]], normals=self.normals[within[large]])


def sample_of(subject: Scene | Model | Points, most: int = MOST, islands: bool = True) -> Sample:
    """At most the given number of a subject's points, spread evenly over its rows; ValueError if it has none.

    Planes do not count. A model that a scene contains several times counts as often.
    islands : whether small groups of a model's points that are far from its others count, see `without_islands`
    """
    placed = _placed(subject)
    total = sum(len(points) for points, _ in placed)
    if total == 0:
        raise ValueError("there are no points to look at")
    origin = (placed[0][1] @ [*placed[0][0].origin, 1.0])[:3]
    far = any(points.origin.any() for points, _ in placed)
    splats = all(_were_splats(points) for points, _ in placed)
    drawn = (_part(points, matrix, min(most / total, 1.0), origin) for points, matrix in placed)
    parts = [Sample(positions, normals, origin, far) for positions, normals in drawn if len(positions) > 0]
    if not parts:
        raise ValueError("no point has finite coordinates")
    if not islands:
        parts = [part.without_islands() for part in parts]
    positions, normals = (np.concatenate(arrays) for arrays in zip(*(part[:2] for part in parts), strict=True))
    return Sample(positions, normals, origin, far, splats)


def _were_splats(points: Points) -> bool:
    """Whether points were Gaussian splats, by the attributes that readers give them; PLY files number the scales."""
    return "opacity" in points.attributes and not points.attributes.keys().isdisjoint(("scale", "scale_0"))


def _placed(subject: Scene | Model | Points) -> list[tuple[Points, Floats]]:
    """Points, and the transform (4, 4) of each to the world."""
    if isinstance(subject, Points):
        return [(subject, np.eye(4))]
    if isinstance(subject, Model):
        return [(points, np.eye(4)) for points in _standing_for(subject)]
    with subject._lock:
        shapes, records = list(subject._instances.shapes), subject._instances.records.copy()
    placed = [(shape, row) for shape, row in zip(shapes, records, strict=True) if isinstance(shape, Model)]
    return [(points, _matrix(row[TO_MODEL:], points)) for shape, row in placed for points in _standing_for(shape)]


def _standing_for(model: Model) -> list[Points]:
    """The points of a model; of one whose parts lie on disk, and need not fit into memory, some of them.

    One level of detail of all parts stands for them, which is as dense everywhere: the coarsest that has COARSE points.
    Parts that have no such level give a share of the points that they have.
    """
    counts = [part.source.file.points for part in model.parts if part.source is not None]
    if not counts:
        return [model.points]
    level = _coarsest(model)
    stood = [part.has_surface and len(part.levels) >= level > 0 for part in model.parts]
    coarse = [part.levels[level - 1].points for part, is_leveled in zip(model.parts, stood, strict=True) if is_leveled]
    share = sum(map(len, coarse)) / max(sum(itertools.compress(counts, stood)), 1) or MOST / len(model.points)
    rest = [
        start + spread_rows(count, max(int(share * count), STRETCHES))
        for start, count, is_leveled in zip(np.cumsum([0, *counts]), counts, stood, strict=False)
        if not is_leveled
    ]
    return [*coarse, *([model.points.select(np.concatenate(rest))] if rest else [])]


def _coarsest(model: Model) -> int:
    """The number of the coarsest level of detail with COARSE points in all parts together.

    1, if none has as many; 0, if there is none.
    """
    sizes: dict[int, int] = {}
    for level in itertools.chain.from_iterable(part.levels for part in model.parts):
        if level.source is not None:
            number = level.source.key.level
            sizes[number] = sizes.get(number, 0) + level.source.file.points
    return max((number for number, size in sizes.items() if size >= COARSE), default=min(len(sizes), 1))


def _matrix(to_model: Floats, points: Points) -> Floats:
    """The transform of an instance from its record, to positions about the points' origin."""
    out = np.eye(4)
    out[:3] = to_model.reshape(3, 4)
    out[:3, 3] += points.origin
    return np.asarray(np.linalg.inv(out))


def _part(points: Points, matrix: Floats, share: float, origin: Floats) -> tuple[Floats, Floats]:
    """A random share of a model's points: positions about an origin, and normals."""
    rows = np.flatnonzero(points.finite)
    if share < 1.0:
        rows = rows[np.random.default_rng(0).random(len(rows)) < share]
    linear = matrix[:3, :3]
    positions = points.positions[rows].astype(np.float64) @ linear.T
    positions += linear @ points.origin + matrix[:3, 3] - origin
    if points.normals is None:
        return positions, np.zeros_like(positions)
    normals = np.nan_to_num(points.normals[rows].astype(np.float64)) @ np.linalg.inv(linear)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return positions, np.asarray(normals / np.where(lengths > 0, lengths, 1.0))
