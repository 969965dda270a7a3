"""Opening of files: their listings, and their selected rows chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate
from typing import NamedTuple

from ..base.progress import Progress, report_progress
from ..base.warning_log import warn
from .formats._source import Chunk, Listing, Source
from .selection import Selection, lengths


class Opener(NamedTuple):
    """A file to open: its name for messages, and the function that opens it."""

    name: str
    open: Callable[[], Source]


@contextmanager
def named(name: str) -> Iterator[None]:
    """Prefix any ValueError raised in the context with the name of a file, and join the lines of its message."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}: {' '.join(str(error).split())}") from error


def name_of(files: Sequence[Opener]) -> str:
    """Return a name for messages about one file or several: the file's name, or "3 files", for example."""
    return files[0].name if len(files) == 1 else f"{len(files)} files"


def listings_of(files: Sequence[Opener]) -> list[Listing]:
    """Open each file and return what its header announces: the number of rows, the georeference and further facts.

    A ValueError for an invalid header names the file.
    """
    listings = []
    for file in files:
        with named(file.name), file.open() as source:
            listings.append(source.listing)
    return listings


def announced_rows(listings: Sequence[Listing], selection: Selection) -> list[int]:
    """Return the number of rows of each file, exact or estimated, after selecting every n-th row.

    Other conditions of the selection are ignored.

    listings : what the header of each file announces
    """
    return [-(-listing.rows // selection.every) for listing in listings]


def shares_of(listings: Sequence[Listing]) -> list[float]:
    """Return the fraction of all expected rows that precedes each file, followed by 1, to divide a progress bar.

    listings : what the header of each file announces
    """
    rows = [listing.rows for listing in listings]
    if not sum(rows):
        rows = [1] * len(rows)
    total = sum(rows)
    return [end / total for end in accumulate(rows, initial=0)]


def selected_chunks(name: str, source: Source, selection: Selection, progress: Progress | None) -> Iterator[Chunk]:
    """Yield the chunks of an opened file, reduced to the selected rows; `selection.max_points` is ignored.

    At the end, warn once of the faults that were repaired and of the reader's automatic choices. Raise ValueError if
    there are faults and no rows.

    name : of the file, in warnings
    """
    some = False
    for chunk, start in lengths(source.chunks()):
        report_progress(progress, min(chunk.share, 1.0))
        some = some or len(chunk.positions) > 0
        yield selection.apply(chunk, start)
    faults = str(source.faults)
    if faults and not some:
        raise ValueError(faults)
    for text in filter(None, (faults, source.note)):
        warn(f"{name}: {text}", stacklevel=2)


def check_selected(files: Sequence[Opener], selection: Selection, rows: int) -> None:
    """Raise ValueError if `rows`, the number of selected rows of all files, is 0.

    files, selection : what was read, for the message
    """
    if rows:
        return
    what = "points" if selection.is_all else "selected points"
    raise ValueError(
        f"{files[0].name}: contains no {what}" if len(files) == 1 else f"none of the {len(files)} files contains {what}"
    )
