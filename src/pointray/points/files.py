"""Which reader takes which file, and how a file is replaced."""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..arguments import check_kind, check_path
from ..data import Points
from . import ply

# Extension -> reader. A format to come adds its file's READERS here.
READERS: dict[str, Callable[[Path], Points]] = {**ply.READERS}


def read(path: str | os.PathLike[str]) -> Points:
    """Read a point cloud.

    Parameters
    ----------
    path : str or path
        A file that ends in .ply: ascii or binary, with or without normals, colours and other properties.

    Returns
    -------
    Points
        The rows are those of the file, in its order.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If there is no reader for the extension, or the contents are damaged or hold no points.
    """
    file = check_path(path)
    reader = check_readable(file)
    try:
        return reader(file)
    except ValueError as error:
        raise ValueError(f"{file}: {' '.join(str(error).split())}") from error


def check_regular(path: str | os.PathLike[str]) -> Path:
    """The path of a file that is there; OSError for others, such as a folder, or a pipe that would wait for ever."""
    file = Path(path)
    if not stat.S_ISREG(file.stat().st_mode):
        number = errno.EISDIR if file.is_dir() else errno.EINVAL
        raise OSError(number, "not a regular file", str(file))
    return file


def check_readable(path: str | os.PathLike[str]) -> Callable[[Path], Points]:
    """The reader of a file; OSError or ValueError if it cannot be opened, or no reader knows its extension."""
    file = check_regular(path)
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        known = ", ".join(sorted(READERS))
        raise ValueError(f"{file}: cannot read {file.suffix or 'a file without extension'}; can read {known}")
    return reader


def write(path: str | os.PathLike[str], points: Points) -> None:
    """Write a point cloud with all that it holds, as binary PLY.

    Parameters
    ----------
    path : str or path
        Ends in .ply; replaced when all is written.
    points : Points
        Positions are written as float64 if they are held about an origin, else as float32. An attribute of k columns
        becomes the properties name_0, name_1 and so on.

    Raises
    ------
    OSError
        If the file cannot be written.
    ValueError
        If the extension is not .ply, or PLY cannot hold the name of an attribute.
    """
    file = check_path(path)
    check_kind(points, "points", Points, "Points")
    if file.suffix.lower() != ".ply":
        raise ValueError(f"{file}: cannot write {file.suffix or 'a file without extension'}; can write .ply")
    with replacing(file) as beside:
        ply.write_ply(beside, points)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise the OSError that writing `path` would end in, before the work is done."""
    file = Path(path)
    folder = file.parent
    if not folder.is_dir():
        raise FileNotFoundError(errno.ENOENT, f"cannot write {file.name}: there is no such folder", str(folder))
    if file.is_dir():
        raise IsADirectoryError(errno.EISDIR, "cannot write: it is a folder", str(file))
    if not os.access(folder, os.W_OK):
        raise PermissionError(errno.EACCES, f"cannot write {file.name}: no permission in the folder", str(folder))


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A path in the same folder to write to: it takes the place of `path` at the end, or goes if anything is raised."""
    check_writable(path)
    file = Path(os.path.realpath(path))  # the file that a link points to, not the link
    beside = file.with_name(f".pointray-{secrets.token_hex(6)}{file.suffix}")
    try:
        yield beside
        beside.replace(file)
    except BaseException:  # Ctrl-C too
        beside.unlink(missing_ok=True)
        raise
