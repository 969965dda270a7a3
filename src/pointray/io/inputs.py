"""Files to read, local or remote: their paths, changes while they are read, and the paths that formats open."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

from ..base.atomic_write import check_regular
from ..base.progress import StageProgress
from ..base.warning_log import warn
from .formats._source import Format, Request
from .known_formats import format_by, format_in_pieces, format_of
from .remote.range_reader import RangedFile
from .remote.remote_file import Location, RemoteFile, local_copy, location_of
from .unpacking import packing_by, packing_of, unpacked

OnePath = str | os.PathLike[str] | RemoteFile
Paths = OnePath | Sequence[OnePath]


def locations_of(path: Any, name: str, stack: ExitStack | None = None) -> list[Location]:
    """Return one path or URL, or a sequence of these, as a list, whether the files exist or not.

    name : the argument, for messages; stack : on exit, removes the temporary copies of files that are given as URLs
    """
    several = isinstance(path, Sequence) and not isinstance(path, str | bytes)
    files: list[Location] = []
    for one in path if several else [path]:
        files.append(file := location_of(one, name))
        if stack is not None and isinstance(file, RemoteFile) and file is not one:
            stack.callback(file.release)
    return files


def paths_of(path: Any, stack: ExitStack | None = None) -> list[Location]:
    """Return one path or URL, or a sequence of these, as a list; raise OSError for a missing file, a folder or a pipe.

    stack : on exit, removes the temporary copies of files that are given as URLs
    """
    files = [check_exists(file) for file in locations_of(path, "path", stack)]
    if not files:
        raise ValueError("path must name at least one file")
    return files


def check_exists(file: Location) -> Location:
    """Return a regular file, or a remote one that its server has; raise OSError for others, ValueError for empty ones.

    Empty local files raise no error.
    """
    if isinstance(file, RemoteFile):
        file.facts  # noqa: B018  # asks the server
        return file
    return check_regular(file)


def stamp(file: Location) -> tuple[int, int | str]:
    """Return the size (bytes) and the modification time (ns) of a file, which change when it is written to.

    For a remote file these are its size (-1: unknown) and what identifies its version, a str (empty: unknown).
    """
    if isinstance(file, RemoteFile):
        return file.stamp
    facts = file.stat()
    return facts.st_size, facts.st_mtime_ns


def identity_of(file: Location) -> str:
    """Return a text that names a file unambiguously: its absolute path, or its URL with a hash of its secret parts."""
    return f"{file} {file.key}" if isinstance(file, RemoteFile) else str(file.resolve())


def check_unchanged(
    files: Sequence[Location], before: Sequence[tuple[int, int | str]], error: ValueError | None = None
) -> None:
    """Raise ValueError if a file has been modified while it was read.

    Changes of remote files are found when parts of them are fetched.

    before : size and modification time of each file before reading
    error : error of reading, probably a consequence, which the message quotes
    """
    for file, known in zip(files, before, strict=True):
        if stamp(file) != known:
            why = f" ({error})" if error else ""
            raise ValueError(f"{file}: was modified while it was read; read it again once writing has finished{why}")


def pieces_of(file: RemoteFile, request: Request) -> tuple[Format, RangedFile] | None:
    """Return the format of a remote file and its stand-in for a path, if it is read in pieces; None otherwise.

    That is done if only parts of the file are needed, and the server can send these.
    """
    format = format_in_pieces(file.facts.head, request)
    return None if format is None or file.pieces is None else (format, file.pieces)


def fetch(files: Sequence[Location], request: Request, progress: StageProgress | None) -> None:
    """Download the remote files that are not read in pieces for a request, if that has not been done."""
    for file in files:
        if isinstance(file, RemoteFile) and pieces_of(file, request) is None:
            file.copy(progress)


def check_format(file: RemoteFile) -> None:
    """Raise ValueError if the format of a remote file is unknown, ImportError if it needs a missing package.

    Only its first bytes are fetched. Compressed files are not examined.
    """
    if packing_by(file.facts.head) is None:
        format_by(file.facts.head, file)


def located(
    file: Location, request: Request, stack: ExitStack, progress: StageProgress | None = None
) -> tuple[Format, Any]:
    """Return the format of a file and the path to open, after downloading and decompressing it if necessary.

    The path is a `RangedFile` if only parts of a remote file are needed.

    stack : keeps a compressed file unpacked until it is left; progress : called while a file is downloaded
    """
    if isinstance(file, RemoteFile):
        pieces = pieces_of(file, request)
        if pieces is not None:
            return pieces
        check_format(file)
        if format_in_pieces(file.facts.head, request) is not None:
            warn(f"{file}: the server cannot send parts of files; the whole file is downloaded", stacklevel=2)
    path = stack.enter_context(local_copy(file, progress))
    if packing_of(path):
        path = stack.enter_context(unpacked(path, request.strict, file))
    return format_of(path, file), path
