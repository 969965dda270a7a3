"""Files on web servers, over the HTTP session of fsspec: range requests, and downloads whose length is checked."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import AsyncIterator
from concurrent.futures import Future
from contextlib import asynccontextmanager
from typing import Any

from ...base.extras import require
from ...base.progress import Progress
from . import transport
from .addresses import clean_name, file_name_of
from .errors import changed_error, lost_error, no_ranges_error, status_error, timeout_error, unreachable_error
from .transport import HEAD, Output, RemoteFacts, Transport, result_of

BLOCK = 1 << 18  # bytes
REDIRECTS = 10
ATTEMPTS = 3  # for a part of a file whose connection is lost; a server may close idle ones at any time


class HttpTransport(Transport):
    """Connection to a file on a web server.

    Parameters
    ----------
    url : str
    shown : str
        The URL without secrets, for messages.
    """

    def __init__(self, url: str, shown: str) -> None:
        self._url, self._shown = url, shown
        fsspec = require("fsspec", "remote", shown)
        require("aiohttp", "remote", shown)
        scheme = url.partition(":")[0].lower()
        known = fsspec.config.conf.get(scheme, {}).get("client_kwargs", {})
        # trust_env: proxies of HTTP_PROXY and HTTPS_PROXY.
        self._files = fsspec.filesystem(scheme, client_kwargs={"trust_env": True, **known})

    def probe(self) -> RemoteFacts:
        return result_of(self._start(self._probe()))

    def fetch(self, start: int, stop: int, facts: RemoteFacts) -> Future[bytes]:
        return self._start(self._fetch(start, stop, facts))

    def download(self, out: Output, facts: RemoteFacts, progress: Progress | None) -> None:
        shares = [0.0]  # the last one counts; a callback that raised in fsspec's thread would end that thread

        def report() -> None:
            if progress is not None and shares[-1] > 0:
                progress(shares[-1])

        result_of(self._start(self._download(out, facts, shares)), report)
        report()

    def _start(self, work: Any) -> Future[Any]:
        return asyncio.run_coroutine_threadsafe(work, self._files.loop)

    @asynccontextmanager
    async def _answer(self, **headers: str) -> AsyncIterator[Any]:
        """Yield the response to a GET request with further headers; convert errors of the connection."""
        import aiohttp

        session = await self._files.set_session()
        limits = aiohttp.ClientTimeout(
            total=None, connect=transport.CONNECT, sock_connect=transport.CONNECT, sock_read=transport.READ
        )
        headers["Accept-Encoding"] = "identity"
        try:
            url = self._files.encode_url(self._url)
            async with session.get(url, headers=headers, timeout=limits, max_redirects=REDIRECTS) as response:
                yield response
        except TimeoutError as error:
            connecting = type(error).__name__ == "ConnectionTimeoutError"  # of aiohttp 3.10 and later
            raise timeout_error(self._shown, transport.CONNECT if connecting else transport.READ) from None
        except aiohttp.TooManyRedirects:
            raise OSError(errno.ELOOP, f"more than {REDIRECTS} redirects: check the address", self._shown) from None
        except (aiohttp.InvalidURL, getattr(aiohttp, "NonHttpUrlClientError", aiohttp.InvalidURL), UnicodeError):
            raise ValueError(f"{self._shown}: invalid URL, or a redirect to one") from None
        except (aiohttp.ClientConnectorCertificateError, aiohttp.ClientConnectorSSLError):
            why = "no secure connection to the server: its certificate is invalid or unknown"
            raise ConnectionError(errno.EPROTO, why, self._shown) from None
        except aiohttp.ClientConnectorError:
            raise unreachable_error(self._shown) from None
        except aiohttp.ClientPayloadError:
            raise lost_error(self._shown, " before all bytes were received") from None
        except aiohttp.ClientResponseError:
            raise OSError(errno.EPROTO, "invalid answer of the server: check the address", self._shown) from None
        except (aiohttp.ClientError, ConnectionError) as error:
            if isinstance(error, ConnectionError) and error.filename == self._shown:
                raise
            raise lost_error(self._shown) from None

    async def _probe(self) -> RemoteFacts:
        async with self._answer(Range=f"bytes=0-{HEAD - 1}") as response:
            if response.status == 416:  # no first byte
                return RemoteFacts(b"", 0, "", False)
            if response.status not in (200, 206):
                raise status_error(response.status, self._shown)
            found, plain = _range_of(response), _is_plain(response)
            size = found[2] if found else response.content_length if plain else None
            ranges = found is not None and found[0] == 0 and found[2] is not None and plain
            head = await _first(response, HEAD)
            if ranges and len(head) != min(HEAD, size or 0):
                raise lost_error(self._shown, " before all bytes were received")
            name = response.content_disposition.filename if response.content_disposition else None
            name = clean_name(name) if name else file_name_of(str(response.url))
            return RemoteFacts(head, size, _tag_of(response), ranges, name)

    async def _fetch(self, start: int, stop: int, facts: RemoteFacts) -> bytes:
        for attempt in range(ATTEMPTS):
            try:
                return await self._fetch_once(start, stop, facts)
            except ConnectionError:
                if attempt == ATTEMPTS - 1:
                    raise
        raise AssertionError

    async def _fetch_once(self, start: int, stop: int, facts: RemoteFacts) -> bytes:
        async with self._answer(Range=f"bytes={start}-{stop - 1}") as response:
            if response.status == 416:
                raise changed_error(self._shown)
            if response.status not in (200, 206):
                raise status_error(response.status, self._shown)
            found = _range_of(response)
            if found is None or not _is_plain(response):
                raise no_ranges_error(self._shown)
            if found[2] not in (None, facts.size) or (_tag_of(response) or facts.tag) != facts.tag:
                raise changed_error(self._shown)
            if found[:2] != (start, stop):
                raise no_ranges_error(self._shown)
            data = await _first(response, stop - start)
            if len(data) != stop - start:
                raise lost_error(self._shown, " before all bytes were received")
            return data

    async def _download(self, out: Output, facts: RemoteFacts, shares: list[float]) -> None:
        async with self._answer() as response:
            if response.status != 200:
                raise status_error(response.status, self._shown)
            size = response.content_length if _is_plain(response) else None
            if (_tag_of(response) or facts.tag) != facts.tag or (facts.ranges and size not in (None, facts.size)):
                raise changed_error(self._shown)
            size = size if size is not None else facts.size if facts.ranges else None
            done = 0
            async for block in response.content.iter_chunked(BLOCK):
                out.write(block)
                done += len(block)
                if size:
                    shares[-1] = min(done / size, 1.0)
            if size is not None and done != size:
                raise lost_error(self._shown, f" after {done:,} of {size:,} bytes")


async def _first(response: Any, count: int) -> bytes:
    """Return the first bytes of a response, `count` or fewer; the others are not read."""
    blocks, left = [], count
    while left > 0:
        block = await response.content.read(left)
        if not block:
            break
        blocks.append(block)
        left -= len(block)
    return b"".join(blocks)


def _range_of(response: Any) -> tuple[int, int, int | None] | None:
    """Return first byte, end and total size that a partial response states; None if it is not partial or invalid."""
    unit, _, rest = response.headers.get("Content-Range", "").strip().partition(" ")
    span, _, total = rest.partition("/")
    first, _, last = span.partition("-")
    if response.status != 206 or unit.lower() != "bytes" or not (first.isdecimal() and last.isdecimal()):
        return None
    return int(first), int(last) + 1, int(total) if total.isdecimal() else None


def _is_plain(response: Any) -> bool:
    """Return whether the body is the file itself; otherwise it is compressed on the way, and its length is unknown."""
    return response.headers.get("Content-Encoding", "identity").strip().lower() in ("", "identity")


def _tag_of(response: Any) -> str:
    return str(response.headers.get("ETag") or response.headers.get("Last-Modified") or "")
