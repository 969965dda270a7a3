"""Conversion of hits to `Points` and to tables of pandas."""

from __future__ import annotations

import importlib
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.executor import is_chunked
from ..base.extras import MissingPackageError
from ..cloud.points import Points
from ..image.tone import linear_to_srgb

FIELDS = "t", "position", "normal", "color", "point", "instance"
POSITION, NORMAL, COLOR = ("x", "y", "z"), ("nx", "ny", "nz"), ("red", "green", "blue")


def points_of(hits: Any) -> Points:
    """Return `Hits` as points, see `Hits.to_points`."""
    flat, own_attributes = _columns_of(hits)
    rows = np.flatnonzero(flat["instance"] >= 0)
    if not len(rows):
        raise ValueError(f"no ray of {len(flat['t']):,} hits anything: there are no points")
    attributes = {"t": flat["t"][rows], "ray": rows}
    attributes |= {name: flat[name][rows] for name in ("point", "instance")}
    for name, values in own_attributes.items():
        attributes[_free(name, attributes)] = values[rows]
    color = flat["color"][rows]
    colors = None if (color == 1).all() else _srgb(color)
    return Points(flat["position"][rows], normals=flat["normal"][rows], colors=colors, attributes=attributes)


def table_of(hits: Any) -> Any:
    """Return `Hits` as a table of pandas, see `Hits.to_pandas`."""
    pandas = require_package("pandas", "Hits.to_pandas")
    flat, attributes = _columns_of(hits)
    columns: dict[str, NDArray[Any]] = {"t": flat["t"]}
    columns |= dict(zip(POSITION, flat["position"].T, strict=True))
    columns |= dict(zip(NORMAL, flat["normal"].T, strict=True))
    columns |= dict(zip(COLOR, _srgb(flat["color"]).T, strict=True))
    columns |= {name: flat[name] for name in ("point", "instance")}
    for name, own in attributes.items():
        several = own.ndim > 1
        for k, column in enumerate(own.T if several else [own]):
            columns[_free(f"{name}_{k}" if several else name, columns)] = column
    return pandas.DataFrame(columns, index=pandas.RangeIndex(len(flat["t"]), name="ray"))


def require_package(module: str, what: str) -> Any:
    """Import and return a package that is no part of an extra; if missing, raise an error with the `pip` command.

    what : what needs it; the message begins with it
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingPackageError(f"{what} needs {module}: pip install {module}") from None


def _columns_of(hits: Any) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """Return the fields of hits, and their attributes, with one row for each ray.

    All Dask arrays are computed together, so that rays are traced once.
    """
    arrays: list[Any] = [*(getattr(hits, name) for name in FIELDS), *hits.attributes.values()]
    if is_chunked(*arrays):
        arrays = list(sys.modules["dask"].compute(*arrays))
    axes = np.ndim(arrays[0])
    flat = [array.reshape(-1, *array.shape[axes:]) for array in map(np.asarray, arrays)]
    fields = len(FIELDS)
    return dict(zip(FIELDS, flat[:fields], strict=True)), dict(zip(hits.attributes, flat[fields:], strict=True))


def _free(name: str, taken: dict[str, Any]) -> str:
    """Return the name of an attribute, with an underscore if a field of the hits has that name."""
    while name in taken:
        name += "_"
    return name


def _srgb(color: NDArray[Any]) -> NDArray[np.uint8]:
    return np.asarray(np.rint(255 * linear_to_srgb(color)), np.uint8)
