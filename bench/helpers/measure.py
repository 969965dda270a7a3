"""Measure one row of the accuracy table: the distance of hits from the known surface of a cloud."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import pointray as pr
from bench.helpers.truth import DEEP, Floats, Truth
from pointray.cloud.neighbors import distinct, neighbors
from pointray.engine.jit import thread_count

BATCH = 250_000  # rays at a time
PLACES = 20_000  # points of the surface at which splats are counted
FRAMES, PIXELS = 5, 400
AUTO, WIDE = "auto", "1.25 d8"  # rules for radii: the model's own, or 1.25 times the distance to the 8th neighbour


@dataclass(frozen=True)
class Cloud:
    """Points of a known surface. noise : standard deviation along the normal, in h (normals stay exact)"""

    truth: Truth
    sampling: str
    points: pr.Points
    noise: float

    @property
    def h(self) -> float:
        """The spacing, sqrt(area / n)."""
        return float(np.sqrt(self.truth.area / len(self.points)))


@dataclass(frozen=True)
class Setting:
    """Settings for building a model from a cloud."""

    surface: str
    samples: int = 4
    refine: int = 1
    radii: str = AUTO


@dataclass
class Row:
    """What was measured. Depths (in h) and normals (in degrees) are errors over all hits; the rest are counts.

    holes : rays that were more than 0.5 h inside the exact solid before they hit anything
    missed : holes that hit nothing at all; the others hit the far wall from inside
    phantoms : hits more than 0.5 h from the surface
    overlap : mean number of splats whose support holds a point of the surface
    references : splats that all leaves list together, per point: 4 for each block of each leaf
    ms : processor time of a frame, divided by the threads; cost : the same, as a multiple of the flat discs' time
    """

    shape: str
    sampling: str
    n: int
    noise: float
    surface: str
    samples: int
    refine: int
    radii: str
    rays: int = 0
    hits: int = 0
    holes: int = 0
    missed: int = 0
    phantoms: int = 0
    depth_rms: float = np.nan
    depth_p99: float = np.nan
    normal_mean: float = np.nan
    normal_p99: float = np.nan
    overlap: float = np.nan
    references: float = np.nan
    ms: float = np.nan
    cost: float = np.nan


@dataclass
class Errors:
    """Errors that rays found, batch after batch."""

    rays: int = 0
    holes: int = 0
    missed: int = 0
    depths: list[NDArray[np.float32]] = field(default_factory=list)
    degrees: list[NDArray[np.float32]] = field(default_factory=list)


def cloud_of(truth: Truth, sampling: str, n: int, noise: float = 0.0, seed: int = 1) -> Cloud:
    """Points of a surface, moved along their exact normals by a Gaussian of standard deviation noise * h."""
    positions, normals = truth.points(n, sampling, seed)
    sigma = noise * np.sqrt(truth.area / len(positions))
    away = np.random.default_rng(seed).normal(scale=sigma, size=(len(positions), 1)) if noise else 0.0
    return Cloud(truth, sampling, pr.Points(positions + away * normals, normals=normals), noise)


def model_of(cloud: Cloud, setting: Setting) -> pr.Model:
    """The model that a setting describes."""
    radii = None if setting.radii == AUTO else _wide(cloud.points.positions)
    options = {"surface": setting.surface, "samples": setting.samples, "refine": setting.refine}
    return pr.Model(cloud.points, radii, **options, scatter="surface")


def _wide(positions: NDArray[np.float32]) -> NDArray[np.float32]:
    """1.25 times the distance to the 8th neighbour, where points of equal position count once."""
    rows, groups = distinct(positions)
    return 1.25 * neighbors(positions[rows], 9)[0][groups, -1]


def scene_of(model: pr.Model) -> pr.Scene:
    """A scene of the model alone."""
    scene = pr.Scene()
    scene.add(model)
    return scene


def unit(v: Floats) -> Floats:
    """Rows of length 1."""
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def lines(bounds: Floats, count: int, seed: int) -> Iterator[tuple[Floats, Floats]]:
    """Lines through the ball around a box, uniform in position and direction: batches of origins and directions."""
    rng = np.random.default_rng(seed)
    center, radius = bounds.mean(axis=0), 0.505 * float(np.linalg.norm(bounds[1] - bounds[0]))
    for start in range(0, count, BATCH):
        some = min(BATCH, count - start)
        d = unit(rng.normal(size=(some, 3)))
        across = unit(np.cross(d, rng.normal(size=(some, 3))))
        yield center + radius * (np.sqrt(rng.random((some, 1))) * across - d), d


def trace(
    scene: pr.Scene, cloud: Cloud, rays: Iterator[tuple[Floats, Floats]], report: Callable[[int], None]
) -> Errors:
    """Trace rays; compare each hit with the exact surface, and each suspicious ray with the exact solid.

    A ray is suspicious if it hits nothing, or hits a side that faces away: it must have come through the surface.
    """
    errors = Errors()
    for origins, directions in rays:
        hits = scene.intersect(origins, directions)
        hit = np.flatnonzero(np.isfinite(hits.t))
        distance, normals = cloud.truth.compare(hits.position[hit])
        cosines = np.clip((normals * hits.normal[hit]).sum(axis=1), -1, 1)
        errors.depths.append((distance / cloud.h).astype(np.float32))
        errors.degrees.append(np.degrees(np.arccos(cosines)).astype(np.float32))
        suspect = ~np.isfinite(hits.t)
        missed = suspect.copy()
        suspect[hit[(normals * directions[hit]).sum(axis=1) > 0]] = True
        asked = np.flatnonzero(suspect)
        ends = np.where(missed, np.inf, hits.t).astype(np.float64)[asked]
        deep = asked[cloud.truth.depth(origins[asked], directions[asked], ends, cloud.h) > DEEP * cloud.h]
        errors.rays += len(origins)
        errors.holes += len(deep)
        errors.missed += int(missed[deep].sum())
        report(len(origins))
    return errors


def overlap(samples: Floats, model: pr.Model) -> float:
    """Mean number of splats whose support holds a sample of the exact surface."""
    held = cKDTree(samples).query_ball_point(model.points.positions, model.radii, return_length=True)
    return float(held.sum() / len(samples))


def references(model: pr.Model) -> float:
    """Splats that all leaves list together, per point: 4 for each block of each leaf, empty slots included."""
    filled = model.tree.spheres.reshape(-1, 4, 16)[:, 3] >= 0
    return float(4 * filled.sum() / len(model.points))


def frame_times(scenes: list[pr.Scene], bounds: Floats, frames: int = FRAMES) -> list[float]:
    """Milliseconds of a frame of each scene, in turn: median processor time, which other programs hardly affect."""
    camera = pr.Camera.frame(bounds, size=(PIXELS, PIXELS))
    settings = pr.Settings("normal")
    times: list[list[float]] = [[] for _ in scenes]
    for scene in scenes:
        pr.render(scene, camera, settings)
    for _ in range(frames):
        for scene, found in zip(scenes, times, strict=True):
            start = time.process_time()
            pr.render(scene, camera, settings)
            found.append(1e3 * (time.process_time() - start) / thread_count())
    return [statistics.median(found) for found in times]


def measure(
    cloud: Cloud, settings: list[Setting], rays: int, report: Callable[[int], None] = lambda done: None, seed: int = 7
) -> list[Row]:
    """A row for each setting, all with the same points and rays. `report` is called with the numbers of rays done.

    Costs are known if flat discs with the model's own radii are among the settings.
    """
    models = [model_of(cloud, setting) for setting in settings]
    scenes = [scene_of(model) for model in models]
    surface_samples = cloud.truth.surface_samples(PLACES, seed=99)
    ms = frame_times(scenes, cloud.points.bounds)
    flat = [t for t, setting in zip(ms, settings, strict=True) if setting.surface == "disc" and setting.radii == AUTO]
    rows = []
    for setting, model, scene, time_of in zip(settings, models, scenes, ms, strict=True):
        found = trace(scene, cloud, lines(cloud.points.bounds, rays, seed), report)
        row = Row(cloud.truth.name, cloud.sampling, len(cloud.points), cloud.noise, model.surface, *_choices(setting))
        _fill(row, found)
        row.overlap, row.references = overlap(surface_samples, model), references(model)
        row.ms, row.cost = time_of, time_of / flat[0] if flat else np.nan
        rows.append(row)
    return rows


def _choices(setting: Setting) -> tuple[int, int, str]:
    return setting.samples, setting.refine, setting.radii


def _fill(row: Row, errors: Errors) -> None:
    depths, degrees = np.concatenate(errors.depths), np.concatenate(errors.degrees)
    row.rays, row.hits, row.holes, row.missed = errors.rays, len(depths), errors.holes, errors.missed
    row.phantoms = int((depths > DEEP).sum())
    if len(depths):
        row.depth_rms = float(np.sqrt(np.square(depths, dtype=np.float64).mean()))
        row.normal_mean = float(degrees.mean(dtype=np.float64))
        row.depth_p99, row.normal_p99 = float(np.quantile(depths, 0.99)), float(np.quantile(degrees, 0.99))
