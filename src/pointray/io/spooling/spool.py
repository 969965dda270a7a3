"""Spooling: scans too large for memory are read into columns on disk, with the same values as `gather` produces.

The files are read once, and their columns are stored unchanged. What is known only at the end (the origin, the common
dtypes, whether colours have 8 or 16 bits) is applied in a second pass over the columns.
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
from ..joining import Part, common_georeference
from ..opening import Opener, announced_rows, check_selected, listings_of, name_of, named, selected_chunks, shares_of
from ..selection import Selection
from .convert import Cloud, File, convert
from .spooled import ATTRIBUTE, COLORS, FACTS, NORMALS, POSITIONS, Spooled, clear, spooled_in

READ = 0.6  # fraction of the time that reading the files takes

__all__ = ["Spooled", "spool", "spooled_in"]


def spool(files: Sequence[Opener], selection: Selection, columns: Columns, progress: Progress | None = None) -> Spooled:
    """Read files one after the other into columns on disk; only a few chunks are held in memory.

    Rows, their order, values and warnings are those of reading into memory, except that rows that are not finite are
    left out. Columns of an earlier cloud are removed first, and unfinished ones if an error is raised.

    files : name of each file, with the function that opens it; columns : folder for the columns on disk

    Raises
    ------
    OSError
        If the disk is full.
    ValueError
        If a file is damaged, the files have different coordinate systems, no row is selected, there are more than
        2^31 - 1 rows, there is too little disk space, or `selection.max_points` is given.
    """
    if selection.max_points is not None:
        raise ValueError("max_points is unsupported when points are stored on disk: read them with `read`")
    listings = listings_of(files)
    clear(columns)
    with named(name_of(files)):
        _check_disk_space(listings, selection, columns.folder)
    some = [Part(file.name, [], x.georeference) for file, x in zip(files, listings, strict=True) if x.count != 0]
    if some:
        common_georeference(some)  # detects a conflict from the headers, before any row is read
    try:
        cloud = Cloud(columns, {}, [])
        shares = [READ * share for share in shares_of(listings)]
        for file, begin, end in zip(files, shares[:-1], shares[1:], strict=True):
            with named(file.name):
                cloud.files.append(_read(file, selection, cloud, part_of(progress, begin, end)))
        check_selected(files, selection, cloud.rows)
        with named(files[0].name) if len(files) == 1 else nullcontext():
            spooled = convert(cloud, part_of(progress, READ, 1.0))
    except BaseException:  # Ctrl-C too
        clear(columns)
        raise
    columns.put(FACTS, spooled.facts)
    return spooled


def _check_disk_space(listings: Sequence[Listing], selection: Selection, folder: Path) -> None:
    """Raise ValueError if there are too many rows or too little disk space. With filters their number is unknown.

    listings : what the header of each file announces; folder : on the disk to be used
    """
    if selection.filters:
        return
    rows = announced_rows(listings, selection)
    check_count(sum(n for n, listing in zip(rows, listings, strict=True) if listing.count is not None))
    need = sum(n * listing.row for n, listing in zip(rows, listings, strict=True))
    free = shutil.disk_usage(folder).free
    if need > free:
        text = f"{sum(rows):,} points need {need / 2**30:.1f} GiB of disk space in {folder}"
        raise ValueError(f"{text}, only {free / 2**30:.1f} GiB are free")


def _read(file: Opener, selection: Selection, cloud: Cloud, progress: Progress | None) -> File:
    """Append the selected rows of a file to the cloud on disk; return its types, row range and colour statistics."""
    heads: list[Chunk] = []
    kinds: set[tuple[np.dtype[Any], ...]] = set()
    known, begin = ColorRange(), cloud.rows
    end = begin
    with file.open() as source:
        filling = Filling(0) if selection.is_all and source.listing.count else None  # collects types only, no rows
        for chunk in selected_chunks(file.name, source, selection, progress):
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
        part = Part(file.name, filling.chunks if filling else heads, source.listing.georeference)
        return File(part, begin, end, known)


def _columns_of(chunk: Chunk) -> dict[str, NDArray[Any]]:
    """Return the columns of a chunk by name: "positions", "normals", "colors", and "attribute." + name for others."""
    plain = {POSITIONS: chunk.positions, NORMALS: chunk.normals, COLORS: chunk.colors}
    there = {name: column for name, column in plain.items() if column is not None}
    for name, column in chunk.attributes.items():
        check_attribute(name, column[:0], 0)
        there[ATTRIBUTE + name] = column
    return there
