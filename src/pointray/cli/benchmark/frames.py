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
    """One measured case, a view of the statue: its frame rate, and the one that the paper reports.

    Attributes
    ----------
    points : int
        Number of points of the statue.
    view : {"far", "near"}
        Whole statue, or a part of it that fills the image.
    size : str
        Width and height of the image, such as "512x512".
    light : str
        "headlight", or "sun, shadows".
    covered : float
        Share of the pixels that show the statue, 0 to 1.
    frame_ms, frames_per_second : float
        Median time of a frame and its reciprocal.
    paper_frames_per_second : float or None
        None: the paper gives none for this case.
    bytes_per_point : float
        Size of the model.
    seconds_for_model : float
        Time to build the model, without the compilation of kernels.
    """

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
    """Measure frame rates of the statue in the cases of the paper: clouds of several sizes, each in one or two views.

    Each case is rendered `runs` times, alternating between the views of a cloud; its time is the median.

    Parameters
    ----------
    counts : sequence of int
        Points of the statue. If there are several counts, the smallest cloud is subsampled from the next larger one,
        as the paper's 32,000 points were. Other clouds are distinct points on the same surface.
    show : callable
        Called with the stage's name and the share done.

    Returns
    -------
    list of Row
        One for each case.

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
    """Yield a statue of each number of points, and its support radii if it was subsampled from a larger one, else None.

    counts : numbers of points, ascending; show : called with the stage's name and the share done
    """
    for k, count in enumerate(counts):
        if k == 0 and len(counts) > 1:
            continue
        show(f"{count:,} points", 0.0)
        points = procedural("statue", count)
        if k == 1:
            yield subsample(points, count=counts[0], progress=show)
        yield points, None


def _cases(model: Model, threads: int) -> Iterator[tuple[str, Scene, Camera, Settings]]:
    """Yield the cases measured for a model of the statue: "far" or "near", and scene, camera and settings to render.

    Models of 24 million points and more have one case with a sun and shadows, others two without shadows.
    """
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
    """Render the cases of a model `runs` times each, alternating between them, and return their median times.

    seconds : time in which the model was built, for the table; show : called with the stage's name and the share done
    """
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
