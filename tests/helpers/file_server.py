"""A web server on this machine that counts the bytes it sends, supports ranges, and misbehaves on demand."""

from __future__ import annotations

import os
import re
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

PAGE = b"<!DOCTYPE html>\n<html><body>Please sign in</body></html>"


@dataclass
class FileServer:
    """Files by path, and how they are served.

    Attributes
    ----------
    files : dict of str to bytes
    faults : dict of str to str
        How a path misbehaves: a status like "404", "plain" (no ranges), "html", "loop", "cut" (the connection is closed
        halfway), "cut later" (only from the second request on), "stall" (nothing is sent any more halfway), "stall
        whole" (the same, but only without a range), "silent" (no answer), "longer" (wrong Content-Length), "shorter"
        (without a range, the file lacks its end), "untagged" (no ETag), "changing" (another ETag each time), "gzip"
        (compressed on the way), "to PATH" (a redirect), "lose one" (one connection is lost), "together" (no answer
        before a second request).
    sent : list of (str, int)
        Path and number of bytes of the body of each answer, recorded before it is sent.
    """

    address: str = ""
    files: dict[str, bytes] = field(default_factory=dict)
    faults: dict[str, str] = field(default_factory=dict)
    sent: list[tuple[str, int]] = field(default_factory=list)
    most_at_once: int = 0
    released: threading.Event = field(default_factory=threading.Event)
    _busy: int = 0
    arrived: threading.Condition = field(default_factory=threading.Condition)

    def url(self, path: str) -> str:
        return f"{self.address}/{path}"

    def add(self, path: str, data: bytes, fault: str = "") -> str:
        """Serve a file; return its URL."""
        self.files[path], self.faults[path] = data, fault
        return self.url(path)

    @property
    def bytes(self) -> int:
        return sum(size for _, size in self.sent)

    @contextmanager
    def busy(self) -> Iterator[None]:
        with self.arrived:
            self._busy += 1
            self.most_at_once = max(self.most_at_once, self._busy)
            self.arrived.notify_all()
        try:
            yield
        finally:
            with self.arrived:
                self._busy -= 1


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Any

    def log_message(self, *args: object) -> None:
        pass

    def do_GET(self) -> None:  # noqa: N802
        files: FileServer = self.server.shared
        with files.busy():
            self._answer(files, self.path.partition("?")[0].lstrip("/"))

    def _answer(self, files: FileServer, path: str) -> None:
        fault, data = files.faults.get(path, "404"), files.files.get(path, b"")
        with files.arrived:
            earlier = sum(each == path for each, _ in files.sent)
            files.sent.append((path, 0))
        if fault == "together":
            with files.arrived:
                files.arrived.wait_for(lambda: files.most_at_once > 1, 20)
        if fault == "silent":
            files.released.wait(60)
            self.close_connection = True
            return
        if fault.isdigit():
            return self._send(int(fault), b"error", {})
        if fault == "loop" or fault.startswith("to "):
            return self._send(302, b"", {"Location": self.path if fault == "loop" else fault[3:]})
        if fault == "html":
            return self._send(200, PAGE, {"Content-Type": "text/html"})
        headers = {} if fault == "untagged" else {"ETag": f'"{earlier if fault == "changing" else len(data)}"'}
        span = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        if span and fault not in ("plain", "gzip", "longer"):
            start, stop = int(span[1]), min(int(span[2]) + 1, len(data))
            if start >= len(data):
                return self._send(416, b"", {})
            headers["Content-Range"] = f"bytes {start}-{stop - 1}/{len(data)}"
            status, data = 206, data[start:stop]
        else:
            status, data = 200, data[:-1000] if fault == "shorter" else data
        if fault == "gzip":
            import gzip

            headers["Content-Encoding"], data = "gzip", gzip.compress(data)
        broken = fault == "cut" or (fault == "cut later" and earlier) or (fault == "lose one" and earlier == 2)
        length = len(data) + (1000 if fault == "longer" else 0)
        stalls = fault == "stall" or (fault == "stall whole" and status == 200)
        self._send(status, data[: len(data) // 2] if broken or stalls else data, headers, length)
        if stalls:
            self.wfile.flush()
            files.released.wait(60)
        if broken or stalls or fault == "longer":
            self.close_connection = True
            self.connection.shutdown(socket.SHUT_RDWR)

    def _send(self, status: int, body: bytes, headers: dict[str, str], length: int | None = None) -> None:
        files: FileServer = self.server.shared
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body) if length is None else length), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        path = self.path.partition("?")[0].lstrip("/")
        with files.arrived:  # before the client has the bytes and can ask for their number
            files.sent[files.sent.index((path, 0))] = (path, len(body))
        try:
            self.wfile.write(body)
        except OSError:  # the client has what it needs
            self.close_connection = True


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, *args: object) -> None:
        pass  # a client closed its connection


@pytest.fixture
def no_proxies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove the proxies of the environment, which requests to this machine would be sent to."""
    for name in [name for name in os.environ if name.lower().endswith("_proxy")]:
        monkeypatch.delenv(name)


@contextmanager
def file_server() -> Iterator[FileServer]:
    """Serve files on a free port of this machine while the context lasts."""
    server: Any = _Server(("127.0.0.1", 0), _Handler)
    server.shared = FileServer(f"http://127.0.0.1:{server.server_port}")
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    try:
        yield server.shared
    finally:
        server.shared.released.set()
        server.shutdown()
        server.server_close()
        thread.join()
