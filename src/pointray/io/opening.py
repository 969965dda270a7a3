"""Opening: the files that are read, what they announce, and their chosen rows as they come."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate
from typing import NamedTuple

from ..base.progress import Progress, tell
from ..base.warning_log import warn
from .formats._source import Chunk, Listing, Source
from .selection import Selection, lengths


class Opener(NamedTuple):
    """A file: its name for messages, and what opens it."""

    name: str
    open: Callable[[], Source]


@contextmanager
def named(name: str) -> Iterator[None]:
    """Put a file's name before its ValueError, in one line."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}: {' '.join(str(error).split())}") from error


def name_of(files: Sequence[Opener]) -> str:
    """What messages call all files together."""
    return files[0].name if len(files) == 1 else f"{len(files)} files"


def listings_of(files: Sequence[Opener]) -> list[Listing]:
    """What each file announces; ValueError names a file whose header is wrong."""
    listings = []
    for file in files:
        with named(file.name), file.open() as source:
            listings.append(source.listing)
    return listings


def announced_rows(listings: Sequence[Listing], selection: Selection) -> list[int]:
    """The rows of each file that are chosen, about, whatever filters leave of them."""
    return [-(-listing.rows // selection.every) for listing in listings]


def shares_of(listings: Sequence[Listing]) -> list[float]:
    """The share of all rows that are announced before each file, and 1."""
    rows = [listing.rows for listing in listings]
    if not sum(rows):
        rows = [1] * len(rows)
    total = sum(rows)
    return [end / total for end in accumulate(rows, initial=0)]


def chosen_of(name: str, source: Source, selection: Selection, progress: Progress | None) -> Iterator[Chunk]:
    """The chunks of a file, each with those of its rows that are chosen by all but `max_points`.

    Warns of the faults that were repaired, and of what the reader chose by itself, once.
    """
    some = False
    for chunk, start in lengths(source.chunks()):
        tell(progress, min(chunk.share, 1.0))
        some = some or len(chunk.positions) > 0
        yield selection.apply(chunk, start)
    faults = str(source.faults)
    if faults and not some:
        raise ValueError(faults)
    for text in filter(None, (faults, source.note)):
        warn(f"{name}: {text}", stacklevel=2)


def check_some(files: Sequence[Opener], selection: Selection, rows: int) -> None:
    """ValueError if no row of any file is chosen."""
    if rows:
        return
    what = "no points" if selection.is_all else "no points that are chosen"
    raise ValueError(
        f"{files[0].name}: holds {what}" if len(files) == 1 else f"none of the {len(files)} files holds {what}"
    )
