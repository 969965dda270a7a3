"""Session of one browser: processes its messages and changes of the shared scene, one at a time."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from ..baking.baked import Baked
from ..rendering.camera import Camera
from ..scene.scene import Scene
from ..shade.attributes import Attribute
from .connection import PageLink
from .display import Display
from .exports import Exports
from .light_control import MAX_LIGHTS, SUN
from .messages import camera_of, free_of, number, parse, short_text, size_of
from .outbox import Outbox
from .page_limits import RateLimiter
from .painter import Frame, FrameRequest, Painter
from .queries import Click, Lookups
from .shared_scene import Progress, SharedScene
from .view_settings import ViewSettings

log = logging.getLogger("pointray.view")

MAX_LOGGED = 10  # invalid messages logged for each page
COSTLY = frozenset({"press", "pick", "view"})  # message types with a rate limit
AUTOMATIC = frozenset({"seen", "size"})  # message types that the page sends without input by the user
COSTLY_RATE = 50.0  # messages a second; bursts of twice as many are allowed
TURN = 180.0  # degrees that the sun turns for a drag over the window's height


class Session:
    """Handler of the messages of one browser: changes its camera, panel and image, and starts exports.

    It also updates the page when the shared scene changes.

    Parameters
    ----------
    link : PageLink
        The connection to the browser.
    shared : SharedScene
        The scene that all browsers show.
    ended : callable
        Called with the session when the browser has disconnected.

    Attributes
    ----------
    used : float
        When the user last did something on the page, or opened it, by `time.monotonic`.
    """

    def __init__(self, link: PageLink, shared: SharedScene, ended: Callable[[Session], None]) -> None:
        self._shared, self._ended, self._outbox = shared, ended, Outbox(link)
        self._rate_limiter = RateLimiter(COSTLY_RATE, 2 * COSTLY_RATE)
        self._invalid_count = 0
        self.used = time.monotonic()
        self._gone, self._state_lock = False, threading.Lock()  # the lock guards `_gone` and `_news`
        self._has_changes = False  # whether a change of the shared scene awaits processing
        self._follower = ThreadPoolExecutor(1, "pointray-follower")
        self._exports = Exports(self._outbox, self.light_of)
        self._painter = Painter(self._deliver, lambda text: self._outbox.toast("error", text), self._report_baking)
        self._lookups = Lookups(self._outbox, self._painter.apply, self._show_legend)
        self._lock = threading.RLock()  # guards the display
        self._display = Display(shared, self._outbox, self._painter, self._lookups)
        self._outbox.hello(shared.title)
        self._leave = shared.subscribe(self._on_change)
        with self._lock:
            self._display.send_panel()
        self._follow()

    def receive(self, text: str) -> None:
        """Process a message of the page (JSON). Invalid messages are ignored and logged."""
        try:
            message = parse(text)
            handler = self._handlers.get(message["type"])
            if handler is None:
                raise ValueError(f"unknown type {message['type']!r:.40}")
            if message["type"] in COSTLY and not self._rate_limiter.take():
                self._outbox.toast("warning", "too many requests at once: some were ignored")
                return
            if message["type"] not in AUTOMATIC:
                self.used = time.monotonic()
            with self._lock:
                handler(self, message)
        except Exception as error:
            self._invalid_count += 1
            if self._invalid_count <= MAX_LOGGED:
                log.warning("ignored a message of the page: %s", error)

    def leave(self) -> None:
        """End the session after the browser has disconnected: stop drawing, baking and saving."""
        self._leave()
        self._painter.close()
        self._exports.stop()
        with self._lock, self._state_lock:  # a notification in progress ends first
            self._gone = True
            self._follower.shutdown(wait=False, cancel_futures=True)
            self._lookups.stop()
        self._ended(self)

    @property
    def has_ended(self) -> bool:
        """Whether drawing, baking and saving have all stopped after `leave`."""
        return self._painter.has_ended and self._exports.has_ended

    # Calls from Python.

    @property
    def camera(self) -> Camera | None:
        """The camera of the page; None before the page has one."""
        return self._display.camera

    @property
    def state(self) -> tuple[Camera | None, ViewSettings | None]:
        """The camera, if it is not the initial one, and the values of the panel, for `resume`."""
        with self._lock:
            return self._display.moved_camera, self._display.view

    def resume(self, state: tuple[Camera | None, ViewSettings | None]) -> None:
        """Continue with the `state` of another session."""
        with self._lock:
            self._display.resume(*state)

    def move(self, camera: Camera) -> None:
        """Move the camera of the page."""
        with self._lock:
            self._display.move(camera)

    def light_of(self, scene: Scene) -> Baked | None:
        """Return the finely baked light of a scene, or None if it is not baked yet."""
        return self._painter.light_of(scene)

    # Messages of the page.

    def _on_size(self, message: dict[str, Any]) -> None:
        self._display.resize(size_of(message), free_of(message))

    def _on_camera(self, message: dict[str, Any]) -> None:
        self._display.look(camera_of(message, self._display.size or (1, 1)), number(message, "time"))

    def _on_seen(self, message: dict[str, Any]) -> None:
        self._painter.seen(int(number(message, "number", 0)))

    def _on_set(self, message: dict[str, Any]) -> None:
        name, display = short_text(message, "name"), self._display
        control = display.control(name)
        value = control.check(message.get("value"))
        if name.startswith("build."):
            self._shared.rebuild(**{name.removeprefix("build."): value})
            return
        if name.startswith("output."):
            display.change_output(name.removeprefix("output."), value)
            return
        if name == "look":
            display.light(value)
            return
        view = display.view
        assert view is not None
        changed: dict[str, Any] = {name: value}
        if name in ("color_by", "colormap"):
            changed |= {"low": None, "high": None}
        for key, part in changed.items():
            view = view.with_value(key, part)
        display.change(view, control.kind in ("choice", "switch"))

    def _on_press(self, message: dict[str, Any]) -> None:
        name, display = short_text(message, "name"), self._display
        display.control(name)  # raises ValueError if there is none
        scene, view = self._shared.scene, display.view
        if scene is None or view is None:
            return
        if name.startswith("lamps.add."):
            self._add_lamp(name.removeprefix("lamps.add."), scene)
        elif name.startswith("lamps."):
            display.change(view.without_lamp(int(name.split(".")[1])), True)
        elif name == "save.stop":
            self._exports.stop()
        elif display.camera is not None:
            self._exports.start(name, display.request(), display.output, self._shared)

    def _on_sun(self, message: dict[str, Any]) -> None:
        dx, dy = number(message, "dx", -10, 10), number(message, "dy", -10, 10)
        scene, view = self._shared.scene, self._display.view
        if scene is None or view is None:
            return
        suns = [k for k, lamp in enumerate(view.lamps) if lamp.kind == SUN and lamp.on]
        if not suns:
            self._add_lamp(SUN, scene)
            return
        lamp = view.lamps[suns[0]]
        azimuth = (lamp.azimuth + TURN * dx + 180.0) % 360.0 - 180.0
        elevation = max(-90.0, min(90.0, lamp.elevation - TURN * dy))
        self._display.move_sun(suns[0], azimuth, elevation)

    def _add_lamp(self, kind: str, scene: Scene) -> None:
        view = self._display.view
        assert view is not None
        if len(view.lamps) >= MAX_LIGHTS:
            self._outbox.toast("warning", f"there are {len(view.lamps):,} lights: remove one to add another")
            return
        self._display.change(view.with_lamp(kind, scene, self._shared.up), True)

    def _on_view(self, message: dict[str, Any]) -> None:
        self._display.go(short_text(message, "name"), animate=True)

    def _on_pick(self, message: dict[str, Any]) -> None:
        x, y = number(message, "x", 0, 1), number(message, "y", 0, 1)
        purpose, extend = short_text(message, "purpose"), message.get("extend") is True
        display = self._display
        if self._shared.scene is None or display.camera is None or display.view is None:
            return
        self._lookups.click(Click(display.request(), (x, y), purpose, extend))

    def _on_clear(self, message: dict[str, Any]) -> None:
        self._lookups.forget()

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

    # Changes of the shared scene.

    def _on_change(self) -> None:
        """Queue an update of the page in this session's own thread, so that the notifier need not wait."""
        with self._state_lock:
            if not self._gone and not self._has_changes:
                self._has_changes = True
                self._follower.submit(self._follow_logged)

    def _follow_logged(self) -> None:
        try:
            self._follow()
        except Exception:
            log.exception("error while updating a browser")

    def _follow(self) -> None:
        """Send the progress of loading or building, and update the page from the shared scene."""
        self._has_changes = False
        self._outbox.progress(self._shared.progress)
        with self._lock:
            if not self._gone:
                self._display.follow()

    # Results. The painter and the lookups call these from their own threads.

    def _deliver(self, frame: Frame) -> None:
        """Send an image to the page. After the first one, load the kernel that finds clicked points."""
        self._outbox.frame(frame, self._painter.frames_a_second)
        if frame.request.sketch is None:
            self._lookups.prepare(frame.request.scene)

    def _report_baking(self, stage: str, share: float | None, seconds: float | None) -> None:
        """Send the progress of baking to the page, unless models are being built.

        share : fraction done; seconds : time left; both None if unknown
        """
        shared = self._shared.progress
        self._outbox.progress(shared if shared.stage else Progress(stage, share, seconds))

    def _show_legend(self, request: FrameRequest, shown: Attribute, image: str) -> None:
        """Send a legend to the page, if it still shows the same settings.

        request : image for which it was drawn; shown : the attribute; image : data URL
        """
        with self._lock:
            self._display.show_legend(request, shown, image)
