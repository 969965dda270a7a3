"""Frame rates of the statue in the cases of Wald and Seidel (2005), section 3."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...cloud.points import Points
from ...engine.jit import compile_seconds
from ...model.model import Model
from ...procedural_models import procedural
from ...rendering.camera import Camera
from ...rendering.picture import render
from ...rendering.settings import Settings
from ...scene.scene import Scene
from ...shade.lights import SunLight
from ...surface.splats.subsample import subsample
from .views import far_view, near_view

SIZE, STRESS_SIZE = (512, 512), (640, 480)
STRESS = 24_000_000  # clouds of at least this many points are the paper's stress test: Phong, a light and shadows
SUN = SunLight((-0.5, 0.6, -0.8), 3.0)
# Frames a second that the paper reports, on two 2.4 GHz Opterons. For 32,000 points it says only "comparable".
PAPER = {(1_000_000, "near"): 4.5, (1_000_000, "far"): 8.7, (STRESS, "far"): 2.1}

Show = Callable[[str, float], None]


@dataclass(frozen=True)
class Row:
    """One case: the rendered scene, and its frame rates here and in the paper (None: not given)."""

    points: int
    view: str
    size: str
    light: str
    covered: float
    frame_ms: float
    frames_per_second: float
    paper_frames_per_second: float | None
    bytes_per_point: float
    seconds_for_model: float


def measure(counts: Sequence[int], runs: int, threads: int, show: Show) -> list[Row]:
    """Render each case `runs` times, alternating between the views of a cloud, and take the medians.

    Parameters
    ----------
    counts : sequence of int
        Points of the statue. If there are several counts, the smallest cloud is subsampled from the next larger one,
        as the paper's 32,000 points were. Other clouds are distinct points on the same surface.
    show : callable
        Called with the stage's name and the share done.

    Raises
    ------
    ValueError
        If a count is given twice.
    """
    if len(set(counts)) < len(counts):
        raise ValueError(f"--points: duplicate counts in {', '.join(f'{n:,}' for n in counts)}")
    rows: list[Row] = []
    for points, radii in _clouds(sorted(counts), show):
        show(f"model of {len(points):,} points", 0.0)
        start = time.perf_counter() - compile_seconds()
        model = Model(points, radii)
        seconds = time.perf_counter() - compile_seconds() - start
        rows += _rows(model, seconds, runs, threads, show)
    return rows


def _clouds(counts: list[int], show: Show) -> Iterator[tuple[Points, np.ndarray | None]]:
    """Yield the statue with each number of points, and radii if it was subsampled."""
    for k, count in enumerate(counts):
        if k == 0 and len(counts) > 1:
            continue
        show(f"{count:,} points", 0.0)
        points = procedural("statue", count)
        if k == 1:
            yield subsample(points, count=counts[0], progress=show)
        yield points, None


def _cases(model: Model, threads: int) -> Iterator[tuple[str, Scene, Camera, Settings]]:
    """Yield the cases of a model: view, scene, camera and settings."""
    scene = Scene()
    scene.add(model)
    if len(model.points) >= STRESS:
        scene.add_light(SUN)
        yield "far", scene, far_view(model.points, model.bounds, STRESS_SIZE), Settings(threads=threads)
        return
    far = far_view(model.points, model.bounds, SIZE)
    yield "far", scene, far, Settings(shadows=False, threads=threads)
    yield "near", scene, near_view(scene, far, SIZE), Settings(shadows=False, threads=threads)


def _rows(model: Model, seconds: float, runs: int, threads: int, show: Show) -> list[Row]:
    """Time the cases of a model, alternating between them."""
    cases = list(_cases(model, threads))
    covered = [float((render(scene, camera, settings)[..., 3] > 0).mean()) for _, scene, camera, settings in cases]
    times: list[list[float]] = [[] for _ in cases]
    for run in range(runs):
        show(f"frames of {len(model.points):,} points", run / runs)
        for (_, scene, camera, settings), kept in zip(cases, times, strict=True):
            start = time.perf_counter()
            render(scene, camera, settings)
            kept.append(time.perf_counter() - start)
    rows = []
    for (view, _, camera, settings), share, kept in zip(cases, covered, times, strict=True):
        median = statistics.median(kept)
        rows.append(
            Row(
                points=len(model.points),
                view=view,
                size=f"{camera.size[0]}x{camera.size[1]}",
                light="sun, shadows" if settings.shadows else "headlight",
                covered=share,
                frame_ms=1e3 * median,
                frames_per_second=1.0 / median,
                paper_frames_per_second=PAPER.get((len(model.points), view)),
                bytes_per_point=model.nbytes / len(model.points),
                seconds_for_model=seconds,
            )
        )
    return rows
