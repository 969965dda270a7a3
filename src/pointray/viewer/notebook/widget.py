"""`ViewerWidget`: the viewer in a cell of a notebook."""

from __future__ import annotations

import base64
import io
import logging
import secrets
import sys
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike
from PIL import Image

from ...auto_view.first_view import up_of
from ...auto_view.framing import Lens
from ...baking.baked import Baked
from ...base.arguments import check_kind, check_whole
from ...base.choices import AUTO
from ...base.extras import require
from ...rendering.camera import Camera
from ...rendering.warmup import warm_up
from ...scene.scene import Scene
from ..display import FOV, request_of
from ..shared_scene import SharedScene, shared_of
from ..view_settings import ViewSettings
from .detection import cell_of_jupyter
from .embedded_page import widget_module
from .page_views import PageViews
from .snapshot import draw

# This module is imported only for notebooks and for its class, which exists without the optional package, too.
if TYPE_CHECKING:
    from anywidget import AnyWidget
    from traitlets import Bytes, Int
else:
    try:
        from anywidget import AnyWidget
        from traitlets import Bytes, Int
    except ImportError:
        AnyWidget = object

log = logging.getLogger("pointray.view")

HEIGHT = 600  # CSS pixels of a cell's view
SIZE = (960, HEIGHT)  # pixels of pictures before there is a view
SAVED_SAMPLES = 8  # per pixel of the picture in a saved notebook
MAX_SAVED = 1280  # its largest width or height, pixels
MAX_WAIT = 20.0  # seconds that it waits for a scene that is loading
MAX_SAMPLES = 1 << 16
NOTHING = "there is nothing to show: the scene has no models, or is not loaded yet"


class ViewerWidget(AnyWidget):
    """Interactive viewer in a cell of a notebook; `view` returns it there. Changes to the scene appear in it.

    It needs no port: the page in the cell and the kernel exchange the notebook's own messages. It can be shown in
    several cells, and in the containers of ipywidgets; each view has a camera and a panel of its own. A saved notebook
    contains a picture. While a cell runs, pictures are still refined, but the view follows the mouse only if the
    notebook delivers messages in the meantime, as JupyterLab 4.4 with ipykernel 7 does.

    Parameters
    ----------
    scene : Scene
    up : (3,) array_like, or "x", "-x", "y", "-y", "z", "-z", or "auto"
        Up direction; "auto" chooses the axis with the most evidence in the points and their file, as in `frame`.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ValueError
        If `up` is invalid.
    ImportError
        If the package anywidget is not installed.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
    >>> widget = pr.ViewerWidget(scene)
    >>> widget.camera = pr.Camera.frame(scene.bounds, (1, 0, 0))
    >>> widget.snapshot((80, 60), samples=1).size
    (80, 60)
    >>> widget.close()
    """

    if AnyWidget is not object:
        _esm = widget_module()
        _height = Int(HEIGHT).tag(sync=True)
        _picture = Bytes(b"").tag(sync=True)  # PNG, shown while there is no kernel

    def __init__(self, scene: Scene | SharedScene, up: ArrayLike | str = AUTO) -> None:
        require("anywidget", "notebook", "the viewer's widget")
        check_kind(scene, "scene", (Scene, SharedScene), "a Scene")
        shared = shared_of(scene, up_of(up)) if isinstance(scene, Scene) else scene
        super().__init__()
        self._shared, self._display_ids = shared, list[str]()
        warm_up(shared.settings, clicks=True)
        self._views = PageViews(shared, self.send, self._is_alive)
        self.on_msg(lambda _, content, buffers: self._views.receive(content))

    @property
    def camera(self) -> Camera:
        """Camera of the view that was last used; setting it moves the cameras of all views.

        The size of a camera that is set does not matter, and neither does its depth of field. Panoramas are not
        supported.
        """
        session = self._views.current
        camera = None if session is None else session.camera
        return camera or self._views.state[0] or self._home()

    @camera.setter
    def camera(self, camera: Camera) -> None:
        camera = check_kind(camera, "camera", Camera, "a Camera")
        if camera.projection == "panorama":
            raise ValueError("camera must be perspective or orthographic: the viewer does not show panoramas")
        self._views.move(replace(camera, aperture=0.0, focus=None))

    def snapshot(self, size: tuple[int, int] | None = None, samples: int | None = None) -> Image.Image:
        """Render the view as shown, with its camera and the values of its panel.

        Parameters
        ----------
        size : (int, int), optional
            Width and height in pixels. None: those of the view.
        samples : int, optional
            Samples per pixel, 1 to 65536. None: those of the panel.

        Returns
        -------
        PIL.Image.Image
            RGB. It is shown as the result of a cell, has methods such as `save`, and NumPy converts it to an array,
            (height, width, 3) uint8.

        Raises
        ------
        TypeError
            If an argument has the wrong type.
        ValueError
            If a value is out of its range, or there is nothing to show yet.

        Examples
        --------
        >>> scene = pr.Scene()
        >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
        >>> widget = pr.ViewerWidget(scene)
        >>> widget.snapshot((80, 60), samples=4).save("view.png")
        >>> widget.close()
        """
        if samples is not None:
            samples = check_whole(samples, "samples", 1, MAX_SAMPLES)
        return self._draw(size, samples, bakes=True)

    def close(self) -> None:
        """End the sessions of all views and remove the views from the notebook; Jupyter keeps the last picture.

        Examples
        --------
        >>> widget = pr.ViewerWidget(pr.Scene())
        >>> widget.close()
        """
        views = vars(self).get("_views")  # absent if the constructor failed
        if views is None or self.comm is None:
            return
        if self._display_ids:
            self._save_picture()
        views.close()
        super().close()
        for number in self._display_ids:
            show(_still(self._picture), number, update=True)
        SHOWN.forget(self)

    def __del__(self) -> None:
        """Close the widget without rendering; at the exit of Python, whose modules are then gone, do nothing."""
        if sys is not None and not sys.is_finalizing():
            vars(self).get("_display_ids", []).clear()
            self.close()

    def _draw(self, size: tuple[int, int] | None, samples: int | None, bakes: bool) -> Image.Image:
        """Render the view. bakes : whether light that a studio lacks is baked now"""
        session, camera = self._views.current, self.camera
        scene = self._shared.scene
        if scene is None:
            raise ValueError(self._shared.problem or NOTHING)
        camera = camera if size is None else replace(camera, size=size)
        view = self._views.state[1] or ViewSettings.of(self._shared, scene)

        def light_of(scene: Scene) -> Baked | None:
            return None if session is None else session.light_of(scene)

        return draw(request_of(self._shared, camera, view), samples or view.samples, light_of, bakes)

    def _home(self) -> Camera:
        """Return the initial camera of a view."""
        shared = self._shared
        if shared.home is not None:
            return replace(shared.home, size=SIZE)
        if shared.scene is None or not shared.scene.models:
            raise ValueError(shared.problem or NOTHING)
        return shared.scan(AUTO).camera(Lens(FOV, SIZE))

    def _save_picture(self) -> None:
        """Render the picture that is shown while there is no kernel; wait a while for a scene that is loading."""
        end = time.monotonic() + MAX_WAIT
        while self._shared.scene is None and not self._shared.problem and time.monotonic() < end:
            time.sleep(0.05)
        try:
            width, height = self.camera.size
            scale = min(1.0, MAX_SAVED / max(width, height))
            size = max(1, round(width * scale)), max(1, round(height * scale))
            stream = io.BytesIO()
            self._draw(size, SAVED_SAMPLES, bakes=False).save(stream, "PNG")
            self._picture = stream.getvalue()
        except ValueError as error:  # such as an empty scene
            log.warning("no picture in the notebook: %s", error)

    def _is_alive(self) -> bool:
        """Whether the notebook still has the widget. If it has closed it, such as marimo does, end everything."""
        comm = self.comm
        if comm is not None and getattr(comm, "_closed", False):
            self._display_ids.clear()
            self.close()
        return self.comm is not None

    def _repr_mimebundle_(self, **_: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the widget and a picture for a notebook."""
        self._save_picture()
        data, metadata = super()._repr_mimebundle_() or ({}, {})
        return {**data, **_still(self._picture)}, metadata

    def _ipython_display_(self) -> None:
        """Show the widget in a cell. Widgets that an earlier run of the cell has shown are closed."""
        if self.comm is None:
            show(_still(self._picture), "")
            return
        number = secrets.token_hex(8)
        self._display_ids.append(number)
        show(self._repr_mimebundle_(), number)
        for replaced in SHOWN.replace(self):
            replaced._display_ids.clear()  # its output is gone
            replaced.close()


class ShownWidgets:
    """The widgets that each cell of a notebook has shown when it was last run."""

    def __init__(self) -> None:
        self._cells: dict[str, tuple[str, list[ViewerWidget]]] = {}  # cell -> execution, widgets

    def replace(self, widget: ViewerWidget) -> list[ViewerWidget]:
        """Note that the running cell shows a widget; return those that only its earlier run has shown."""
        cell, execution = cell_of_jupyter() or ("", "")
        last, widgets = self._cells.get(cell, ("", []))
        if not cell or last == execution:
            self._cells[cell] = execution, [*widgets, widget]
            return []
        self._cells[cell] = execution, [widget]
        shown = [one for _, others in self._cells.values() for one in others]
        return [one for one in widgets if not any(one is other for other in shown)]

    def forget(self, widget: ViewerWidget) -> None:
        """Forget a closed widget."""
        for _, widgets in self._cells.values():
            widgets[:] = [one for one in widgets if one is not widget]


SHOWN = ShownWidgets()


def _still(picture: bytes) -> dict[str, Any]:
    """Return the part of a cell's output that needs no kernel. picture : PNG; empty if there is none"""
    text = {"text/plain": "pointray viewer"}
    return {**text, "image/png": base64.b64encode(picture).decode()} if picture else text


def show(bundle: Any, number: str, update: bool = False) -> None:
    """Show data in the running cell, or replace data shown earlier. number : identifies the output; empty: none"""
    display = require("IPython.display", "notebook", "the viewer's widget")
    data, metadata = bundle if isinstance(bundle, tuple) else (bundle, {})
    shown = {"transient": {"display_id": number}} if number else {}
    display.publish_display_data(data, metadata, update=update, **shown)
