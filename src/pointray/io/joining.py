"""Properties that the parts of a cloud, read from different files, must share: types, coordinates, stations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.warning_log import warn
from ..cloud.georeference import Georeference
from .colors import ColorRange
from .formats._source import Chunk

NO_SCAN = -1  # station of points from files without stations, if other files have stations

Column = NDArray[Any]


class Part(NamedTuple):
    """Rows read from one file, with its name and georeference.

    chunks : may have zero rows, to carry the types of the columns only
    """

    name: str
    chunks: list[Chunk]
    georeference: Georeference


def attributes_of(parts: Sequence[Part]) -> list[str]:
    """Return the names of all attributes of the files, without duplicates, in order of first appearance."""
    return list(dict.fromkeys(name for part in parts for name in part.chunks[0].attributes))


def kind_of(name: str, columns: Sequence[Column | None]) -> tuple[np.dtype[Any], tuple[int, ...]] | None:
    """Return the dtype and the row shape, () or (k,), that hold the values of all chunks; None if no chunk has them.

    Raise ValueError if the shapes differ.

    name : of an attribute, for the message; columns : the column in each chunk, or None
    """
    some = [column for column in columns if column is not None]
    if not some:
        return None
    shapes = {column.shape[1:] for column in some}
    if len(shapes) > 1:
        raise ValueError(f"attribute {name!r} has different numbers of columns in the files")
    return np.result_type(*(column.dtype.newbyteorder("=") for column in some)), shapes.pop()


def missing_of(dtype: np.dtype[Any]) -> float:
    """Return the value of an attribute in the rows of files that lack it: NaN for floats, 0 for other types."""
    return np.nan if dtype.kind == "f" else 0


def in_common_dtype(columns: Sequence[Column | None]) -> list[Column | None]:
    """Return the column of each chunk of a file in one dtype that holds all values; None stays None.

    In text, a later chunk may be the first with a fraction, and its dtype is then a float.
    """
    dtypes = {column.dtype for column in columns if column is not None}
    if len(dtypes) < 2:
        return list(columns)
    return [None if column is None else column.astype(np.result_type(*dtypes)) for column in columns]


# --------------------------------------------------------------------------------------------------------- colours


def color_kind(part: Part) -> np.dtype[Any] | None:
    """Return the dtype that holds all colours of a file; None if it has none."""
    columns = [column for column in in_common_dtype([chunk.colors for chunk in part.chunks]) if column is not None]
    return columns[0].dtype.newbyteorder("=") if columns else None


def colored(part: Part, known: ColorRange) -> Part:
    """Warn of what the conversion of a file's colours changes; return its rows, without colours if all are zero or NaN.

    known : statistics of the colours
    """
    kind = color_kind(part)
    if kind is None:
        return part
    if known.is_empty:
        note = "all colours are zero or missing: they are ignored"
        part = part._replace(chunks=[chunk._replace(colors=None) for chunk in part.chunks])
    else:
        note = known.note(kind)
    if note:
        warn(f"{part.name}: {note}", stacklevel=2)
    return part


# -------------------------------------------------------------------------------------------------- georeferences


def common_georeference(parts: Sequence[Part]) -> Georeference:
    """Return the georeference of several files together, with the scanner positions of all.

    Raise ValueError if coordinate systems or units differ. Scale and offset of integer coordinates are kept if
    all files round coordinates to the same grid.
    """
    crs = _common_value({part.name: part.georeference.crs for part in parts}, "coordinate systems")
    unit = _common_value({part.name: part.georeference.unit for part in parts}, "units")
    stations = tuple(station for part in parts for station in part.georeference.stations)
    first = parts[0].georeference
    same = first.scale is not None and all(_same_grid(first, part.georeference) for part in parts[1:])
    grid = (first.scale, first.offset) if same else (None, None)
    formats = {part.georeference.format for part in parts}
    return Georeference(crs, unit, *grid, stations, format=formats.pop() if len(formats) == 1 else None)


def _common_value(stated: dict[str, str | None], noun: str) -> str | None:
    """Return the one value that the files state, None if no file states any; raise ValueError if there are two.

    stated : value or None by file name; noun : what the values are, in the message
    """
    known: dict[str, str] = {}
    for name, value in stated.items():
        if value is not None:
            known.setdefault(value, name)
    if len(known) > 1:
        (one, first), (other, second) = list(known.items())[:2]
        raise ValueError(f"{first} and {second} have different {noun}, {one[:60]!r} and {other[:60]!r}: convert one")
    return next(iter(known), None)


def _same_grid(one: Georeference, other: Georeference) -> bool:
    """Whether two files round coordinates alike: to integers of the same scale, with offsets whole steps apart."""
    if one.scale is None or one.scale != other.scale:
        return False
    steps = (np.array(other.offset) - np.array(one.offset)) / np.array(one.scale)
    return bool((np.abs(steps - np.rint(steps)) < 1e-4).all())


# --------------------------------------------------------------------------------------------------------- stations


def first_stations(parts: Sequence[Part]) -> list[int | None] | None:
    """Return the index of each file's first scanner position, counted over all files; None for a file without any.

    Return None instead of a list if rows keep the indices of their file: there is only one, or no file has scanner
    positions.
    """
    if len(parts) == 1 or not any(part.georeference.stations for part in parts):
        return None
    ends = np.cumsum([len(part.georeference.stations) for part in parts]).tolist()
    return [
        end - len(p.georeference.stations) if p.georeference.stations else None
        for p, end in zip(parts, ends, strict=True)
    ]


def scans_of(own: Column | None, rows: int, first: int | None) -> NDArray[np.int32]:
    """Return the index of each row's scanner position, counted over all files, (rows,), for the rows of one file.

    own : (rows,), index among the positions of this file, negative if unknown; None if it has only one
    first : index of the file's first position, counted over all files; None if it has none: all rows get -1
    """
    if first is None:
        return np.full(rows, NO_SCAN, np.int32)
    if own is None:
        return np.full(rows, first, np.int32)
    index = np.asarray(own, np.int64)
    return np.where(index < 0, NO_SCAN, index + first).astype(np.int32)
