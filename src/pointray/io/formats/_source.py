"""Interface of the readers: a `Source` is an opened file that lists its contents and yields its rows in chunks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from ...base.arrays import Doubles
from ...base.progress import Progress
from ...cloud.georeference import Georeference
from ...cloud.points import Points

CHUNK = 1 << 18  # approximate number of rows of a chunk
HEAD = 1 << 12  # bytes at the beginning of a file from which its format is detected
NO, MAYBE, SURE = range(3)  # result of detection: MAYBE by the extension only, SURE by the contents


class Request(NamedTuple):
    """Options of reading that concern the format; formats ignore options that do not apply.

    Attributes
    ----------
    columns : tuple of str or None
        Names of the columns of a text file, "-" for an ignored one; None: detected.
    bounds : (2, 3) float64 or None
        World box. A format may skip rows outside; the caller filters exactly.
    resolution : float or None
        Coarsest acceptable spacing, in the file's unit: formats with levels of detail (COPC) stop there.
    sample : int or None
        Number of points to sample on the triangles of a mesh; 0: its vertices; None: chosen automatically.
    opacity : float
        Gaussian splats with a lower opacity are left out.
    intrinsics : tuple of float or None
        fx, fy, cx, cy of a depth image, in pixels; optionally the number of depth steps per unit of length.
    strict : bool
        Refuse files that are truncated, inconsistent or refer to a missing file. Otherwise the available data are read,
        with a warning.
    """

    columns: tuple[str, ...] | None = None
    bounds: Doubles | None = None
    resolution: float | None = None
    sample: int | None = None
    opacity: float = 0.1
    intrinsics: tuple[float, ...] | None = None
    strict: bool = False


class Chunk(NamedTuple):
    """Some rows of a file. All chunks of a file have the same columns; in text, later chunks may have wider dtypes.

    Attributes
    ----------
    positions : (m, 3) array of floats or integers
        World coordinates.
    normals : (m, 3) array of floats or None
    colors : (m, 3) array or None
        sRGB as stored in the file: 8 bits, 16 bits, 8 bits in a wider type, or floats from 0 to 1.
    attributes : dict of str to (m,) or (m, k) array
        Other columns by name.
    share : float
        Fraction of the file that has been read after this chunk, 0 to 1.
    """

    positions: NDArray[Any]
    normals: NDArray[Any] | None = None
    colors: NDArray[Any] | None = None
    attributes: Mapping[str, NDArray[Any]] = {}
    share: float = 1.0

    @property
    def columns(self) -> list[NDArray[Any]]:
        """List of all existing columns: positions, normals, colours, then the attributes."""
        there = [column for column in (self.positions, self.normals, self.colors) if column is not None]
        return [*there, *self.attributes.values()]

    def select(self, rows: NDArray[Any] | slice) -> Chunk:
        """Return some of the rows as copies, so that the memory of larger arrays can be freed.

        rows : slice, mask or row numbers
        """
        return self.each(lambda column: column[rows].copy() if isinstance(rows, slice) else column[rows])

    def each(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Chunk:
        """Return a chunk whose columns are the results of a function applied to each column."""
        return Chunk(
            change(self.positions),
            None if self.normals is None else change(self.normals),
            None if self.colors is None else change(self.colors),
            {name: change(values) for name, values in self.attributes.items()},
            self.share,
        )


@dataclass(frozen=True)
class Listing:
    """What the header of a file announces.

    Attributes
    ----------
    count : int or None
        Number of rows, checked against the file's size; None if it is known only after reading. A truncated text may
        yield fewer.
    expected : int
        Estimated number of rows, if `count` is None.
    row : int
        Bytes per row of all columns in memory while reading.
    georeference : Georeference
        May be completed while rows are read: use it after the last chunk.
    facts : dict
        Further information for `pointray info`, as JSON values: "version", "software", "scans".
    """

    count: int | None
    row: int
    expected: int = 0
    georeference: Georeference = Georeference()
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Exact or estimated number of rows."""
        return self.expected if self.count is None else self.count


class Faults:
    """Record of the faults of a file that its reader repairs, as text for a warning: `str(faults)`.

    A strict reader refuses the file instead.

    Parameters
    ----------
    strict : bool
        Whether to raise ValueError for a fault.
    """

    def __init__(self, strict: bool) -> None:
        self.strict = strict
        self._found: list[str] = []

    def add(self, message: str) -> None:
        """Record a repaired fault; raise ValueError with this message if the reader is strict."""
        if self.strict:
            raise ValueError(message)
        if message not in self._found:
            self._found.append(message)

    def __str__(self) -> str:
        return "; ".join(self._found)


class Source(ABC):
    """An opened file, to be used in a `with` statement, which closes it. Each format has a subclass.

    Attributes
    ----------
    listing : Listing
        What the header announces.
    faults : Faults
        Faults that were repaired; complete after all rows have been read.
    note : str
        Automatic choices of the reader, and how to override them; complete after all rows have been read.
    """

    listing: Listing
    faults = Faults(strict=True)  # for formats that repair nothing
    note: str = ""

    @abstractmethod
    def chunks(self) -> Iterator[Chunk]:
        """Yield the rows in the file's order, once. Raise ValueError, with the place, if the contents are invalid."""

    def close(self) -> None:  # noqa: B027  # optional: a file read in one go has nothing to close
        """Close the open files."""

    def __enter__(self) -> Source:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


Writer = Callable[[Any, Points, Progress | None], list[str]]


@dataclass(frozen=True)
class Format:
    """A file format: each module of this folder defines one, called FORMAT.

    Attributes
    ----------
    name : str
        Name for users.
    extensions : tuple of str
        Usual extensions with the dot, in lower case, the most common one first.
    recognise : callable
        (first `HEAD` bytes of a file, its path) -> `NO`, `MAYBE` (the extension matches and the contents may) or
        `SURE`.
    open : callable
        (path, `Request`) -> `Source`. Raises ValueError if the header is invalid.
    keeps : dict of str to str
        What is read from a file, in words, for the table in the documentation: "positions", "normals", "colors",
        "attributes", "survey" (coordinate system, unit, stations), and optionally "note".
    extra : tuple of str or None
        A package that a plain install lacks, and the optional dependency group of pointray that contains it.
    write : callable or None
        (output stream with the attribute `path`, points, progress or None) -> descriptions of what the format cannot
        store. Raises ValueError if the points cannot be written at all.
    in_pieces : callable or None
        (first `HEAD` bytes of a file, `Request`) -> whether only parts of the file are needed. `open` then takes a
        `RangedFile` in place of the path of a remote file.
    written : tuple of str or None
        Extensions of the files that `write` writes; None: all.
    write_compressed : callable or None
        Like `write`, for smaller files of the same format.
    """

    name: str
    extensions: tuple[str, ...]
    recognise: Callable[[bytes, Path], int]
    open: Callable[[Path, Request], Source]
    keeps: Mapping[str, str]
    extra: tuple[str, str] | None = None
    write: Writer | None = None
    in_pieces: Callable[[bytes, Request], bool] | None = None
    written: tuple[str, ...] | None = None
    write_compressed: Writer | None = None

    @property
    def targets(self) -> tuple[str, ...]:
        """Extensions of the files that can be written."""
        return () if self.write is None else self.extensions if self.written is None else self.written
