"""Views of a widget, which are pages in cells, and the session of each."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, Full, Queue
from typing import Any

from ..session import Session
from ..sessions import Sessions
from ..shared_scene import SharedScene
from .comm_link import CommLink, Post

log = logging.getLogger("pointray.view")

MAX_VIEWS = 4  # of one widget; a page that reloads leaves its view behind, which a later one replaces
MAX_QUEUED = 1000  # messages of a page that wait for its session; more are ignored
LARGEST_MESSAGE = 1 << 16  # characters of a message from the page
LONGEST_ID = 100  # characters
CHECK = 0.5  # seconds between checks whether the notebook still has the widget
MAX_LOGGED = 10  # invalid messages logged for each widget


class PageView:
    """One view of a widget: its link, its session, and the thread that passes the messages of the page to it.

    Parameters
    ----------
    is_alive : callable
        Whether the notebook still has the widget; the session ends when it returns False.
    """

    def __init__(self, sessions: Sessions, link: CommLink, state: Any, is_alive: Callable[[], bool]) -> None:
        self.link, self.session, self._is_alive = link, sessions.make(link), is_alive
        self.session.resume(state)
        self._messages: Queue[str | None] = Queue(MAX_QUEUED)
        self._thread = threading.Thread(target=self._run, name="pointray-visitor", daemon=True)
        self._thread.start()

    def receive(self, text: str) -> None:
        """Queue a message for the session; return at once, so that the kernel can go on."""
        with suppress(Full):
            self._messages.put_nowait(text)

    def close(self, note: str = "gone") -> None:
        """Disconnect the page and end the session. note : content of the last message, as in `CommLink.close`"""
        self.link.close(note)
        with suppress(Full):
            self._messages.put_nowait(None)

    def _run(self) -> None:
        while self.link.open and self._is_alive():
            with suppress(Empty):
                text = self._messages.get(timeout=CHECK)
                if text is None:
                    break
                self.session.receive(text)
        self.link.close()
        self.session.leave()


class PageViews:
    """Views of a widget by the identifiers that their pages choose. Thread-safe.

    Parameters
    ----------
    shared : SharedScene
        The scene that all views show.
    post : callable
        Sends a message, a dict and a list of binary buffers, to all pages of the widget.
    is_alive : callable
        Whether the notebook still has the widget; sessions end when it returns False.
    """

    def __init__(self, shared: SharedScene, post: Post, is_alive: Callable[[], bool]) -> None:
        self._sessions, self._post, self._is_alive = Sessions(shared), post, is_alive
        self._views: dict[str, PageView] = {}
        self._state: Any = None, None  # camera and values of the panel, for the next view
        self._lock, self._closed, self._invalid_count = threading.RLock(), False, 0

    @property
    def current(self) -> Session | None:
        """Session of the view that the user has used last; None if there is no view."""
        with self._lock:
            sessions = [view.session for view in self._views.values()]
        return max(sessions, key=lambda session: session.used, default=None)

    @property
    def state(self) -> Any:
        """Camera (None: the initial one) and values of the panel of the current view, or of the last one."""
        session = self.current
        return self._state if session is None else session.state

    def move(self, camera: Any) -> None:
        """Move the cameras of all views; those opened later begin with it."""
        with self._lock:
            self._state = camera, self.state[1]
            sessions = [view.session for view in self._views.values()]
        for session in sessions:
            session.move(camera)

    def receive(self, content: Any) -> None:
        """Process a message of a page, in the thread that the notebook chooses. Invalid ones are ignored and logged.

        content : a dict with the view's identifier "view" and one of

            - "state": "open" or "closed"
            - "text": a message to the session
            - "read": bytes that the page has received
        """
        try:
            self._dispatch(content)
        except Exception as error:
            self._invalid_count += 1
            if self._invalid_count <= MAX_LOGGED:
                log.warning("ignored a message of a notebook's page: %s", error)

    def close(self) -> None:
        """End all sessions; pages keep their last image. Later messages are ignored."""
        with self._lock:
            self._state, self._closed = self.state, True
            views = list(self._views.values())
            self._views.clear()
        for view in views:
            view.close("ended")
        self._sessions.close()

    def _dispatch(self, content: Any) -> None:
        name = content.get("view") if isinstance(content, dict) else None
        if not isinstance(name, str) or not 0 < len(name) <= LONGEST_ID:
            raise ValueError("expected an object with the identifier of a view")
        with self._lock:
            if self._closed:
                return
            if content.get("state") == "open":
                self._open(name)
            elif content.get("state") == "closed":
                self._drop(name)
            elif (view := self._views.get(name)) is None:
                CommLink(self._post, name).close()  # so that it connects again
            else:
                self._pass_on(view, content)

    def _pass_on(self, view: PageView, content: dict[str, Any]) -> None:
        read, text = content.get("read"), content.get("text")
        if isinstance(read, int) and not isinstance(read, bool):
            view.link.acknowledge(read)
        elif isinstance(text, str) and len(text) <= LARGEST_MESSAGE:
            view.receive(text)
        else:
            raise ValueError("expected a text of at most 65,536 characters, or a number of bytes")

    def _open(self, name: str) -> None:
        state = self.state
        self._drop(name)
        while len(self._views) >= MAX_VIEWS:
            self._drop(min(self._views, key=lambda other: self._views[other].session.used), "replaced")
        link = CommLink(self._post, name)
        link.greet()
        self._views[name] = PageView(self._sessions, link, state, self._is_alive)

    def _drop(self, name: str, note: str = "gone") -> None:
        state = self.state
        view = self._views.pop(name, None)
        if view is not None:
            self._state = state
            view.close(note)
