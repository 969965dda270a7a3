"""Remote files read in pieces: only those are fetched that are read, announced ones ahead and several at once."""

from __future__ import annotations

import io
import os
import sys
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from contextlib import closing
from typing import TYPE_CHECKING, Any

from .transport import result_of

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

CONNECTIONS = 6  # requests at the same time
LARGEST = 1 << 22  # bytes of a request that joins pieces; a larger piece is one request
WASTE = 0.2  # bytes between joined pieces that nobody needs, as a share of the pieces
KEPT = 1 << 26  # bytes of pieces that are kept for the next reader of the same file

Span = tuple[int, int]  # first byte and end
Fetch = Callable[[int, int], "Future[bytes]"]


def joined(spans: Iterable[Span]) -> list[Span]:
    """Return spans of requests that cover the given spans, sorted: near ones are joined to fewer requests.

    At most 20% of the bytes of a request, relative to the others, are between the spans.
    """
    requests: list[list[int]] = []  # first byte, end, bytes between the spans
    for start, stop in sorted(set(spans)):
        if requests:
            first, end, waste = last = requests[-1]
            gap = max(start - end, 0)
            needed = max(end, stop) - first - waste - gap
            if waste + gap <= WASTE * needed and (start < end or max(end, stop) - first <= LARGEST):
                last[1:] = max(end, stop), waste + gap
                continue
        requests.append([start, stop, 0])
    return [(first, end) for first, end, _ in requests]


class Kept:
    """Pieces of a remote file that its readers share, such as its header, up to `KEPT` bytes. head : first bytes"""

    def __init__(self, head: bytes) -> None:
        self.head = head
        self._pieces: dict[Span, bytes] = {}
        self._size = 0

    def get(self, start: int, stop: int) -> bytes | None:
        """Return the bytes of a span if they are known; None otherwise."""
        if stop <= len(self.head):
            return self.head[start:stop]
        return self._pieces.get((start, stop))

    def put(self, start: int, data: bytes) -> None:
        """Keep the bytes of a span that begins at `start`, unless too many are kept already."""
        if self._size + len(data) <= KEPT:
            self._pieces[start, start + len(data)] = data
            self._size += len(data)


class RangeReader(io.RawIOBase):
    """Remote file that is open for reading.

    Parameters
    ----------
    fetch : callable
        Begins to fetch the bytes of a span, see `Transport.fetch`.
    size : int
        Size of the file in bytes.
    kept : Kept
        What other readers of the same file have fetched.
    check : callable, optional
        Raises OSError if the file has changed; called by `close` if pieces were fetched.
    """

    def __init__(self, fetch: Fetch, size: int, kept: Kept, check: Callable[[], None] | None = None) -> None:
        self._fetch, self._size, self._kept, self._at = fetch, size, kept, 0
        self._check, self._fetched = check, False
        # Requests of announced spans, by their index; those before `_first` are done.
        self._spans: list[Span] = []
        self._sent: dict[int, Future[bytes]] = {}
        self._first = self._next = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        self._at = max(base + offset, 0)
        return self._at

    def read(self, size: int | None = -1, /) -> bytes:
        stop = self._size if size is None or size < 0 else min(self._at + size, self._size)
        start, self._at = self._at, max(stop, self._at)
        return self._piece(start, stop) if stop > start else b""

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        view = memoryview(buffer).cast("B")
        data = self.read(len(view))
        view[: len(data)] = data
        return len(data)

    def announce(self, spans: Sequence[Span]) -> None:
        """Plan to read spans in ascending order. They are fetched ahead, several at once, and not kept."""
        self._drop()
        self._spans, self._first, self._next = joined(self._valid(spans)), 0, 0
        self._send()

    def keep(self, spans: Sequence[Span]) -> None:
        """Fetch spans, several at once, and keep them for this and other readers."""
        missing = [span for span in self._valid(spans) if self._kept.get(*span) is None]
        self._fetched = self._fetched or bool(missing)
        with closing(RangeReader(self._fetch, self._size, self._kept)) as reader:
            reader.announce(missing)
            for start, stop in sorted(set(missing)):
                self._kept.put(start, reader._piece(start, stop))

    def close(self) -> None:
        if self.closed:
            return
        self._drop()
        super().close()
        kind = sys.exc_info()[0]
        if self._check is not None and self._fetched and (kind is None or issubclass(kind, Exception)):  # no Ctrl-C
            self._check()

    def __del__(self) -> None:
        self._check = None  # an exception would be lost
        super().__del__()

    def _valid(self, spans: Sequence[Span]) -> list[Span]:
        return [(start, stop) for start, stop in spans if 0 <= start < stop <= self._size]

    def _piece(self, start: int, stop: int) -> bytes:
        """Return the bytes of a span: known ones, those of a request, or those of a request of its own."""
        known = self._kept.get(start, stop)
        if known is not None:
            return known
        self._fetched = True
        number = bisect_right(self._spans, (start, self._size)) - 1
        if self._first <= number and stop <= self._spans[number][1]:
            for old in [k for k in self._sent if k < number]:
                self._sent.pop(old).cancel()
            self._first, self._next = number, max(number, self._next)
            self._send()
            begin = self._spans[number][0]
            return result_of(self._sent[number])[start - begin : stop - begin]
        data = result_of(self._fetch(start, stop))
        if len(data) <= LARGEST:
            self._kept.put(start, data)
        return data

    def _send(self) -> None:
        while self._next < min(self._first + CONNECTIONS, len(self._spans)):
            self._sent[self._next] = self._fetch(*self._spans[self._next])
            self._next += 1

    def _drop(self) -> None:
        for future in self._sent.values():
            future.cancel()
        self._sent.clear()
        self._spans = []


class RangedFile:
    """Stand-in for the path of a remote file whose server can send parts of it; formats that read in parts take it.

    Parameters
    ----------
    open_reader : callable
        Returns a new `RangeReader`.
    size : int
        Size in bytes.
    name : str
        File name.
    """

    def __init__(self, open_reader: Callable[[], RangeReader], size: int, name: str) -> None:
        self._open_reader, self._size, self.name = open_reader, size, name

    def stat(self) -> Any:
        """Return the size of the file, as `st_size`."""
        return os.stat_result((0, 0, 0, 0, 0, 0, self._size, 0, 0, 0))

    def open(self, mode: str = "rb") -> RangeReader:
        """Open the file for reading, which sends no request. mode : only "rb" """
        return self._open_reader()


def announce(file: Any, spans: Sequence[Span], keep: bool = False) -> None:
    """Fetch spans of an open file ahead if it is remote; for a local file do nothing.

    keep : fetch them at once and keep them, instead of reading them once in ascending order
    """
    if isinstance(file, RangeReader):
        (file.keep if keep else file.announce)(spans)
