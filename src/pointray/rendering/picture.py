"""`render`: passes of samples until the settings' limit is reached."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arguments import check_callback, check_kind
from ..base.arrays import Floats
from ..base.executor import Client, Executor, snapshot_and_executor
from ..base.memory import check_memory
from ..base.progress import StageProgress, in_stage
from ..base.registered import registered
from ..base.warning_log import warn
from ..cloud.conversion import PointsLike
from ..engine.jit import Cancel, run
from ..image.denoise import check_denoise, denoise
from ..scene.scene import Scene
from ..scene.world import Snapshot
from .baked import baked_frame
from .camera import Camera
from .film import ALL_SUMS, LIGHT_SUMS, LONGEST_PASS, NOISE_SUMS
from .integrate import BLOCK_EDGE, quick_frame, sampled_frame
from .lod import Fetch
from .noise import light_of, noise_of
from .pieces import Order, add_in_pieces
from .plan import plan
from .ray_forwarding.spread import NOTHING, check_spread
from .settings import Settings

IMAGE_BYTES, FILM_NUMBER = 16, 4  # bytes of a pixel of the image, and of each of its sums in the film
DENOISE_BYTES = 68  # bytes of a pixel: light, noise mask, albedo, normal, and the buffers of Open Image Denoise
NOT_BAKED = (
    "the scene has no baked light: it is baked for this call only; to reuse it, set scene.baked = pr.bake(scene)"
)
SURFACE_SAMPLES = 16  # samples of the denoiser's albedo and normal

Progress = Callable[[float], None]


def render(
    scene: Scene | PointsLike,
    camera: Camera | None = None,
    settings: Settings | None = None,
    progress: StageProgress | None = None,
    client: Client = None,
    spread: bool | None = None,
) -> NDArray[np.float32]:
    """Render an image of a scene as seen by a camera. The scene is not modified.

    Of anything but a scene it returns the picture that `pointray render` writes: ``pr.render("scan.laz")``.

    Parameters
    ----------
    scene : Scene, Model, or what `as_points` accepts, or a list of these
        Points and paths of scans become models, which stand in the light of a studio. The light is baked, the exposure
        chosen, and a background added.
    camera : Camera, optional
        Default: as `frame` chooses it; 800 x 600 pixels, except for a Scene.
    settings : Settings, optional
        Default: `Settings()`; for anything but a scene those of `pointray render`, with baked light.
    progress : callable, optional
        Called about ten times a second as `progress(stage, share)` with the name of the stage and its completed share,
        0 to 1. An exception raised in it ends the call.
    client : dask.distributed.Client, optional
        Render on the workers of a cluster, with all of their threads (`pip install 'pointray[cluster]'`). The image is
        the same, to the last bit if all processors are of one kind, unless a time limit ends it.
        See https://pointray.readthedocs.io/page/scale.html.
    spread : bool, optional
        Distribute the parts of models in parts over the workers and send rays to them; not for "baked" and "cost".
        None: if a model's parts do not fit into the memory of a worker.

    Returns
    -------
    (h, w, 4) float32
        Linear RGB, premultiplied, and alpha, the covered fraction of the pixel (1 with a background). For anything but
        a scene: the displayed colours, to be written without exposure.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ImportError
        If `Settings.denoise` is set and pyoidn is not installed.
    ValueError
        If an argument is invalid, or the image does not fit into the available memory.

    Notes
    -----
    A scene without lights is lit by a headlight at the camera; for "path", if nothing emits light, by a uniform white
    sky of radiance 1. "baked" uses `Scene.baked`; without it, light is baked for this call only, with a warning.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
    >>> light = scene.add_light(pr.SunLight((1, 1, -1.2)))
    >>> image = pr.render(scene, pr.frame(scene, size=(32, 24)), pr.Settings(spp=4))
    >>> image.shape, image.dtype
    ((24, 32, 4), dtype('float32'))
    """

    def draw(scene: Scene, camera: Camera, settings: Settings) -> NDArray[np.float32]:
        now, executor = snapshot_and_executor(scene, client, check_spread(spread, client, settings))
        return render_snapshot(now, camera, settings, in_stage(progress, "rendering"), executor)

    if camera is not None:
        check_kind(camera, "camera", Camera, "a Camera, or None")
    if not isinstance(scene, Scene):
        check_options(settings, progress)
        check_spread(spread, client, settings or Settings())
        return registered("default_scene").render(scene, camera, settings, draw, progress)
    seen = registered("default_scene").frame(scene) if camera is None else camera
    scene, settings = check_view(scene, seen, settings, progress)
    return draw(scene, seen, settings)


def render_snapshot(
    scene: Snapshot, camera: Camera, settings: Settings, progress: Progress | None, executor: Executor | None = None
) -> NDArray[np.float32]:
    """Render a snapshot as an (h, w, 4) image: linear, premultiplied RGB and alpha, denoised if so set.

    progress : called with the completed fraction; executor : workers that render; None: this process
    """
    if settings.denoised:
        check_denoise()
    picture = Picture(scene, camera, settings, executor=executor)
    for share in picture.passes(progress):
        if progress is not None:
            progress(share)
    if not settings.denoised:
        return picture.image
    image, (light, noisy) = picture.image, picture.light()
    del picture  # frees all but the image
    albedo, normal = (_surfaces(scene, camera, replace(settings, integrator=i), executor) for i in ("color", "normal"))
    for row in normal:  # stored as 0 to 1, times alpha
        row[:, :3] = 2.0 * row[:, :3] - row[:, 3:]
    if scene.shows_sky:  # the visible sky has no noise: only the covered fraction of a pixel is noisy
        noisy *= albedo[..., 3]
    # Only the light is denoised: the background has no noise, and is composited by alpha as before.
    without = light[..., :3].copy()
    denoise(light, albedo, normal)
    for row, clean, old, share in zip(image, light, without, noisy, strict=True):
        some = share > 0
        row[some, :3] += share[some, None] * (clean[some, :3] - old[some])
    return image


def picture_bytes(settings: Settings, catchers: bool = True, written: int = 0) -> int:
    """Return the memory that a pixel needs while an image is rendered and written, in bytes.

    catchers : whether the scene may have shadow catchers, which need more sums; written : bytes a pixel for writing
    """
    one_pass = settings.time_limit is None and settings.noise is None and not settings.denoised
    film = 0 if one_pass else FILM_NUMBER * _sums(settings, catchers)
    return IMAGE_BYTES + max(film, DENOISE_BYTES if settings.denoised else 0, written)


def check_picture(size: tuple[int, int], bytes_a_pixel: int) -> None:
    """Raise ValueError if an image does not fit into the available memory. size : width and height"""
    check_memory(size[0] * size[1] * bytes_a_pixel, f"for a picture of {size[0]}x{size[1]}")


def _sums(settings: Settings, catchers: bool) -> int:
    """Return how many sums over samples each pixel has: 4 (RGB, hits), 5 to measure noise, 8 with shadow catchers."""
    return ALL_SUMS if catchers else NOISE_SUMS if settings.noise is not None or settings.denoised else LIGHT_SUMS


def check_view(scene: Any, camera: Any, settings: Any, progress: Any) -> tuple[Scene, Settings]:
    """Validate the arguments of `render`; return the scene to render and the settings, the defaults for None.

    The scene is a copy with baked light if the integrator needs it and the scene has none.
    """
    check_kind(camera, "camera", Camera, "a Camera")
    return check_scene(scene, settings, progress, 4)


def check_scene(scene: Any, settings: Any, progress: Any, stacklevel: int = 3) -> tuple[Scene, Settings]:
    """Validate arguments of `render`; return the scene to render and the settings, the defaults for None.

    The scene is a copy with baked light if the integrator needs it and the scene has none; a warning says so.

    stacklevel : of the stack frame that the warning names
    """
    check_kind(scene, "scene", Scene, "a Scene")
    settings = check_options(settings, progress)
    if settings.integrator == "baked" and scene.baked is None:
        from ..baking.baked import bake  # importing takes 0.1 s, which other integrators save
        from ..baking.settings import BakeSettings

        warn(NOT_BAKED, stacklevel=stacklevel)
        lit = scene.copy()
        lit.baked = bake(scene, BakeSettings(seed=settings.seed, threads=settings.threads))
        scene = lit
    return scene, settings


def check_options(settings: Any, progress: Any) -> Settings:
    """Validate the settings of an image, and a progress callback; return the settings, the defaults for None."""
    check_callback(progress)
    return Settings() if settings is None else check_kind(settings, "settings", Settings, "Settings, or None")


def _surfaces(scene: Snapshot, camera: Camera, settings: Settings, executor: Executor | None) -> NDArray[np.float32]:
    """Render the albedo or the normals of first hits, (h, w, 4) with alpha, no background, as guides for the denoiser.

    They are averaged over up to 16 of the image's own samples. settings : with the integrator "color" or "normal"
    """
    spp = min(settings.most, SURFACE_SAMPLES)
    few = replace(settings, spp=spp, time_limit=None, noise=None, denoise=False)
    picture = Picture(scene, camera, few, background=(0.0, 0.0, 0.0, 0.0), executor=executor)
    for _ in picture.passes(None):
        pass
    return picture.image


class Picture:
    """Image in progress, to which passes (ranges of samples of all pixels) are added.

    Parameters
    ----------
    scene : Snapshot
    background : RGB and alpha, optional
        Replaces the scene's.
    in_passes : bool
        Keep the sums of samples, so that samples can be added in passes even if the settings have no limit.
    executor : Executor, optional
        Workers of the same scene that add the samples; None: this process.
    checked : bool
        Whether memory is checked first, which takes 1 ms. False for a piece: untouched pages are not allocated.
    fetch : Fetch, optional
        Opens models on disk in the background, while other levels are shown; None: they are opened at once.

    Attributes
    ----------
    image : (h, w, 4) float32
        Result of `render` from the samples so far.
    """

    def __init__(
        self,
        scene: Snapshot,
        camera: Camera,
        settings: Settings,
        background: tuple[float, float, float, float] | None = None,
        in_passes: bool = False,
        executor: Executor | None = None,
        checked: bool = True,
        fetch: Fetch | None = None,
    ) -> None:
        self._settings, self._camera = settings, camera.record()
        self._executor, self._seen, self._background = executor, camera, background
        scene = self._scene = scene.for_camera(self._camera)
        spread = executor is not None and executor.spread
        width, height = camera.size
        self._blocks = -(-width // BLOCK_EDGE) * -(-height // BLOCK_EDGE)
        self._one_pass = settings.time_limit is None and settings.noise is None and not in_passes
        self._kernel = kernel_for(settings)
        self._world, self._pass = plan(scene, camera, settings, fetch, NOTHING if spread else None)
        if background is not None:
            self._pass = self._pass._replace(background=background)
        catchers = self._world.catchers > 0
        if checked:
            check_picture(camera.size, picture_bytes(settings, catchers))
        sums = _sums(settings, catchers)
        self.image = np.empty((height, width, 4), np.float32)
        without_film = self._one_pass and not settings.denoised and not (spread and settings.most > LONGEST_PASS)
        self._film = np.zeros((0, 0, sums) if without_film else (height, width, sums), np.float32)
        self._done = 0  # samples

    def passes(self, progress: Progress | None) -> Iterator[float]:
        """Add samples in passes until the limit of samples, time or noise is reached; yield completed fractions.

        progress : called with the completed fraction while the only pass of an image without limits runs
        """
        settings, begun, done, step = self._settings, time.perf_counter(), 0, 1
        most = settings.most
        while done < most:
            end = most if self._one_pass else min(done + step, most)
            self.add(done, end, progress if self._one_pass else None)
            done = end
            spent = time.perf_counter() - begun
            shares = [done / most]
            if settings.time_limit is not None:
                shares.append(spent / settings.time_limit)
            if settings.noise is not None and done > 1:
                shares.append((settings.noise / max(noise_of(self._film, done), 1e-30)) ** 2)
            yield min(max(shares), 1.0)
            if max(shares) >= 1.0:
                return
            step = min(max(done, 1), LONGEST_PASS)
            if settings.time_limit is not None:  # no pass longer than the remaining time
                step = max(min(step, int((settings.time_limit - spent) / spent * done)), 1)

    def add(self, first: int, end: int, progress: Progress | None = None, cancel: Cancel | None = None) -> None:
        """Add the samples with indices from `first` up to `end` to all pixels; these follow the samples added before.

        A cancelled call has added samples to some tiles only, so no more can be added. `cancel` has no effect with an
        executor.
        """
        if self._executor is None:
            self._run((first, end), (0, self._blocks), progress, cancel)
        elif self._executor.spread:
            self._forward_rays(self._executor, (first, end), progress)
        else:
            order = Order(self._seen, self._settings, self._background, (first, end))
            add_in_pieces(self._executor, render_piece, order, (self.image, self._film), progress)
        self._done = end

    def _run(
        self, samples: tuple[int, int], blocks: tuple[int, int], progress: Progress | None, cancel: Cancel | None = None
    ) -> None:
        """Add samples to some blocks of the image, and to their pixels' sums over samples, in this process.

        samples : range of sample indices; blocks : number of the first block, and their count
        """
        args = (
            self._world,
            self._camera,
            self._pass._replace(first=samples[0], end=samples[1]),
            self._film,
            self.image,
        )
        threads = self._settings.threads
        run(self._kernel, blocks[1], *args, threads=threads, progress=progress, cancel=cancel, first=blocks[0])

    def _forward_rays(self, executor: Executor, samples: tuple[int, int], progress: Progress | None) -> None:
        """Add samples to all pixels of the image, with rays sent to the workers that hold the models.

        samples : range of sample indices
        """
        from .ray_forwarding.ray_exchange import View, add_by_waves
        from .ray_forwarding.replay import replay_kernel_for
        from .ray_forwarding.wave import KernelArguments

        settings = self._settings
        fixed = self._world, self._camera, self._pass
        picture = KernelArguments(replay_kernel_for(self._kernel), *fixed, self._film, self.image, settings.threads)
        view = View(self._seen, settings.most if settings.levels else None)
        add_by_waves(executor, self._scene, view, picture, samples, progress)

    def add_to(self, order: Order, progress: Progress | None) -> tuple[Floats, Floats | None]:
        """Add samples to a piece of the image, as an order (a request from another process) says.

        Returns the piece, (h, w, 4), RGB and alpha, and, if the order requests them, the k sums over samples of each of
        its pixels, (h, w, k).
        """
        piece = order.piece
        if order.sums is not None:
            piece.of(self._film)[:] = order.sums
        self._run(order.samples, (piece.block, piece.blocks), progress)
        return piece.of(self.image).copy(), piece.of(self._film).copy() if order.returns else None

    def light(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return RGB (no background) and alpha, (h, w, 4), and a mask of noisy pixels, (h, w), for the denoiser."""
        return light_of(self._film, self._done)


def render_piece(
    scene: Snapshot, order: Order, threads: int, progress: Progress | None
) -> tuple[Floats, Floats | None]:
    """Render the piece of an image that an order (a request from the client) names, on a worker.

    Returns the piece, (h, w, 4), RGB and alpha, and, if the order requests them, the k sums over samples of each of its
    pixels, (h, w, k).
    """
    settings, in_passes = replace(order.settings, threads=threads), order.returns or order.sums is not None
    picture = Picture(scene, order.camera, settings, order.background, in_passes, checked=False)
    return picture.add_to(order, progress)


# Kernel of each of `choices.INTEGRATORS`.
KERNELS: dict[str, Any] = {
    **dict.fromkeys(("phong", "normal", "depth", "color", "cost"), quick_frame),
    **dict.fromkeys(("ao", "path"), sampled_frame),
    "baked": baked_frame,
}


def kernel_for(settings: Settings) -> Any:
    """Return the kernel that renders images with the settings' integrator."""
    return KERNELS[settings.integrator]
