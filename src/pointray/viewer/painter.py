"""Draws the images of one browser in its own thread. The newest request wins; `pace` defines the policy."""

from __future__ import annotations

import io
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..auto_view.first_view import Scan
from ..auto_view.studio import with_direct_light
from ..baking.baked import Baked
from ..base.arrays import Floats
from ..engine.jit import Cancel
from ..image.screen import to_8bit
from ..image.tone import backdrop_rows
from ..rendering.camera import Camera
from ..rendering.picture import Picture
from ..rendering.settings import Settings
from ..scene.scene import Scene
from .baker import Baker
from .contacts import Contacts
from .fetcher import Fetcher
from .pace import MOVING, REFINED, REST, STILL, Pace, Stage, next_pass
from .sketch import Sketch
from .view_settings import ViewSettings

log = logging.getLogger("pointray.view")

BAKED = "baked"
EXPOSURE_TOLERANCE = 0.4  # stops: smaller changes of the automatic exposure are ignored
IN_FLIGHT = 2  # images sent but not yet drawn by the page: it draws one while the next is traced
SAMPLES_WHILE_BAKING = 4  # samples of a refined image until finer light is baked, which restarts it
MAX_JPEG_BYTES = 6 << 20  # IN_FLIGHT such images fit into `connection.MAX_WAITING`
MAGNIFIED = 500  # pixels: height below which moving images are not compressed more than still ones
COARSER = ((90, 2), (75, 2), (50, 2), (25, 2))  # (quality, subsampling) tried in turn for larger images


class FrameRequest(NamedTuple):
    """Description of the image to draw.

    Attributes
    ----------
    camera : Camera
    view : ViewSettings
        The panel's settings.
    scene : Scene
        The scene without these settings.
    version : (2,) tuple of int
        Changes whenever the scene is replaced or modified.
    up : (3,) tuple
        Up direction for the sun and the ground.
    refine : bool
        False while models are built, which needs the CPU: the image then has one sample per pixel.
    time : float
        Timestamp of the page's camera message, sent back with the image.
    sketch : Sketch or None
        Dots, drawn instead of the scene.
    bakes : bool
        False for the coarse version of a scene that is loading: it keeps direct light.
    scan : callable or None
        Returns the scene's points with their up direction, which decide whether there is a contact shadow.
    """

    camera: Camera
    view: ViewSettings
    scene: Scene
    version: tuple[int, int]
    up: tuple[float, float, float]
    refine: bool
    time: float
    sketch: Sketch | None = None
    bakes: bool = True
    scan: Callable[[], Scan] | None = None

    def same_picture(self, other: FrameRequest | None) -> bool:
        """Return whether both requests give the same image, so that the image need not be drawn again."""
        if other is None or self.view is not other.view:  # not ==: lights may hold arrays
            return False
        return (self.camera, self.version, self.refine) == (other.camera, other.version, other.refine)


class Frame(NamedTuple):
    """An encoded image for the page.

    number : counts the images of a browser from 1
    request : what was drawn; size : width and height in pixels
    stage : whether it was drawn while the camera moves, for a still camera, or with more samples
    samples : samples per pixel so far; jpeg : the encoded image
    seconds, rays : duration of the last pass, and camera rays traced in it
    """

    number: int
    request: FrameRequest
    size: tuple[int, int]
    stage: Stage
    samples: int
    jpeg: bytes
    seconds: float
    rays: int


class Painter:
    """Draws the images of one browser in its own thread. A newer request replaces the last one.

    Parameters
    ----------
    deliver : callable
        Called with each `Frame`, in the painter's thread.
    fail : callable
        Called with the reason why an image cannot be drawn.
    report : callable
        Called with stage, fraction done and seconds left (or None) while light is baked.
    """

    def __init__(
        self,
        deliver: Callable[[Frame], None],
        fail: Callable[[str], None],
        report: Callable[[str, float | None, float | None], None],
    ) -> None:
        self._deliver, self._fail = deliver, fail
        self._baker = Baker(self._draw_lit, report)
        self._fetcher = Fetcher(self._draw_again, fail)
        self._redrawn: FrameRequest | None = None  # a request drawn again at full resolution, with new light or parts
        self._changed = threading.Condition()
        self._request: FrameRequest | None = None
        self._asked = 0.0  # when `want` received it, by `time.perf_counter`
        self._open, self._cancel = True, Cancel()
        self._drawn, self._seen = 0, 0
        self._pace = Pace()
        self._contacts = Contacts()
        self._last_applied: tuple[FrameRequest, Scene] | None = None
        self._last_tone: tuple[ViewSettings, tuple[int, int], tuple[float, str]] | None = (
            None  # last automatic exposure and curve, with the view settings and version they were found for
        )
        self._times: deque[float] = deque(maxlen=60)
        self._thread = threading.Thread(target=self._run, name="pointray-painter", daemon=True)
        self._thread.start()

    def want(self, request: FrameRequest) -> None:
        """Request an image in place of the last request; a request for the same image has no effect."""
        with self._changed:
            if not self._open or request.same_picture(self._request):
                return
            self._request, self._asked = request, time.perf_counter()
            self._cancel()
            self._changed.notify_all()

    def _draw_lit(self) -> None:
        """Draw the current image again with new light, if it shows baked light."""
        request = self._request
        if request is not None and request.view.integrator == BAKED:
            self._draw_again()

    def _draw_again(self) -> None:
        """Draw the current image again, at full resolution, with light or parts of models that it lacked."""
        with self._changed:
            if self._request is not None:
                self._request = self._redrawn = self._request._replace()
                self._cancel()
                self._changed.notify_all()

    def seen(self, number: int) -> None:
        """Record that the page has displayed an image. number : `Frame.number`

        The painter waits while two images that it has sent are not displayed yet.
        """
        with self._changed:
            self._seen = max(self._seen, min(number, self._drawn))
            self._changed.notify_all()

    def close(self) -> None:
        """Stop drawing and baking, and drop references to scenes at once, so that their memory is released."""
        self._baker.close()
        self._fetcher.close()
        with self._changed:
            self._open = False
            self._request = self._redrawn = self._last_applied = None
            self._cancel()
            self._changed.notify_all()

    @property
    def has_ended(self) -> bool:
        """Whether drawing, baking and opening of parts have all stopped after `close`."""
        return not self._thread.is_alive() and self._baker.has_ended and self._fetcher.has_ended

    @property
    def frames_a_second(self) -> float:
        """Frame rate of the images of the last second, without refinements; 0 if there were fewer than three."""
        times = [t for t in self._times if t > time.perf_counter() - 1.0]
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 2 else 0.0

    def apply(self, request: FrameRequest) -> Scene:
        """Return the scene of a request with the panel's settings applied, such as lights and materials; cached."""
        applied = self._last_applied
        if applied is None or applied[0].version != request.version or not applied[0].view.same_scene(request.view):
            applied = request, request.view.apply(request.scene, request.up)
            with self._changed:
                self._last_applied = applied if self._open else None
        return applied[1]

    def _run(self) -> None:
        done: FrameRequest | None = None
        while (request := self._next(done)) is not None:
            try:
                self._draw(request)
            except (OSError, ValueError) as error:  # such as a missing file
                self._fail(str(error))
            except Exception as error:
                log.exception("error while drawing")
                self._fail(f"{type(error).__name__}: {error}")
            done = request

    def _next(self, done: FrameRequest | None) -> FrameRequest | None:
        """Wait for a request other than the last one, and for the page to display earlier images; None after `close`.

        done : the last request
        """
        with self._changed:
            while self._open and (self._request is done or self._drawn - self._seen >= IN_FLIGHT):
                self._changed.wait()
            self._cancel = Cancel()
            return self._request if self._open else None

    def _draw(self, request: FrameRequest) -> None:
        """Draw a request at the size that the frame rate allows.

        If no newer request arrives, draw it at full size and refine it.
        """
        if request.sketch is not None:
            begun = time.perf_counter()
            self._send(request, request.sketch.draw(request.camera), STILL, (1, 1), time.perf_counter() - begun)
            return
        scene, scale = self.apply(request), 1.0 if request is self._redrawn else self._pace.scale()
        begun = time.perf_counter()
        # The first image is shown despite newer requests: otherwise none would appear while the camera moves.
        self._show(request, scene, _scaled(request.camera, scale), MOVING if scale < 1 else STILL, None)
        self._pace.record(time.perf_counter() - begun, scale)
        self._times.append(time.perf_counter())
        if self._is_old(request, self._asked + REST - time.perf_counter()):
            return
        if scale < 1:
            self._show(request, scene, request.camera, STILL, self._cancel)
        self._refine(request, scene)

    def _show(self, request: FrameRequest, scene: Scene, camera: Camera, stage: Stage, cancel: Cancel | None) -> None:
        """Draw and send an image with one sample per pixel.

        scene : with the panel's settings; camera : with the size to draw
        stage : `MOVING` (fast, perhaps reduced) or `STILL` (full size), which also sets the quality of the JPEG
        cancel : when it is set, drawing stops and nothing is sent; None: the image is always sent
        """
        begun = time.perf_counter()
        settings = self._light(request, scene, request.view.settings(1))
        if stage is MOVING:  # contact shadows of one sample are mostly noise
            settings = replace(settings, sky_rays=0)
        picture = Picture(scene.snapshot(), camera, settings, fetch=self._fetcher, checked=stage is not MOVING)
        picture.add(0, 1, cancel=cancel)
        if cancel is None or not cancel.wanted:
            self._send(request, picture.image, stage, (1, 1), time.perf_counter() - begun)

    def _refine(self, request: FrameRequest, scene: Scene) -> None:
        """Add samples to an image in passes and send it after each, until it is complete or a newer request arrives.

        scene : with the panel's settings
        """
        most = request.view.samples
        if most == 1 or not request.refine or self._cancel.wanted:
            return
        settings = self._light(request, scene, request.view.settings(most))
        if settings.integrator != request.view.integrator:
            return  # no light yet: leave the CPU to baking
        if settings.integrator == BAKED and self._baker.is_baking:
            most = min(most, SAMPLES_WHILE_BAKING)
        picture = Picture(scene.snapshot(), request.camera, settings, in_passes=True, fetch=self._fetcher)
        done, last, seconds = 0, 1, 0.0
        while done < most:
            count = min(next_pass(last, seconds) if done else 2, most - done)
            begun = time.perf_counter()
            picture.add(done, done + count, cancel=self._cancel)
            if self._cancel.wanted:
                return
            done, last, seconds = done + count, count, time.perf_counter() - begun
            if not self._keeps_up(request):
                return
            self._send(request, picture.image, REFINED, (done, count), seconds)

    def _light(self, request: FrameRequest, scene: Scene, settings: Settings) -> Settings:
        """Attach the baked light that an image needs to a scene, and request its baking if there is none.

        Return the settings to draw with: until there is baked light, with direct light; if only levels of detail lack
        light, without these.

        scene : with the panel's settings; settings : those wanted
        """
        if settings.integrator != BAKED:
            return settings
        own = request.scene.baked  # such as from a file
        if isinstance(own, Baked) and own.fits(scene):
            if scene.baked is not own:
                scene.baked = own
            return settings
        light = self._baker.light_for(scene, request.refine) if request.bakes else None
        if light is None:
            return replace(with_direct_light(settings), sky_rays=0)  # fast: leave the CPU to baking
        if scene.baked is not light:
            scene.baked = light
        return replace(settings, levels=False) if light.lacks_levels(scene) else settings

    def light_of(self, scene: Scene) -> Baked | None:
        """Return the final (fine) baked light of a scene, or None if it is not baked yet; for exported images."""
        return self._baker.fine_for(scene)

    def _is_old(self, request: FrameRequest, seconds: float) -> bool:
        """Return whether there is a newer request, or one arrives within the given seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: self._request is not request or not self._open, seconds)

    def _keeps_up(self, request: FrameRequest) -> bool:
        """Wait until the page has displayed all but one of its images; return False if there is a newer request."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._request is not request or not self._open or self._drawn - self._seen < IN_FLIGHT
            )
            return self._request is request and self._open

    def _send(
        self, request: FrameRequest, image: Floats, stage: Stage, samples: tuple[int, int], seconds: float
    ) -> None:
        """Expose and encode an image, and deliver it to the page.

        image : (h, w, 4) float32, linear, premultiplied, with alpha
        stage : `MOVING`, `STILL` or `REFINED`, which sets the quality of the JPEG
        samples : the total per pixel, and the number per pixel added in the given seconds
        """
        view, tone = request.view, self._tone(request, image, stage)
        behind = backdrop_rows(view.behind, len(image))[:, 0]
        if request.sketch is None:
            seen = self.apply(request), request.version
            shadow = self._contacts.of(request.scan, seen, view, stage is REFINED)
            if shadow is not None:
                image = shadow.put_under(image, replace(request.camera, size=(image.shape[1], image.shape[0])))
        pixels = to_8bit(image, behind, *tone)
        jpeg = encode(pixels, stage)
        height, width = pixels.shape[:2]
        with self._changed:
            self._drawn += 1
        rays = width * height * samples[1]
        self._deliver(Frame(self._drawn, request, (width, height), stage, samples[0], jpeg, seconds, rays))

    def _tone(self, request: FrameRequest, image: Floats, stage: Stage) -> tuple[float, str]:
        """Return the exposure (stops) and tone curve (its name) of an image, (h, w, 4) float32, RGB and alpha.

        Automatic values are chosen again when the panel's settings or the scene change; the exposure also when a still
        image needs a much different one. Images therefore do not flicker while the camera moves.
        """
        view, known = request.view, self._last_tone
        if not view.auto_exposed:
            return view.tone(image)
        if known is None or known[0] is not view or known[1] != request.version:
            known = view, request.version, view.tone(image)
        elif stage is STILL:
            found = replace(view, curve=known[2][1]).tone(image)
            known = (*known[:2], found if abs(found[0] - known[2][0]) > EXPOSURE_TOLERANCE else known[2])
        self._last_tone = known
        return known[2]


def encode(pixels: NDArray[np.uint8], stage: Stage) -> bytes:
    """Encode pixels, (h, w, 3) uint8, as JPEG at their stage's quality.

    The quality is reduced if the result would exceed MAX_JPEG_BYTES (6 MiB), as noise at 4K does. Small moving images,
    which the page magnifies, get the quality of still ones: subsampled chroma would show coloured fringes.
    """
    stage = STILL if stage is MOVING and len(pixels) < MAGNIFIED else stage
    for quality, subsampling in ((stage.quality, stage.subsampling), *COARSER):
        stream = io.BytesIO()
        Image.fromarray(pixels).save(stream, "JPEG", quality=quality, subsampling=subsampling)
        if stream.tell() <= MAX_JPEG_BYTES:
            break
    return stream.getvalue()


def _scaled(camera: Camera, scale: float) -> Camera:
    """Return the camera for the same view with an image of `scale` times the width and height."""
    width, height = camera.size
    return replace(camera, size=(max(1, round(width * scale)), max(1, round(height * scale))))
