"""The connection to one browser: messages wait here, in bounded memory, until it has read the earlier ones."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode

from .page_limits import RateLimiter

log = logging.getLogger("pointray.view")

MAX_WAITING = 15 << 20  # bytes: a browser that reads too little is disconnected
MESSAGE_OVERHEAD = 256  # bytes that a waiting message takes besides its own
PIECE = 1 << 18  # bytes: longer messages go in pieces, so that only pieces are copied
READ_SIZE = 1 << 14  # bytes read at once: all frames in them are processed before reading can pause
MAX_PARTIAL_RATE = 10.0  # frames a second that are not whole messages; ten times as many at once: pages send hardly any


class _File(NamedTuple):
    """A file to send: it stays on disk and is read while it is sent. left : set once it is no longer needed."""

    header: bytes
    stream: BinaryIO
    done: threading.Event


_Message = str | bytes | _File


class Connection(ServerConnection):
    """A connection that drops a client that sends pings or pieces of messages without end.

    These are processed in the thread that serves all browsers, and neither answers to pings nor pieces wait in bounded
    memory.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._parts = RateLimiter(MAX_PARTIAL_RATE, 10 * MAX_PARTIAL_RATE)

    def connection_made(self, transport: Any) -> None:
        """Begin, as in the base class."""
        transport.max_size = READ_SIZE  # an attribute that asyncio's own event loops have
        super().connection_made(transport)

    def process_event(self, event: Any) -> None:
        """Take what came, as in the base class."""
        whole = not isinstance(event, Frame) or (event.fin and event.opcode in (Opcode.TEXT, Opcode.BINARY))
        if whole or event.opcode is Opcode.CLOSE or self._parts.take():
            super().process_event(event)
        else:
            self.transport.abort()


class Link:
    """Sends messages in order; any thread may call it.

    Attributes
    ----------
    open : bool
    is_local : bool
        Whether the browser is on this machine.
    """

    def __init__(self, connection: ServerConnection, loop: asyncio.AbstractEventLoop) -> None:
        self._connection, self._loop = connection, loop
        self.open, self.is_local = True, is_loopback(str(connection.remote_address[0]))
        self._lock = threading.Lock()
        self._queue: deque[_Message] = deque()
        self._waiting = 0  # bytes in the queue, and of the message that is being sent
        self._sending = False

    def send(self, message: str | bytes) -> None:
        """Send a message soon; to a browser that has gone, send nothing."""
        self._put(message)

    def send_file(self, header: bytes, path: Path) -> None:
        """Send a header and a file's contents as one message; returns when the file is no longer needed.

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
        """Drop what waits: the browser has gone."""
        with self._lock:
            self.open = False
            files = [message for message in self._queue if isinstance(message, _File)]
            self._queue.clear()
        for file in files:
            file.done.set()

    def _put(self, message: _Message) -> bool:
        """Queue a message; returns whether it will be sent, or its file be left."""
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
                log.warning("a browser does not read what it is sent: its connection is closed")
                self.close()
                self._loop.call_soon_threadsafe(self._connection.transport.abort)
            elif starts:
                asyncio.run_coroutine_threadsafe(self._send_all(), self._loop)
        except RuntimeError:  # the loop has ended
            self.close()
        return fits

    async def _send_all(self) -> None:
        """Send until nothing waits."""
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
            log.exception("while sending to a browser")
            self.close()
            self._connection.transport.abort()

    def _next(self) -> _Message | None:
        with self._lock:
            self._sending = bool(self._queue)
            return self._queue.popleft() if self._queue else None


def _bytes_of(message: _Message) -> int:
    """The bytes that a message holds."""
    return MESSAGE_OVERHEAD + len(message.header if isinstance(message, _File) else message)


def _pieces(message: _Message) -> str | bytes | Iterator[str] | Iterator[bytes]:
    """A message in the form in which it is sent."""
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
    """Whether an address, or "localhost", is this machine and cannot be reached from elsewhere."""
    if host == "localhost":
        return True
    with suppress(ValueError):
        address = ipaddress.ip_address(host.partition("%")[0])
        return (getattr(address, "ipv4_mapped", None) or address).is_loopback
    return False
