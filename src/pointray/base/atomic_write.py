"""Atomic replacement of files: a new file is written in the same folder and renamed once it is complete."""

from __future__ import annotations

import errno
import io
import os
import re
import secrets
import stat
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

if sys.platform != "win32":
    import fcntl
if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

BESIDE = re.compile(r"\.pointray-[0-9a-f]{16}(\..*)?")  # names of unfinished files
BUFFER = 1 << 20  # bytes
_swept: set[Path] = set()


def check_regular(path: str | os.PathLike[str]) -> Path:
    """Return the path of a regular file.

    Raise OSError if it is missing or not a regular file, such as a folder, or a pipe, which would block.
    """
    file = Path(path)
    if not stat.S_ISREG(file.stat().st_mode):
        number = errno.EISDIR if file.is_dir() else errno.EINVAL
        raise OSError(number, "not a regular file", str(file))
    return file


def unsupported_extension(file: Path, known: Iterable[str]) -> ValueError:
    """Return the ValueError for an output file whose extension stands for no supported format.

    known : supported extensions, for the message
    """
    extension = file.suffix or "a file without extension"
    return ValueError(f"{file}: cannot write {extension}; supported: {', '.join(known)}")


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise OSError if a file cannot be written: no such folder, no permission in it, or `path` is a folder itself."""
    file = Path(path)
    folder = file.parent
    if not folder.is_dir():
        raise FileNotFoundError(errno.ENOENT, f"cannot write {file.name}: folder not found", str(folder))
    if file.is_dir():
        raise IsADirectoryError(errno.EISDIR, "cannot write: it is a folder", str(file))
    if not os.access(folder, os.W_OK):
        raise PermissionError(errno.EACCES, f"cannot write {file.name}: no permission in the folder", str(folder))


class Replacement(io.BufferedIOBase):
    """Output stream to a temporary file that replaces another file once it is complete.

    The temporary file is in the same folder. Writers that need a path instead of a stream can use `path`; their callers
    must check that the file is complete. The stream has no file descriptor: Pillow would write to it, and would mistake
    a partial write for a complete one.

    `take_place_of` raises the first error of a write again, in case a library has hidden it. The temporary file is
    locked until it is renamed: unlocked ones were left behind by killed processes, and `sweep` removes them.

    Attributes
    ----------
    path : path
        The temporary file.
    """

    def __init__(self, file: Path) -> None:
        self.path, self._lock = _new_beside(file)
        self._file = self.path.open("r+b", BUFFER)
        self._error: OSError | None = None

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def write(self, data: ReadableBuffer, /) -> int:
        with self._remembering():
            return self._file.write(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        with self._remembering():  # seeking writes the buffer
            return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        if not self._file.closed:
            with self._remembering():
                self._file.flush()

    def take_place_of(self, file: Path) -> None:
        """Rename the temporary file to `file` once all data has reached the disk; raise OSError if any write failed."""
        self.flush()
        with self._remembering():
            os.fsync(self._file.fileno())
            self._file.close()
        if self._error is not None:
            raise self._error
        if sys.platform == "win32":  # an open file cannot be replaced there
            os.close(self._lock)
        self.path.replace(file)
        if sys.platform != "win32":
            os.close(self._lock)

    def discard(self) -> None:
        """Close and remove the temporary file, so that the file that it should replace stays as it is."""
        for close in (self._file.close, lambda: os.close(self._lock)):
            with suppress(OSError):  # the disk may be full, but the file is removed anyway
                close()
        self.path.unlink(missing_ok=True)

    @contextmanager
    def _remembering(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._error = self._error or error
            raise


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Replacement]:
    """Yield an output stream to a temporary file, which replaces `path` at the end, or is removed on an error.

    `path` is added to an OSError without a file name, such as that of a full disk.
    """
    check_writable(path)
    file = Path(os.path.realpath(path))  # the file that a link points to, not the link
    sweep(file.parent)
    beside = Replacement(file)
    try:
        yield beside
        beside.take_place_of(file)
    except BaseException as error:  # Ctrl-C too
        beside.discard()
        if isinstance(error, OSError) and error.errno is not None and error.filename is None:
            error.filename = str(path)
        raise


def sweep(folder: Path) -> None:
    """Remove unfinished files that killed processes left in a folder; do so only once per folder in this process."""
    if folder in _swept:
        return
    _swept.add(folder)
    with suppress(OSError), os.scandir(folder) as entries:
        for path in [entry.path for entry in entries if BESIDE.fullmatch(entry.name)]:
            with suppress(OSError):  # it is in use, or belongs to another user
                _remove_left(path)


def _new_beside(file: Path) -> tuple[Path, int]:
    """Create an empty temporary file in the folder of `file`, with its extension, and lock it.

    Return its path and the file descriptor that holds the lock.
    """
    while True:
        path = file.with_name(f".pointray-{secrets.token_hex(8)}{file.suffix}")
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        if sys.platform == "win32":
            return path, lock
        with suppress(OSError):  # on a file system without locks, files left behind are not removed
            fcntl.flock(lock, fcntl.LOCK_EX)
        with suppress(FileNotFoundError):  # another process removed it before it was locked
            if os.path.samestat(os.fstat(lock), path.stat()):
                return path, lock
        os.close(lock)


def _remove_left(path: str) -> None:
    """Remove a temporary file left behind by a killed process.

    Raise OSError if a process on this or another machine still writes it and has therefore locked it.
    """
    if sys.platform == "win32":
        os.unlink(path)  # fails while it is open
        return
    lock = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.unlink(path)
    finally:
        os.close(lock)
