"""One browser's session: its messages, and the reactions to them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..choices import AUTO, VIEWS
from ..rendering.camera import Camera
from ..scene.scene import Scene
from ..staging.framing import Lens
from .controls import Control, Folder
from .exports import Exports
from .light_control import MOST_LAMPS, SUN, light_controls_of
from .link import Link
from .messages import camera_of, free_of, number, parse, size_of, word
from .outbox import Outbox, legend_of
from .painter import Frame, FrameRequest, Painter
from .panel import Output, folders
from .pick import pick, prepare
from .share import Allowance
from .shared_scene import SharedScene
from .view_settings import CONSTANT, OWN, ViewSettings

log = logging.getLogger("pointray.view")

FOV = 40.0
SKETCHED = ViewSettings(exposes=True)  # for the sketch, before there is a scene
MOST_SAID = 10  # ignored messages of one page that are logged
COSTLY = frozenset({"press", "pick", "view"})  # messages that no user sends MOST_COSTLY times a second
MOST_COSTLY = 50.0  # a second; twice as many at once
TURN = 180.0  # degrees that the sun turns when dragged over a window's height


class Session:
    """A visitor of the server, see `server.Visitor`: the camera, the view settings and the pictures of one browser.

    Parameters
    ----------
    ended : callable
        Called when the browser has gone.
    """

    def __init__(self, link: Link, shared: SharedScene, ended: Callable[[Session], None]) -> None:
        self._shared, self._ended, self._outbox = shared, ended, Outbox(link)
        self._lock = threading.RLock()
        self._size: tuple[int, int] | None = None  # of the view; nothing is shown until it is known
        self._free = (0, 0, 1, 1)  # what the panel leaves free of the view: left, top, right, bottom, pixels
        self._time = 0.0
        self._camera: Camera | None = None
        self._at_home = False  # whether it is still where it was placed first
        self._sketched = False  # whether a sketch was shown last
        self._view: ViewSettings | None = None
        self._output = Output()
        self._version: tuple[int, int] | None = None
        self._lights: tuple[Any, ...] = ()  # the scene's lights, as last read
        self._around: Any = None
        self._picked: NDArray[np.float64] | None = None
        self._problem: tuple[int, str] = 0, ""
        self._asked: tuple[FrameRequest, tuple[float, float], str, bool] | None = None  # the next pick
        self._unexplained: FrameRequest | None = None  # the request whose legend is drawn next
        self._allowance = Allowance(MOST_COSTLY, 2 * MOST_COSTLY)
        self._nonsense = 0
        self._prepared = False  # whether loading for clicks has begun
        self._gone, self._told = False, threading.Lock()  # the lock guards `_gone` and `_news`
        self._news = False  # whether a change of the shared scene is still to be processed
        self._follower = ThreadPoolExecutor(1, "pointray-follower")
        self._jobs = ThreadPoolExecutor(1, "pointray-pick")
        self._exports = Exports(self._outbox)
        self._painter = Painter(
            self._deliver,
            lambda text: self._outbox.toast("error", text),
        )
        self._outbox.hello(shared.title)
        self._leave = shared.subscribe(self._hear)
        with self._lock:
            self._panel()
        self._follow()

    def receive(self, text: str) -> None:
        """Process a message of the page."""
        try:
            message = parse(text)
            handler = self._handlers.get(message["type"])
            if handler is None:
                raise ValueError(f"unknown type {message['type']!r:.40}")
            if message["type"] in COSTLY and not self._allowance.take():
                self._outbox.toast("warning", "too much was asked for at once: some of it was left out")
                return
            with self._lock:
                handler(self, message)
        except Exception as error:
            self._nonsense += 1
            if self._nonsense <= MOST_SAID:
                log.warning("ignored a message of the page: %s", error)

    def leave(self) -> None:
        """End: the browser has gone, and nothing more is drawn for it."""
        self._leave()
        self._painter.close()
        self._exports.stop()
        with self._lock, self._told:  # the scene may be notifying now: that ends before this, or does nothing
            self._gone = True
            self._follower.shutdown(wait=False, cancel_futures=True)
            self._jobs.shutdown(wait=False, cancel_futures=True)
        self._ended(self)

    # Messages of the page.

    def _on_size(self, message: dict[str, Any]) -> None:
        self._size, self._free = size_of(message), free_of(message)
        seen = self._shared.scene or self._shared.sketch
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
            self._shared.rebuild(**{name.removeprefix("build."): value})
            return
        if name.startswith("output."):
            self._output = self._output._replace(**{name.removeprefix("output."): value})
            return
        assert self._view is not None
        changed: dict[str, Any] = {name: value}
        if name in ("color_by", "colormap"):
            changed |= {"low": None, "high": None}
        for key, part in changed.items():
            self._view = self._view.with_value(key, part)
        self._changed(control.kind in ("choice", "switch"))

    def _on_press(self, message: dict[str, Any]) -> None:
        name = word(message, "name")
        self._control(name)
        scene = self._shared.scene
        if scene is None or self._view is None:
            return
        if name.startswith("lamps.add."):
            self._add_lamp(name.removeprefix("lamps.add."), scene)
        elif name.startswith("lamps."):
            self._view = self._view.without_lamp(int(name.split(".")[1]))
            self._changed(True)
        elif name == "save.stop":
            self._exports.stop()
        elif self._camera is not None:
            self._exports.start(name, self._request(), self._output, self._shared)

    def _on_sun(self, message: dict[str, Any]) -> None:
        dx, dy = number(message, "dx", -10, 10), number(message, "dy", -10, 10)
        scene = self._shared.scene
        if scene is None or self._view is None:
            return
        suns = [k for k, lamp in enumerate(self._view.lamps) if lamp.kind == SUN and lamp.on]
        if not suns:
            self._add_lamp(SUN, scene)
            return
        lamp = self._view.lamps[suns[0]]
        azimuth = (lamp.azimuth + TURN * dx + 180.0) % 360.0 - 180.0
        elevation = max(-90.0, min(90.0, lamp.elevation - TURN * dy))
        at = f"lamps.{suns[0]}."
        self._view = self._view.with_value(f"{at}azimuth", azimuth).with_value(f"{at}elevation", elevation)
        self._outbox.say(type="values", values={f"{at}azimuth": azimuth, f"{at}elevation": elevation})
        self._want()

    def _add_lamp(self, kind: str, scene: Scene) -> None:
        assert self._view is not None
        if len(self._view.lamps) >= MOST_LAMPS:
            self._outbox.toast("warning", f"there are {len(self._view.lamps):,} lights: remove one to add another")
            return
        self._view = self._view.with_lamp(kind, scene, self._shared.up)
        self._changed(True)

    def _on_view(self, message: dict[str, Any]) -> None:
        self._go(word(message, "name"), animate=True)

    def _on_pick(self, message: dict[str, Any]) -> None:
        x, y = number(message, "x", 0, 1), number(message, "y", 0, 1)
        purpose, extend = word(message, "purpose"), message.get("extend") is True
        if self._shared.scene is None or self._camera is None or self._view is None:
            return
        asked, self._asked = self._asked, (self._request(), (x, y), purpose, extend)
        if asked is None:  # else one is running, which takes this
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

    # Messages to the page.

    def _hear(self) -> None:
        """Process a change of the shared scene in this page's thread, not in the one that notifies all pages."""
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
        """Find what has changed, and react."""
        self._news = False
        self._outbox.progress(self._shared.progress)
        with self._lock:
            if self._gone:
                return
            problem = self._shared.failures, self._shared.problem
            if problem != self._problem:
                self._problem = problem
                if problem[1]:
                    self._outbox.toast("error", problem[1], stay=True)
            scene, version, sketch = self._shared.scene, self._shared.version, self._shared.sketch
            if version != self._version and ((scene is not None and scene.models) or sketch is not None):
                self._version = version
                begins = self._camera is None or (self._sketched and self._at_home)
                self._sketched = scene is None
                if scene is not None:
                    self._meet(scene)
                elif sketch is not None:
                    self._outbox.place(sketch, self._shared.up)
                if begins and self._size is not None:
                    self._go("home", animate=False)
            self._want()

    def _meet(self, scene: Scene) -> None:
        """Take a new scene, or more of it."""
        lights, around = scene.lights, (scene.shows_sky, None if scene.background is None else list(scene.background))
        if self._view is None:
            self._view = ViewSettings.of(self._shared, scene)
        if len(lights) != len(self._lights) or any(a is not b for a, b in zip(lights, self._lights, strict=True)):
            self._view = replace(self._view, lamps=light_controls_of(scene, self._shared.up))
        if around != self._around:
            self._view = self._view.before(scene)
        self._lights, self._around = lights, around
        self._outbox.place(scene, self._shared.up)
        self._panel()
        self._legend()

    def _go(self, name: str, animate: bool) -> None:
        """Move the page to one of the standard views."""
        seen, size = self._shared.scene or self._shared.sketch, self._size
        if seen is None or size is None or (name not in VIEWS and name != "home"):
            raise ValueError(f"there is no view {name!r:.40}")
        if name == "home" and self._shared.home is not None:
            camera = replace(self._shared.home, size=size)
        else:
            fov = FOV if self._camera is None else self._camera.fov
            camera = self._shared.scan(AUTO if name == "home" else name).camera(Lens(fov, size), self._part_free())
        if not animate:
            self._camera, self._at_home = camera, True
        self._outbox.go(camera, animate)

    def _part_free(self) -> tuple[float, float, float, float]:
        """The part of the view that the panel leaves free: left, top, right, bottom, shares."""
        width, height = self._size or (1, 1)
        left, top, right, bottom = self._free
        return left / width, top / height, right / width, bottom / height

    def _changed(self, rebuild: bool) -> None:
        """React to new view settings."""
        if rebuild:
            self._panel()
        self._want()
        self._legend()

    def _want(self) -> None:
        if self._camera is None or self._size is None:
            return
        shared, sketch = self._shared, self._shared.sketch
        if self._view is not None and shared.scene is not None:
            self._painter.want(self._request())
        elif sketch is not None:
            nothing, version = Scene(), shared.version
            self._painter.want(
                FrameRequest(self._camera, SKETCHED, nothing, version, shared.up, False, self._time, sketch)
            )

    def _request(self) -> FrameRequest:
        assert self._camera is not None and self._view is not None and self._shared.scene is not None
        shared, refine = self._shared, not self._shared.is_building
        return FrameRequest(self._camera, self._view, self._shared.scene, shared.version, shared.up, refine, self._time)

    def _panel(self) -> None:
        self._outbox.panel(self._folders())

    def _folders(self) -> list[Folder]:
        scene = self._shared.scene
        view = self._view or ViewSettings()
        return folders(view, self._shared, self._output, None if self._view is None else scene)

    def _control(self, name: str) -> Control:
        for folder in self._folders():
            for control in folder.controls:
                if control.name == name:
                    return control
        raise ValueError(f"there is no control {name!r:.60}")

    def _legend(self) -> None:
        """Send the legend of the colours."""
        assert self._view is not None
        if self._view.color_by in (OWN, CONSTANT) or self._view.material in ("mirror", "glass"):
            self._outbox.legend(None)
            return
        unexplained, self._unexplained = self._unexplained, self._request()
        if unexplained is None:  # else one is running, which takes this
            self._jobs.submit(self._draw_legend)

    def _draw_legend(self) -> None:
        """Draw and send the legend of the newest view settings."""
        with self._lock:
            request, self._unexplained = self._unexplained, None
        assert request is not None
        try:
            shown = self._painter.apply(request).shown_attributes[0]
            image = legend_of(shown)
        except ValueError:  # the painter reports it
            return
        with self._lock:
            if request.view is not self._view:
                return
            self._outbox.legend(image)
            if self._view.low is None and shown.range is not None:  # a range that was found can be changed now
                self._view = replace(self._view, low=shown.range[0], high=shown.range[1])
                self._panel()
                self._want()

    def _deliver(self, frame: Frame) -> None:
        """Send a picture. After the first one there is time to load what a click needs, which takes seconds."""
        self._outbox.frame(frame, self._painter.frames_a_second)
        with self._told:
            if not self._prepared and not self._gone and frame.request.sketch is None:
                self._prepared = True
                self._jobs.submit(self._prepare, frame.request.scene)

    def _prepare(self, scene: Scene) -> None:
        try:
            prepare(scene)
        except Exception:
            log.exception("while preparing for clicks")

    def _pick_newest(self) -> None:
        """Pick for the last of the clicks that have come while an earlier one was processed."""
        with self._lock:
            asked, self._asked = self._asked, None
        if asked is not None:
            self._pick(*asked)

    def _pick(self, request: FrameRequest, place: tuple[float, float], purpose: str, extend: bool) -> None:
        try:
            found = pick(self._painter.apply(request), request.camera, *place)
        except ValueError:  # the painter reports it
            return
        if found is None:
            return
        if purpose == "target":
            self._outbox.say(type="target", position=found.position.tolist())
            return
        self._outbox.found(found, self._picked if extend else None)
        self._picked = found.position
