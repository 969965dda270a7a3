"""Interface of connections to remote files, and the wait for their results."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from ...base.progress import Progress

T = TypeVar("T")

HEAD = 1 << 12  # bytes at the beginning of a file that are read first
CONNECT, READ = 10.0, 30.0  # seconds to wait for a connection, and for the next bytes
POLL = 0.2  # seconds between looks for Ctrl-C


@dataclass(frozen=True)
class RemoteFacts:
    """What a server says about a file, and the file's first bytes.

    Attributes
    ----------
    head : bytes
        The first `HEAD` bytes, or all of a smaller file.
    size : int or None
        Size in bytes; None if the server does not say.
    tag : str
        Identifies this version of the file: its ETag or the time of its last change; empty if unknown.
    ranges : bool
        Whether the server can send parts of the file, and `size` is known.
    name : str
        File name that the server gives; empty if it gives none.
    """

    head: bytes
    size: int | None
    tag: str
    ranges: bool
    name: str = ""


class Output(Protocol):
    """What a download is written to, such as a file."""

    def write(self, block: bytes, /) -> Any:
        """Write bytes."""


class Transport(ABC):
    """A connection to one remote file. All errors are OSErrors or ValueErrors that name its URL without secrets."""

    @abstractmethod
    def probe(self) -> RemoteFacts:
        """Fetch the first bytes of the file and what the server says about it."""

    @abstractmethod
    def fetch(self, start: int, stop: int, facts: RemoteFacts) -> Future[bytes]:
        """Begin to fetch the bytes from `start` to `stop`; the result has exactly these.

        facts : result of `probe`; a file that has changed since raises OSError
        """

    @abstractmethod
    def download(self, out: Output, facts: RemoteFacts, progress: Progress | None) -> None:
        """Write the whole file to `out`, which checks the free space of the disk.

        facts : result of `probe`; a file that has changed since raises OSError
        progress : called with the completed share; not called if the size is unknown
        """

    def check(self, facts: RemoteFacts) -> None:
        """Raise OSError if the file has changed since `probe`, unless `fetch` and `download` notice that themselves."""
        return


def result_of(future: Future[T], report: Callable[[], None] | None = None) -> T:
    """Wait for the result of another thread; Ctrl-C interrupts the wait and cancels the work.

    report : called in this thread every `POLL` seconds; its exceptions, too, cancel the work
    """
    try:
        while not wait([future], POLL).done:
            if report is not None:
                report()
        return future.result()
    except BaseException:
        future.cancel()
        raise
