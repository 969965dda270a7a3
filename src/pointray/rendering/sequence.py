"""`animate`: images of one scene from a sequence of cameras."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_kind, wrong
from ..base.arrays import Floats
from ..base.executor import Client, Executor, Job, snapshot_and_executor
from ..base.progress import StageProgress, in_stage
from ..scene.scene import Scene
from ..scene.world import Snapshot
from .camera import Camera
from .picture import Progress, check_picture, check_scene, picture_bytes, render_snapshot
from .pieces import in_order
from .ray_forwarding.spread import check_spread
from .settings import Settings

AHEAD = 4  # images a worker that are in progress or finished ahead of the first missing one


def animate(
    scene: Scene,
    cameras: Sequence[Camera],
    settings: Settings | None = None,
    progress: StageProgress | None = None,
    client: Client = None,
    spread: bool | None = None,
) -> Iterator[NDArray[np.float32]]:
    """Render the frames of an animation, one for each camera; see `turntable` and `fly`. The scene is not modified.

    Parameters
    ----------
    scene : Scene
    cameras : sequence of Camera
    settings : Settings, optional
        With "baked", if `Scene.baked` is None, light is baked once for all frames, with a warning.
    progress : callable, optional
        Called as `progress(stage, share)` with the name of the stage and the completed share of all frames, 0 to 1,
        about ten times a second while a frame is rendered. An exception raised in it ends the rendering.
    client : dask.distributed.Client, optional
        Render on the workers of a cluster, a frame at a time on each, some frames ahead. The frames are the same, see
        `render`.
    spread : bool, optional
        Distribute the parts of models in parts over the workers, which then render each frame together; not for "baked"
        and "cost". None: if a model's parts do not fit into the memory of a worker.

    Returns
    -------
    iterator of (h, w, 4) float32
        Frames as returned by `render`, in the order of the cameras, rendered on demand. Changes to the scene after the
        call have no effect.

    Raises
    ------
    TypeError
        At the call, if an argument has the wrong type.
    ImportError
        If `Settings.denoise` is set and pyoidn is not installed.
    ValueError
        At the call, if an argument is invalid or an image does not fit into the available memory.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
    >>> cameras = pr.turntable(pr.frame(scene, size=(32, 24)), 3)
    >>> for k, image in enumerate(pr.animate(scene, cameras)):
    ...     pr.write_image(f"{k:04d}.png", image)
    """
    if not isinstance(cameras, Sequence) or isinstance(cameras, str | bytes):
        raise wrong("cameras", "a sequence of Camera", cameras)
    for k, camera in enumerate(cameras):
        check_kind(camera, f"cameras[{k}]", Camera, "a Camera")
    scene, settings = check_scene(scene, settings, progress)
    for size in {camera.size for camera in cameras}:
        check_picture(size, picture_bytes(settings))
    spread = check_spread(spread, client, settings)
    return render_each(scene, list(cameras), settings, client, in_stage(progress, "rendering"), spread=spread)


def render_each(
    scene: Scene,
    cameras: Sequence[Camera],
    settings: Settings,
    client: Client,
    progress: Progress | None,
    numbers: Sequence[int] | None = None,
    spread: bool | None = None,
) -> Iterator[Floats]:
    """Render the frames of an animation, with validated arguments; yield them in order, (h, w, 4) RGB and alpha each.

    Each worker renders whole frames. With denoising or spread models, all workers render one frame after the other.

    progress : called with the completed fraction of all frames
    numbers : frame numbers shown on the dashboard; None: 0, 1, 2 and so on
    spread : whether each worker opens only some parts of models; None: only if a worker's memory cannot hold all parts
    """
    now, executor = snapshot_and_executor(scene, client, spread)
    if executor is None or executor.spread or settings.denoised:
        parts = [_part(progress, k, len(cameras)) for k in range(len(cameras))]
        return (render_snapshot(now, *each, executor) for each in zip(cameras, repeat(settings), parts, strict=False))
    names = [f"frame {number}" for number in (numbers or range(len(cameras)))]
    return in_order(_render_whole(executor, cameras, settings, names, progress))


def _part(progress: Progress | None, k: int, count: int) -> Progress | None:
    """Return a callback for the progress of frame k of `count` frames, which reports that of all frames."""
    return None if progress is None else lambda share: progress((k + share) / count)


def _render_whole(
    executor: Executor, cameras: Sequence[Camera], settings: Settings, names: Sequence[str], progress: Progress | None
) -> Iterator[tuple[int, Floats]]:
    """Render the frames of an animation on workers; yield each with its index when it is finished, in any order.

    At most AHEAD (4) frames a worker are begun beyond the first unfinished one; finished frames wait for it in memory.

    names : names of the frames, shown on the dashboard; progress : called with the finished share of the frames
    """
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
    """Render one frame of an animation on a worker: (h, w, 4), linear RGB and alpha. progress : raises to cancel"""
    return render_snapshot(scene, camera, replace(settings, threads=threads), progress)
