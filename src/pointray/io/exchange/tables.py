"""Tables of pandas, polars and Arrow as points, and points as a pandas table."""

from __future__ import annotations

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
    columns = {str(name): _values(table[name]) for name in table.columns}
    known = table.attrs.get(KEY, {}) if isinstance(table.attrs, dict) else {}
    facts = known.get("georeference", {}) if isinstance(known, dict) else {}
    crs = table.attrs.get("crs") if not facts else None
    georeference = Georeference(**facts) if facts else Georeference(crs=crs if isinstance(crs, str) else None)
    for name, width in (known.get("widths", {}) if isinstance(known, dict) else {}).items():
        parts = [f"{name}_{k}" for k in range(width)]
        if all(part in columns for part in parts) and name not in columns:
            columns[name] = np.stack([columns.pop(part) for part in parts], axis=1)
    return points_of_columns(columns, "DataFrame", georeference)


def points_of_polars(table: Any) -> Points:
    """Return a polars DataFrame as points; missing integers turn a column into floats with NaN."""
    return points_of_columns({name: table[name].to_numpy() for name in table.columns}, "DataFrame")


def points_of_arrow(table: Any) -> Points:
    """Return an Arrow Table or RecordBatch as points; missing integers turn a column into floats with NaN."""
    columns = {}
    for name in table.schema.names:
        column = table.column(name)
        whole = column.combine_chunks() if hasattr(column, "combine_chunks") else column
        columns[name] = np.asarray(whole.to_numpy(zero_copy_only=False))
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
    for name, values in points.attributes.items():
        if values.ndim == 1:
            columns[free_name(name, columns, lost)] = values
            continue
        widths[name] = values.shape[1]
        columns |= {free_name(f"{name}_{k}", columns, lost): values[:, k] for k in range(values.shape[1])}
    table = pandas.DataFrame(columns, copy=False)
    facts = points.georeference.facts
    if facts or widths:
        table.attrs[KEY] = {"georeference": facts, "widths": widths}
    warn_lost("to_pandas", lost)
    return table
