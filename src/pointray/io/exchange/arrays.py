"""NumPy arrays, plain and structured, and arrays of other libraries: PyTorch, JAX, CuPy, TensorFlow."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...cloud.points import Points
from .columns import points_of_columns
from .losses import free_name, lost_georeference, warn_lost

STANDARD = ("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue")


def array_of(x: Any) -> NDArray[Any]:
    """Return an object with `__array__` or `__dlpack__`, or nested sequences of numbers, as a NumPy array.

    Memory on the CPU is shared. Raise ValueError if it is elsewhere, or the rows have different lengths.
    """
    if isinstance(x, np.ma.MaskedArray):
        return _unmasked(x)
    if isinstance(x, np.ndarray):
        return x
    try:
        if hasattr(x, "__dlpack__") and not hasattr(x, "__array__"):
            return np.from_dlpack(x)
        return np.asarray(x)
    except (TypeError, ValueError, BufferError, RuntimeError) as error:
        # PyTorch: memory of a graphics card, or a tensor that requires gradients.
        detach = getattr(x, "detach", None)
        if detach is None:
            raise ValueError(f"not an array of numbers: {error}") from None
        return np.asarray(detach().cpu())


def _unmasked(x: Any) -> NDArray[Any]:
    """Return a masked array as a plain one; masked numbers become NaN."""
    if x.dtype.names is not None or not np.ma.is_masked(x):
        return np.asarray(x.data)
    return np.asarray(x.astype(np.float64).filled(np.nan))


def points_of_array(x: Any) -> Points:
    """Return an (n, 3) array_like of positions, or a structured array with fields such as x, y, z, red, as points."""
    array = x if isinstance(x, np.ma.MaskedArray) and x.dtype.names is not None else array_of(x)
    if array.dtype.names is not None:
        rows = np.ravel(array)
        return points_of_columns({name: array_of(rows[name]) for name in array.dtype.names}, "structured array")
    return Points(array)


def to_structured(points: Points) -> NDArray[Any]:
    """Return all columns of points as an (n,) structured array; see `Points.to_structured`."""
    lost = lost_georeference(points.georeference)
    columns = standard_columns(points)
    for name, values in points.attributes.items():
        columns[free_name(name, columns, lost)] = values
    out = np.empty(len(points), [(name, column.dtype, column.shape[1:]) for name, column in columns.items()])
    for name, column in columns.items():
        out[name] = column
    warn_lost("to_structured", lost)
    return out


def standard_columns(points: Points) -> dict[str, NDArray[Any]]:
    """Return positions (world), normals and colours as columns x, y, z, nx, ny, nz, red, green and blue."""
    world = points.world
    columns: dict[str, NDArray[Any]] = {axis: world[:, k] for k, axis in enumerate("xyz")}
    for names, values in ((STANDARD[3:6], points.normals), (STANDARD[6:], points.colors)):
        if values is not None:
            columns |= {name: values[:, k] for k, name in enumerate(names)}
    return columns
