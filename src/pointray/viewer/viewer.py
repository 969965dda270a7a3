"""Viewer: a shared scene, the server that shows it, and a session for each browser."""

from __future__ import annotations

import html
import os
import threading
import time
import webbrowser
from collections.abc import Callable
from typing import Any

from ..base.memory import trim_heap
from ..rendering.warmup import warm_up
from .connection import Link
from .server import Server
from .session import Session
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
        self._shared = shared
        warm_up(shared.settings, clicks=True)
        self._ended = threading.Event()
        self._sessions: set[Session] = set()
        self._leaving: set[Session] = set()  # closed sessions whose threads still run
        self._lock = threading.Lock()
        self._server = Server(self._make_handler, host, port, token, os.environ.get(HUB, ""))
        self.url, self.port, self.is_public = self._server.url, self._server.port, self._server.is_public
        self._watcher = threading.Thread(target=self._watch, name="pointray-watcher", daemon=True)
        self._watcher.start()

    def close(self) -> None:
        """Stop the server. Open pages keep their last image.

        Examples
        --------
        >>> pr.view(pr.Scene(), open_browser=False, block=False).close()
        pointray: http://127.0.0.1:...
        """
        self._ended.set()
        self._server.close()
        with self._lock:
            sessions, self._sessions = self._sessions, set()
        for session in sessions:
            session.leave()

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

    def _make_handler(self, link: Link) -> Session:
        session = Session(link, self._shared, self._forget)
        with self._lock:
            self._sessions.add(session)
        return session

    def _forget(self, session: Session) -> None:
        with self._lock:
            self._sessions.discard(session)
            self._leaving.add(session)

    def _watch(self) -> None:
        """Notify browsers of changes that the caller makes to the scene; checks ten times a second until `close`.

        It also updates the progress of compiling kernels and releases the memory of ended sessions.
        """
        version: Any = self._shared.version
        while not self._ended.wait(0.1):
            self._shared.update_compile_progress()
            self._release_memory()
            if self._shared.version != version:
                version = self._shared.version
                self._shared.notify()

    def _release_memory(self) -> None:
        """Return the memory of ended sessions to the system.

        Otherwise heap fragmentation retains it. With 20,000 points, after all browsers had disconnected, memory was 308
        to 385 MB, and in one of two runs it grew by 10% from 10,000 to 20,000 events; with this call it is 261 to 302
        MB.
        """
        with self._lock:
            ended = {session for session in self._leaving if session.has_ended}
            self._leaving -= ended
        if ended:
            trim_heap()

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
