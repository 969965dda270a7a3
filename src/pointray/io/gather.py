"""Assembly of the chunks of one file or several into one cloud in memory."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.arrays import Doubles, Floats
from ..base.memory import check_memory
from ..base.progress import Progress, part_of, report_progress
from ..cloud.georeference import RESIDUAL, SCAN, Georeference
from ..cloud.points import Points, check_count
from . import joining
from .colors import GREY, ColorRange, to_shades
from .filling import Filling
from .formats._source import Chunk, Listing
from .joining import Part
from .locating import georeferenced, locate, origin_of, sample_step
from .missing_columns import warn_missing_columns
from .opening import Opener, announced_rows, check_selected, listings_of, name_of, named, selected_chunks, shares_of
from .selection import Selection, Thinning

READ = 0.8  # fraction of the time that reading takes; joining the chunks takes the rest
MEMORY_ADVICE = "read fewer points (--max-points, --every) or run `pointray prepare --tolerance` on a larger machine"

Arrays = list[NDArray[Any]]


def gather(files: Sequence[Opener], selection: Selection, progress: Progress | None) -> Points:
    """Read files one after the other into one cloud.

    A column that only some files have is filled in the others, with a warning: NaN in floats, 0 in integers, grey for
    colours, and a zero vector for normals, which marks a missing normal.

    files : name of each file, with the function that opens it

    Raises
    ------
    ValueError
        If a file is damaged, the files have different coordinate systems, no row is selected, or memory is
        insufficient.
    """
    listings = listings_of(files)
    with named(name_of(files)):
        _check_memory(listings, selection)
    known = not selection.filters and all(listing.count is not None for listing in listings)
    thinning = Thinning(selection.max_points, sum(announced_rows(listings, selection)) if known else None)
    parts: list[Part] = []
    shares = [READ * share for share in shares_of(listings)]
    for file, begin, end in zip(files, shares[:-1], shares[1:], strict=True):
        with named(file.name):
            parts.append(_read(file, selection, thinning, parts, part_of(progress, begin, end)))
    check_selected(files, selection, sum(len(chunk.positions) for part in parts for chunk in part.chunks))
    with named(files[0].name) if len(files) == 1 else nullcontext():
        return _joined(parts, part_of(progress, READ, 1.0))


def _check_memory(listings: Sequence[Listing], selection: Selection) -> None:
    """Raise ValueError if the selected rows do not fit into memory. With filters their number is unknown: no check.

    listings : what the header of each file announces
    """
    rows = announced_rows(listings, selection)
    if selection.filters:
        return  # the number of selected rows is unknown
    chosen = min(sum(rows), selection.max_points or sum(rows))
    check_count(chosen)
    need = int(chosen / max(sum(rows), 1) * sum(n * x.row for n, x in zip(rows, listings, strict=True)))
    _check_bytes(need, f"to read {chosen:,} points")


def _check_bytes(need: int, what: str) -> None:
    try:
        check_memory(need, what)
    except ValueError as error:
        raise ValueError(f"{error}; {MEMORY_ADVICE}") from None


def _read(
    file: Opener, selection: Selection, thinning: Thinning, before: list[Part], progress: Progress | None
) -> Part:
    """Read the selected rows of a file; return them as chunks, with the file's name and georeference.

    If there are more than `thinning` allows, the rows of all files so far are thinned, those in `before` in place.

    thinning : limits the number of rows of all files; before : rows of the files read earlier
    """
    chunks: list[Chunk] = []
    with file.open() as source:
        listing = source.listing
        filling = Filling(listing.count) if selection.is_all and listing.count else None
        for chunk in selected_chunks(file.name, source, selection, progress):
            chosen = thinning.apply(chunk)
            if filling:
                filling.add(chosen)
            elif len(chosen.positions) or not chunks:
                chunks.append(chosen)
            _check_bytes(listing.row * len(chosen.positions), "to read on")
            if thinning.is_over(len(chosen.positions)):
                every = [c for part in before for c in part.chunks] + chunks
                every = thinning.halve(every)
                for part in before:
                    part.chunks[:], every = every[: len(part.chunks)], every[len(part.chunks) :]
                chunks = every
        return Part(file.name, filling.chunks if filling else chunks, source.listing.georeference)


# -------------------------------------------------------------------------------------------------------- joining


def _joined(parts: list[Part], progress: Progress | None) -> Points:
    """Join the rows of all files, one part each, into one cloud; their chunks are freed as they are copied."""
    ranges = [ColorRange.of([c.colors[:, :3] for c in part.chunks if c.colors is not None]) for part in parts]
    parts = [joining.colored(part, known) for part, known in zip(parts, ranges, strict=True)]
    known = [known for part, known in zip(parts, ranges, strict=True) if part.chunks]
    parts = [part for part in parts if part.chunks]
    georeference = joining.common_georeference(parts)
    scans = _scans(parts)
    counts = [[len(chunk.positions) for chunk in part.chunks] for part in parts]
    check_count(sum(map(sum, counts)))
    warn_missing_columns([(part.name, part.chunks[0]) for part in parts])
    normals = _column("normals", [chunk.normals for part in parts for chunk in part.chunks], counts, 0)
    colors = _colors(parts, known)
    names = joining.attributes_of(parts)
    attributes = {}
    for k, name in enumerate(names):
        report_progress(progress, k / (len(names) + 2))
        columns = [chunk.attributes.get(name) for part in parts for chunk in part.chunks]
        column = _column(name, columns, counts)
        assert column is not None
        attributes[name] = column
    if scans is not None:
        attributes[SCAN] = scans
    positions = [chunk.positions for part in parts for chunk in part.chunks]
    for part in parts:
        part.chunks.clear()
    report_progress(progress, 0.9)
    origin, local, residual, georeference = _about_origin(positions, georeference)
    if residual is not None:
        attributes[RESIDUAL] = residual
    return Points.about(origin, local, normals, colors, attributes, georeference)


def _column(
    name: str, columns: list[NDArray[Any] | None], counts: list[list[int]], missing: float | None = None
) -> NDArray[Any] | None:
    """Join a column, normals or an attribute, of all chunks; return None if no chunk has it.

    columns : the column in each chunk, or None; counts : number of rows of each chunk, listed by file
    missing : value where a chunk lacks the column; None: NaN in floats, 0 in integers
    """
    kind = joining.kind_of(name, columns)
    if kind is None:
        return None
    dtype, shape = kind
    flat = [count for part in counts for count in part]
    if len(columns) == 1 and columns[0] is not None and columns[0].dtype == dtype:
        return columns[0]
    out = np.empty((sum(flat), *shape), dtype)
    start = 0
    for k, count in enumerate(flat):
        column, columns[k] = columns[k], None
        empty = joining.missing_of(dtype) if missing is None else missing
        out[start : start + count] = empty if column is None else column
        start += count
    return out


def _colors(parts: list[Part], ranges: list[ColorRange]) -> NDArray[np.uint8] | None:
    """Return the colours of all files, (n, 3); None if no file has colours. Rows of files without colours are grey.

    ranges : statistics of the colours of each file, by which its values are converted to 8 bits
    """
    columns: list[NDArray[np.uint8]] = []
    for part, known in zip(parts, ranges, strict=True):
        kind = joining.color_kind(part)
        scale = 1.0 if kind is None else known.scale(kind)
        columns += [
            np.full((len(chunk.positions), 3), GREY, np.uint8)
            if chunk.colors is None
            else to_shades(chunk.colors[:, :3], scale)
            for chunk in part.chunks
        ]
    if not any(joining.color_kind(part) is not None for part in parts):
        return None
    return columns[0] if len(columns) == 1 else np.concatenate(columns)


def _scans(parts: list[Part]) -> NDArray[np.int32] | None:
    """Return the index of each row's scanner position, counted over all files, (n,); -1 for files without one.

    Return None if rows keep the indices of their file: there is only one, or no file has scanner positions.
    """
    firsts = joining.first_stations(parts)
    if firsts is None:
        return None
    chunks = [(chunk, first) for part, first in zip(parts, firsts, strict=True) for chunk in part.chunks]
    return np.concatenate([joining.scans_of(x.attributes.get(SCAN), len(x.positions), first) for x, first in chunks])


def _about_origin(
    positions: Arrays, georeference: Georeference
) -> tuple[Doubles, Floats, NDArray[Any] | None, Georeference]:
    """Choose an origin; return it, the positions relative to it, the rounding errors, and the georeference.

    The rounding errors, (n, 3) int32, are the steps of a file's integer coordinates that float32 loses; None if nothing
    is lost. The georeference may have a local projection added. `positions` is emptied, to free memory.

    positions : world coordinates of all rows, in pieces
    """
    total = sum(map(len, positions))
    step, start, sample = sample_step(total), 0, []
    for chunk in positions:
        sample.append(chunk[-start % step :: step].copy())  # a view would keep the chunk
        start += len(chunk)
    georeference, sample = georeferenced(sample, georeference)
    origin = origin_of(sample, total)
    plain = georeference.projection is None and not origin.any()
    if plain and len(positions) == 1 and positions[0].dtype == np.float32:
        return origin, positions[0], None, georeference
    local, residual, end = np.empty((total, 3), np.float32), None, total
    for k in reversed(range(len(positions))):  # malloc returns memory from the end of its heap: saves 120 of 420 MB
        chunk = positions[k]
        begin = end - len(chunk)
        for rows, lost in locate(chunk, origin, georeference, local[begin:end]):
            residual = np.zeros((total, 3), np.int32) if residual is None else residual
            residual[begin:end][rows] = lost
        positions[k] = np.empty((0, 3), chunk.dtype)  # an empty view would keep the chunk
        end = begin
    return origin, local, residual, georeference
