"""Exports from the viewer: images and films as files, the view as a command or as Python code."""

from __future__ import annotations

import logging
import shlex
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..auto_view import HEADLIGHT, STUDIO
from ..auto_view.contact import ContactShadow
from ..baking.baked import Baked, bake
from ..baking.settings import BakeSettings
from ..base.arguments import Vector
from ..base.choices import AUTO, SAME
from ..image.frames import Frames
from ..image.mp4 import check_mp4, write_mp4
from ..image.tone import srgb_to_linear
from ..image.write import SHOWN_BYTES, check_image_path, write_image
from ..model.model import SURFACE, Model
from ..model.model_file import SAVED
from ..rendering.camera_path import turntable
from ..rendering.picture import check_picture, picture_bytes, render
from ..rendering.settings import Settings
from ..scene.scene import Scene
from ..shade.environment import EnvironmentLight
from ..shade.lights import PointLight, SunLight
from .contacts import Contacts
from .outbox import Outbox
from .painter import FrameRequest
from .panel import Output
from .shared_scene import Build, Progress, SharedScene
from .time_left import TimeLeft
from .view_settings import CONSTANT, OWN, ViewSettings

log = logging.getLogger("pointray.view")

SAMPLES = 4  # default of `Model`
MIME = {"png": "image/png", "jpg": "image/jpeg", "exr": "image/x-exr", "mp4": "video/mp4"}


class StoppedError(Exception):
    """Raised in the thread of an export when the user has stopped it."""


class Exports:
    """Saves images and animations for one browser in the background, one at a time.

    Also shows the view on the page as a command or as Python code to copy.

    Parameters
    ----------
    outbox : Outbox
        Messages to the page, which receives the files.
    light_of : callable
        Returns the finely baked light of a scene, or None if it is not baked yet.
    """

    def __init__(self, outbox: Outbox, light_of: Callable[[Scene], Baked | None]) -> None:
        self._outbox, self._light_of, self._time_left = outbox, light_of, TimeLeft()
        self._stop, self._contacts = threading.Event(), Contacts()
        self._thread: threading.Thread | None = None

    def start(self, name: str, request: FrameRequest, output: Output, shared: SharedScene) -> None:
        """Start rendering an image or animation in a thread, or send the page a text to copy, as a button requests.

        While an image or animation is in progress, another one is refused with a warning on the page.

        name : "save.picture", "save.film", "copy.command" or "copy.python"
        request : the image shown; output : size, samples and format
        shared : gives the name of the file, and the source and surface options of the command
        """
        if name == "copy.command":
            source = shared.source if self._outbox.is_local else Path(shared.source).name
            text = _command(request, output, source, shared.build)
            self._outbox.send_message(type="copy", text=text, title="View and lights as command")
            return
        if name == "copy.python":
            self._outbox.send_message(type="copy", text=_python(request, output), title="Camera as Python")
            return
        if not self.has_ended:
            self._outbox.toast("warning", "an export is in progress: wait for it or stop it")
            return
        self._stop.clear()
        work = self._film if name == "save.film" else self._picture
        self._thread = threading.Thread(
            target=self._run, args=(work, request, output, Path(shared.title).stem), name="pointray-export", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Stop the export in progress at its next progress report; return at once."""
        self._stop.set()

    @property
    def has_ended(self) -> bool:
        """Whether no export is in progress."""
        return self._thread is None or not self._thread.is_alive()

    def _run(self, work: Callable[..., None], request: FrameRequest, output: Output, stem: str) -> None:
        try:
            with tempfile.TemporaryDirectory(prefix="pointray-") as folder:
                work(request, output, Path(folder), stem)
        except StoppedError:
            self._outbox.toast("info", "stopped")
        except (OSError, ValueError) as error:
            self._outbox.toast("error", str(error))
        except Exception as error:
            log.exception("error while saving")
            self._outbox.toast("error", f"{type(error).__name__}: {error}")
        self._outbox.progress(Progress())

    def _picture(self, request: FrameRequest, output: Output, folder: Path, stem: str) -> None:
        """Render an image and send it to the page as a file.

        request : camera and scene; output : size, samples and format
        folder : temporary folder; stem : file name without suffix
        """
        path = folder / f"{stem}.{output.format}"
        check_image_path(path)
        settings = replace(request.view.settings(output.samples), denoise=output.denoise)
        camera = replace(request.camera, size=(output.width, output.height))
        scene = request.view.apply(request.scene, request.up)
        check_picture(camera.size, picture_bytes(settings, written=SHOWN_BYTES))
        self._light(scene, request.scene, settings)
        image = render(scene, camera, settings, lambda _, share: self._report_progress("picture", share))
        legend = next(iter(scene.shown_attributes), None) if output.format != "exr" else None
        backdrop = None if output.format == "exr" else request.view.behind
        tone = request.view.tone(image)
        shadow = None if backdrop is None else self._shadow(request, scene)
        image = image if shadow is None else shadow.put_under(image, camera)
        write_image(path, image, *tone, legend, backdrop)
        del image  # frees memory for sending the file
        self._publish(path)

    def _film(self, request: FrameRequest, output: Output, folder: Path, stem: str) -> None:
        """Render a turntable animation as MP4 and send it to the page.

        request : first camera and scene; output : size, samples, duration and frame rate
        folder : temporary folder; stem : file name without suffix
        """
        path = folder / f"{stem}.mp4"
        check_mp4(path)
        settings = replace(request.view.settings(output.samples), denoise=output.denoise)
        count = max(1, round(output.seconds * output.fps))
        size = output.width, output.height
        scene = request.view.apply(request.scene, request.up)
        self._light(scene, request.scene, settings)
        frames = Frames(folder / "frames" / "%04d.png", {}, count, size)
        frames.begin()
        for k, camera in enumerate(turntable(replace(request.camera, up=request.up, size=size), count)):

            def report_share(stage: str, share: float, k: int = k) -> None:
                self._report_progress("film", (k + share) / count)

            image = render(scene, camera, settings, report_share)
            self._report_progress("film", (k + 1) / count)
            if k == 0:  # once for the whole film
                stops, curve = request.view.tone(image)
                shadow = self._shadow(request, scene)
            image = image if shadow is None else shadow.put_under(image, camera)
            frames.keep(k, image, stops, curve, request.view.behind)
        write_mp4(path, frames.pattern, count, output.fps, size)
        self._publish(path)

    def _light(self, scene: Scene, shown: Scene, settings: Settings) -> None:
        """Set the baked light of a scene to be rendered if the settings need it.

        It is the light of `shown` if that fits, else the one baked for the browser's images, else it is baked now.

        scene : with the panel's settings applied; shown : the same scene without them
        """
        if settings.integrator != "baked":
            return
        own = shown.baked  # such as from a file
        light = own if isinstance(own, Baked) and own.fits(scene) else self._light_of(scene)
        scene.baked = light or bake(scene.copy(), BakeSettings(), self._report_progress)

    def _shadow(self, request: FrameRequest, scene: Scene) -> ContactShadow | None:
        return self._contacts.of(request.scan, (scene, request.version), request.view)

    def _report_progress(self, stage: str, share: float) -> None:
        if self._stop.is_set():
            raise StoppedError
        self._outbox.progress(Progress(stage, share, self._time_left(stage, share)))

    def _publish(self, path: Path) -> None:
        self._outbox.file(path, MIME[path.suffix[1:]])


def _command(request: FrameRequest, output: Output, source: str, build: Build | None = None) -> str:
    """Return a `pointray render` command that renders the view, as far as options exist for it.

    request : the image shown; output : its size, samples and format
    source : file to render; build : how the models are built; None: with the command line's defaults
    """
    camera, view = request.camera, request.view
    words = ["pointray", "render", source, "-o", f"picture.{output.format}"]
    words += [f"--{name}={_commas(getattr(camera, name))}" for name in ("eye", "target", "up")]
    words += ["--fov", f"{camera.fov:.6g}", "--size", f"{output.width}x{output.height}"]
    words += [] if camera.projection == "perspective" else ["--projection", camera.projection]
    words += ["--integrator", view.integrator, "--spp", str(output.samples)]
    words += ["--exposure", "auto" if view.auto_exposed else f"{view.exposure:g}"]
    words += [] if view.levels else ["--no-levels"]
    is_scan = not source.endswith(".toml")
    if view.integrator in ("phong", "baked") and (is_scan or view.backfaces != view.base.backfaces):
        words += ["--backfaces", view.backfaces]
    if is_scan:
        words += _light_options(view, request.up)
        words += [] if view.contact_shadow else ["--no-contact-shadow"]
        words += [] if build is None or source.endswith(SAVED) else _surface_options(build, request.scene.models)
        words += ["--ground"] if view.ground else []
        color = _commas(srgb_to_linear(np.array(view.backdrop)))
        words += ["--background", {"sky": "sky", "gradient": "auto"}.get(view.around, color)]
        if view.color_by not in (OWN, CONSTANT):
            words += ["--color-by", f"{view.color_by}:{view.colormap}"]
    return shlex.join(words)


def _surface_options(build: Build, models: Sequence[Model]) -> list[str]:
    """Return the options of `pointray render` for a surface that differs from the defaults.

    build : values of the panel; models : the shown ones, for the exact value of --smooth
    """
    defaults, words = Build(SURFACE, SAMPLES), []
    for name in ("surface", "samples", "radius_scale", "scatter", "scatter_size"):
        value = getattr(build, name)
        if value != getattr(defaults, name):
            words += [f"--{name.replace('_', '-')}", f"{value:g}" if isinstance(value, float) else str(value)]
    smooth = next((model.smooth for model in models), AUTO)
    return words if smooth == AUTO else [*words, "--smooth", f"{smooth:.9g}"]


def _light_options(view: ViewSettings, up: Vector) -> list[str]:
    """Return the lights as options of `pointray render`; none for a studio with baked light, the default.

    up : direction about which the azimuths of lights are measured
    """
    lights = view.lights(up)
    if not lights:
        return ["--light", HEADLIGHT]
    if view.look == STUDIO and view.integrator == "baked":
        return []
    texts = [text for light in lights if (text := _light_text(light))]
    words = [word for text in texts for word in ("--light", text)]
    return [*words, "--fill", "0"] if texts and not any(text.startswith("sky") for text in texts) else words


def _light_text(light: Any) -> str:
    """Return a light as the value of --light; an empty text for lights that the command line does not support."""
    if isinstance(light, SunLight):
        along = ",camera" if light.camera else ""
        return f"sun:{_commas(light.direction)}:{float(np.max(light.irradiance)):.6g}{along}"
    if isinstance(light, PointLight):
        along = ",camera" if light.camera else ""
        return f"point:{_commas(light.position)}:{float(np.max(light.intensity)):.6g}{along}"
    if isinstance(light, EnvironmentLight) and light.image is None and light.horizon is None and light.ground is None:
        return f"sky:{_commas(np.broadcast_to(light.radiance, 3))}"
    return ""


def _python(request: FrameRequest, output: Output) -> str:
    """Return Python code that renders the view; it expects the scene in a variable `scene`."""
    camera, view = request.camera, request.view
    eye, target, up = (f"[{', '.join(repr(float(x)) for x in v)}]" for v in (camera.eye, camera.target, camera.up))
    size = output.width, output.height
    more = "" if view.levels else ", levels=False"
    more += "" if view.backfaces == SAME else f', backfaces="{view.backfaces}"'
    exposure = '"auto"' if view.auto_exposed else f"{view.exposure}"
    projection = "" if camera.projection == "perspective" else f', projection="{camera.projection}"'
    return (
        f"camera = pr.Camera.look_at({eye}, {target}, {up}, fov={camera.fov:.6g}, size={size}{projection})\n"
        f'settings = pr.Settings("{view.integrator}", spp={output.samples}, shadows={view.shadows}{more})\n'
        f"image = pr.render(scene, camera, settings)\n"
        f'pr.write_image("picture.{output.format}", image, exposure={exposure}, curve="{view.curve}")'
    )


def _commas(vector: Any) -> str:
    return ",".join(f"{float(x):.9g}" for x in vector)
