"""One browser: what it says, and what is done about it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..rendering.camera import Camera
from ..scene.scene import Scene
from ..staging.direction import VIEWS
from ..staging.first_view import AUTO
from ..staging.framing import Lens
from .controls import Control, Folder
from .exports import Exports
from .lamps import MOST_LAMPS, SUN, lamps_of
from .link import Link
from .looks import CONSTANT, OWN, Looks
from .messages import camera_of, free_of, number, parse, size_of, word
from .painter import Frame, Painter, Wish
from .panel import Output, folders
from .pick import pick, prepare
from .share import Allowance
from .subject import Subject
from .voice import Voice, legend_of

log = logging.getLogger("pointray.view")

FOV = 40.0
SKETCHED = Looks(exposes=True)  # of what is seen before there is a scene
MOST_SAID = 10  # messages of one page that are ignored and told in the log
COSTLY = frozenset({"press", "pick", "view"})  # messages of which no hand makes MOST_COSTLY a second
MOST_COSTLY = 50.0  # a second; twice as many at once
TURN = 180.0  # degrees that the sun turns over a window's height


class Session:
    """A visitor of the server, see `server.Visitor`: its camera, its looks, its pictures.

    Parameters
    ----------
    ended : callable
        Told when the browser has gone.
    """

    def __init__(self, link: Link, subject: Subject, ended: Callable[[Session], None]) -> None:
        self._subject, self._ended, self._voice = subject, ended, Voice(link)
        self._lock = threading.RLock()
        self._size: tuple[int, int] | None = None  # of the view; until it is known nothing is shown
        self._free = (0, 0, 1, 1)  # what the panel leaves free of it: left, top, right, bottom, pixels
        self._time = 0.0
        self._camera: Camera | None = None
        self._at_home = False  # where it was taken at first, and has not moved
        self._sketched = False  # whether what was seen last is a sketch
        self._looks: Looks | None = None
        self._output = Output()
        self._version: tuple[int, int] | None = None
        self._lights: tuple[Any, ...] = ()  # of the scene, when it was looked at last
        self._around: Any = None
        self._picked: NDArray[np.float64] | None = None
        self._problem: tuple[int, str] = 0, ""
        self._asked: tuple[Wish, tuple[float, float], str, bool] | None = None  # what is to be picked next
        self._unexplained: Wish | None = None  # whose legend is to be drawn next
        self._allowance = Allowance(MOST_COSTLY, 2 * MOST_COSTLY)
        self._nonsense = 0
        self._prepared = False  # whether what clicks need is being loaded
        self._gone, self._told = False, threading.Lock()  # the lock: of `_news`, and of the going for it
        self._news = False  # whether a change of the subject is still to be looked at
        self._follower = ThreadPoolExecutor(1, "pointray-follower")
        self._jobs = ThreadPoolExecutor(1, "pointray-pick")
        self._exports = Exports(self._voice)
        self._painter = Painter(
            self._deliver,
            lambda text: self._voice.toast("error", text),
        )
        self._voice.hello(subject.title)
        self._leave = subject.listen(self._hear)
        with self._lock:
            self._panel()
        self._follow()

    def receive(self, text: str) -> None:
        """A message of the page."""
        try:
            message = parse(text)
            handler = self._handlers.get(message["type"])
            if handler is None:
                raise ValueError(f"unknown type {message['type']!r:.40}")
            if message["type"] in COSTLY and not self._allowance.take():
                self._voice.toast("warning", "too much was asked for at once: some of it was left out")
                return
            with self._lock:
                handler(self, message)
        except Exception as error:
            self._nonsense += 1
            if self._nonsense <= MOST_SAID:
                log.warning("ignored a message of the page: %s", error)

    def leave(self) -> None:
        """The browser has gone: nothing more is drawn for it."""
        self._leave()
        self._painter.close()
        self._exports.stop()
        with self._lock, self._told:  # the subject may be telling of a change just now: before this, or not at all
            self._gone = True
            self._follower.shutdown(wait=False, cancel_futures=True)
            self._jobs.shutdown(wait=False, cancel_futures=True)
        self._ended(self)

    # What the page says.

    def _on_size(self, message: dict[str, Any]) -> None:
        self._size, self._free = size_of(message), free_of(message)
        seen = self._subject.scene or self._subject.sketch
        if (self._camera is None or self._at_home) and seen is not None:
            self._go("home", animate=False)  # as large as fits into this view
        elif self._camera is not None:
            self._camera = replace(self._camera, size=self._size)
        self._want()

    def _on_camera(self, message: dict[str, Any]) -> None:
        self._camera = camera_of(message, self._size or (1, 1))
        self._at_home = False
        self._time = number(message, "time")
        self._want()

    def _on_seen(self, message: dict[str, Any]) -> None:
        self._painter.seen(int(number(message, "number", 0)))

    def _on_set(self, message: dict[str, Any]) -> None:
        name = word(message, "name")
        control = self._control(name)
        value = control.check(message.get("value"))
        if name.startswith("build."):
            self._subject.rebuild(**{name.removeprefix("build."): value})
            return
        if name.startswith("output."):
            self._output = self._output._replace(**{name.removeprefix("output."): value})
            return
        assert self._looks is not None
        changed: dict[str, Any] = {name: value}
        if name in ("color_by", "colormap"):
            changed |= {"low": None, "high": None}
        for key, part in changed.items():
            self._looks = self._looks.with_value(key, part)
        self._changed(control.kind in ("choice", "switch"))

    def _on_press(self, message: dict[str, Any]) -> None:
        name = word(message, "name")
        self._control(name)
        scene = self._subject.scene
        if scene is None or self._looks is None:
            return
        if name.startswith("lamps.add."):
            self._add_lamp(name.removeprefix("lamps.add."), scene)
        elif name.startswith("lamps."):
            self._looks = self._looks.without_lamp(int(name.split(".")[1]))
            self._changed(True)
        elif name == "save.stop":
            self._exports.stop()
        elif self._camera is not None:
            self._exports.start(name, self._wish(), self._output, self._subject)

    def _on_sun(self, message: dict[str, Any]) -> None:
        dx, dy = number(message, "dx", -10, 10), number(message, "dy", -10, 10)
        scene = self._subject.scene
        if scene is None or self._looks is None:
            return
        suns = [k for k, lamp in enumerate(self._looks.lamps) if lamp.kind == SUN and lamp.on]
        if not suns:
            self._add_lamp(SUN, scene)
            return
        lamp = self._looks.lamps[suns[0]]
        azimuth = (lamp.azimuth + TURN * dx + 180.0) % 360.0 - 180.0
        elevation = max(-90.0, min(90.0, lamp.elevation - TURN * dy))
        at = f"lamps.{suns[0]}."
        self._looks = self._looks.with_value(f"{at}azimuth", azimuth).with_value(f"{at}elevation", elevation)
        self._voice.say(type="values", values={f"{at}azimuth": azimuth, f"{at}elevation": elevation})
        self._want()

    def _add_lamp(self, kind: str, scene: Scene) -> None:
        assert self._looks is not None
        if len(self._looks.lamps) >= MOST_LAMPS:
            self._voice.toast("warning", f"there are {len(self._looks.lamps):,} lights: remove one to add another")
            return
        self._looks = self._looks.with_lamp(kind, scene, self._subject.up)
        self._changed(True)

    def _on_view(self, message: dict[str, Any]) -> None:
        self._go(word(message, "name"), animate=True)

    def _on_pick(self, message: dict[str, Any]) -> None:
        x, y = number(message, "x", 0, 1), number(message, "y", 0, 1)
        purpose, extend = word(message, "purpose"), message.get("extend") is True
        if self._subject.scene is None or self._camera is None or self._looks is None:
            return
        asked, self._asked = self._asked, (self._wish(), (x, y), purpose, extend)
        if asked is None:  # else one is on its way, which takes this
            self._jobs.submit(self._pick_newest)

    def _on_clear(self, message: dict[str, Any]) -> None:
        self._picked = None

    _handlers: dict[str, Callable[[Any, dict[str, Any]], None]] = {
        "size": _on_size,
        "camera": _on_camera,
        "seen": _on_seen,
        "set": _on_set,
        "press": _on_press,
        "sun": _on_sun,
        "view": _on_view,
        "pick": _on_pick,
        "clear": _on_clear,
    }

    # What the page is told.

    def _hear(self) -> None:
        """The subject has changed in some way: looked at in a thread of this page, not of who tells all pages."""
        with self._told:
            if not self._gone and not self._news:
                self._news = True
                self._follower.submit(self._follow_logged)

    def _follow_logged(self) -> None:
        try:
            self._follow()
        except Exception:
            log.exception("while telling a browser")

    def _follow(self) -> None:
        """See what has changed."""
        self._news = False
        self._voice.progress(self._subject.progress)
        with self._lock:
            if self._gone:
                return
            problem = self._subject.failures, self._subject.problem
            if problem != self._problem:
                self._problem = problem
                if problem[1]:
                    self._voice.toast("error", problem[1], stay=True)
            scene, version, sketch = self._subject.scene, self._subject.version, self._subject.sketch
            if version != self._version and ((scene is not None and scene.models) or sketch is not None):
                self._version = version
                begins = self._camera is None or (self._sketched and self._at_home)
                self._sketched = scene is None
                if scene is not None:
                    self._meet(scene)
                elif sketch is not None:
                    self._voice.place(sketch, self._subject.up)
                if begins and self._size is not None:
                    self._go("home", animate=False)
            self._want()

    def _meet(self, scene: Scene) -> None:
        """There is another scene, or more of it."""
        lights, around = scene.lights, (scene.shows_sky, None if scene.background is None else list(scene.background))
        if self._looks is None:
            self._looks = Looks.of(self._subject, scene)
        if len(lights) != len(self._lights) or any(a is not b for a, b in zip(lights, self._lights, strict=True)):
            self._looks = replace(self._looks, lamps=lamps_of(scene, self._subject.up))
        if around != self._around:
            self._looks = self._looks.before(scene)
        self._lights, self._around = lights, around
        self._voice.place(scene, self._subject.up)
        self._panel()
        self._legend()

    def _go(self, name: str, animate: bool) -> None:
        """Take the page to one of the standard views."""
        seen, size = self._subject.scene or self._subject.sketch, self._size
        if seen is None or size is None or (name not in VIEWS and name != "home"):
            raise ValueError(f"there is no view {name!r:.40}")
        if name == "home" and self._subject.home is not None:
            camera = replace(self._subject.home, size=size)
        else:
            fov = FOV if self._camera is None else self._camera.fov
            camera = self._subject.scan(AUTO if name == "home" else name).camera(Lens(fov, size), self._part_free())
        if not animate:
            self._camera, self._at_home = camera, True
        self._voice.go(camera, animate)

    def _part_free(self) -> tuple[float, float, float, float]:
        """What the panel leaves free of the view: left, top, right, bottom, shares."""
        width, height = self._size or (1, 1)
        left, top, right, bottom = self._free
        return left / width, top / height, right / width, bottom / height

    def _changed(self, rebuild: bool) -> None:
        """The looks are others."""
        if rebuild:
            self._panel()
        self._want()
        self._legend()

    def _want(self) -> None:
        if self._camera is None or self._size is None:
            return
        subject, sketch = self._subject, self._subject.sketch
        if self._looks is not None and subject.scene is not None:
            self._painter.want(self._wish())
        elif sketch is not None:
            nothing, version = Scene(), subject.version
            self._painter.want(Wish(self._camera, SKETCHED, nothing, version, subject.up, False, self._time, sketch))

    def _wish(self) -> Wish:
        assert self._camera is not None and self._looks is not None and self._subject.scene is not None
        subject, refine = self._subject, not self._subject.is_building
        return Wish(self._camera, self._looks, self._subject.scene, subject.version, subject.up, refine, self._time)

    def _panel(self) -> None:
        self._voice.panel(self._folders())

    def _folders(self) -> list[Folder]:
        scene = self._subject.scene
        looks = self._looks or Looks()
        return folders(looks, self._subject, self._output, None if self._looks is None else scene)

    def _control(self, name: str) -> Control:
        for folder in self._folders():
            for control in folder.controls:
                if control.name == name:
                    return control
        raise ValueError(f"there is no control {name!r:.60}")

    def _legend(self) -> None:
        """Say what the colours mean."""
        assert self._looks is not None
        if self._looks.color_by in (OWN, CONSTANT) or self._looks.material in ("mirror", "glass"):
            self._voice.legend(None)
            return
        unexplained, self._unexplained = self._unexplained, self._wish()
        if unexplained is None:  # else one is on its way, which takes this
            self._jobs.submit(self._draw_legend)

    def _draw_legend(self) -> None:
        """For the newest looks."""
        with self._lock:
            wish, self._unexplained = self._unexplained, None
        assert wish is not None
        try:
            shown = self._painter.dress(wish).shown_attributes[0]
            image = legend_of(shown)
        except ValueError:  # the painter says so
            return
        with self._lock:
            if wish.looks is not self._looks:
                return
            self._voice.legend(image)
            if self._looks.low is None and shown.range is not None:  # what was found can be changed now
                self._looks = replace(self._looks, low=shown.range[0], high=shown.range[1])
                self._panel()
                self._want()

    def _deliver(self, frame: Frame) -> None:
        """Send a picture. After the first one there is time to load what a click needs, which takes seconds."""
        self._voice.frame(frame, self._painter.frames_a_second)
        with self._told:
            if not self._prepared and not self._gone and frame.wish.sketch is None:
                self._prepared = True
                self._jobs.submit(self._prepare, frame.wish.scene)

    def _prepare(self, scene: Scene) -> None:
        try:
            prepare(scene)
        except Exception:
            log.exception("while preparing for clicks")

    def _pick_newest(self) -> None:
        """Of clicks that have come while another one was looked at the last one counts."""
        with self._lock:
            asked, self._asked = self._asked, None
        if asked is not None:
            self._pick(*asked)

    def _pick(self, wish: Wish, place: tuple[float, float], purpose: str, extend: bool) -> None:
        try:
            found = pick(self._painter.dress(wish), wish.camera, *place)
        except ValueError:  # the painter says so
            return
        if found is None:
            return
        if purpose == "target":
            self._voice.say(type="target", position=found.position.tolist())
            return
        self._voice.found(found, self._picked if extend else None)
        self._picked = found.position
