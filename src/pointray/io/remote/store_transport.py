"""Files in the stores that fsspec knows, such as s3 and gs."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

from ...base.extras import require
from ...base.progress import Progress
from . import transport
from .errors import changed_error, lost_error, store_error
from .range_reader import CONNECTIONS
from .transport import HEAD, Output, RemoteFacts, Transport, result_of

BLOCK = 1 << 22  # bytes
TAGS = ("ETag", "etag", "md5Hash", "generation", "LastModified", "last_modified", "updated", "mtime", "created")


class StoreTransport(Transport):
    """Connection to a file in a store of fsspec, which finds credentials in its usual places.

    Parameters
    ----------
    url : str
    shown : str
        The URL without secrets, for messages.
    """

    def __init__(self, url: str, shown: str) -> None:
        self._url, self._shown = url, shown
        core = require("fsspec", "remote", shown).core
        with self._errors():
            self._files, self._path = core.url_to_fs(url, **_timeouts(url.partition(":")[0].lower()))

    def probe(self) -> RemoteFacts:
        with self._errors():
            facts = self._files.info(self._path)
            if facts.get("type") == "directory":
                raise IsADirectoryError
            size, tag = facts.get("size"), _tag_of(facts)
            head = bytes(self._files.cat_file(self._path, start=0, end=HEAD))[:HEAD] if size != 0 else b""
        return RemoteFacts(head, size, tag, size is not None)

    def fetch(self, start: int, stop: int, facts: RemoteFacts) -> Future[bytes]:
        if self._files.async_impl:
            return asyncio.run_coroutine_threadsafe(self._fetch(start, stop), self._files.loop)
        future: Future[bytes] = Future()
        try:
            with self._errors():
                data = self._files.cat_file(self._path, start=start, end=stop)
            future.set_result(self._checked(data, start, stop))
        except Exception as error:
            future.set_exception(error)
        return future

    def download(self, out: Output, facts: RemoteFacts, progress: Progress | None) -> None:
        if facts.size is None:
            with self._errors(), self._files.open(self._path, "rb") as stream:
                while block := stream.read(BLOCK):
                    out.write(block)
            self.check(facts)
            return
        size, waiting = facts.size, deque[Future[bytes]]()
        starts = iter(range(0, size, BLOCK))
        done = 0
        while done < size:
            while len(waiting) < CONNECTIONS and (start := next(starts, None)) is not None:
                waiting.append(self.fetch(start, min(start + BLOCK, size), facts))
            block = result_of(waiting.popleft())
            out.write(block)
            done += len(block)
            if progress is not None:
                progress(done / size)
        self.check(facts)

    def check(self, facts: RemoteFacts) -> None:
        with self._errors():
            self._files.invalidate_cache()
            now = self._files.info(self._path)
            if now.get("size") != facts.size or _tag_of(now) != facts.tag:
                raise changed_error(self._shown)

    async def _fetch(self, start: int, stop: int) -> bytes:
        with self._errors():
            data = await self._files._cat_file(self._path, start=start, end=stop)
        return self._checked(data, start, stop)

    def _checked(self, data: Any, start: int, stop: int) -> bytes:
        if len(data) != stop - start:
            raise lost_error(self._shown, f" after {len(data):,} of {stop - start:,} bytes")
        return bytes(data)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Convert exceptions of fsspec and of the packages of stores, unless they name the file already."""
        try:
            yield
        except Exception as error:
            if getattr(error, "filename", None) == self._shown or str(error).startswith(f"{self._shown}:"):
                raise
            raise store_error(error, self._url, self._shown) from None


def _tag_of(facts: dict[str, Any]) -> str:
    """Return what identifies this version of a file. facts : what its store says about it"""
    return next((str(facts[name]) for name in TAGS if facts.get(name)), "")


def _timeouts(scheme: str) -> dict[str, Any]:
    """Return the arguments that set the timeouts of a store; its other settings of fsspec's configuration stay."""
    if scheme in ("s3", "s3a"):
        from fsspec.config import conf

        known = conf.get(scheme, {}).get("config_kwargs", {})
        return {"config_kwargs": {"connect_timeout": transport.CONNECT, "read_timeout": transport.READ, **known}}
    return {"requests_timeout": transport.READ} if scheme in ("gs", "gcs") else {}
