"""Columns in memory as a `Source`: they become points exactly as the columns of a file do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.warning_log import warn
from ...cloud.geographic import in_file
from ...cloud.georeference import Georeference
from ...cloud.points import Points
from ..formats._named_columns import Columns, own, roles_of, stack
from ..formats._source import Chunk, Listing, Source
from ..gather import gather
from ..opening import Opener
from ..selection import Selection, Thinning

ROW = "row\0"  # column with row numbers, whose name no attribute of a file has
MOST_NAMES = 5  # names that a warning lists


class ColumnSource(Source):
    """Columns in memory, read as one chunk.

    chunk : the columns; georeference : coordinate system, unit and scanner positions
    """

    def __init__(self, chunk: Chunk, georeference: Georeference) -> None:
        self._chunk = chunk
        row = sum(column.nbytes for column in chunk.columns) // max(len(chunk.positions), 1)
        # The count is None: otherwise the rows are copied into arrays of this length.
        self.listing = Listing(None, row, len(chunk.positions), georeference)

    def chunks(self) -> Iterator[Chunk]:
        """Yield all rows at once."""
        yield self._chunk


def selected(points: Points, selection: Selection) -> Points:
    """Return the points that a selection chooses, as if they were read from a file; they themselves if it is all.

    Raises
    ------
    ValueError
        If no point is selected, or there is no attribute of a name in the selection.
    """
    if selection.is_all:
        return points
    columns = {**points.attributes, ROW: np.arange(len(points))}
    chosen = selection.apply(Chunk(in_file(points.georeference, points.world), attributes=columns), 0)
    if not len(chosen.positions):
        raise ValueError("points: contains no selected points")
    return points.select(Thinning(selection.max_points, len(chosen.positions)).apply(chosen).attributes[ROW])


def points_of_chunk(chunk: Chunk, what: str, georeference: Georeference | None = None) -> Points:
    """Return columns whose roles are known as points; arrays of the right dtype and layout are not copied.

    what : name of the object in messages, such as "DataFrame"

    Raises
    ------
    ValueError
        If the lengths of the columns differ, there are no rows, or a shape, dtype or value is wrong.
    """
    n, known = len(chunk.positions), georeference or Georeference()
    for name, column in [("normals", chunk.normals), ("colors", chunk.colors), *chunk.attributes.items()]:
        if column is not None and len(column) != n:
            raise ValueError(f"{what}: {name} has {len(column):,} rows, positions have {n:,}")
    for name, column, widths in (("normals", chunk.normals, (3,)), ("colors", chunk.colors, (3, 4))):
        if column is not None and (column.ndim != 2 or column.shape[1] not in widths or column.dtype.kind not in "iuf"):
            raise ValueError(f"{what}: {name} must be numbers of the shape (n, 3), not {column.dtype} {column.shape}")
    # A projection has been applied already: the positions are metres, not the degrees of the coordinate system.
    source = ColumnSource(chunk, known if known.projection is None else Georeference())
    points = gather([Opener(what, lambda: source)], Selection(), None)
    return points if known.projection is None else points.changed(georeference=known)


def points_of_columns(
    columns: Mapping[Any, NDArray[Any]], what: str, georeference: Georeference | None = None
) -> Points:
    """Return named columns, (n,) or (n, k) arrays, as points; their roles are found by name as in files.

    Columns that hold no numbers are left out, with a warning.
    """
    numbers = _numeric(columns, what)
    lengths = {name: len(column) for name, column in numbers.items()}
    if len(set(lengths.values())) > 1:
        some = {length: f"{name} has {length:,} rows" for name, length in lengths.items()}
        raise ValueError(f"{what}: columns of different lengths: {', '.join(list(some.values())[:MOST_NAMES])}")
    try:
        roles = roles_of(_types(numbers))
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from None
    return points_of_chunk(roles.chunk(numbers, 1.0), what, georeference)


def named_points(
    positions: NDArray[Any], others: Mapping[Any, NDArray[Any]], what: str, georeference: Georeference | None = None
) -> Points:
    """Return points with these positions, (n, 3); the roles of the other columns are found by name."""
    numbers = _numeric(others, what)
    types = {name: kind for name, kind in _types(numbers).items() if name.lower() not in ("x", "y", "z")}
    roles = roles_of({**{axis: (np.dtype(np.float32), 0) for axis in "xyz"}, **types})
    normals, colors = (
        stack([numbers[name] for name in names]) if names else None for names in (roles.normals, roles.colors)
    )
    taken = {*roles.normals, *roles.colors}
    attributes = {name: own(column) for name, column in numbers.items() if name not in taken}
    return points_of_chunk(Chunk(own(positions), normals, colors, attributes), what, georeference)


def _types(columns: Columns) -> dict[str, tuple[np.dtype[Any], int]]:
    """Return the dtype and the width of each column; width 0 for (n,) arrays."""
    return {name: (column.dtype, column.shape[1] if column.ndim > 1 else 0) for name, column in columns.items()}


def _numeric(columns: Mapping[Any, NDArray[Any]], what: str) -> Columns:
    """Return the columns that hold one number or one row of numbers for each point; warn about all others."""
    numbers: Columns = {}
    left: list[str] = []
    for name, column in columns.items():
        if column.dtype.kind in "biuf" and column.ndim in (1, 2) and str(name):
            numbers[str(name)] = column
        else:
            left.append(f"{name} ({column.dtype}{'' if column.ndim == 1 else f' {column.shape}'})")
    if left:
        more = f" and {len(left) - MOST_NAMES:,} more" if len(left) > MOST_NAMES else ""
        warn(f"{what}: left out, as they are no columns of numbers: {', '.join(left[:MOST_NAMES])}{more}", stacklevel=2)
    return numbers
