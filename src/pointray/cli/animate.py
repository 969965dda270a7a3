"""pointray animate: a film of a scan or a scene file, which goes on where it was interrupted."""

from __future__ import annotations

import math
import shutil
import warnings
from collections.abc import Callable
from dataclasses import asdict, astuple, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from ..arguments import check_positive
from ..choices import AUTO
from .keys import read_keys
from .scan_scene import ScanScene
from .views import SceneView, View
from .waiting import Progress, in_background, writing

SECONDS, TURNS = 6.0, 1.0  # of a film that says nothing
PREVIEWS, PREVIEW, PREVIEW_SAMPLES = 8, 128, 16  # frames by which it is exposed, their pixels across, their samples
TRANSPARENT = "an MP4 cannot be transparent, numbered .png can"


class CameraPath:
    """The way of the camera: a turntable, or along keys. Raises what is wrong with the options at once."""

    def __init__(self, view: View | SceneView, fps: float, wishes: dict[str, Any]) -> None:
        self.view, self.fps = view, check_positive(fps, "--fps")
        self._cameras: list[Any] = []  # of keys; a turntable's depend on the first one
        if wishes["keys"] is None:
            if isinstance(view, View) and view.framed and view.lens["projection"] == "panorama":
                raise ValueError("a panorama is all around the camera, no turntable before it: say --keys, or --eye")
            seconds = SECONDS if wishes["seconds"] is None else check_positive(wishes["seconds"], "--seconds")
            self._turns = TURNS if wishes["turns"] is None else wishes["turns"]
            if not math.isfinite(self._turns):
                raise ValueError(f"--turns must be finite, not {self._turns}")
            self.count = _frames(seconds * fps)
            self.settings: dict[str, Any] = {"turns": self._turns, **view.settings}
            return
        from ..rendering.camera_path import fly

        for name in ("seconds", "turns", "eye", "target"):
            if wishes[name] is not None:
                raise ValueError(f"--{name} is not for --keys, which say it themselves")
        keys = read_keys(wishes["keys"], view)
        self._cameras = fly(keys, fps)
        self.count = len(self._cameras)
        self.settings = {"fps": fps, "keys": [[time, *astuple(camera)] for time, camera in keys]}

    def cameras(self, first: Any) -> list[Any]:
        """The camera of each frame; a turntable turns the one that is given."""
        from ..rendering.camera_path import turntable

        return self._cameras or turntable(first, self.count, self._turns)


def _frames(count: float) -> int:
    from ..rendering.camera_path import MOST_FRAMES

    if not 0.5 <= count <= MOST_FRAMES:
        raise ValueError(f"a film has 1 to {MOST_FRAMES} frames; --seconds times --fps are {count:.6g}")
    return math.floor(count + 0.5)


@dataclass(frozen=True)
class FilmOutput:
    """Where a film goes.

    Attributes
    ----------
    pattern : path
        Of the numbered pictures: the result, or beside the MP4 until it is made.
    mp4 : bool
    """

    path: Path
    pattern: Path
    mp4: bool


def film_output(output: Path, background: str) -> FilmOutput:
    """What -o means; raises what would keep the film from being written."""
    from ..image.frames import check_pattern, note_of
    from ..image.mp4 import check_mp4
    from ..points.files import sweep

    if output.suffix.lower() == ".mp4" and not output.is_dir():
        check_mp4(output)
        if background == "none":
            raise ValueError(f"--background none: {TRANSPARENT}")
        pattern = Path(f"{output}.frames") / "%04d.png"
        folder = pattern.parent
        sweep(folder)
        if folder.is_dir() and any(folder.iterdir()) and not note_of(pattern).exists():
            raise ValueError(f"{folder}: not of a film that was interrupted, and its place is needed for frames")
        check_pattern(pattern)
        return FilmOutput(output, pattern, True)
    if "%" not in output.name and output.suffix and not output.is_dir():
        raise ValueError(f"{output}: a film is .mp4, or numbered pictures: a folder, or a name like %04d.png")
    pattern = output if "%" in output.name else output / "%04d.png"
    check_pattern(pattern)
    return FilmOutput(output, pattern, False)


class FilmSource(NamedTuple):
    """What a film shows.

    Attributes
    ----------
    build : callable
        Makes, with a Progress, the scene and the camera that a turntable turns.
    picture : Settings
    exposure : float or "auto"
        Auto: one for all frames.
    curve : str
        "auto": chosen with the exposure.
    backdrop : two sRGB colours, or None
    settings : dict
        What the scene depends on, as JSON takes it.
    leveled : bool
        Whether its models get levels of detail where frames would show these.
    """

    build: Callable[[Progress], tuple[Any, Any]]
    picture: Any
    exposure: float | str
    curve: str
    settings: dict[str, Any]
    leveled: bool = False
    backdrop: Any = None


def scan_source(scan_scene: ScanScene, view: View, picture: Any, exposure: float | str) -> FilmSource:
    """A film of a scan: the whole of it stays in the picture, where the view says nothing else."""

    def build(progress: Progress) -> tuple[Any, Any]:
        scene, _, scan = scan_scene.build(progress)
        return scene, view.turning(scan)

    leveled = picture.levels and scan_scene.is_plain
    return FilmSource(build, picture, exposure, AUTO, scan_scene.settings, leveled, scan_scene.backdrop)


def animate(output: FilmOutput, camera_path: CameraPath, source: FilmSource) -> str:
    """Render the frames that are not there yet, and write the film; returns a line that says what was done."""
    from ..image.frames import Frames
    from ..image.mp4 import even, write_mp4
    from ..image.write import SHOWN_BYTES
    from ..rendering.picture import check_picture, picture_bytes

    size = camera_path.view.size
    check_picture(size, picture_bytes(source.picture, written=SHOWN_BYTES))
    frames = Frames(output.pattern, _settings(camera_path, source), camera_path.count, size)
    missing, other = frames.find()
    if other:
        differ = ", ".join(name.replace("_", " ") for name in other)
        warnings.warn(f"{frames.pattern}: all frames are rendered anew: not as before: {differ}", stacklevel=2)
    with Progress(source.picture if missing else None) as progress:
        try:
            if missing:
                _render(frames, missing, camera_path, source, progress)
            if output.mp4:
                progress.show("writing the film", 1.0)
                with writing(output.path):
                    write_mp4(output.path, output.pattern, camera_path.count, camera_path.fps, size)
        except KeyboardInterrupt:
            warnings.warn(f"{output.path}: the same command goes on where this one stopped", stacklevel=2)
            raise
    with writing(output.path):
        if output.mp4:
            shutil.rmtree(output.pattern.parent)
        else:
            frames.finish()
    shape = f"{size[0]}x{size[1]}"
    if output.mp4 and even(size) != size:
        shape += " (an MP4 has even sides: {}x{})".format(*even(size))
    before = camera_path.count - len(missing)
    known = f", {before:,} of them from before" if before else ""
    seconds = camera_path.count / camera_path.fps
    return f"{output.path}: {shape}, {camera_path.count:,} frames{known}, {seconds:.3g} seconds"


def _render(frames: Any, missing: list[int], camera_path: CameraPath, source: FilmSource, progress: Progress) -> None:
    """Render frames, one after the other: each is kept before the next one begins."""
    from ..rendering.lod import is_far
    from ..rendering.picture import render

    scene, first = source.build(progress)
    cameras = camera_path.cameras(first)
    for model in scene.models if source.leveled else ():
        if not model.levels and any(is_far(model, camera, source.picture.most) for camera in cameras):
            in_background(partial(model.make_levels, progress.show))

    def picture(camera: Any, done: int) -> Any:
        def show(share: float) -> None:
            progress.show(f"frame {done + 1} of {len(missing)}", (done + share) / len(missing))

        show(0.0)
        return render(scene, camera, source.picture, show)

    exposure, curve = source.exposure, "srgb" if source.curve == AUTO else source.curve
    if isinstance(exposure, str):
        progress.show("choosing the exposure", 0.0)
        exposure, curve = in_background(lambda: _exposure(scene, cameras, source.picture))
    with writing(frames.pattern):
        frames.begin()
    for done, k in enumerate(missing):
        image = in_background(partial(picture, cameras[k], done))
        with writing(frames.path(k)):
            frames.keep(k, image, exposure, curve, source.backdrop)


def _exposure(scene: Any, cameras: list[Any], picture: Any) -> tuple[float, str]:
    """Exposure and curve for a film: the least of those that some small frames would have, so that none burns out."""
    from ..image.exposure import auto_exposure, auto_tone
    from ..rendering.picture import render_snapshot

    snapshot = scene.snapshot()
    few = replace(picture, spp=1, time_limit=None, noise=None, denoise=False)
    if picture.integrator != "phong":
        few = replace(few, spp=min(picture.most, PREVIEW_SAMPLES))
    images = []
    for camera in cameras[:: max(len(cameras) // PREVIEWS, 1)]:
        width, height = camera.size
        share = min(PREVIEW / max(width, height), 1.0)
        small = replace(camera, size=(max(1, round(width * share)), max(1, round(height * share))))
        images.append(render_snapshot(snapshot, small, few, None))
    curve = "soft" if any(auto_tone(image)[1] == "soft" for image in images) else "srgb"
    return min(auto_exposure(image, curve) for image in images), curve


def _settings(camera_path: CameraPath, source: FilmSource) -> dict[str, Any]:
    """All that the pictures depend on; not the threads, which make no difference."""
    from .. import __version__

    picture = {name: value for name, value in asdict(source.picture).items() if name != "threads"}
    film = {
        "version": __version__,
        "frames": camera_path.count,
        "size": camera_path.view.size,
        "exposure": source.exposure,
    }
    return {**film, **camera_path.settings, **picture, **source.settings}
