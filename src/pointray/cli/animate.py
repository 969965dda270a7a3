"""pointray animate: a film of a scan or a scene file; an interrupted film continues when it is started again."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, astuple, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from ..base.arguments import check_positive
from ..base.choices import AUTO
from ..base.warning_log import warn
from .baked_light import ONCE
from .cluster import wait_for_kernels
from .keys import read_keys
from .scan_scene import ScanScene
from .views import SceneView, View
from .waiting import Progress, in_background, writing

SECONDS, TURNS = 6.0, 1.0  # defaults of a turntable
PREVIEWS, PREVIEW, PREVIEW_SAMPLES = 8, 128, 16  # frames that determine the exposure: number, longer side, samples
ROUNDING = 1e-6  # frames: rounding error of a share that is a whole number of frames
TRANSPARENT = "MP4 does not support transparency; use numbered .png"


class CameraPath:
    """The cameras of an animation: a turntable, or a flight along keyframes from a file.

    Raises ValueError or OSError if an option is invalid.

    Parameters
    ----------
    view : View or SceneView
        Camera of the command's options or of a scene file, from which size and lens are taken.
    fps : float
        Frames per second.
    options : dict
        Values of `animate`'s options keys, seconds, turns, eye and target; None: not given.

    Attributes
    ----------
    count : int
        Number of frames.
    inputs : dict
        All that the cameras depend on besides the image size, as JSON values. If it has changed, an interrupted one is
        rendered again from the start.
    """

    def __init__(self, view: View | SceneView, fps: float, options: dict[str, Any]) -> None:
        self.view, self.fps = view, check_positive(fps, "--fps")
        self._cameras: list[Any] = []  # empty for a turntable, whose cameras follow from the first one
        if options["keys"] is None:
            if isinstance(view, View) and view.framed and view.lens["projection"] == "panorama":
                raise ValueError("a panorama surrounds the camera, a turntable needs --eye; or use --keys")
            seconds = SECONDS if options["seconds"] is None else check_positive(options["seconds"], "--seconds")
            self._turns = TURNS if options["turns"] is None else options["turns"]
            if not math.isfinite(self._turns):
                raise ValueError(f"--turns must be finite, not {self._turns}")
            self.count = _frames(seconds * fps)
            self.inputs: dict[str, Any] = {"turns": self._turns, **view.inputs}
            return
        from ..rendering.camera_path import fly

        for name in ("seconds", "turns", "eye", "target"):
            if options[name] is not None:
                raise ValueError(f"--{name} cannot be combined with --keys, which define it")
        keys = read_keys(options["keys"], view)
        self._cameras = fly(keys, fps)
        self.count = len(self._cameras)
        self.inputs = {"fps": fps, "keys": [[time, *astuple(camera)] for time, camera in keys]}

    def cameras(self, first: Any) -> list[Any]:
        """Return the camera of each frame. first : first camera of a turntable; unused for keyframes"""
        from ..rendering.camera_path import turntable

        return self._cameras or turntable(first, self.count, self._turns)


def _frames(count: float) -> int:
    from ..rendering.camera_path import MOST_FRAMES

    if not 0.5 <= count <= MOST_FRAMES:
        raise ValueError(f"expected 1 to {MOST_FRAMES} frames, got --seconds times --fps = {count:.6g}")
    return math.floor(count + 0.5)


@dataclass(frozen=True)
class FilmOutput:
    """Paths to which the frames of an animation are written.

    Attributes
    ----------
    path : Path
        The path that the user gave.
    pattern : Path
        Path of numbered images, such as %04d.png: the result, or temporary files until an MP4 is made of them.
    mp4 : bool
        Whether the result is an MP4.
    """

    path: Path
    pattern: Path
    mp4: bool


def film_output(output: Path, background: str) -> FilmOutput:
    """Return where to write an animation for the value of -o: an .mp4, a folder, or a name like %04d.png.

    Raise an error if it cannot be written there. background : value of --background; an MP4 cannot be transparent
    """
    from ..base.atomic_write import sweep
    from ..image.frames import check_pattern, note_of
    from ..image.mp4 import check_mp4

    if output.suffix.lower() == ".mp4" and not output.is_dir():
        check_mp4(output)
        if background == "none":
            raise ValueError(f"--background none: {TRANSPARENT}")
        pattern = Path(f"{output}.frames") / "%04d.png"
        folder = pattern.parent
        sweep(folder)
        if folder.is_dir() and any(folder.iterdir()) and not note_of(pattern).exists():
            raise ValueError(f"{folder}: needed for frames, but contains other files")
        check_pattern(pattern)
        return FilmOutput(output, pattern, True)
    if "%" not in output.name and output.suffix and not output.is_dir():
        raise ValueError(f"{output}: expected .mp4, or for numbered images a folder or a name like %04d.png")
    pattern = output if "%" in output.name else output / "%04d.png"
    check_pattern(pattern)
    return FilmOutput(output, pattern, False)


class FilmSource(NamedTuple):
    """What an animation shows, a scan or a scene file, and how its frames are rendered and written.

    Attributes
    ----------
    build : callable
        Takes a Progress; returns the scene, the first camera of a turntable, and the final settings.
    settings : Settings
        Render settings as far as they are known before the scene is built; `build` returns the final ones.
    exposure : float or "auto"
        In stops. "auto": one exposure for all frames.
    curve : str
        Tone curve. "auto": chosen with the exposure.
    inputs : dict
        All that the scene depends on, as JSON values. If it has changed, all frames are rendered again.
    leveled : bool
        Whether to make levels of detail if a frame would show them.
    backdrop : two sRGB colours, or None
        Colours at the top and bottom of the background.
    light : callable, optional
        Takes a Progress; gives the scene its baked light, unless `build` does.
    bakes : bool
        Whether light is baked, not read from a file.
    shadow : callable, optional
        Returns the shadow of a standing object, drawn on an invisible ground, or None. Called after `build`.
    """

    build: Callable[[Progress], tuple[Any, Any, Any]]
    settings: Any
    exposure: float | str
    curve: str
    inputs: dict[str, Any]
    leveled: bool = False
    backdrop: Any = None
    light: Callable[[Progress], None] | None = None
    bakes: bool = False
    shadow: Callable[[], Any] = lambda: None


def scan_source(scan_scene: ScanScene, view: View, settings: Any, exposure: float | str) -> FilmSource:
    """Return what an animation of a scan shows, and how to render it.

    With an automatic camera a turntable keeps the whole scan in the image.

    settings : those of the images; exposure : in stops, or "auto"
    """

    def build(progress: Progress) -> tuple[Any, Any, Any]:
        scene, _, scan = scan_scene.build(progress)
        scan_scene.keep(progress)
        camera = view.turning(scan)
        return scene, camera, scan_scene.shown_with(settings, camera)

    def light(progress: Progress) -> None:
        scan_scene.light(progress, ONCE)

    inputs, leveled = scan_scene.inputs, settings.levels and scan_scene.may_level
    shown = exposure, AUTO, inputs, leveled, scan_scene.backdrop, light, scan_scene.bakes
    return FilmSource(build, settings, *shown, lambda: scan_scene.shadow(settings))


def animate(output: FilmOutput, camera_path: CameraPath, source: FilmSource, client: Any = None) -> str:
    """Render the missing frames of an animation and write it. Return the line about it that the command prints.

    source : what it shows, and how its frames are rendered and written
    client : Dask client whose workers render; None: this process
    """
    from ..image.frames import Frames
    from ..image.mp4 import even, write_mp4
    from ..image.write import SHOWN_BYTES
    from ..rendering.picture import check_picture, picture_bytes

    size = camera_path.view.size
    check_picture(size, picture_bytes(source.settings, written=SHOWN_BYTES))
    frames = Frames(output.pattern, _inputs(camera_path, source), camera_path.count, size)
    missing, other = frames.find()
    if other:
        differ = ", ".join(name.replace("_", " ") for name in other)
        warn(f"{frames.pattern}: rendering all frames again, because these changed: {differ}", stacklevel=2)
    with Progress(source.settings if missing else None, source.bakes and len(missing) > 0) as progress:
        try:
            if missing:
                _render(frames, missing, camera_path, (source, client), progress)
            if output.mp4:
                progress.show("writing the film", 1.0)
                with writing(output.path):
                    write_mp4(output.path, output.pattern, camera_path.count, camera_path.fps, size)
        except KeyboardInterrupt:
            warn(f"{output.path}: interrupted; run the same command to continue", stacklevel=2)
            raise
    with writing(output.path):
        if output.mp4:
            shutil.rmtree(output.pattern.parent)
        else:
            frames.finish()
    shape = f"{size[0]}x{size[1]}"
    if output.mp4 and even(size) != size:
        shape += " (rounded to even sides: {}x{})".format(*even(size))
    before = camera_path.count - len(missing)
    known = f", {before:,} of them rendered before" if before else ""
    seconds = camera_path.count / camera_path.fps
    return f"{output.path}: {shape}, {camera_path.count:,} frames{known}, {seconds:.3g} seconds"


def _render(
    frames: Any, missing: list[int], camera_path: CameraPath, work: tuple[FilmSource, Any], progress: Progress
) -> None:
    """Build the scene of an animation, render the missing frames and write them as images, in order.

    frames : `Frames`, the numbered images; missing : frame numbers, from 0
    work : (source, client), what the animation shows and how to render it, and a Dask client or None
    """
    from ..rendering.lod import is_far

    source, client = work
    scene, first, settings = source.build(progress)
    cameras = camera_path.cameras(first)
    for model in scene.models if source.leveled else ():
        if not model.levels and not model.parts and any(is_far(model, camera, settings.most) for camera in cameras):
            in_background(partial(model.make_levels, progress.show))
    if source.light is not None:
        source.light(progress)

    exposure, curve = source.exposure, "srgb" if source.curve == AUTO else source.curve
    if isinstance(exposure, str):
        progress.show("choosing the exposure", 0.0)
        exposure, curve = in_background(lambda: _exposure(scene, cameras, settings))
    shadow = source.shadow()
    with writing(frames.pattern):
        frames.begin()
    pictures = _pictures((scene, [cameras[k] for k in missing], settings), missing, progress, client)
    for k in missing:
        image = in_background(lambda: next(pictures))
        with writing(frames.path(k)):
            image = image if shadow is None else shadow.put_under(image, cameras[k])
            frames.keep(k, image, exposure, curve, source.backdrop)


def _pictures(job: tuple[Any, list[Any], Any], numbers: list[int], progress: Progress, client: Any) -> Iterator[Any]:
    """Render frames of an animation one after the other; yield them: (h, w, 4) float32, linear RGB and alpha.

    job : scene, cameras and settings; numbers : frame number of each camera
    """
    from ..rendering.ray_forwarding.spread import check_spread
    from ..rendering.sequence import render_each

    scene, cameras, settings = job
    count = len(cameras)

    def show(share: float) -> None:
        number = min(math.floor(share * count + ROUNDING), count - 1) + 1
        progress.show(f"{count} frames" if client is not None else f"frame {number} of {count}", share)

    wait_for_kernels(client, settings)
    show(0.0)
    return render_each(scene, cameras, settings, client, show, numbers, check_spread(None, client, settings))


def _exposure(scene: Any, cameras: list[Any], settings: Any) -> tuple[float, str]:
    """Return the exposure, in stops, and the tone curve of an animation.

    Some frames are rendered in a small size. Of their exposures the lowest is taken, so that no frame is overexposed.
    """
    from ..image.exposure import PLAIN, auto_exposure, auto_tone, white_under
    from ..rendering.picture import render_snapshot

    snapshot = scene.snapshot()
    preview = replace(settings, spp=1, time_limit=None, noise=None, denoise=False)
    if settings.integrator != "phong":
        preview = replace(preview, spp=min(settings.most, PREVIEW_SAMPLES))
    images = []
    for camera in cameras[:: max(len(cameras) // PREVIEWS, 1)]:
        width, height = camera.size
        share = min(PREVIEW / max(width, height), 1.0)
        small = replace(camera, size=(max(1, round(width * share)), max(1, round(height * share))))
        images.append(render_snapshot(snapshot, small, preview, None))
    white = white_under(scene.lights, settings.integrator)
    curve = "soft" if any(auto_tone(image, white)[1] == "soft" for image in images) else PLAIN
    return min(auto_exposure(image, curve, white) for image in images), curve


def _inputs(camera_path: CameraPath, source: FilmSource) -> dict[str, Any]:
    """Return everything that the frames of an animation depend on, as JSON values; the number of threads is left out.

    If it has changed since an interrupted animation was begun, all frames are rendered again.
    """
    from .. import __version__

    settings = {name: value for name, value in asdict(source.settings).items() if name != "threads"}
    film = {
        "version": __version__,
        "frames": camera_path.count,
        "size": camera_path.view.size,
        "exposure": source.exposure,
    }
    return {**film, **camera_path.inputs, **settings, **source.inputs}
