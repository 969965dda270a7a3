"""A file by its URL: what its server says about it, its temporary copy, and pieces of it."""

from __future__ import annotations

import errno
import hashlib
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

from ...base.arguments import check_path
from ...base.progress import StageProgress, in_stage
from .addresses import WEB, check_url, clean_name, file_name_of, is_url, local_path_of, shown_url
from .errors import check_no_web_page
from .range_reader import Kept, RangedFile, RangeReader
from .transport import RemoteFacts, Transport

SPARE = 1 << 28  # bytes of the disk to leave free


class RemoteFile:
    """File that is named by a URL. `str` gives the URL without passwords and signatures.

    Its whole contents are in a temporary copy, downloaded when it is needed, which `release` removes. It has those
    attributes and methods of a Path that say what kind of file it is.

    Parameters
    ----------
    url : str
        Address with a scheme that fsspec knows, such as https:// or s3://.

    Raises
    ------
    ValueError
        If the URL is invalid.
    """

    def __init__(self, url: str) -> None:
        self._url = check_url(url)
        self._shown = shown_url(url)
        self._path: Path | None = None
        self._remove: weakref.finalize[..., Any] | None = None  # removes the folder of the copy, at the latest at exit

    def __str__(self) -> str:
        return self._shown

    def __repr__(self) -> str:
        return f"RemoteFile({self._shown!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RemoteFile) and other._url == self._url

    def __hash__(self) -> int:
        return hash(self._url)

    @property
    def name(self) -> str:
        """File name: the end of the URL; the name that the server gives if that has no extension."""
        own = file_name_of(self._url)
        given = "" if PurePosixPath(own).suffix or "facts" not in self.__dict__ else self.facts.name
        return clean_name(given or own)

    @property
    def suffix(self) -> str:
        """Extension of the file name, with the dot."""
        return PurePosixPath(self.name).suffix

    @property
    def stem(self) -> str:
        """File name without its extension."""
        return PurePosixPath(self.name).stem

    @property
    def key(self) -> str:
        """Hash of the URL, which tells files apart whose shown URLs are equal."""
        return hashlib.sha256(self._url.encode()).hexdigest()[:16]

    def is_dir(self) -> bool:
        """Return False: folders on servers are not supported."""
        return False

    def resolve(self) -> RemoteFile:
        """Return this file, like the method of a Path."""
        return self

    @cached_property
    def _connection(self) -> Transport:
        if WEB.match(self._url):
            from .http_transport import HttpTransport

            return HttpTransport(self._url, self._shown)
        from .store_transport import StoreTransport

        return StoreTransport(self._url, self._shown)

    @cached_property
    def facts(self) -> RemoteFacts:
        """What the server says about the file, asked once.

        Raises
        ------
        OSError
            If the file is missing, access is denied, the server does not answer, or it sends a web page.
        ImportError
            If a package is missing.
        ValueError
            If the file is empty, or the kind of address is unknown.
        """
        facts = self._connection.probe()
        check_no_web_page(facts.head, self._shown)
        if facts.size == 0 or not facts.head:
            raise ValueError(f"{self}: is empty")
        return facts

    @property
    def stamp(self) -> tuple[int, str]:
        """Size in bytes (-1: unknown) and what identifies this version of the file (empty: unknown)."""
        return -1 if self.facts.size is None else self.facts.size, self.facts.tag

    @cached_property
    def pieces(self) -> RangedFile | None:
        """The file as a stand-in for a path, of which only the pieces that are read are fetched; None if impossible."""
        facts, connection = self.facts, self._connection
        if not facts.ranges or facts.size is None:
            return None
        size, kept = facts.size, Kept(facts.head)

        def reader() -> RangeReader:
            return RangeReader(lambda a, b: connection.fetch(a, b, facts), size, kept, lambda: connection.check(facts))

        return RangedFile(reader, size, self.name)

    def copy(self, progress: StageProgress | None = None) -> Path:
        """Return the path of the temporary copy, downloaded at the first call; an incomplete one is removed.

        progress : called with the stage "downloading" and the file's name, and the completed share

        Raises
        ------
        OSError
            If the download fails, the connection breaks, or the disk is too full.
        """
        if self._path is not None:
            return self._path
        facts = self.facts
        stage = in_stage(progress, f"downloading {self.name}")
        if stage is not None:
            stage(0.0)
        folder = tempfile.mkdtemp(prefix="pointray-")
        self._remove = weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        path = Path(folder) / self.name
        try:
            with path.open("wb") as file:
                self._connection.download(_CheckedOutput(file, self, facts.size), facts, stage)
            self.check_not_released()
        except BaseException:  # Ctrl-C too
            self.release()
            raise
        self._path = path
        return path

    def release(self) -> None:
        """Remove the temporary copy, if there is one, and stop the download in another thread."""
        remove, self._remove, self._path = self._remove, None, None
        if remove is not None:
            remove()

    def check_not_released(self) -> None:
        """Raise OSError if the copy that is being downloaded was released."""
        if self._remove is None:
            raise OSError(errno.ECANCELED, "download canceled", str(self))


class _CheckedOutput:
    """Output of a download, which raises OSError if the disk becomes too full. size : expected bytes, if known"""

    def __init__(self, file: BinaryIO, remote: RemoteFile, size: int | None) -> None:
        self._file, self._remote, self._left = file, remote, size or 0
        self._check(self._left)

    def write(self, block: bytes) -> int:
        """Write bytes, like a file."""
        self._remote.check_not_released()
        self._check(len(block))
        try:
            return self._file.write(block)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self._remote)) from None

    def _check(self, size: int) -> None:
        folder = Path(self._file.name).parent
        with suppress(FileNotFoundError):
            if shutil.disk_usage(folder).free < size + SPARE:
                need = f"{size / 2**20:,.0f} MiB" if size > SPARE else "it"
                advice = f"too little space for {need} in {folder.parent}: free some, or set TMPDIR to another folder"
                raise OSError(errno.ENOSPC, advice, str(self._remote))


Location = Path | RemoteFile


def location_of(value: Any, name: str = "path") -> Location:
    """Return an argument, a string, path object or `RemoteFile`, as a Path, or as a RemoteFile if it is a URL.

    Raise an ArgumentTypeError that names the argument for other types; ValueError if the URL is invalid.
    """
    if isinstance(value, RemoteFile):
        return value
    if is_url(value):
        return RemoteFile(value)
    check_path(value, name)
    return local_path_of(value)


@contextmanager
def local_copy(file: Location, progress: StageProgress | None = None) -> Iterator[Path]:
    """Yield the path of a local file, or of the temporary copy of a remote one, whose URL replaces it in errors."""
    if isinstance(file, Path):
        yield file
        return
    path = file.copy(progress)
    try:
        yield path
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and error.filename is not None and str(error.filename) == str(path):
            error.filename = str(file)
        elif str(path) in str(error) and isinstance(error, ValueError):
            raise ValueError(str(error).replace(str(path), str(file))) from error
        raise
