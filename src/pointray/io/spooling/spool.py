"""Spooling: scans that do not fit into memory become columns on disk, with the values that `gather` gives them.

The files are read once, and leave their columns as they have them. What is known only at the end (the origin, the
dtypes that hold all values, whether colours have 8 or 16 bits) is applied when these are read again.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.disk_columns import Columns
from ...base.progress import Progress, part_of
from ...cloud.points import check_attribute, check_count
from ..colors import ColorRange
from ..filling import Filling
from ..formats._source import Chunk, Listing
from ..joining import Part, common_survey
from ..opening import Opener, announced_rows, check_some, chosen_of, listings_of, name_of, named, shares_of
from ..selection import Selection
from .convert import Cloud, File, convert
from .spooled import ATTRIBUTE, COLORS, FACTS, NORMALS, POSITIONS, Spooled, clear, spooled_in

READ = 0.6  # the share of the time after which the files are read

__all__ = ["Spooled", "spool", "spooled_in"]


def spool(files: Sequence[Opener], selection: Selection, columns: Columns, progress: Progress | None = None) -> Spooled:
    """Read files one after the other into columns on disk; memory for a few chunks is enough.

    Rows, their order, values and warnings are those of `gather`, but rows that are not finite are left out. Columns
    of an earlier cloud are removed first, and what is unfinished if an error is raised.

    Raises
    ------
    OSError
        If the disk is full.
    ValueError
        If a file is damaged, the files have different coordinate systems, nothing is chosen, there are more than
        2^31 - 1 rows, the disk has too little room, or `selection.max_points` is given.
    """
    if selection.max_points is not None:
        raise ValueError("max_points chooses among points in memory: read them with `read`")
    listings = listings_of(files)
    clear(columns)
    with named(name_of(files)):
        _check_room(listings, selection, columns.folder)
    some = [Part(file.name, [], x.survey) for file, x in zip(files, listings, strict=True) if x.count != 0]
    if some:
        common_survey(some)  # before work, if headers tell
    try:
        cloud = Cloud(columns, {}, [])
        shares = [READ * share for share in shares_of(listings)]
        for file, begin, end in zip(files, shares[:-1], shares[1:], strict=True):
            with named(file.name):
                cloud.files.append(_read(file, selection, cloud, part_of(progress, begin, end)))
        check_some(files, selection, cloud.rows)
        with named(files[0].name) if len(files) == 1 else nullcontext():
            spooled = convert(cloud, part_of(progress, READ, 1.0))
    except BaseException:  # Ctrl-C too
        clear(columns)
        raise
    columns.put(FACTS, spooled.facts)
    return spooled


def _check_room(listings: Sequence[Listing], selection: Selection, folder: Path) -> None:
    """ValueError if rows are too many or do not fit on the disk; with filters nobody knows yet how many there are."""
    if selection.filters:
        return
    rows = announced_rows(listings, selection)
    check_count(sum(n for n, listing in zip(rows, listings, strict=True) if listing.count is not None))
    need = sum(n * listing.row for n, listing in zip(rows, listings, strict=True))
    free = shutil.disk_usage(folder).free
    if need > free:
        text = f"{sum(rows):,} points need {need / 2**30:.1f} GiB of the disk of {folder}"
        raise ValueError(f"{text}, which has {free / 2**30:.1f} GiB left")


def _read(file: Opener, selection: Selection, cloud: Cloud, progress: Progress | None) -> File:
    """Append the chosen rows of a file to raw columns; returns what is known of it when all are read."""
    heads: list[Chunk] = []
    kinds: set[tuple[np.dtype[Any], ...]] = set()
    known, begin = ColorRange(), cloud.rows
    end = begin
    with file.open() as source:
        filling = Filling(0) if selection.is_all and source.listing.count else None  # of types: there are no rows
        for chunk in chosen_of(file.name, source, selection, progress):
            rows = chunk if chunk.colors is None else chunk._replace(colors=chunk.colors[:, :3])
            if rows.colors is not None:
                known.add(rows.colors)
            head = rows.select(slice(0))
            kind = tuple(column.dtype for column in head.columns)
            if filling:
                filling.add(head)
            elif not heads or (len(rows.positions) and kind not in kinds):
                heads.append(head)
            kinds.add(kind)
            for name, column in _columns_of(rows).items():
                cloud.raw(name).add(end, column)
            end += len(rows.positions)
            check_count(end)
        part = Part(file.name, filling.chunks if filling else heads, source.listing.survey)
        return File(part, begin, end, known)


def _columns_of(chunk: Chunk) -> dict[str, NDArray[Any]]:
    """The columns of a chunk, by names that tell them apart."""
    plain = {POSITIONS: chunk.positions, NORMALS: chunk.normals, COLORS: chunk.colors}
    there = {name: column for name, column in plain.items() if column is not None}
    for name, column in chunk.attributes.items():
        check_attribute(name, column[:0], 0)
        there[ATTRIBUTE + name] = column
    return there
