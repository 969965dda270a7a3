"""Gathering: the chunks of one file or of several become one cloud."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..data import SAMPLE, Points, check_count, choose_origin
from ..memory import check_memory
from ..progress import Progress, part_of, tell
from ..survey import RESIDUAL, SCAN, Survey, numbers_of
from .colors import to_uint8
from .filling import Filling
from .formats._source import Chunk, Listing, Source
from .lacking import tell_lacking
from .selection import Selection, Thinning, lengths

READ = 0.8  # the share of the time after which files are read, and their chunks are joined
GREY = 128  # sRGB of points whose file has no colours, beside files that have
BLOCK = 1 << 15  # rows whose positions are moved at once: they stay in the processor's cache
SAFE = 2**22  # of whole numbers as large float32 loses nothing
WAYS_OUT = "read fewer points: --max-points, --every, or what `pointray prepare --tolerance` leaves on a larger machine"

Arrays = list[NDArray[Any]]


class Part(NamedTuple):
    """What is read of a file."""

    name: str
    chunks: list[Chunk]
    survey: Survey


class Opener(NamedTuple):
    """A file: its name for messages, and what opens it."""

    name: str
    open: Callable[[], Source]


def gather(files: Sequence[Opener], selection: Selection, progress: Progress | None) -> Points:
    """Read files one after the other into one cloud.

    Columns that only some files have are filled in the others: NaN in floats, 0 in whole numbers, grey, and the
    normal 0, which stands for one that is missing; a warning tells.

    Raises
    ------
    ValueError
        If a file is damaged, the files have different coordinate systems, nothing is chosen, or more memory is needed
        than is available.
    """
    listings = [_listing_of(file) for file in files]
    with named(files[0].name if len(files) == 1 else f"{len(files)} files"):
        _check_memory(listings, selection)
    known = not selection.filters and all(listing.count is not None for listing in listings)
    total = sum(listing.rows for listing in listings)
    thinning = Thinning(selection.max_points, sum(_every(x.rows, selection.every) for x in listings) if known else None)
    parts: list[Part] = []
    done = 0.0
    for file, listing in zip(files, listings, strict=True):
        share = READ * (listing.rows / total if total else 1 / len(files))
        watch = part_of(progress, done, done + share)
        with named(file.name):
            parts.append(_read(file, selection, thinning, parts, watch))
        done += share
    if not any(len(chunk.positions) for part in parts for chunk in part.chunks):
        what = "holds no points" if selection.is_all else "holds no points that are chosen"
        raise ValueError(
            f"{files[0].name}: {what}" if len(files) == 1 else f"none of the {len(files)} files {what[6:]}"
        )
    with named(files[0].name) if len(files) == 1 else nullcontext():
        return _joined(parts, part_of(progress, READ, 1.0))


@contextmanager
def named(name: str) -> Iterator[None]:
    """Put a file's name before its ValueError, in one line."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}: {' '.join(str(error).split())}") from error


def _listing_of(file: Opener) -> Listing:
    with named(file.name), file.open() as source:
        return source.listing


def _every(rows: int, every: int) -> int:
    return -(-rows // every)


def _check_memory(listings: Sequence[Listing], selection: Selection) -> None:
    """ValueError if the chosen rows do not fit into memory."""
    rows = [_every(listing.rows, selection.every) for listing in listings]
    if selection.filters:
        return  # how many are chosen is not known
    chosen = min(sum(rows), selection.max_points or sum(rows))
    check_count(chosen)
    need = int(chosen / max(sum(rows), 1) * sum(n * x.row for n, x in zip(rows, listings, strict=True)))
    _check_bytes(need, f"to read {chosen:,} points")


def _check_bytes(need: int, what: str) -> None:
    try:
        check_memory(need, what)
    except ValueError as error:
        raise ValueError(f"{error}; {WAYS_OUT}") from None


def _read(
    file: Opener, selection: Selection, thinning: Thinning, before: list[Part], progress: Progress | None
) -> Part:
    """The chosen rows of a file; `before`, the parts of earlier files, is thinned with it if there are too many."""
    chunks: list[Chunk] = []
    with file.open() as source:
        listing = source.listing
        filling = Filling(listing.count) if selection.is_all and listing.count else None
        for chunk, start in lengths(source.chunks()):
            tell(progress, min(chunk.share, 1.0))
            chosen = thinning.apply(selection.apply(chunk, start))
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
        return Part(file.name, filling.chunks if filling else chunks, source.listing.survey)


# -------------------------------------------------------------------------------------------------------- joining


def _joined(parts: list[Part], progress: Progress | None) -> Points:
    """One cloud of all parts, whose chunks are freed on the way."""
    parts = [part for part in parts if part.chunks]
    survey = _common(parts)
    scans = _scans(parts)
    counts = [[len(chunk.positions) for chunk in part.chunks] for part in parts]
    check_count(sum(map(sum, counts)))
    tell_lacking([(part.name, part.chunks[0]) for part in parts])
    normals = _column("normals", [chunk.normals for part in parts for chunk in part.chunks], counts, 0.0)
    colors = _colors(parts, counts)
    names = dict.fromkeys(name for part in parts for name in part.chunks[0].attributes)
    attributes = {}
    for k, name in enumerate(names):
        tell(progress, k / (len(names) + 2))
        columns = [chunk.attributes.get(name) for part in parts for chunk in part.chunks]
        column = _column(name, columns, counts, np.nan)
        assert column is not None
        attributes[name] = column
    if scans is not None:
        attributes[SCAN] = scans
    positions = [chunk.positions for part in parts for chunk in part.chunks]
    for part in parts:
        part.chunks.clear()
    tell(progress, 0.9)
    origin, local, residual = _about_origin(positions, survey)
    if residual is not None:
        attributes[RESIDUAL] = residual
    return Points.about(origin, local, normals, colors, attributes, survey)


def _column(
    name: str, columns: list[NDArray[Any] | None], counts: list[list[int]], missing: float
) -> NDArray[Any] | None:
    """The column of all chunks; chunks without it get a value that says so. None if no chunk has it."""
    some = [column for column in columns if column is not None]
    if not some:
        return None
    shapes = {column.shape[1:] for column in some}
    if len(shapes) > 1:
        raise ValueError(f"the attribute {name!r} has different numbers of columns in the files")
    dtype = np.result_type(*(column.dtype.newbyteorder("=") for column in some))
    flat = [count for part in counts for count in part]
    if len(some) == len(columns) == 1 and some[0].dtype == dtype:
        return some[0]
    out = np.empty((sum(flat), *shapes.pop()), dtype)
    start = 0
    for k, count in enumerate(flat):
        column, columns[k] = columns[k], None
        out[start : start + count] = column if column is not None else missing if dtype.kind == "f" else 0
        start += count
    return out


def _colors(parts: list[Part], counts: list[list[int]]) -> NDArray[np.uint8] | None:
    columns = [column for part in parts for column in _alike([chunk.colors for chunk in part.chunks])]
    made = iter(to_uint8([column[:, :3] for column in columns if column is not None]))
    bytes_or_none: list[NDArray[Any] | None] = [None if column is None else next(made) for column in columns]
    if all(column is None for column in columns):
        return None
    for k, (column, count) in enumerate(zip(columns, [n for part in counts for n in part], strict=True)):
        if column is None:
            bytes_or_none[k] = np.full((count, 3), GREY, np.uint8)
    return np.concatenate([column for column in bytes_or_none if column is not None])


def _alike(columns: Sequence[NDArray[Any] | None]) -> list[NDArray[Any] | None]:
    """A file's columns in one dtype: text may show only in a later chunk that its numbers are not whole."""
    dtypes = {column.dtype for column in columns if column is not None}
    if len(dtypes) < 2:
        return list(columns)
    return [None if column is None else column.astype(np.result_type(*dtypes)) for column in columns]


def _about_origin(
    positions: Arrays, survey: Survey
) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[Any] | None]:
    """The origin, positions about it, and what these lose of a file's whole numbers, None if nothing."""
    total = sum(map(len, positions))
    step, start, sample = -(-total // SAMPLE), 0, []
    for chunk in positions:
        sample.append(chunk[-start % step :: step].copy())  # a view would keep the chunk
        start += len(chunk)
    with np.errstate(invalid="ignore", over="ignore"):  # signalling NaNs of a damaged file
        origin = choose_origin(np.concatenate(sample), total)
    if len(positions) == 1 and positions[0].dtype == np.float32 and not origin.any():
        return origin, positions[0], None
    local, residual, end = np.empty((total, 3), np.float32), None, total
    origins = np.tile(origin, (min(BLOCK, total), 1))
    for k in reversed(range(len(positions))):  # the heap gives back memory from its end only: 120 of 420 MB
        chunk = positions[k]
        begin = end - len(chunk)
        for start in range(0, len(chunk), BLOCK):
            part = chunk[start : start + BLOCK]
            rows = slice(begin + start, begin + start + len(part))
            _localise(part, origins, local[rows])
            lost = _lost(part, local[rows], origin, survey)
            if lost is not None:
                residual = np.zeros((total, 3), np.int32) if residual is None else residual
                residual[rows] = lost
        positions[k] = np.empty((0, 3), chunk.dtype)  # an empty view would keep the chunk
        end = begin
    return origin, local, residual


def _localise(rows: NDArray[Any], origins: NDArray[np.float64], out: NDArray[np.float32]) -> None:
    """Positions about the origin, which `origins` holds for each row; rows of three would take three times as long."""
    with np.errstate(over="ignore"):  # too large a number becomes infinite: the row is not finite
        out.reshape(-1)[:] = rows.reshape(-1) - origins[: len(rows)].reshape(-1)


def _lost(
    rows: NDArray[Any], local: NDArray[np.float32], origin: NDArray[np.float64], survey: Survey
) -> NDArray[np.int64] | None:
    """What float32 loses of the whole numbers of some rows, (n, 3); None if nothing, or if the file has none."""
    if survey.scale is None:
        return None
    if max(-local.min(), local.max()) < SAFE * min(survey.scale):  # by axes it takes ten times as long
        return None
    lost = numbers_of(survey, rows) - numbers_of(survey, local + origin)
    return lost if lost.any() else None


def _common(parts: list[Part]) -> Survey:
    """What all parts say of their coordinates; ValueError if they say different things."""
    crs = _agreed({part.name: part.survey.crs for part in parts}, "coordinate systems")
    unit = _agreed({part.name: part.survey.unit for part in parts}, "units")
    stations = tuple(station for part in parts for station in part.survey.stations)
    first = parts[0].survey
    alike = first.scale is not None and all(_same_grid(first, part.survey) for part in parts[1:])
    return Survey(crs, unit, first.scale if alike else None, first.offset if alike else None, stations)


def _agreed(said: dict[str, str | None], noun: str) -> str | None:
    """The one value that files have, by their names; ValueError if there are two."""
    known: dict[str, str] = {}
    for name, value in said.items():
        if value is not None:
            known.setdefault(value, name)
    if len(known) > 1:
        (one, first), (other, second) = list(known.items())[:2]
        raise ValueError(f"{first} and {second} have different {noun}, {one[:60]!r} and {other[:60]!r}: convert one")
    return next(iter(known), None)


def _same_grid(one: Survey, other: Survey) -> bool:
    """Whether the whole numbers of one file are whole numbers of the other."""
    if one.scale is None or one.scale != other.scale:
        return False
    steps = (np.array(other.offset) - np.array(one.offset)) / np.array(one.scale)
    return bool((np.abs(steps - np.rint(steps)) < 1e-4).all())


def _scans(parts: list[Part]) -> NDArray[Any] | None:
    """The station of each row where several parts have stations, counted over all parts; None if parts are as read."""
    if len(parts) == 1 or not any(part.survey.stations for part in parts):
        return None
    rows, start = [], 0
    for part in parts:
        for chunk in part.chunks:
            own = chunk.attributes.get(SCAN, np.zeros(len(chunk.positions), np.int64))
            rows.append(np.asarray(own, np.int64) + start if part.survey.stations else np.full(len(own), -1))
        start += len(part.survey.stations)
    return np.concatenate(rows).astype(np.int32)
