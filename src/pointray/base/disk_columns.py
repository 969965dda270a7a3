"""Arrays on disk, read and written in pieces, for clouds larger than memory.

The files are not memory-mapped, because the pages of a mapped file count as memory of the process.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import sys
import threading
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .atomic_write import replacing

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9.-]*")
FILE = re.compile(rf"({NAME.pattern})\.([biuf]\d+)x(\d+)")
GAP = 1 << 12  # maximum bytes between two rows that are read in one call
SPAN = 1 << 20  # maximum bytes per call when only some rows are needed


class Column:
    """Array of n rows in a file, for clouds larger than memory.

    Threads may read and write different rows at the same time.

    Parameters
    ----------
    path : path
        An existing file; its name states name, dtype and width: "positions.f4x3".
    written : set of Column, optional
        Set to which the column adds itself when it is written to, so that its owner knows what to flush to the disk.

    Attributes
    ----------
    path : path
    name : str
    dtype : dtype
        In native byte order.
    width : int
        Numbers per row; 0 for an (n,) array.

    Raises
    ------
    ValueError
        If the file size is not a multiple of the row size.
    """

    def __init__(self, path: Path, written: set[Column] | None = None) -> None:
        name, kind, width = _parsed(path)
        self.path, self.name, self.dtype, self.width = path, name, np.dtype(kind), width
        self._written = written
        self._row = self.dtype.itemsize * max(width, 1)
        self._file = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        self._close = weakref.finalize(self, os.close, self._file)
        self._lock = threading.Lock()
        size = os.fstat(self._file).st_size
        if size % self._row:
            self._close()
            raise ValueError(f"{path}: is cut off: its {size:,} bytes are not a multiple of {self._row}, the row size")

    def __len__(self) -> int:
        return os.fstat(self._file).st_size // self._row

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the column: (n,) or (n, width)."""
        return (len(self), self.width) if self.width else (len(self),)

    @property
    def nbytes(self) -> int:
        """Number of bytes of all rows."""
        return len(self) * self._row

    def __getitem__(self, rows: slice | NDArray[np.integer[Any]]) -> NDArray[Any]:
        """Read rows into a new array, (m,) or (m, width): those of a slice, or with the given numbers in any order."""
        if not isinstance(rows, slice):
            return self._gather(np.asarray(rows))
        start, stop, step = rows.indices(len(self))
        if step != 1:
            return self._gather(np.arange(start, stop, step))
        out = self._empty_rows(max(stop - start, 0))
        self._read(start, out)
        return out

    def write(self, start: int, rows: ArrayLike) -> None:
        """Write rows, (n,) or (n, width), from row `start` on; the column grows as needed."""
        array = np.ascontiguousarray(rows, self.dtype)
        if array.shape[1:] != ((self.width,) if self.width else ()):
            raise ValueError(f"rows of {self.path.name} cannot have the shape {array.shape}")
        if start < 0:
            raise ValueError(f"row numbers of {self.path.name} start at 0, got {start}")
        bytes_left, place = array.reshape(-1).view(np.uint8).data, start * self._row
        if self._written is not None:
            self._written.add(self)
        with _explaining_errors(self.path):
            while len(bytes_left):
                written = self._put(bytes_left, place)
                bytes_left, place = bytes_left[written:], place + written

    def append(self, rows: ArrayLike) -> None:
        """Write rows, (m,) or (m, width), after the last one; not thread-safe."""
        self.write(len(self), rows)

    def sync(self) -> None:
        """Wait until all written data has reached the disk."""
        with _explaining_errors(self.path):
            os.fsync(self._file)

    def _empty_rows(self, n: int) -> NDArray[Any]:
        return np.empty((n, self.width) if self.width else n, self.dtype)

    def _gather(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Read the rows with the given numbers, (m,) in any order, into a new array, (m,) or (m, width).

        Rows that are close together in the file are read in one call.
        """
        if rows.ndim != 1 or (rows.dtype.kind not in "iu" and len(rows)):
            raise TypeError(f"row numbers must be integers, (n,), not {rows.dtype} {rows.shape}")
        out = self._empty_rows(len(rows))
        if not len(rows):
            return out
        order = None if (rows[1:] >= rows[:-1]).all() else np.argsort(rows, kind="stable")
        ordered = (rows if order is None else rows[order]).astype(np.int64)
        if ordered[0] < 0 or ordered[-1] >= len(self):
            raise IndexError(
                f"rows {ordered[0]} to {ordered[-1]} are outside {self.path.name}, which has {len(self):,}"
            )
        apart = np.diff(ordered) > 1 + GAP // self._row
        apart |= np.diff(ordered // max(SPAN // self._row, 1)) > 0
        bounds = [0, *(np.flatnonzero(apart) + 1).tolist(), len(ordered)]
        for begin, end in zip(bounds[:-1], bounds[1:], strict=True):
            first = int(ordered[begin])
            piece = self._empty_rows(int(ordered[end - 1]) + 1 - first)
            self._read(first, piece)
            into = slice(begin, end) if order is None else order[begin:end]
            out[into] = piece[ordered[begin:end] - first]
        return out

    def _read(self, start: int, out: NDArray[Any]) -> None:
        """Fill the array `out`, (m,) or (m, width), with the rows `start` to start + m."""
        bytes_left, place = out.reshape(-1).view(np.uint8).data, start * self._row
        while len(bytes_left):
            read = self._get(bytes_left, place)
            if not read:
                raise ValueError(f"{self.path}: is cut off after {place:,} bytes")
            bytes_left, place = bytes_left[read:], place + read

    if sys.platform == "win32":  # has no calls that read or write at an offset

        def _get(self, out: memoryview, place: int) -> int:
            with self._lock:
                os.lseek(self._file, place, os.SEEK_SET)
                piece = os.read(self._file, min(len(out), SPAN))
            out[: len(piece)] = piece
            return len(piece)

        def _put(self, data: memoryview, place: int) -> int:
            with self._lock:
                os.lseek(self._file, place, os.SEEK_SET)
                return os.write(self._file, data[:SPAN])
    else:

        def _get(self, out: memoryview, place: int) -> int:
            return os.preadv(self._file, [out], place)

        def _put(self, data: memoryview, place: int) -> int:
            return os.pwrite(self._file, data, place)


class Columns:
    """Folder of arrays on disk (columns), found by name, and of small JSON records, for clouds larger than memory.

    It can be pickled for processes that share the folder.

    Parameters
    ----------
    folder : path
        Created if missing.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._written: set[Column] = set()  # columns with data that may not have reached the disk
        folder.mkdir(parents=True, exist_ok=True)

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder, "_written": set()}

    @property
    def names(self) -> list[str]:
        """Sorted names of all columns in the folder, without those of JSON records."""
        return sorted({match[1] for match in map(FILE.fullmatch, os.listdir(self.folder)) if match})

    def __contains__(self, name: str) -> bool:
        return bool(self._files(name))

    def __getitem__(self, name: str) -> Column:
        """Open the column with a name; raise KeyError if it is missing."""
        files = self._files(name)
        if not files:
            raise KeyError(name)
        if len(files) > 1:
            raise ValueError(f"{self.folder}: duplicate column {name}: {', '.join(sorted(f.name for f in files))}")
        return Column(files[0], self._written)

    def find(self, name: str) -> Column | None:
        """Open the column with a name; return None if it is missing."""
        return self[name] if name in self else None  # noqa: SIM401

    def make(self, name: str, dtype: DTypeLike, width: int = 0, rows: int = 0) -> Column:
        """Create a column of zeros, replacing one with this name. Its rows take no disk space until they are written.

        width : numbers per row, 0 for an (n,) array; rows : initial number of rows
        """
        path = self._path(name, np.dtype(dtype), width)
        self.drop(name)
        with _explaining_errors(path), path.open("xb") as file:
            file.truncate(rows * np.dtype(dtype).itemsize * max(width, 1))
        return Column(path, self._written)

    def fill(self, name: str, rows: NDArray[Any]) -> None:
        """Write all `rows`, (n,) or (n, width), of a column atomically, replacing one with this name."""
        path = self._path(name, rows.dtype, rows.shape[1] if rows.ndim > 1 else 0)
        with replacing(path) as beside:
            beside.write(np.ascontiguousarray(rows).reshape(-1).view(np.uint8).data)

    def rename(self, name: str, new: str) -> None:
        """Rename a column, replacing the one that has the new name."""
        column = self[name]
        self.drop(new)
        column.path.replace(self._path(new, column.dtype, column.width))

    def drop(self, name: str) -> None:
        """Remove the column and the JSON record with this name, if they exist."""
        self._written -= {column for column in self._written if column.name == name}
        for file in (*self._files(name), self._facts(name)):
            file.unlink(missing_ok=True)

    def sync(self) -> None:
        """Wait until all data written to columns since the last call has reached the disk."""
        for column in list(self._written):
            column.sync()
            self._written.discard(column)

    def put(self, name: str, facts: Mapping[str, Any]) -> None:
        """Store a JSON record, a file NAME.json in the folder, replacing one with this name."""
        with replacing(self._facts(name)) as beside:
            beside.write(json.dumps(facts, indent=1).encode())

    def get(self, name: str) -> dict[str, Any] | None:
        """Return the JSON record with a name as a dict; None if it is missing."""
        path = self._facts(name)
        try:
            facts = json.loads(path.read_bytes())
        except FileNotFoundError:
            return None
        except ValueError as error:
            raise ValueError(f"{path}: is damaged: {error}") from error
        if not isinstance(facts, dict):
            raise ValueError(f"{path}: is damaged: expected a JSON object")
        return facts

    def get_or_put(self, name: str, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Return the JSON record with a name as a dict; if it is missing, call `compute` and store its result."""
        known = self.get(name)
        if known is not None:
            return known
        facts = compute()
        self.put(name, facts)
        return facts

    def _files(self, name: str) -> list[Path]:
        matches = [match for match in map(FILE.fullmatch, os.listdir(self.folder)) if match]
        return [self.folder / match[0] for match in matches if match[1] == name]

    def _path(self, name: str, dtype: np.dtype[Any], width: int) -> Path:
        path = self.folder / f"{_checked(name)}.{dtype.str[1:]}x{width}"
        _parsed(path)
        return path

    def _facts(self, name: str) -> Path:
        return self.folder / f"{_checked(name)}.json"


def refresh_listing(folder: Path) -> None:
    """Make files that other machines have written into a folder of a network file system visible here.

    Such a file system may show an outdated listing for up to a minute, until a file is created in the folder: a
    temporary file is created and removed. Raise OSError if the folder is not writable.
    """
    path = folder / f".{secrets.token_hex(8)}"
    with _explaining_errors(folder):
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        path.unlink()


@contextmanager
def _explaining_errors(path: Path) -> Iterator[None]:
    """Add the path to an OSError raised in this context; that of a full disk, for example, names no file."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def _parsed(path: Path) -> tuple[str, str, int]:
    """Return what the file name of a column states: its name, dtype such as "f4", and width (0 for an (n,) array)."""
    match = FILE.fullmatch(path.name)
    if match is None:
        raise ValueError(f"{path}: is not the file name of a column, such as positions.f4x3")
    return match[1], match[2], int(match[3])


def _checked(name: str) -> str:
    if not NAME.fullmatch(name):
        raise ValueError(f"column names consist of letters, digits, dots and hyphens: {name!r} is invalid")
    return name
