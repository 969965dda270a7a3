"""Pictures of one scene from several cameras, in their order: those of a film."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_kind, wrong
from ..base.executor import Client, Executor, Job, snapshot_and_executor
from ..scene.scene import Scene
from ..scene.world import Snapshot
from .camera import Camera
from .picture import (
    Progress,
    check_picture,
    check_scene,
    picture_bytes,
    render_snapshot,
)
from .pieces import in_order
from .ray_forwarding.spread import check_spread
from .settings import Settings

AHEAD = 4  # pictures for each worker that are begun, or wait, before the first of them is taken

Floats = NDArray[np.float32]


def animate(
    scene: Scene,
    cameras: Sequence[Camera],
    settings: Settings | None = None,
    progress: Progress | None = None,
    client: Client = None,
    spread: bool | None = None,
) -> Iterator[NDArray[np.float32]]:
    """Render the pictures of a film, one for each camera: see `turntable` and `fly`.

    Parameters
    ----------
    cameras : sequence of Camera
    progress : callable, optional
        Called with the share of the film that is done, some ten times a second while a picture is waited for. An error
        in it ends the work.
    client : dask.distributed.Client, optional
        The workers of a cluster render, each whole pictures, some ahead of the one that is taken. The pictures are the
        same, see `render`.
    spread : bool, optional
        As for `render`; then all workers render one picture after the other.

    Returns
    -------
    iterator of (h, w, 4) float32
        The pictures in the order of the cameras, as `render` returns them; each is rendered when it is asked for. The
        scene is that of the call, whatever is changed while the pictures are taken.

    Raises
    ------
    ValueError
        At the call, if an argument is wrong or a picture would not fit into the available memory.

    Examples
    --------
    >>> for k, picture in enumerate(pr.animate(scene, pr.turntable(camera, 48))):
    ...     pr.write_image(f"{k:04d}.png", picture)
    """
    if not isinstance(cameras, Sequence) or isinstance(cameras, str | bytes):
        raise wrong("cameras", "a sequence of Camera", cameras)
    for k, camera in enumerate(cameras):
        check_kind(camera, f"cameras[{k}]", Camera, "a Camera")
    scene, settings = check_scene(scene, settings, progress)
    for size in {camera.size for camera in cameras}:
        check_picture(size, picture_bytes(settings))
    spread = check_spread(spread, client, settings)
    return render_each(scene, list(cameras), settings, client, progress, spread=spread)


def render_each(
    scene: Scene,
    cameras: Sequence[Camera],
    settings: Settings,
    client: Client,
    progress: Progress | None,
    numbers: Sequence[int] | None = None,
    spread: bool | None = None,
) -> Iterator[Floats]:
    """The pictures of `animate`, of checked arguments.

    Each worker renders whole pictures. Where they are denoised, or models are spread, all render one after the other.

    numbers : what the dashboard calls the pictures; None: 0 and so on
    spread : see `check_spread`
    """
    now, executor = snapshot_and_executor(scene, client, spread)
    if executor is None or executor.spread or settings.denoised:
        parts = [_part(progress, k, len(cameras)) for k in range(len(cameras))]
        return (render_snapshot(now, *each, executor) for each in zip(cameras, repeat(settings), parts, strict=False))
    names = [f"frame {number}" for number in (numbers or range(len(cameras)))]
    return in_order(_render_whole(executor, cameras, settings, names, progress))


def _part(progress: Progress | None, k: int, count: int) -> Progress | None:
    """The progress of one of several pictures."""
    return None if progress is None else lambda share: progress((k + share) / count)


def _render_whole(
    executor: Executor, cameras: Sequence[Camera], settings: Settings, names: Sequence[str], progress: Progress | None
) -> Iterator[tuple[int, Floats]]:
    """Render pictures; yields each with its number as it is ready. No more are begun than a while ahead of the first
    that is missing, as all that are ready are kept."""
    number_of: dict[Job, int] = {}
    jobs = deque[Job]()
    missing, begun = set(range(len(cameras))), 0

    def begin() -> None:
        nonlocal begun
        end = min(missing, default=0) + AHEAD * max(len(executor.workers), 1)
        while begun < min(end, len(cameras)):
            job = Job(names[begun], render_whole, (cameras[begun], settings))
            number_of[job] = begun
            jobs.append(job)
            begun += 1

    def tick() -> None:
        if progress is not None:
            progress(1.0 - len(missing) / len(cameras))

    begin()
    for job, image in executor.run(jobs, tick):
        number = number_of.pop(job)
        missing.remove(number)
        yield number, image
        begin()


def render_whole(scene: Snapshot, camera: Camera, settings: Settings, threads: int, progress: Progress) -> Floats:
    """Render a picture on a worker."""
    return render_snapshot(scene, camera, replace(settings, threads=threads), progress)
