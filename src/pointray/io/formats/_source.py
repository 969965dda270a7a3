"""What a format's reader gives: an opened file lists what it holds, then yields its rows in chunks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import Progress
from ...cloud.georeference import Survey
from ...cloud.points import Points

CHUNK = 1 << 18  # rows of a chunk, about
HEAD = 1 << 12  # bytes of a file's beginning from which its format is recognised
NO, MAYBE, SURE = range(3)  # how certain a format recognises a file: by what people call such files, by its contents


class Request(NamedTuple):
    """What a caller asks of a file beyond its rows; a format ignores what does not concern it.

    Attributes
    ----------
    columns : tuple of str or None
        Names of the columns of a text file, "-" for one to leave out; None: recognised.
    bounds : (2, 3) float64 or None
        World box: a format may leave out what lies outside, its caller does so anyway.
    resolution : float or None
        The coarsest spacing that will do, in the file's unit: formats with levels of detail (COPC) stop there.
    sample : int or None
        Points to scatter on the triangles of a mesh; 0: its vertices; None: whichever shows its surface.
    opacity : float
        Splats of less opacity are left out (3D Gaussian splatting).
    intrinsics : tuple of float or None
        fx, fy, cx, cy of a depth picture, pixels; a fifth number is the depth's unit: so many to a metre.
    strict : bool
        Refuse files that contradict themselves, are cut off or lack a file that they name; otherwise what is there is
        read, with a warning.
    """

    columns: tuple[str, ...] | None = None
    bounds: NDArray[np.float64] | None = None
    resolution: float | None = None
    sample: int | None = None
    opacity: float = 0.1
    intrinsics: tuple[float, ...] | None = None
    strict: bool = False


class Chunk(NamedTuple):
    """Some rows of a file. All chunks of a file have the same columns; only text may need wider dtypes in later ones.

    Attributes
    ----------
    positions : (m, 3) array of floats or whole numbers
        World coordinates.
    normals : (m, 3) array of floats or None
    colors : (m, 3) array or None
        sRGB as the file has it: 8 bits, 16 bits, 8 bits in a wider type, or floats from 0 to 1.
    attributes : dict of str to (m,) or (m, k) array
    share : float
        The share of the file that has been read, 0 to 1.
    """

    positions: NDArray[Any]
    normals: NDArray[Any] | None = None
    colors: NDArray[Any] | None = None
    attributes: Mapping[str, NDArray[Any]] = {}
    share: float = 1.0

    @property
    def columns(self) -> list[NDArray[Any]]:
        """All columns that are there, in the order of `each`."""
        there = [column for column in (self.positions, self.normals, self.colors) if column is not None]
        return [*there, *self.attributes.values()]

    def select(self, rows: NDArray[Any] | slice) -> Chunk:
        """The same columns of fewer rows, in arrays of their own, so that larger ones become free."""
        return self.each(lambda column: column[rows].copy() if isinstance(rows, slice) else column[rows])

    def each(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Chunk:
        """The same columns, each of them changed."""
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
        Number of rows; None: known only when all are read. It is checked against the file's size. Fewer may come of a
        text that is cut off.
    expected : int
        About how many rows there are, if `count` is None.
    row : int
        Bytes that a row of all columns takes in memory while it is read.
    survey : Survey
        May be completed while rows are read: take it at the end.
    facts : dict
        What `info` tells of the file besides, in values of JSON: "version", "software", "scans".
    """

    count: int | None
    row: int
    expected: int = 0
    survey: Survey = Survey()
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """How many rows there are, about."""
        return self.expected if self.count is None else self.count


class Faults:
    """Faults of a file that its reader repairs. A strict reader refuses the file instead.

    Parameters
    ----------
    strict : bool
    """

    def __init__(self, strict: bool) -> None:
        self.strict = strict
        self._found: list[str] = []

    def add(self, message: str) -> None:
        """Record a fault that is repaired; ValueError with this message if the reader is strict."""
        if self.strict:
            raise ValueError(message)
        if message not in self._found:
            self._found.append(message)

    def __str__(self) -> str:
        return "; ".join(self._found)


class Source(ABC):
    """An opened file. It is closed at the end of `with`.

    Attributes
    ----------
    listing : Listing
    faults : Faults
        Complete when all rows have been read.
    note : str
        What the reader chose by itself, and how to choose otherwise; known when all rows have been read.
    """

    listing: Listing
    faults = Faults(strict=True)  # of a format that finds none
    note: str = ""

    @abstractmethod
    def chunks(self) -> Iterator[Chunk]:
        """The rows in the file's order, once. ValueError says what is wrong with the contents, and where."""

    def close(self) -> None:  # noqa: B027  # a file that is read at once has nothing to close
        """Close what is open."""

    def __enter__(self) -> Source:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class Whole(Source):
    """A file that is read at once, by a library that cannot do it in parts."""

    def __init__(self, listing: Listing, load: Callable[[], Chunk]) -> None:
        self.listing, self._load = listing, load

    def chunks(self) -> Iterator[Chunk]:
        yield self._load()


Writer = Callable[[Any, Points, Progress | None], list[str]]


@dataclass(frozen=True)
class Format:
    """A format of files: each file of this folder has one, called FORMAT.

    Attributes
    ----------
    name : str
        What people call it.
    extensions : tuple of str
        Those that its files usually have, with the dot, in lower case; the first one is the most usual.
    recognise : callable
        Given the first `HEAD` bytes of a file and its path: `NO`, `MAYBE` (the extension says so and the contents may
        be) or `SURE`.
    open : callable
        Given a path and a `Request`: the `Source`. ValueError says what is wrong with the header.
    keeps : dict of str to str
        What is kept of a file, in words, for the table in the documents: "positions", "normals", "colors",
        "attributes", "survey" (coordinate system, unit, stations), and perhaps "note".
    extra : tuple of str or None
        A package that is not part of a plain install, and the extra of pointray that brings it.
    write : callable or None
        Given a stream (a `Replacement`), points and perhaps a progress: writes them; returns what the format cannot
        hold, in words. ValueError says what it cannot write at all.
    """

    name: str
    extensions: tuple[str, ...]
    recognise: Callable[[bytes, Path], int]
    open: Callable[[Path, Request], Source]
    keeps: Mapping[str, str]
    extra: tuple[str, str] | None = None
    write: Writer | None = None
