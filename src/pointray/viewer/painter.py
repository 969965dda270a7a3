"""The drawing of one browser's pictures, in a thread of its own: the newest wish wins, see `pace` for the policy."""

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

from ..image.screen import levels_of
from ..image.tone import backdrop_rows
from ..jit import Cancel
from ..rendering.camera import Camera
from ..rendering.picture import Picture
from ..scene.scene import Scene
from .looks import Looks
from .pace import MOVING, REFINED, REST, STILL, Pace, Stage, next_pass
from .sketch import Sketch

log = logging.getLogger("pointray.view")

STEADY = 0.4  # stops: a smaller change of what still pictures ask for is not followed
IN_FLIGHT = 2  # pictures on their way to the page: while it draws one, the next is traced
LARGEST = 6 << 20  # bytes of a picture: so many in flight fit into what may wait for a page, see `link`
COARSER = ((90, 2), (75, 2), (50, 2), (25, 2))  # quality and subsampling of those that would be larger


class Wish(NamedTuple):
    """What is to be seen.

    Attributes
    ----------
    version : of the scene
    up : of its sun and ground
    refine : bool
        Not while models are built: the processors are needed for that.
    time : of the page's message
    sketch : Sketch or None
        What is drawn, instead of the scene.
    """

    camera: Camera
    looks: Looks
    scene: Scene
    version: tuple[int, int]
    up: tuple[float, float, float]
    refine: bool
    time: float
    sketch: Sketch | None = None

    def same_picture(self, other: Wish | None) -> bool:
        """Whether nothing that is seen differs."""
        if other is None or self.looks is not other.looks:  # not ==: lights may hold arrays
            return False
        return (self.camera, self.version, self.refine) == (other.camera, other.version, other.refine)


class Frame(NamedTuple):
    """A picture as it goes to the page. seconds : that tracing took; rays : of the camera."""

    number: int
    wish: Wish
    size: tuple[int, int]
    stage: Stage
    samples: int
    jpeg: bytes
    seconds: float
    rays: int


class Painter:
    """Draws what is wished for last.

    Parameters
    ----------
    deliver : callable
        Takes each `Frame`, in the painter's thread.
    fail : callable
        Takes a text: why a picture cannot be drawn.
    """

    def __init__(self, deliver: Callable[[Frame], None], fail: Callable[[str], None]) -> None:
        self._deliver, self._fail = deliver, fail
        self._changed = threading.Condition()
        self._wish: Wish | None = None
        self._open, self._cancel = True, Cancel()
        self._drawn, self._seen = 0, 0
        self._pace = Pace()
        self._dressed: tuple[Wish, Scene] | None = None
        self._toned: tuple[Looks, tuple[int, int], tuple[float, str]] | None = None  # what was chosen, for which looks
        self._times: deque[float] = deque(maxlen=60)
        threading.Thread(target=self._run, name="pointray-painter", daemon=True).start()

    def want(self, wish: Wish) -> None:
        """From now on this is to be seen."""
        with self._changed:
            if wish.same_picture(self._wish):
                return
            self._wish = wish
            self._cancel()
            self._changed.notify_all()

    def seen(self, number: int) -> None:
        """The page has drawn a picture."""
        with self._changed:
            self._seen = max(self._seen, min(number, self._drawn))
            self._changed.notify_all()

    def close(self) -> None:
        """Draw no more."""
        with self._changed:
            self._open = False
            self._cancel()
            self._changed.notify_all()

    @property
    def frames_a_second(self) -> float:
        """Of the last moving pictures, until a second ago."""
        times = [t for t in self._times if t > time.perf_counter() - 1.0]
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 2 else 0.0

    def dress(self, wish: Wish) -> Scene:
        """The scene of a wish as it looks."""
        dressed = self._dressed
        if dressed is None or dressed[0].version != wish.version or not dressed[0].looks.dressed_like(wish.looks):
            dressed = self._dressed = wish, wish.looks.dress(wish.scene, wish.up)
        return dressed[1]

    def _run(self) -> None:
        done: Wish | None = None
        while (wish := self._next(done)) is not None:
            try:
                self._draw(wish)
            except ValueError as error:
                self._fail(str(error))
            except Exception as error:
                log.exception("while drawing")
                self._fail(f"{type(error).__name__}: {error}")
            done = wish

    def _next(self, done: Wish | None) -> Wish | None:
        """Wait for another wish, and for the page to keep up; None at the end."""
        with self._changed:
            while self._open and (self._wish is done or self._drawn - self._seen >= IN_FLIGHT):
                self._changed.wait()
            self._cancel = Cancel()
            return self._wish if self._open else None

    def _draw(self, wish: Wish) -> None:
        """All stages, until the picture is refined or something else is wished for."""
        if wish.sketch is not None:
            begun = time.perf_counter()
            self._send(wish, wish.sketch.draw(wish.camera), STILL, (1, 1), time.perf_counter() - begun)
            return
        scene, scale = self.dress(wish), self._pace.scale()
        begun = time.perf_counter()
        # The first one is shown whatever is wished for in the meantime: else nothing would be seen while things move.
        self._show(wish, scene, _scaled(wish.camera, scale), MOVING if scale < 1 else STILL, None)
        self._pace.took(time.perf_counter() - begun, scale)
        self._times.append(time.perf_counter())
        if self._is_old(wish, REST):
            return
        if scale < 1:
            self._show(wish, scene, wish.camera, STILL, self._cancel)
        self._refine(wish, scene)

    def _show(self, wish: Wish, scene: Scene, camera: Camera, stage: Stage, cancel: Cancel | None) -> None:
        """One sample a pixel."""
        begun = time.perf_counter()
        settings = wish.looks.settings(1)
        if stage is MOVING:  # contact shadows of one sample would be grain
            settings = replace(settings, sky_rays=0)
        picture = Picture(scene.snapshot(), camera, settings)
        picture.add(0, 1, cancel=cancel)
        if cancel is None or not cancel.wanted:
            self._send(wish, picture.image, stage, (1, 1), time.perf_counter() - begun)

    def _refine(self, wish: Wish, scene: Scene) -> None:
        """Add samples, and show what there is now and then."""
        most = wish.looks.samples
        if most == 1 or not wish.refine or self._cancel.wanted:
            return
        picture = Picture(scene.snapshot(), wish.camera, wish.looks.settings(most), in_passes=True)
        done, last, seconds = 0, 1, 0.0
        while done < most:
            count = min(next_pass(last, seconds) if done else 2, most - done)
            begun = time.perf_counter()
            picture.add(done, done + count, cancel=self._cancel)
            if self._cancel.wanted:
                return
            done, last, seconds = done + count, count, time.perf_counter() - begun
            if not self._keeps_up(wish):
                return
            self._send(wish, picture.image, REFINED, (done, count), seconds)

    def _is_old(self, wish: Wish, seconds: float) -> bool:
        """Whether something else is wished for, or is within some time."""
        with self._changed:
            return self._changed.wait_for(lambda: self._wish is not wish or not self._open, seconds)

    def _keeps_up(self, wish: Wish) -> bool:
        """Wait for the page; False if something else is wished for."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._wish is not wish or not self._open or self._drawn - self._seen < IN_FLIGHT
            )
            return self._wish is wish and self._open

    def _send(
        self, wish: Wish, image: NDArray[np.float32], stage: Stage, samples: tuple[int, int], seconds: float
    ) -> None:
        """Send a picture. samples : a pixel's in all, and those that were added in these seconds."""
        looks = wish.looks
        behind = backdrop_rows(looks.behind, len(image))[:, 0]
        levels = levels_of(image, behind, *self._tone(wish, image, stage))
        jpeg = encode(levels, stage)
        height, width = levels.shape[:2]
        with self._changed:
            self._drawn += 1
        rays = width * height * samples[1]
        self._deliver(Frame(self._drawn, wish, (width, height), stage, samples[0], jpeg, seconds, rays))

    def _tone(self, wish: Wish, image: NDArray[np.float32], stage: Stage) -> tuple[float, str]:
        """Exposure, stops, and curve. What is chosen is chosen anew where looks have changed; the exposure where still
        pictures ask for much more or less, so that nothing flickers while the camera moves."""
        looks, known = wish.looks, self._toned
        if not looks.chooses:
            return looks.tone(image)
        if known is None or known[0] is not looks or known[1] != wish.version:
            known = looks, wish.version, looks.tone(image)
        elif stage is STILL:
            found = replace(looks, curve=known[2][1]).tone(image)
            known = (*known[:2], found if abs(found[0] - known[2][0]) > STEADY else known[2])
        self._toned = known
        return known[2]


def encode(levels: NDArray[np.uint8], stage: Stage) -> bytes:
    """A JPEG as its stage has it; a coarser one where that is larger than LARGEST, as of noise on a huge view."""
    for quality, subsampling in ((stage.quality, stage.subsampling), *COARSER):
        stream = io.BytesIO()
        Image.fromarray(levels).save(stream, "JPEG", quality=quality, subsampling=subsampling)
        if stream.tell() <= LARGEST:
            break
    return stream.getvalue()


def _scaled(camera: Camera, scale: float) -> Camera:
    """The camera for a smaller picture."""
    width, height = camera.size
    return replace(camera, size=(max(1, round(width * scale)), max(1, round(height * scale))))
