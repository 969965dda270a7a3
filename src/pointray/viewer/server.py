"""The transport: one page over HTTP, and a WebSocket for each browser that has it open. It knows nothing of pictures.

All connections live in one thread with an event loop of its own, so that it serves notebooks too.
"""

from __future__ import annotations

import asyncio
import errno
import http
import ipaddress
import logging
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

from websockets.asyncio.server import Server as Listener
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

log = logging.getLogger("pointray.view")

PAGE = Path(__file__).parent / "page"
KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".md": "text/plain"}
PORT = 8080  # where none is asked for; the next free one, if it is taken
TRIES = 100
LARGEST_MESSAGE = 1 << 16  # bytes, of the page's
MOST_WAITING = 1 << 29  # bytes, for a browser that does not read: it is let go
# Nothing from elsewhere is loaded or asked, and no other site may show the page in a frame but a notebook of this
# machine.
POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
    "frame-ancestors 'self' http://localhost:* http://127.0.0.1:* https://localhost:* vscode-webview:"
)


class Visitor(Protocol):
    """What is behind a browser."""

    def receive(self, text: str) -> None:
        """A message of the page; called in the server's thread, so it must not take long."""

    def leave(self) -> None:
        """The browser has gone."""


class Link:
    """The way to one browser; messages may be sent from any thread."""

    def __init__(self, connection: ServerConnection, loop: asyncio.AbstractEventLoop) -> None:
        self._connection, self._loop = connection, loop
        self.open = True
        self._waiting = 0  # bytes

    def send(self, message: str | bytes) -> None:
        """Send, some time soon; to a browser that has gone, nothing."""
        if self._waiting > MOST_WAITING:
            self.open = False
            self._loop.call_soon_threadsafe(self._connection.transport.abort)
        if self.open:
            self._waiting += len(message)
            try:
                asyncio.run_coroutine_threadsafe(self._send(message), self._loop)
            except RuntimeError:  # the loop has ended
                self.open = False

    async def _send(self, message: str | bytes) -> None:
        try:
            await self._connection.send(message)
        except ConnectionClosed:
            self.open = False
        finally:
            self._waiting -= len(message)


class Server:
    """Serves the page from its making until `close`.

    Parameters
    ----------
    welcome : callable
        Makes the `Visitor` behind a `Link`.
    host : str
        The address to listen on.
    port : int
        0: PORT, or the next one that is free. Another that is taken: the next one too, see `port`.

    Raises
    ------
    OSError
        If it cannot listen there.
    """

    def __init__(self, welcome: Callable[[Link], Visitor], host: str, port: int) -> None:
        self._welcome, self.host, self.port = welcome, host, port or PORT
        self._ready = threading.Event()
        self._failed: Exception | None = None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="pointray-server", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._failed is not None:
            raise self._failed

    @property
    def url(self) -> str:
        """Where the page is, for a browser on this machine."""
        host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(self.host, self.host)
        return f"http://{f'[{host}]' if ':' in host and '[' not in host else host}:{self.port}/"

    @property
    def is_public(self) -> bool:
        """Whether other machines can reach it."""
        return not _is_loopback(self.host)

    def close(self) -> None:
        """End it, and all connections."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join(timeout=2.0)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        self._ended = asyncio.Event()
        try:
            listener = await self._listen()
        except (OSError, ValueError) as error:  # ValueError: a host that is no name
            self._failed = error
            return
        finally:
            self._ready.set()
        async with listener:
            await self._ended.wait()

    async def _listen(self) -> Listener:
        first = self.port
        for self.port in range(first, min(first + TRIES, 65536)):
            try:
                listener = await serve(
                    self._attend,
                    self.host,
                    self.port,
                    process_request=self._answer,
                    compression=None,  # pictures are compressed already
                    max_size=LARGEST_MESSAGE,
                    logger=_quiet(),
                )
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise OSError(error.errno, f"cannot listen there: {error.strerror}", self.host) from error
                continue
            return listener
        raise OSError(errno.EADDRINUSE, f"ports {first} to {self.port} are all taken", self.host)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The answer to a request over HTTP; None lets a WebSocket through."""
        path = urlsplit(request.path).path
        if not self._is_known(request.headers.get("Host", "")):
            return _response(http.HTTPStatus.FORBIDDEN, b"unknown host", "text/plain")
        if path == "/socket":
            return None if self._is_own(request.headers) else _response(http.HTTPStatus.FORBIDDEN, b"", "text/plain")
        file = PAGE / (path.lstrip("/") or "index.html")
        if file.parent != PAGE or file.suffix not in KINDS or not file.is_file():
            return _response(http.HTTPStatus.NOT_FOUND, b"not found", "text/plain")
        return _response(http.HTTPStatus.OK, file.read_bytes(), KINDS[file.suffix])

    def _is_own(self, headers: Headers) -> bool:
        """Whether a socket is opened by our page or no page at all: another site's may not drive the viewer."""
        origin = headers.get("Origin")
        own = origin is None or urlsplit(origin).netloc == headers.get("Host")
        if not own:
            log.warning("refused a connection from the page of %s", origin)
        return own

    def _is_known(self, host: str) -> bool:
        """Whether a Host header names this machine: another name may be one that a foreign site has pointed here."""
        name = (urlsplit(f"//{host}").hostname or "").lower()
        if name in {"localhost", self.host.lower()} or _is_address(name):
            return True
        own = socket.gethostname().lower()
        return self.is_public and name in {own, f"{own}.local", socket.getfqdn().lower()}

    async def _attend(self, connection: ServerConnection) -> None:
        """One browser, from coming to going."""
        link = Link(connection, self._loop)
        try:
            visitor = self._welcome(link)
        except Exception:
            log.exception("while a browser came")
            raise
        try:
            async for message in connection:
                if isinstance(message, str):
                    visitor.receive(message)
        except ConnectionClosed:
            pass
        finally:
            link.open = False
            visitor.leave()


def _response(status: http.HTTPStatus, body: bytes, kind: str) -> Response:
    headers = Headers()
    headers["Content-Type"] = f"{kind}; charset=utf-8"
    headers["Content-Length"] = str(len(body))
    headers["Cache-Control"] = "no-cache"
    headers["X-Content-Type-Options"] = "nosniff"
    headers["Content-Security-Policy"] = POLICY
    return Response(status.value, status.phrase, headers, body)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _is_loopback(host: str) -> bool:
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


def _quiet() -> Any:
    """A logger for what browsers do all day: connections that end in the middle of a handshake, and so on."""
    logger = logging.getLogger("pointray.view.websockets")
    logger.setLevel(logging.CRITICAL)
    return logger
