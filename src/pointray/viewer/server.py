"""Transport: the page over HTTP, and a WebSocket for each browser.

All connections are served by one thread with its own event loop, so that the server also works in notebooks. The
messages of each browser are processed in a thread of their own. The address contains a random token; requests without
it are refused.
"""

from __future__ import annotations

import asyncio
import errno
import http
import ipaddress
import logging
import secrets
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

from websockets.asyncio.server import Server as Listener, ServerConnection, serve
from websockets.datastructures import Headers, MultipleValuesError
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from .connection import Connection, Link, is_loopback
from .page_limits import CpuBudget

log = logging.getLogger("pointray.view")

PAGE = Path(__file__).parent / "page"
KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".md": "text/plain"}
FILES = {path.name: path for path in PAGE.iterdir() if path.suffix in KINDS}  # requests cannot name other files
PORT = 8080  # default; if it is in use, the next free one
TRIES = 100
LARGEST_MESSAGE = 1 << 16  # bytes of a message from the page
TOKEN_BYTES = 16
# Nothing is loaded from other sites, and no other site may show the page in a frame, except a notebook on
# this machine.
POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
    "frame-ancestors 'self' http://localhost:* http://127.0.0.1:* https://localhost:* vscode-webview:"
)


class PageHandler(Protocol):
    """Interface of the object that processes the messages of one browser."""

    def receive(self, text: str) -> None:
        """Process a message of the page (JSON). Calls come one after the other, from the handler's own thread."""

    def leave(self) -> None:
        """End processing: the browser has disconnected. Called from the same thread as `receive`."""


class Server:
    """Web server of the viewer, in its own thread until `close`: the page over HTTP, and a WebSocket for each browser.

    Parameters
    ----------
    make_handler : callable
        Returns the `PageHandler` of a `Link` (connection to a browser); called in the handler's own thread.
    host : str
        Address to listen on.
    port : int
        0: 8080. If the port is in use, the server listens on the next free one; see the attribute `port`.
    token : str
        Secret part of the address. Empty: a random one.
    hub : str
        Path of a notebook server on a JupyterHub, such as "/user/x/". Empty: none. With a hub, browsers connect through
        its proxy and under its host name.

    Raises
    ------
    OSError
        If the server cannot listen on that address.
    """

    def __init__(
        self, make_handler: Callable[[Link], PageHandler], host: str, port: int, token: str = "", hub: str = ""
    ) -> None:
        self._make_handler, self.host, self.port, self._hub = make_handler, host, port or PORT, hub.strip("/")
        self.token = token or secrets.token_urlsafe(TOKEN_BYTES)
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
        """Address of the page for a browser on this machine, including the token."""
        host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(self.host, self.host)
        return f"http://{f'[{host}]' if ':' in host and '[' not in host else host}:{self.port}/{self.token}/"

    @property
    def proxied(self) -> str:
        """Path of the page through a JupyterHub's proxy, such as "/user/x/proxy/8080/TOKEN/"; empty without a hub."""
        return f"{self._prefix}/{self.token}/" if self._hub else ""

    @property
    def _prefix(self) -> str:
        """Path under which a JupyterHub's proxy serves this port, such as "/user/x/proxy/8080".

        The proxy (jupyter-server-proxy) removes it from the paths of requests and sends it in a header.
        """
        return f"/{self._hub}/proxy/{self.port}"

    @property
    def is_public(self) -> bool:
        """Whether other machines can reach the server."""
        return not is_loopback(self.host)

    def close(self) -> None:
        """Stop the server and close all connections."""
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
        except (OSError, ValueError) as error:  # ValueError: invalid host name
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
                    self._serve_browser,
                    self.host,
                    self.port,
                    process_request=self._answer,
                    create_connection=Connection,
                    compression=None,  # images are already compressed
                    max_size=LARGEST_MESSAGE,
                    logger=_silent_logger(),
                )
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise OSError(error.errno, f"cannot listen on this address: {error.strerror}", self.host) from error
                continue
            return listener
        raise OSError(errno.EADDRINUSE, f"ports {first} to {self.port} are all in use", self.host)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the response to an HTTP request; None lets a WebSocket handshake proceed."""
        try:
            return self._respond(request)
        except (ValueError, MultipleValuesError) as error:  # invalid address or repeated header
            return _refused(http.HTTPStatus.BAD_REQUEST, f"{type(error).__name__}: {error}")

    def _respond(self, request: Request) -> Response | None:
        if not (self._is_known(request.headers.get("Host", "")) or self._is_proxied(request.headers)):
            return _refused(http.HTTPStatus.FORBIDDEN, "unknown host")
        token, slash, name = urlsplit(request.path).path.removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode(), self.token.encode()):
            return _refused(http.HTTPStatus.FORBIDDEN, "open the complete address printed by pointray, with its token")
        if name == "socket":
            own = self._is_own(request.headers)
            return None if own else _refused(http.HTTPStatus.FORBIDDEN, "request from a page of another site")
        if not slash:
            return _response(http.HTTPStatus.PERMANENT_REDIRECT, b"", "text/plain", Location=f"{self.token}/")
        file = FILES.get(name or "index.html")
        if file is None:
            return _refused(http.HTTPStatus.NOT_FOUND, "not found")
        return _response(http.HTTPStatus.OK, file.read_bytes(), KINDS[file.suffix])

    def _is_own(self, headers: Headers) -> bool:
        """Return whether the page that opens a WebSocket is the viewer's (or there is none), by the Origin header.

        Pages of other sites must not control the viewer.
        """
        origin = headers.get("Origin")
        own = origin is None or urlsplit(origin).netloc == headers.get("Host")
        if not own:
            log.warning("refused a connection from a page of %s", origin)
        return own

    def _is_known(self, host: str) -> bool:
        """Return whether a Host header names this machine; other names may be DNS rebinding by another site."""
        name = (urlsplit(f"//{host}").hostname or "").lower()
        if name in {"localhost", self.host.lower()} or _is_address(name):
            return True
        own = socket.gethostname().lower()
        return self.is_public and name in {own, f"{own}.local", socket.getfqdn().lower()}

    def _is_proxied(self, headers: Headers) -> bool:
        """Return whether a request comes through the JupyterHub's proxy, judged by the proxy's header.

        A page of another site cannot make a browser add this header. After DNS rebinding it could, but lacks the token.
        """
        return bool(self._hub) and headers.get("X-Forwarded-Context", "").rstrip("/") == self._prefix

    async def _serve_browser(self, connection: ServerConnection) -> None:
        """Serve one browser until it disconnects. No further message is read while its handler works."""
        link, share = Link(connection, self._loop), CpuBudget()
        if connection.request is None or self._is_proxied(connection.request.headers):
            link.is_local = False  # only the proxy is on this machine
        thread = ThreadPoolExecutor(1, "pointray-visitor")
        try:
            handler = await self._loop.run_in_executor(thread, self._try_make_handler, link)
            try:
                async for message in connection:
                    spent = await self._loop.run_in_executor(thread, _cpu_seconds_of, handler.receive, str(message))
                    if rest := share.rest(spent):
                        await asyncio.sleep(rest)
            except ConnectionClosed:
                pass
            finally:
                link.close()
                await self._loop.run_in_executor(thread, handler.leave)
        finally:
            link.close()
            thread.shutdown(wait=False)

    def _try_make_handler(self, link: Link) -> PageHandler:
        try:
            return self._make_handler(link)
        except Exception:
            log.exception("error while a browser connected")
            raise


def _cpu_seconds_of(work: Callable[[str], None], text: str) -> float:
    """Call `work` with a text and return the CPU time that it took, in seconds."""
    begun = time.thread_time()
    work(text)
    return time.thread_time() - begun


def _refused(status: http.HTTPStatus, why: str) -> Response:
    return _response(status, why.encode(errors="replace"), "text/plain")


def _response(status: http.HTTPStatus, body: bytes, kind: str, **more: str) -> Response:
    headers = Headers(**more)
    headers["Content-Type"] = f"{kind}; charset=utf-8"
    headers["Content-Length"] = str(len(body))
    headers["Cache-Control"] = "no-cache"
    headers["X-Content-Type-Options"] = "nosniff"
    headers["Referrer-Policy"] = "no-referrer"  # the address is secret
    headers["Content-Security-Policy"] = POLICY
    return Response(status.value, status.phrase, headers, body)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _silent_logger() -> Any:
    """Return a logger for the WebSocket library that hides events such as connections that end in the handshake."""
    logger = logging.getLogger("pointray.view.websockets")
    logger.setLevel(logging.CRITICAL)
    return logger
