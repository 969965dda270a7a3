"""Connection to one browser: messages wait in bounded memory until the browser has read earlier ones."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Protocol

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode

from .page_limits import RateLimiter

log = logging.getLogger("pointray.view")

MAX_WAITING = 15 << 20  # bytes; a browser with more unread messages is disconnected
MESSAGE_OVERHEAD = 256  # bytes of memory of a waiting message besides its contents
PIECE = 1 << 18  # bytes; longer messages are sent in pieces, so that only pieces are copied
READ_SIZE = 1 << 14  # bytes read at once; all their frames are processed before reading can pause
MAX_PARTIAL_RATE = 10.0  # control frames and fragments a second, bursts of ten times as many; pages send few


class _File(NamedTuple):
    """Message whose contents are read from an open file while they are sent.

    header : bytes sent before the contents; stream : the file
    done : set when the file has been sent, or will not be
    """

    header: bytes
    stream: BinaryIO
    done: threading.Event


_Message = str | bytes | _File


class PageLink(Protocol):
    """Queue of messages to one page, over a WebSocket (`Link`) or a notebook (`notebook.comm_link`).

    is_local : whether the page's user may see names of folders
    """

    is_local: bool

    def send(self, message: str | bytes) -> None:
        """Queue a text or binary message."""

    def send_file(self, header: bytes, path: Path) -> None:
        """Send a header and a file's contents as one message; wait until it is sent or the page is gone."""


class Connection(ServerConnection):
    """WebSocket connection that drops clients that flood it with pings or message fragments.

    These are processed in the thread that serves all browsers, and neither the replies to pings nor fragments of
    unfinished messages are limited otherwise.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._parts = RateLimiter(MAX_PARTIAL_RATE, 10 * MAX_PARTIAL_RATE)

    def connection_made(self, transport: Any) -> None:
        """Limit the bytes that the event loop reads at once, so that reading can pause; begin as in the base class."""
        transport.max_size = READ_SIZE  # attribute of transports of asyncio's own event loops
        super().connection_made(transport)

    def process_event(self, event: Any) -> None:
        """Process a received WebSocket frame as in the base class; abort the connection if the client floods it.

        Control frames other than close, and fragments of messages, are limited to 10 a second with bursts of 100.
        """
        whole = not isinstance(event, Frame) or (event.fin and event.opcode in (Opcode.TEXT, Opcode.BINARY))
        if whole or event.opcode is Opcode.CLOSE or self._parts.take():
            super().process_event(event)
        else:
            self.transport.abort()


class Link:
    """Queue of messages to one browser, sent in order. Thread-safe.

    Attributes
    ----------
    open : bool
        Whether the browser is connected. Later messages are ignored.
    is_local : bool
        Whether the browser runs on this machine.
    """

    def __init__(self, connection: ServerConnection, loop: asyncio.AbstractEventLoop) -> None:
        self._connection, self._loop = connection, loop
        self.open, self.is_local = True, is_loopback(str(connection.remote_address[0]))
        self._lock = threading.Lock()
        self._queue: deque[_Message] = deque()
        self._waiting = 0  # bytes in the queue, and of the message that is being sent
        self._sending = False

    def send(self, message: str | bytes) -> None:
        """Queue a text or binary message; ignored after the browser has disconnected.

        A browser that leaves more than 15 MiB unread is disconnected.
        """
        self._put(message)

    def send_file(self, header: bytes, path: Path) -> None:
        """Send a header and a file's contents as one message; wait until it is sent or the browser has disconnected.

        Raises
        ------
        OSError
            If the file cannot be opened.
        """
        with path.open("rb") as stream:
            file = _File(header, stream, threading.Event())
            if self._put(file):
                file.done.wait()

    def close(self) -> None:
        """Discard waiting messages and ignore later ones: the browser has disconnected."""
        with self._lock:
            self.open = False
            files = [message for message in self._queue if isinstance(message, _File)]
            self._queue.clear()
        for file in files:
            file.done.set()

    def _put(self, message: _Message) -> bool:
        """Queue a message and start sending; return False if the browser has disconnected.

        A browser is disconnected if the messages that it has not read exceed MAX_WAITING bytes.
        """
        with self._lock:
            if not self.open:
                return False
            fits = self._waiting + _bytes_of(message) <= MAX_WAITING
            starts = fits and not self._sending
            if fits:
                self._queue.append(message)
                self._waiting += _bytes_of(message)
                self._sending = True
        try:
            if not fits:
                log.warning("closed the connection of a browser that does not read its messages")
                self.close()
                self._loop.call_soon_threadsafe(self._connection.transport.abort)
            elif starts:
                asyncio.run_coroutine_threadsafe(self._send_all(), self._loop)
        except RuntimeError:  # the loop has ended
            self.close()
        return fits

    async def _send_all(self) -> None:
        """Send messages until the queue is empty. One such coroutine runs at a time, on the server's event loop."""
        try:
            while (message := self._next()) is not None:
                try:
                    await self._connection.send(_pieces(message))
                finally:
                    with self._lock:
                        self._waiting -= _bytes_of(message)
                    if isinstance(message, _File):
                        message.done.set()
        except ConnectionClosed:
            self.close()
        except Exception:
            log.exception("error while sending to a browser")
            self.close()
            self._connection.transport.abort()

    def _next(self) -> _Message | None:
        with self._lock:
            self._sending = bool(self._queue)
            return self._queue.popleft() if self._queue else None


def _bytes_of(message: _Message) -> int:
    """Return the bytes of memory that a waiting message takes; the contents of a file do not count."""
    return MESSAGE_OVERHEAD + len(message.header if isinstance(message, _File) else message)


def _pieces(message: _Message) -> str | bytes | Iterator[str] | Iterator[bytes]:
    """Return a message as `ServerConnection.send` accepts it: the message, or its fragments if it is long or a file."""
    if isinstance(message, _File):
        return _read(message)
    if len(message) <= PIECE:
        return message
    return (message[k : k + PIECE] for k in range(0, len(message), PIECE))  # type: ignore[return-value]


def _read(file: _File) -> Iterator[bytes]:
    yield file.header
    while piece := file.stream.read(PIECE):
        yield piece


def is_loopback(host: str) -> bool:
    """Return whether a host, an IP address or "localhost", is this machine and unreachable from others."""
    if host == "localhost":
        return True
    with suppress(ValueError):
        address = ipaddress.ip_address(host.partition("%")[0])
        return (getattr(address, "ipv4_mapped", None) or address).is_loopback
    return False
