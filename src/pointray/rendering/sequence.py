"""Pictures of one scene from several cameras, in their order: those of a film, on the workers of a cluster."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..cluster.crew import Crew
from ..cluster.dispatch import AT_ONCE, Job
from ..scene.scene import Scene
from ..scene.world import Snapshot
from .camera import Camera
from .picture import Client, Progress, render_snapshot, taken
from .pieces import in_order
from .settings import Settings

AHEAD = 2  # pictures for each job of a worker that are begun, or wait, before the first of them is taken

Floats = NDArray[np.float32]


def render_each(
    scene: Scene,
    cameras: Sequence[Camera],
    settings: Settings,
    client: Client,
    progress: Progress,
    numbers: Sequence[int] | None = None,
) -> Iterator[Floats]:
    """Render pictures on a cluster; yields each when those before have been taken.

    Each worker renders whole pictures. Those that are denoised are cut into pieces, one picture after the other.

    progress : called with the share done, some ten times a second
    numbers : what the dashboard calls the pictures; None: 0 and so on
    """
    now, crew = taken(scene, client)
    assert crew is not None
    if settings.denoised:
        for k, camera in enumerate(cameras):
            yield render_snapshot(now, camera, settings, _part(progress, k, len(cameras)), crew)
        return
    names = [f"frame {number}" for number in (numbers or range(len(cameras)))]
    yield from in_order(_render_whole(crew, cameras, settings, names, progress))


def _part(progress: Progress, k: int, count: int) -> Progress:
    """The progress of one of several pictures."""
    return lambda share: progress((k + share) / count)


def _render_whole(
    crew: Crew, cameras: Sequence[Camera], settings: Settings, names: Sequence[str], progress: Progress
) -> Iterator[tuple[int, Floats]]:
    """Render pictures; yields each with its number as it is ready. No more are begun than a while ahead of the first
    that is missing, as all that are ready are kept."""
    number_of: dict[Job, int] = {}
    jobs = deque[Job]()
    missing, begun = set(range(len(cameras))), 0

    def begin() -> None:
        nonlocal begun
        end = min(missing, default=0) + AHEAD * AT_ONCE * max(len(crew.workers), 1)
        while begun < min(end, len(cameras)):
            job = Job(names[begun], render_whole, (cameras[begun], settings))
            number_of[job] = begun
            jobs.append(job)
            begun += 1

    begin()
    for job, image in crew.run(jobs, lambda: progress(1.0 - len(missing) / len(cameras))):
        number = number_of.pop(job)
        missing.remove(number)
        yield number, image
        begin()


def render_whole(scene: Snapshot, camera: Camera, settings: Settings, threads: int, progress: Progress) -> Floats:
    """Render a picture on a worker."""
    return render_snapshot(scene, camera, replace(settings, threads=threads), progress)
