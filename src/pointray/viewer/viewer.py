"""Viewer: a shared scene, the server that shows it, and a session for each browser."""

from __future__ import annotations

import html
import os
import threading
import time
import webbrowser
from collections.abc import Callable

from ..rendering.warmup import warm_up
from .server import Server
from .sessions import Sessions
from .shared_scene import SharedScene

HUB = "JUPYTERHUB_SERVICE_PREFIX"  # set by JupyterHub: path of the notebook server


class Viewer:
    """Running server of a page that shows a scene, as returned by `view`. Changes to the scene appear on the page.

    Attributes
    ----------
    url : str
        Address of the page. It contains a random token; requests without it are refused.
    port : int

    Examples
    --------
    >>> viewer = pr.view(pr.Scene(), open_browser=False, block=False)
    pointray: http://127.0.0.1:...
    >>> viewer.url.startswith("http://127.0.0.1:")
    True
    >>> viewer.close()
    """

    url: str
    port: int

    def __init__(self, shared: SharedScene, host: str = "127.0.0.1", port: int = 0, token: str = "") -> None:
        warm_up(shared.settings, clicks=True)
        self._ended = threading.Event()
        self._sessions = Sessions(shared)
        self._server = Server(self._sessions.make, host, port, token, os.environ.get(HUB, ""))
        self.url, self.port, self.is_public = self._server.url, self._server.port, self._server.is_public

    def close(self) -> None:
        """Stop the server. Open pages keep their last image.

        Examples
        --------
        >>> pr.view(pr.Scene(), open_browser=False, block=False).close()
        pointray: http://127.0.0.1:...
        """
        self._ended.set()
        self._server.close()
        self._sessions.close()

    def wait(self, until: Callable[[], bool] = lambda: False) -> None:
        """Wait until `close` is called, Ctrl-C is pressed, or a condition holds; then close the viewer.

        Parameters
        ----------
        until : callable
            Called ten times a second; the wait ends when it returns True.

        Examples
        --------
        >>> pr.view(pr.Scene(), open_browser=False, block=False).wait(until=lambda: True)
        pointray: http://127.0.0.1:...
        """
        try:
            # Not Event.wait: Ctrl-C inside it can leave its lock held, and `close` would then wait forever.
            while not self._ended.is_set() and not until():
                time.sleep(0.1)
        finally:
            self.close()

    def open_browser(self) -> bool:
        """Open the page in the user's browser.

        Returns
        -------
        bool
            False if no browser is available.
        """
        try:
            return webbrowser.open(self.url)
        except webbrowser.Error:
            return False

    def _repr_html_(self) -> str:
        """Return the page as an inline frame for a notebook, with a hint in case it does not appear."""
        if self._server.proxied:
            hint = "If nothing appears: run pip install jupyter-server-proxy on the notebook server and restart it."
        else:
            hint = (
                "If nothing appears, the notebook runs on another machine: forward the port from yours, "
                f"<code>ssh -L {self.port}:127.0.0.1:{self.port} MACHINE</code>, and run the cell again."
            )
        page = html.escape(self._server.proxied or self.url)
        return (
            f'<iframe src="{page}" width="100%" height="600" style="border:0"></iframe>'
            f'<div style="font-size:small;opacity:0.6">{hint}</div>'
        )
