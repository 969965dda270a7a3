"""The cases of `compare.py` about scans: layers and strays, the tower's wall, and time."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pointray as pr
from bench.helpers.measure import frame_times, scene_of, unit
from bench.helpers.truth import FOLDER, Floats
from bench.noise.clouds import STATUE_POINTS, Cloud, Procedural, noisy
from bench.noise.measure import RAYS, Found, Row, aimed, around, found_by, rms, row_of
from bench.noise.scenes import Room, Scene, drift, layers, plate, strays, veil
from bench.noise.surfaces import (
    CLEARED,
    OURS,
    PLAIN,
    POISSON,
    RIMLS,
    Surface,
    cleared,
    finds_strays,
    model_of,
    smooths,
    strays_of,
    surfaces,
)
from bench.noise.tables import Figure, Limit, figures
from pointray.cloud.neighbors import neighbors
from pointray.engine.jit import thread_count

EYE = np.array([-3.0, -30.0, 0.0])  # of the tower's wall
ASIDE = np.array([2.0, 0.0, 1.0])  # from where the room is looked at: veils are thin to the scanner itself
TOWER, OPEN3D = "tls_tower_wall_ghost_nonormals.ply", "Open3D"
TANGENT = 16  # neighbours of Open3D's normals and of its spanning tree
RUNS = 3

Rays = list[tuple[Floats, Floats]]


def rays_of(scene: Scene, count: int) -> Rays:
    """Rays to the targets, or lines around a torus with strays."""
    targets, normals = scene.targets
    if scene.cloud.exact.name == "torus":
        return list(around(scene.cloud, count))
    rows = np.random.default_rng(5).integers(0, len(targets), count)
    if isinstance(scene.cloud.exact, Room):
        return [(np.broadcast_to(ASIDE, (count, 3)).copy(), unit(targets[rows] - ASIDE))]
    return [aimed(targets[rows], normals[rows], 1.0)]


def scenes() -> Iterator[Scene]:
    """All generated scans with defects."""
    for gap in (0.5, 1, 2, 3, 4):
        yield layers(gap)
    yield layers(2, seen=True)
    for thickness in (2, 4):
        yield plate(thickness)
    yield drift()
    yield veil()
    for kind in ("anywhere", "close"):
        yield strays(kind)


def layered(others: list[str], rays: int = RAYS // 2) -> Iterator[Figure]:
    """Layers, plates, drift, veil, strays: the depth of what rays see, and which strays are found."""
    some = [name for name in others if name != RIMLS]
    for scene in scenes():
        makers: list[Callable[[], Surface]] = surfaces(scene.cloud, some)
        if finds_strays():
            found = strays_of(scene.cloud)
            yield from found_strays(scene, found)
            makers.append(lambda s=scene, f=found: cleared(s.cloud, f))
        for make in makers:
            surface = make()
            hits = found_by(surface, scene.cloud, rays_of(scene, rays))
            row = _nearest(scene, row_of(surface, scene.cloud, hits), hits)
            yield from figures("layers", row, {"depth": Limit(0.3, 0.1), "far": Limit(0.05, 0.0)})


def _nearest(scene: Scene, row: Row, found: Found) -> Row:
    """The row, with the depth relative to that of the scans (or their mean) to which it is nearest."""
    for other in scene.others:
        depth = other.compare(found.x)[0] / scene.cloud.h
        if rms(depth) < row.depth:
            row.depth, row.bias = rms(depth), float(depth.mean())
    return row


def found_strays(scene: Scene, found: NDArray[np.bool_]) -> Iterator[Figure]:
    """Strays found and good points lost. A second layer need not be found: it may be merged."""
    label, asked = scene.cloud.label, not scene.cloud.label.startswith("layer")
    if scene.strays.any():
        share = 100 * float(found[scene.strays].mean())
        yield Figure("layers", label, "strays found, %", CLEARED, share, Limit(95, 99, least=True) if asked else None)
    lost = 100 * float(found[scene.good].mean())
    yield Figure("layers", label, "good points lost, %", CLEARED, lost, Limit(0.5, 0.1))


# ------------------------------------------------------------------------------------------------- the tower's wall


def wall(others: list[str], folder: Path = FOLDER) -> Iterator[Figure]:
    """Normals of the tower's wall that face away. Raises a ValueError if the scan is missing."""
    path = folder.parent / "points" / TOWER
    if not path.exists():
        raise ValueError(f"{TOWER} not found in {path.parent}")
    points = pr.read(path)
    toward = EYE - points.world
    near = neighbors(points.positions, TANGENT + 1)[1][:, 1:]
    methods: dict[tuple[str, str], Callable[[], Any]] = {
        ("given", OURS): lambda: pr.estimate_normals(points, viewpoint=EYE).normals,
        ("none", OURS): lambda: pr.estimate_normals(points).normals,
    }
    if POISSON in others:
        methods["none", OPEN3D] = lambda: _tangent_planes(points.world)
    for (viewpoint, name), method in methods.items():
        start = time.perf_counter()
        normals = np.asarray(method(), np.float64)
        seconds = time.perf_counter() - start
        yield from _facing(f"wall, viewpoint {viewpoint}", name, normals, toward, near, seconds)


def _tangent_planes(positions: Floats) -> Floats:
    """Open3D's normals, signed along a spanning tree."""
    import open3d

    there = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(positions))
    there.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(TANGENT))
    there.orient_normals_consistent_tangent_plane(TANGENT)
    return np.array(there.normals)


def _facing(
    label: str, name: str, normals: Floats, toward: Floats, near: NDArray[Any], seconds: float
) -> Iterator[Figure]:
    """Fractions of normals that face away, and that disagree with their neighbours, independent of a global flip."""
    given = "given" in label
    away = 100 * float(((normals * toward).sum(axis=1) < 0).mean())
    away, limit = (away, Limit(0.3, 0.1)) if given else (min(away, 100 - away), None)
    yield Figure("wall", label, "face away, %", name, away, limit)
    agree = np.einsum("nc,nkc->nk", normals, normals[near]) > 0
    other = 100 * float((agree.mean(axis=1) < 0.5).mean())
    limit = None if given else Limit(1.0, 0.5)
    yield Figure("wall", label, "against most of 16 neighbours, %", name, other, limit)
    yield Figure("wall", label, "made in, s", name, seconds)


# -------------------------------------------------------------------------------------------------------------- time


def times(n: int = STATUE_POINTS, runs: int = RUNS) -> Iterator[Figure]:
    """Seconds to build a model of the statue, and milliseconds of a frame. Settings alternate."""
    exact = Procedural("statue")
    settings: list[tuple[str, str | float]] = [(OURS, "auto"), (PLAIN, 0)] if smooths() else [(OURS, "auto")]
    for noise in (0.0, 0.3):
        cloud = noisy(exact, n, noise)
        label = f"statue, {n:,} points, {noise:g} h"
        taken: dict[str, list[tuple[float, float]]] = {name: [] for name, _ in settings}
        models: dict[str, pr.Model] = {}
        for _ in range(runs):
            for name, smooth in settings:
                models.pop(name, None)
                models[name], *seconds = _timed(cloud, smooth)
                taken[name].append((seconds[0], seconds[1]))
        for k, what in enumerate(("prepared in, s", "processors' time, s")):
            for name, found in taken.items():
                limit = Limit(1.3, 1.0, times=PLAIN) if name == OURS else None
                yield Figure("time", label, what, name, statistics.median(pair[k] for pair in found), limit)
        frames = frame_times([scene_of(model) for model in models.values()], cloud.bounds)
        for name, ms in zip(models, frames, strict=True):
            yield Figure("time", label, "a frame, ms", name, ms, Limit(1.0, 0.9, times=PLAIN) if name == OURS else None)


def _timed(cloud: Cloud, smooth: str | float) -> tuple[pr.Model, float, float]:
    """A model, seconds, and processor time divided by the threads."""
    points = pr.Points(cloud.positions)
    wall_clock, processors = time.perf_counter(), time.process_time()
    model = model_of(points, smooth)
    return model, time.perf_counter() - wall_clock, (time.process_time() - processors) / thread_count()
