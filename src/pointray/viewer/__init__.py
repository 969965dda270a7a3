"""The interactive viewer: a page in the browser, and the ray traced pictures that it shows.

server: the transport; link: the connection to one browser; share: limits for one page; viewer: all of it together.
A browser has a session (what its messages do; messages checks them), an outbox (messages to it), a display (its camera
and panel: panel, controls, light_control), view settings (the panel's values), a painter (its pictures, at a pace),
lookups (answers to its clicks with pick, and legends) and exports (files that it saves). Its baker bakes light while
one looks, with a niceness that yields to pictures. When the browser has gone memory is given back (heap). page is what
the browser itself runs. All browsers show one shared scene, which loading brings (time_left: how long that takes);
sketch shows dots while kernels are compiled.

The path of a slider's value: `server` hands the page's message to `session`, the panel's control checks the value,
`display` holds it in its `view_settings` and asks for a picture, `painter` draws it, `outbox` packs it and `link` sends
it.

Begin with viewer, then session, then display.
"""

from __future__ import annotations

import sys
from contextlib import suppress

from numpy.typing import ArrayLike

from ..auto_view.first_view import Scan, ViewChoice, up_of
from ..base.arguments import check_flag, check_text, check_whole
from ..scene.scene import Scene
from .shared_scene import SharedScene
from .viewer import Viewer

__all__ = ["Viewer", "view"]


def view(
    scene: Scene,
    host: str = "127.0.0.1",
    port: int = 0,
    open_browser: bool = True,
    block: bool = True,
    up: ArrayLike | str = "auto",
) -> Viewer:
    """Show a scene in the browser, interactively.

    Parameters
    ----------
    scene : Scene
        Changes in the scene while it is shown appear on the page.
    host : str
        The address to listen on; by default only this machine can reach it. Whoever can reach it and knows the
        viewer's `url`, which contains a random token, sees the scene.
    port : int
        0: 8080, or the next free one.
    open_browser : bool
        Whether to open the page; where there is no browser, the address is printed.
    block : bool
        Wait until Ctrl-C. In a notebook it never waits: the page appears in the cell.
    up : (3,) array_like, or "x", "-x", "y", "-y", "z", "-z", or "auto"
        Which way is up; auto: see `pointray.frame`.

    Returns
    -------
    Viewer
        `close` ends it.

    Raises
    ------
    OSError
        If it cannot listen on that address.

    Examples
    --------
    >>> viewer = pr.view(scene, block=False)
    >>> scene.add_light(pr.SunLight([1, 1, -2]))
    >>> viewer.close()
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"scene must be a Scene, not {type(scene).__name__}")
    host, port = check_text(host, "host"), check_whole(port, "port", 0, 65535)
    open_browser, block = check_flag(open_browser, "open_browser"), check_flag(block, "block")
    wanted = up_of(up)
    if wanted is None:
        wanted = Scan(scene, ViewChoice()).up if scene.models else (0.0, 0.0, 1.0)
    viewer = Viewer(SharedScene("pointray", scene, wanted), host, port)
    if in_notebook():
        return viewer
    if not (open_browser and viewer.open_browser()):
        print(f"pointray: {viewer.url}", flush=True)
    if block:
        with suppress(KeyboardInterrupt):
            viewer.wait()
    return viewer


def in_notebook() -> bool:
    """Whether the code runs in a notebook's kernel."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return type(shell).__name__ == "ZMQInteractiveShell"
