"""State of one browser: its camera, view settings and panel for the shared scene."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from ..auto_view import STUDIO
from ..auto_view.framing import Lens
from ..auto_view.studio import studio
from ..base.choices import AUTO, VIEWS
from ..rendering.camera import Camera
from ..scene.scene import Scene
from ..shade.attributes import Attribute
from .controls import Control, Folder
from .light_control import light_controls_of
from .outbox import Outbox
from .painter import FrameRequest, Painter
from .panel import Output, folders
from .queries import Lookups
from .shared_scene import SharedScene
from .view_settings import CHANGED, CONSTANT, OWN, ViewSettings

FOV = 40.0
SKETCH_SETTINGS = ViewSettings(exposes=True)  # for the sketch, before there is a scene


class Display:
    """State of one browser: its camera and panel. Each change is sent to the page or requests a new image.

    Not thread-safe: the browser's `Session` serializes the calls.

    Parameters
    ----------
    shared : SharedScene
        The scene that all browsers show.
    outbox : Outbox
        Messages to the page.
    painter : Painter
        Draws the images.
    lookups : Lookups
        Draws the legend.

    Attributes
    ----------
    size : (2,) tuple of int, or None
        Width and height of the view in pixels. None: not known yet, and nothing is drawn.
    time : float
        Timestamp in the page's last camera message.
    camera : Camera or None
        None: nothing to show yet.
    view : ViewSettings or None
        Values of the panel. None: there is no scene yet.
    output : Output
        Options of saved images and animations.
    """

    def __init__(self, shared: SharedScene, outbox: Outbox, painter: Painter, lookups: Lookups) -> None:
        self._shared, self._outbox, self._painter, self._lookups = shared, outbox, painter, lookups
        self.size: tuple[int, int] | None = None
        self.time = 0.0
        self.camera: Camera | None = None
        self.view: ViewSettings | None = None
        self.output = Output()
        self._free = (0, 0, 1, 1)  # part of the view not covered by the panel: left, top, right, bottom, pixels
        self._at_home = False  # whether the user has not moved the camera yet
        self._sketched = False  # whether the last thing shown was a sketch
        self._version: tuple[int, int] | None = None
        self._lights: tuple[Any, ...] = ()  # the scene's lights, as last read
        self._around: Any = None  # the scene's background, as last read
        self._problem: tuple[int, str] = 0, ""

    def resize(self, size: tuple[int, int], free: tuple[int, int, int, int]) -> None:
        """Set the size of the view; frame the model again unless the user has moved the camera.

        size : width and height in pixels
        free : part of the view that the panel does not cover: left, top, right, bottom in pixels
        """
        self.size, self._free = size, free
        seen = self._shared.scene or self._shared.sketch
        if (self.camera is None or self._at_home) and seen is not None:
            self.go("home", animate=False)  # frames the model again for the new size
        elif self.camera is not None:
            self.camera = replace(self.camera, size=size)
        self.refresh()

    def look(self, camera: Camera, time: float) -> None:
        """Set the camera to which the user has moved. time : timestamp of the page's message"""
        self.camera, self._at_home, self.time = camera, False, time
        self.refresh()

    def go(self, name: str, animate: bool) -> None:
        """Move the page's camera to a standard view; raise ValueError if there is none of this name.

        name : "home" (the initial view) or a view of `frame`, such as "front"; animate : whether it moves gradually
        """
        seen, size = self._shared.scene or self._shared.sketch, self.size
        if seen is None or size is None or (name not in VIEWS and name != "home"):
            raise ValueError(f"unknown view {name!r:.40}")
        if name == "home" and self._shared.home is not None:
            camera = replace(self._shared.home, size=size)
        else:
            fov = FOV if self.camera is None else self.camera.fov
            camera = self._shared.scan(AUTO if name == "home" else name).camera(Lens(fov, size), self._free_share())
        if not animate:
            self.camera, self._at_home = camera, True
        self._outbox.go(camera, animate)

    def change(self, view: ViewSettings, new_rows: bool) -> None:
        """Set new values of the panel and request an image. new_rows : whether the panel may have other rows now"""
        self.view = view
        if new_rows:
            self.send_panel()
        self.refresh()
        self._send_legend()

    def move_sun(self, lamp: int, azimuth: float, elevation: float) -> None:
        """Set the direction (degrees) of a light that the user drags, and update its sliders on the page.

        lamp : index in `ViewSettings.lamps`
        """
        assert self.view is not None
        values = {f"lamps.{lamp}.azimuth": azimuth, f"lamps.{lamp}.elevation": elevation}
        for name, value in values.items():
            self.view = self.view.with_value(name, value)
        self._outbox.send_message(type="values", values=values)
        self.refresh()

    def light(self, look: str) -> None:
        """Replace the lights by a preset. look : "studio", "headlight" or "own", the lights of the scene"""
        shared, view = self._shared, self.view
        if shared.scene is None or view is None or look == CHANGED:
            return
        if look == STUDIO:
            outlook = shared.scan(AUTO).outlook
            front = None if outlook.within else float(round(outlook.azimuth))
            self.change(view.in_studio(studio(shared.up, front), shared.up), True)
        else:
            lights = shared.scene.lights if look == OWN else ()
            self.change(view.lit_by(lights, shared.up, shared.settings.integrator), True)

    def change_output(self, name: str, value: Any) -> None:
        """Set an option of saved images and animations. name : field of `Output`, such as "width"; value : validated"""
        self.output = self.output._replace(**{name: value})

    def follow(self) -> None:
        """Update the page after a change of the shared scene: loaded, modified, rebuilt, or an error."""
        self._report_problem()
        version = self._shared.version  # read first: a scene newer than its version is processed twice, never missed
        scene, sketch = self._shared.scene, self._shared.sketch
        if version != self._version and ((scene is not None and scene.models) or sketch is not None):
            self._version = version
            begins = self.camera is None or (self._sketched and self._at_home)
            self._sketched = scene is None
            if scene is not None:
                self._set_scene(scene)
            elif sketch is not None:
                self._outbox.place(sketch, self._shared.up)
            if begins and self.size is not None:
                self.go("home", animate=False)
        self.refresh()

    def show_legend(self, request: FrameRequest, shown: Attribute, image: str) -> None:
        """Send a legend to the page, unless the panel's settings have changed since it was requested.

        request : image for which it was drawn; image : data URL
        shown : the attribute in the legend; its range becomes that of the panel if none is set
        """
        if self.view is None or request.view is not self.view:
            return
        self._outbox.legend(image)
        if self.view.low is None and shown.range is not None:  # the user can now change the range that was found
            self.view = replace(self.view, low=shown.range[0], high=shown.range[1])
            self.send_panel()
            self.refresh()

    def refresh(self) -> None:
        """Request the image of the current state from the painter; an unchanged request has no effect."""
        if self.camera is None or self.size is None:
            return
        shared, sketch = self._shared, self._shared.sketch
        if self.view is not None and shared.scene is not None:
            self._painter.want(self.request())
        elif sketch is not None:
            nothing, version = Scene(), shared.version
            self._painter.want(
                FrameRequest(self.camera, SKETCH_SETTINGS, nothing, version, shared.up, False, self.time, sketch)
            )

    def request(self) -> FrameRequest:
        """Return the request that the painter needs to draw the current state.

        Requires that `camera`, `view` and the shared scene are not None.
        """
        assert self.camera is not None and self.view is not None
        return request_of(self._shared, self.camera, self.view, self.time)

    def move(self, camera: Camera) -> None:
        """Set the camera from Python, and move that of the page. Its size is ignored."""
        self.camera, self._at_home = replace(camera, size=self.size or camera.size), False
        self._outbox.go(self.camera, animate=False)
        self.refresh()

    def resume(self, camera: Camera | None, view: ViewSettings | None) -> None:
        """Continue with the camera and the values of the panel of an earlier page; None: the initial ones."""
        if view is not None and self.view is not None:
            self.change(view, True)
        if camera is not None:
            self.move(camera)

    @property
    def moved_camera(self) -> Camera | None:
        """The camera; None while it is the initial one, which frames everything."""
        return None if self._at_home else self.camera

    def control(self, name: str) -> Control:
        """Return the panel's control with this `Control.name`; raise ValueError if there is none."""
        for folder in self._folders():
            for control in folder.controls:
                if control.name == name:
                    return control
        raise ValueError(f"unknown control {name!r:.60}")

    def send_panel(self) -> None:
        """Send the panel's rows and values to the page if they have changed."""
        self._outbox.panel(self._folders())

    def _folders(self) -> list[Folder]:
        scene = self._shared.scene
        view = self.view or ViewSettings()
        return folders(view, self._shared, self.output, None if self.view is None else scene)

    def _send_legend(self) -> None:
        """Request a legend if an attribute colours the points; otherwise remove the legend from the page."""
        assert self.view is not None
        if self.view.color_by in (OWN, CONSTANT) or self.view.material in ("mirror", "glass"):
            self._outbox.legend(None)
        else:
            self._lookups.legend(self.request())

    def _set_scene(self, scene: Scene) -> None:
        """Show a new or modified scene: its lights and background replace those of the panel if they have changed."""
        lights, around = scene.lights, (scene.shows_sky, None if scene.background is None else list(scene.background))
        if self.view is None:
            self.view = ViewSettings.of(self._shared, scene)
        if len(lights) != len(self._lights) or any(a is not b for a, b in zip(lights, self._lights, strict=True)):
            lamps = light_controls_of(scene, self._shared.up)
            studio_lamps = lamps if self._shared.look == STUDIO else self.view.studio
            self.view = replace(self.view, lamps=lamps, studio=studio_lamps)
        if around != self._around:
            self.view = self.view.with_background(scene)
        self._lights, self._around = lights, around
        self._outbox.place(scene, self._shared.up)
        self.send_panel()
        self._send_legend()

    def _report_problem(self) -> None:
        """Send the latest error in loading or building to the page, once for each failure."""
        problem = self._shared.failures, self._shared.problem
        if problem != self._problem:
            self._problem = problem
            if problem[1]:
                self._outbox.toast("error", problem[1], stay=True)

    def _free_share(self) -> tuple[float, float, float, float]:
        """Return the part of the view not covered by the panel: left, top, right, bottom, as fractions of the view."""
        width, height = self.size or (1, 1)
        left, top, right, bottom = self._free
        return left / width, top / height, right / width, bottom / height


def request_of(shared: SharedScene, camera: Camera, view: ViewSettings, time: float = 0.0) -> FrameRequest:
    """Return the request for an image of a shared scene, which must not be None.

    view : values of the panel; time : timestamp of the page's camera message
    """
    version = shared.version  # read first: a newer scene is requested again
    scene = shared.scene
    assert scene is not None
    bakes = not shared.is_coarse
    scan = partial(shared.scan, AUTO) if shared.look == STUDIO and bakes else None
    seen = camera, view, scene, version, shared.up
    return FrameRequest(*seen, not shared.is_building, time, bakes=bakes, scan=scan)
