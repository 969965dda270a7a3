"""Tables of pandas, polars and Arrow as points, and points as a pandas table."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...cloud.georeference import Georeference
from ...cloud.points import Points
from .arrays import standard_columns
from .columns import points_of_columns
from .losses import free_name, package, warn_lost

KEY = "pointray"  # of a pandas table's `attrs`: georeference, and the widths of attributes with several columns


def points_of_pandas(table: Any) -> Points:
    """Return a pandas DataFrame as points. Its `attrs` restore what `to_pandas` stored there."""
    names = _checked_names(table.columns, "DataFrame")
    columns = {name: _values(table.iloc[:, k]) for k, name in enumerate(names)}
    georeference, widths = _known(table.attrs)
    for name, width in widths.items():
        parts = [f"{name}_{k}" for k in range(width)]
        if all(part in columns for part in parts) and name not in columns:
            columns[name] = np.stack([columns.pop(part) for part in parts], axis=1)
    return points_of_columns(columns, "DataFrame", georeference)


def _known(attrs: Any) -> tuple[Georeference, dict[str, int]]:
    """Return what `to_pandas` stored in a table's `attrs`: georeference, and widths of attributes of several columns.

    Others may have stored something else there, or the coordinate system as `crs`.
    """
    with suppress(AttributeError, KeyError, TypeError, ValueError):
        known = attrs[KEY]
        return Georeference(**known["georeference"]), {str(name): int(width) for name, width in known["widths"].items()}
    with suppress(AttributeError, KeyError, TypeError, ValueError):
        return Georeference(crs=attrs["crs"]), {}
    return Georeference(), {}


def _checked_names(names: Any, what: str) -> list[str]:
    """Return the names of a table's columns as text; ValueError if two are equal. what : of the table, in messages"""
    texts = [str(name) for name in names]
    twice = next((name for k, name in enumerate(texts) if name in texts[:k]), None)
    if twice is not None:
        raise ValueError(f"{what}: several columns are called {twice!r}: rename or drop them")
    return texts


def points_of_polars(table: Any) -> Points:
    """Return a polars DataFrame as points; missing integers turn a column into floats with NaN."""
    return points_of_columns({name: table[name].to_numpy() for name in table.columns}, "DataFrame")


def points_of_arrow(table: Any) -> Points:
    """Return an Arrow Table or RecordBatch as points; missing integers turn a column into floats with NaN."""
    columns = {}
    for k, name in enumerate(_checked_names(table.schema.names, "Arrow table")):
        column = table.column(k)
        whole = column.combine_chunks() if hasattr(column, "combine_chunks") else column
        width = getattr(whole.type, "list_size", 0)  # of fixed-size lists: rows of numbers
        flat = whole.flatten() if width and not whole.null_count else whole
        values = np.asarray(flat.to_numpy(zero_copy_only=False))
        columns[name] = values.reshape(-1, width) if flat is not whole else values
    return points_of_columns(columns, "Arrow table")


def _values(column: Any) -> NDArray[Any]:
    """Return a column of a pandas table as an array; nullable numbers with missing values become floats with NaN."""
    values = column.to_numpy()
    if values.dtype != object:
        return np.asarray(values)
    kind = getattr(getattr(column, "dtype", None), "kind", "O")
    return np.asarray(column.to_numpy(dtype=np.float64, na_value=np.nan) if kind in "biuf" else values)


def to_pandas(points: Points) -> Any:
    """Return all columns of points as a pandas DataFrame; see `Points.to_pandas`."""
    pandas = package("pandas", "to_pandas")
    lost: list[str] = []
    columns, widths = standard_columns(points), {}
    for own_name, values in points.attributes.items():
        name = free_name(own_name, columns, lost)
        if values.ndim == 1:
            columns[name] = values
            continue
        widths[name] = values.shape[1]
        columns |= {free_name(f"{name}_{k}", columns, lost): values[:, k] for k in range(values.shape[1])}
    table = pandas.DataFrame(columns, copy=False)
    facts = points.georeference.facts
    if facts or widths:
        table.attrs[KEY] = {"georeference": facts, "widths": widths}
    warn_lost("to_pandas", lost)
    return table
