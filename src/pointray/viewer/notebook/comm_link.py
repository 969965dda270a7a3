"""Link to one view of a widget, over the messages of a notebook instead of a WebSocket."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..connection import MAX_WAITING, MESSAGE_OVERHEAD

log = logging.getLogger("pointray.view")

WINDOW = 4 << 20  # bytes sent that the page has not acknowledged; further messages wait
PIECE = 1 << 20  # bytes of a file in one message

Post = Callable[[dict[str, Any], list[bytes]], None]


class CommLink:
    """Queue of messages to one view of a widget, sent in order. Thread-safe.

    A notebook does not report what its page has read, so the page acknowledges it: `acknowledge`.

    Parameters
    ----------
    post : callable
        Sends a message, a dict and a list of binary buffers, to the widget's pages.
    view : str
        Identifier of the view, contained in each message.

    Attributes
    ----------
    open : bool
        Whether the view is connected. Later messages are ignored.
    is_local : bool
        True: whoever uses a notebook may read the files of its kernel.
    """

    def __init__(self, post: Post, view: str) -> None:
        self.open, self.is_local = True, True
        self._post, self._view = post, view
        self._changed = threading.Condition(threading.RLock())
        self._queue: deque[str | bytes] = deque()
        self._waiting, self._unread = 0, 0  # bytes in the queue, and sent but not acknowledged

    def send(self, message: str | bytes) -> None:
        """Queue a text or binary message; ignored after the view has been disconnected.

        A view that leaves more than 15 MiB waiting is disconnected.
        """
        with self._changed:
            if not self.open:
                return
            self._queue.append(message)
            self._waiting += MESSAGE_OVERHEAD + len(message)
            self._send_waiting()
            if self._waiting > MAX_WAITING:
                log.warning("closed the connection of a notebook's page that does not read its messages")
                self.close()

    def send_file(self, header: bytes, path: Path) -> None:
        """Send a header and a file's contents in pieces; wait until they are sent or the view is disconnected.

        Raises
        ------
        OSError
            If the file cannot be read.
        """
        with path.open("rb") as stream:
            piece: bytes = header
            while piece:
                following = stream.read(PIECE)
                with self._changed:
                    self._changed.wait_for(lambda: not self.open or (self._unread < WINDOW and not self._queue))
                    if not self.open:
                        return
                    self._send_now({"view": self._view, "piece": "more" if following else "last"}, piece)
                piece = following

    def acknowledge(self, count: int) -> None:
        """Note that the page has read messages whose fields "bytes" sum to `count`, and send waiting ones."""
        with self._changed:
            self._unread = max(0, self._unread - max(0, count))
            self._send_waiting()
            self._changed.notify_all()

    def close(self, note: str = "gone") -> None:
        """Discard waiting messages and ignore later ones.

        note : content of the last message: "gone", "ended", or "replaced", after which the page connects again only
        when it is used
        """
        with self._changed:
            if self.open:
                self._send_now({"view": self._view, "state": note})
            self.open = False
            self._queue.clear()
            self._changed.notify_all()

    def greet(self) -> None:
        """Tell the page that it is connected."""
        with self._changed:
            self._send_now({"view": self._view, "state": "opened"})

    def _send_waiting(self) -> None:
        while self.open and self._queue and self._unread < WINDOW:
            message = self._queue.popleft()
            self._waiting -= MESSAGE_OVERHEAD + len(message)
            if isinstance(message, str):
                self._send_now({"view": self._view, "text": message})
            else:
                self._send_now({"view": self._view}, message)

    def _send_now(self, content: dict[str, Any], *buffers: bytes) -> None:
        """Send a message; if that fails, since the notebook has closed the widget, ignore all later ones."""
        size = MESSAGE_OVERHEAD + len(content.get("text", "")) + sum(map(len, buffers))
        self._unread += size
        try:
            self._post({**content, "bytes": size}, list(buffers))
        except Exception:
            log.exception("error while sending to a notebook")
            self.open = False
