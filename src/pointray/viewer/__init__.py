"""Interactive viewer: a page in the browser that shows ray-traced images of a scene.

`viewer.Viewer` holds a `SharedScene` (`shared_scene`), which all browsers show, and a `server`. Each browser has a
`Session` with

- `connection`, `outbox`, `messages`: the WebSocket, messages to the page, and checks of messages from it
- `display`: its camera, its `view_settings` (the values of the panel) and its panel (`panel`, `controls`,
  `light_control`)
- `painter`: its images, at the quality that `pace` chooses; `baker` bakes light and `fetcher` opens parts of large
  models in threads of lower priority (`thread_priority`); `contacts` caches the shadow under a standing object
- `queries`: answers to clicks (`pick`) and legends; `exports`: saved images and films

`sessions` holds the sessions of all browsers and notifies them of changes. `notebook` is a widget that shows the page
in a cell of a notebook, without the server.

`loading` loads the shared scene (`time_left`: estimates of the time left; `scene_setup`: its lights and ground;
`default_view`: what `view` shows of anything but a scene); `sketch` draws points while kernels are compiled.
`page_limits` limits what one page may use. `page` holds the files that the browser loads.

A change of a slider: `server` passes the message to `session`, the panel's control checks the value, `display` stores
it in its `view_settings` and requests an image, `painter` draws it, `outbox` packs it and `connection` sends it.

Read first: `viewer`, then `session`, then `display`.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from ..auto_view.first_view import up_of
from ..base.arguments import check_flag, check_text, check_whole
from ..cloud.conversion import PointsLike
from ..scene.scene import Scene
from .notebook.detection import has_widgets, in_notebook
from .shared_scene import SharedScene, shared_of
from .viewer import Viewer

if TYPE_CHECKING:
    from .notebook.widget import ViewerWidget

__all__ = ["Viewer", "view"]


def view(
    scene: Scene | PointsLike,
    host: str = "127.0.0.1",
    port: int = 0,
    open_browser: bool = True,
    block: bool = True,
    up: ArrayLike | str = "auto",
) -> Viewer | ViewerWidget:
    """Show a scene, scans, points or models in the browser, interactively: ``pr.view("scan.laz")``.

    Parameters
    ----------
    scene : Scene, Model, or what `as_points` accepts, or a list of these
        Changes to a scene appear on the page. Anything else is shown as by `pointray view`, a coarse version first,
        with automatic view, light and exposure. The path of a scene file (.toml) shows that scene.
    host : str
        Address to listen on. By default only this machine can reach it. Anyone who can reach it and knows the viewer's
        `url`, which contains a random token, can see the scene.
    port : int
        Port to listen on; 0: 8080, or the next free one.
    open_browser : bool
        Whether to open the page. If no browser is available, the address is printed.
    block : bool
        Whether to wait until Ctrl-C. In a notebook the call never waits, and the page appears in the cell.
    up : (3,) array_like, or "x", "-x", "y", "-y", "z", "-z", or "auto"
        Up direction; "auto" chooses the axis with the most evidence in the points and their file, as in `frame`.

    Returns
    -------
    Viewer or ViewerWidget
        Its method `close` stops the server. In a notebook with the package anywidget, a widget without a server, for
        which `host`, `port`, `open_browser` and `block` have no meaning.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    OSError
        If the server cannot listen on that address.
    ValueError
        If `port` is out of its range or `up` is invalid.

    Examples
    --------
    >>> scene = pr.Scene()
    >>> ball = scene.add(pr.Model(pr.procedural("sphere", 1000)))
    >>> viewer = pr.view(scene, open_browser=False, block=False)
    pointray: http://127.0.0.1:...
    >>> light = scene.add_light(pr.SunLight((1, 1, -2)))
    >>> viewer.close()
    """
    host, port = check_text(host, "host"), check_whole(port, "port", 0, 65535)
    open_browser, block = check_flag(open_browser, "open_browser"), check_flag(block, "block")
    wanted, loader = up_of(up), None
    if isinstance(scene, Scene):
        shared = shared_of(scene, wanted)
    else:
        from .default_view import default_view

        shared, loader = default_view(scene, wanted)
    viewer = _make_widget(shared) if in_notebook() and has_widgets() else Viewer(shared, host, port)
    if loader is not None:
        shared.load(loader)
    if not isinstance(viewer, Viewer):
        return viewer
    if in_notebook():
        print("pointray: for a viewer that needs no port: pip install 'pointray[notebook]'", flush=True)
        return viewer
    if not (open_browser and viewer.open_browser()):
        print(f"pointray: {viewer.url}", flush=True)
    if block:
        with suppress(KeyboardInterrupt):
            viewer.wait()
    return viewer


def _make_widget(shared: SharedScene) -> ViewerWidget:
    from .notebook.widget import ViewerWidget  # imports anywidget

    return ViewerWidget(shared)
